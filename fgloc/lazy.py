"""Heavy libraries, imported only when needed and helped where they fail by themselves."""

from __future__ import annotations

import ctypes
import importlib
import sys
from typing import Any

from fgloc.errors import FglocError


def import_open3d() -> Any:
    """Return the module open3d (about two seconds the first time, then nothing).

    Its compiled part needs libusb-1.0 at load time (for depth cameras), which a bare machine does
    not have. Where that is the reason of a failed import, the library that comes with the package
    libusb-package is loaded for the whole process, and the import tried again. Raises FglocError
    with what to do if open3d still cannot be imported.
    """
    try:
        return importlib.import_module("open3d")
    except (ImportError, OSError) as first:
        if "libusb" not in str(first):
            raise _unusable(first) from first
    try:
        _load_libusb()
        # A failed import leaves the submodules that did load; they would hide the rest.
        for name in [m for m in sys.modules if m.partition(".")[0] == "open3d"]:
            del sys.modules[name]
        return importlib.import_module("open3d")
    except (ImportError, OSError) as error:
        raise _unusable(error) from error


def import_rerun() -> Any:
    """Return the module rerun; raises FglocError with what to do where it is not installed."""
    try:
        return importlib.import_module("rerun")
    except (ImportError, OSError) as error:
        raise FglocError(
            f"the viewer cannot be imported ({error}); `pip install 'fgloc[viz]'` installs it, or "
            "use --html FILE, a page for any browser that needs nothing"
        ) from error


def _load_libusb() -> None:
    """Load libusb so that libraries loaded later find it; ImportError or OSError if it cannot be.

    The loader resolves a needed library by the name stored in an already loaded one, so loading
    it from any folder is enough; RTLD_GLOBAL makes its symbols visible to them.
    """
    libusb_package = importlib.import_module("libusb_package")
    path = libusb_package.get_library_path()
    if path is None:
        raise ImportError("libusb_package holds no libusb-1.0 for this platform")
    ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)


def _unusable(error: Exception) -> FglocError:
    """Return the one-line error for an open3d that cannot be imported."""
    return FglocError(
        f"open3d cannot be imported ({error}); `fgloc doctor` shows what is missing, "
        "and `pip install --force-reinstall open3d libusb-package` mends a broken installation"
    )
