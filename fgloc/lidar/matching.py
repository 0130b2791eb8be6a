"""Point-to-line matching of scans and of small maps made of scans.

Every moving point is pulled to the line through its nearest reference point, with a robust loss;
noise and normals are per point (`fgloc.lidar.surfaces`). The covariance comes from the same
information, less what noise in the normals pretends to know, so that a corridor leaves its own
direction open. After Censi, "An ICP variant using a point-to-line metric" (ICRA 2008).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.lidar.icp import CELL, Indices, grid_index, icp
from fgloc.lidar.surfaces import ScanPoints


@dataclass(frozen=True)
class MatchSettings:
    """How two sets of points are matched."""

    gate: float = 0.5
    """How far apart points may be at first [m]; at most 0.5."""
    last_gate: float = 0.12
    """How far apart they may be at the end [m]."""
    iterations: int = 40
    """Most iterations."""
    guess_sigma: tuple[float, float, float] = (0.3, 0.3, 0.1)
    """Standard deviations of the guess [m, m, rad]: a weak pull to it, and in directions that the
    points leave open it stays. Not part of the covariance that is returned."""


@dataclass(frozen=True)
class Match:
    """Where the moving points are in the reference's axes, and how well that is known."""

    relative: Floats
    """(3,) pose of the moving frame in the reference's."""
    covariance: Floats
    """(3, 3) of x, y [m] and heading [rad] in the reference's axes; a direction of which nothing
    is known has a standard deviation of 10 m."""
    overlap: float
    """Share of the moving points with a partner in the reference."""
    inliers: float
    """Share of these that lie on their partner's line within three sigmas."""
    rms: float
    """Root mean square of their distances in sigmas, weighted; NaN without any."""
    converged: bool
    """Whether the iterations settled."""


@dataclass(frozen=True)
class Reference:
    """Points to match against, sorted for the search."""

    scan: ScanPoints
    """The points."""
    index: tuple[Floats, Indices, Indices, Indices]
    """The grid, see `fgloc.lidar.icp.grid_index`."""


def reference(scan: ScanPoints) -> Reference:
    """Return the points sorted for the search; worth it where they are matched to more than once.

    O(P + area).
    """
    return Reference(scan, grid_index(scan.points))


def match(
    fixed: ScanPoints | Reference,
    moving: ScanPoints,
    guess: Floats,
    settings: MatchSettings = MatchSettings(),
    start: Floats | None = None,
) -> Match:
    """Fit `moving` to `fixed` from `guess` (3,), the pose of the moving frame in the fixed one.

    `start` (3,) is where to begin, where that is another pose than the guess: a search's result,
    say. What the points leave open stays as guessed.

    Less than three pairs: the guess comes back, unknown and not converged. About 1 ms for two
    scans of 400 beams.
    """
    target = fixed if isinstance(fixed, Reference) else reference(fixed)
    points = target.scan
    covariance = np.eye(3)
    expected = np.asarray(guess, dtype=np.float64)
    begin = expected if start is None else np.asarray(start, dtype=np.float64)
    pose, paired, inliers, rms, used = icp(
        points.points,
        points.normals,
        points.tilt,
        points.variance,
        *target.index,
        moving.points,
        moving.normals,
        moving.variance,
        begin,
        expected,
        np.asarray(settings.guess_sigma) ** -2.0,
        np.array([min(settings.gate, CELL), settings.last_gate]),
        settings.iterations,
        covariance,
    )
    return Match(
        pose,
        covariance,
        paired / max(moving.size, 1),
        inliers / max(paired, 1),
        float(rms),
        bool(paired >= 3 and used <= settings.iterations and np.all(np.isfinite(pose))),
    )
