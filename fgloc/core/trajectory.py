"""A trajectory: stamps, planar poses and, where known, their covariances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.core.measurements import Floats, Stamps
from fgloc.errors import FglocError


@dataclass(frozen=True)
class Trajectory:
    """Poses of one frame in another over time; no interpolation is implied between stamps."""

    stamps_ns: Stamps
    """(N,) strictly increasing int64 nanoseconds."""
    poses: Floats
    """(N, 3) x [m], y [m], heading [rad]; the heading is continuous (unwrapped), not in ±π."""
    covariances: Floats | None = None
    """(N, 3, 3) covariance of x, y, heading in MAP axes [m, m, rad]; None where it is not known."""

    def __post_init__(self) -> None:
        n = self.stamps_ns.size
        if self.stamps_ns.dtype != np.int64 or self.poses.shape != (n, 3):
            raise FglocError(f"a trajectory of {n} stamps needs int64 stamps and ({n}, 3) poses")
        if n > 1 and not bool(np.all(np.diff(self.stamps_ns) > 0)):
            raise FglocError("a trajectory's stamps must strictly increase")
        if not bool(np.all(np.isfinite(self.poses))):
            raise FglocError("a trajectory holds a pose that is not finite")
        if self.covariances is not None and self.covariances.shape != (n, 3, 3):
            raise FglocError(f"a trajectory of {n} poses needs ({n}, 3, 3) covariances")

    def __len__(self) -> int:
        return int(self.stamps_ns.size)
