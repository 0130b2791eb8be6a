"""Where results will go, looked at before hours of work rather than after."""

from __future__ import annotations

import os
from pathlib import Path

from fgloc.errors import FglocError


def check_file(path: Path | None) -> None:
    """Raise FglocError if a file cannot be made at `path`; nothing is created, None is fine."""
    if path is None:
        return
    if path.is_dir():
        raise FglocError("is a folder; give the name of a file", file=path)
    _check_folder(path, path.parent)


def check_folder(path: Path | None) -> None:
    """Raise FglocError if `path` is no folder and cannot become one; None is fine."""
    if path is not None:
        _check_folder(path, path)


def _check_folder(wanted: Path, folder: Path) -> None:
    """Raise FglocError unless `folder`, or the nearest above it that exists, can be written."""
    # Not resolved: `x/..` of a missing x would count as there.
    for existing in (folder, *folder.parents):
        if not existing.exists():
            continue
        if not existing.is_dir():
            raise FglocError(f"{existing} is not a folder; choose another place", file=wanted)
        if not os.access(existing, os.W_OK | os.X_OK):
            raise FglocError(f"no permission to write in {existing}; choose another", file=wanted)
        return
