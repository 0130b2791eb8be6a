"""Points of a map as a PLY file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fgloc.atomic import atomic_path
from fgloc.core.measurements import Floats
from fgloc.errors import FglocError
from fgloc.lazy import import_open3d


def write_ply(points: Floats, path: Path) -> Path:
    """Write points (N, 2) [m] as binary PLY with z = 0, atomically; return the path.

    Raises FglocError if open3d cannot be imported, or the file cannot be written.
    """
    open3d = import_open3d()
    cloud = open3d.geometry.PointCloud()
    cloud.points = open3d.utility.Vector3dVector(
        np.column_stack([points, np.zeros(points.shape[0])])
    )
    with atomic_path(path) as temporary:
        # open3d returns False, and prints a warning, where others raise.
        with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
            written = open3d.io.write_point_cloud(str(temporary), cloud)
        if not written:
            raise FglocError("cannot be written by open3d; choose another place", file=path)
    return path
