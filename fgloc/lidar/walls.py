"""The map that a drive leaves: walls and point landmarks with what is uncertain of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.core.measurements import Floats, Stamps
from fgloc.errors import FglocError
from fgloc.lidar.segments import Segments


@dataclass(frozen=True)
class Walls:
    """Walls in map axes: the line n(normal)·(p - anchor) = offset, and the part that was seen.

    `normal` is the side from which the wall was seen; the far side of a thin wall is another one.
    The anchor is a fixed point near the wall, so that no wall is singular.
    """

    normal: Floats
    """(L,) direction of the normal [rad]."""
    offset: Floats
    """(L,) distance of the line from its anchor along the normal [m]."""
    anchor: Floats
    """(L, 2) [m]."""
    reach: Floats
    """(L, 2) where it was seen along the tangent from the anchor's foot [m]: right, left end; the
    tangent is the normal turned by +90°."""
    covariance: Floats
    """(L, 2, 2) of normal and offset; NaN where it is not known."""
    sightings: Stamps
    """(L,) how many segments told of it."""

    def __post_init__(self) -> None:
        n = self.normal.size
        shapes = {"anchor": (n, 2), "reach": (n, 2), "covariance": (n, 2, 2)}
        for name, shape in shapes.items():
            values = getattr(self, name)
            if values.shape != shape:
                raise FglocError(f"walls: {name} must have shape {shape}, got {values.shape}")

    def select(self, which: Stamps) -> Walls:
        """Return some of the walls, by index, in that order."""
        return Walls(
            self.normal[which],
            self.offset[which],
            self.anchor[which],
            self.reach[which],
            self.covariance[which],
            self.sightings[which],
        )

    @property
    def ends(self) -> Floats:
        """Return (L, 2, 2) the right and the left end [m] of each wall in map axes."""
        normal = np.stack([np.cos(self.normal), np.sin(self.normal)], axis=1)
        tangent = np.stack([-np.sin(self.normal), np.cos(self.normal)], axis=1)
        foot = self.anchor + self.offset[:, None] * normal
        return np.asarray(foot[:, None] + self.reach[:, :, None] * tangent[:, None])


@dataclass(frozen=True)
class Marks:
    """Point landmarks in map axes."""

    landmark: Stamps
    """(L,) identities; numbers of the method's own where the sensor knew none."""
    positions: Floats
    """(L, 2) [m]."""
    covariance: Floats
    """(L, 2, 2) [m²]; NaN where it is not known."""
    sightings: Stamps
    """(L,) how often it was seen."""


@dataclass(frozen=True)
class Map:
    """What a drive tells of its surroundings."""

    walls: Walls | None = None
    """Walls; None where there is no lidar."""
    segments: Segments | None = None
    """What was seen of them, as extracted; `scan` counts all scans of the drive's first lidar."""
    wall: Stamps | None = None
    """(M,) the wall that each segment belongs to; -1 where it belongs to none."""
    marks: Marks | None = None
    """Point landmarks; None where no sensor sees any."""
