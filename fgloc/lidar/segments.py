"""Straight pieces of wall as scans show them: what extraction finds and the graph uses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.core.measurements import Floats, Stamps
from fgloc.errors import FglocError


@dataclass(frozen=True)
class Segments:
    """Straight pieces of wall, each in the lidar's axes at the stamp of its scan's first beam.

    A segment is its middle, the direction of its normal and how far it reaches to both sides. The
    middle is chosen so that the errors of direction and of offset are uncorrelated or nearly so.
    """

    scan: Stamps
    """(M,) index of the scan, non-decreasing."""
    normal: Floats
    """(M,) direction [rad] of the normal that points from the wall to the lidar."""
    middle: Floats
    """(M, 2) a point of the line [m], about the middle of what was seen of it."""
    reach: Floats
    """(M, 2) how far the segment reaches from its middle along its tangent [m]: to the right end
    (≤ 0) and to the left one (≥ 0), the tangent being the normal turned by +90°."""
    covariance: Floats
    """(M, 2, 2) of the normal's direction [rad] and of the middle along the normal [m]."""
    points: Stamps
    """(M,) how many beams it was made of."""

    def __post_init__(self) -> None:
        m = self.scan.size
        shapes = {"normal": (m,), "middle": (m, 2), "reach": (m, 2), "covariance": (m, 2, 2)}
        for name, shape in shapes.items():
            values = getattr(self, name)
            if values.shape != shape:
                raise FglocError(f"segments: {name} must have shape {shape}, got {values.shape}")

    @property
    def ends(self) -> Floats:
        """Return (M, 2, 2) the right and the left end [m] of each segment in the lidar's axes."""
        tangent = np.stack([-np.sin(self.normal), np.cos(self.normal)], axis=1)
        return np.asarray(self.middle[:, None] + self.reach[:, :, None] * tangent[:, None])

    @property
    def lengths(self) -> Floats:
        """Return (M,) lengths [m]."""
        return np.asarray(self.reach[:, 1] - self.reach[:, 0])

    def select(self, which: Stamps) -> Segments:
        """Return some of the segments, by index or mask, in their order."""
        return Segments(
            self.scan[which],
            self.normal[which],
            self.middle[which],
            self.reach[which],
            self.covariance[which],
            self.points[which],
        )
