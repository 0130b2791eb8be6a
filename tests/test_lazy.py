"""open3d imports on a machine without libusb."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def test_open3d_imports_and_works() -> None:
    script = (
        "from fgloc.lazy import import_open3d\n"
        "o3d = import_open3d()\n"
        "assert import_open3d() is o3d\n"
        "import open3d\n"
        "assert open3d is o3d\n"
        # Corners of a unit cube: the compiled part must answer, not only import.
        "cube = o3d.geometry.TriangleMesh.create_box(1.0, 1.0, 1.0)\n"
        "print(cube.get_volume())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, cwd=ROOT, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert abs(float(done.stdout.splitlines()[-1]) - 1.0) < 1e-12


def test_missing_library_is_one_clear_line() -> None:
    script = (
        "import sys\n"
        "class Refuse:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'libusb_package': raise ImportError('refused')\n"
        "        if name == 'open3d': raise ImportError('libusb-1.0.so.0: cannot open')\n"
        "sys.meta_path.insert(0, Refuse())\n"
        "from fgloc.errors import FglocError\n"
        "from fgloc.lazy import import_open3d\n"
        "try:\n"
        "    import_open3d()\n"
        "except FglocError as error:\n"
        "    print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, cwd=ROOT, timeout=60
    )
    assert done.stdout.startswith("open3d cannot be imported (refused); `fgloc doctor`")
