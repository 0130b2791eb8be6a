"""Small maps along a drive: what loop closure compares instead of single scans."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.geometry import between
from fgloc.core.measurements import Floats
from fgloc.lidar.icp import Indices
from fgloc.lidar.surfaces import ScanPoints, merge

BINS = 360
"""Directions that a scan's view is divided into."""
MARGIN = 0.3
"""A point this much [m] nearer than what was seen behind it contradicts that view …"""
SLOPE = 0.05
"""… and this share of its distance more, for errors of direction."""


@dataclass(frozen=True)
class Submap:
    """The scans about one place of a drive, in the axes of its middle scan."""

    scan: int
    """Index of the middle scan."""
    members: Indices
    """(S,) indices of the scans it is made of."""
    points: ScanPoints
    """Their points, thinned."""
    views: Floats
    """(S, BINS) distance [m] to what each of them saw, by direction in its own axes; infinite
    where it saw nothing."""
    poses: Floats
    """(S, 3) poses of its scans in the middle one's axes."""


@compiled
def _views(points: Floats, view: Floats) -> None:
    """Write the distance of the nearest point in every direction."""
    view[:] = np.inf
    for p in range(points.shape[0]):
        angle = np.arctan2(points[p, 1], points[p, 0])
        k = int(np.floor((angle + np.pi) / (2.0 * np.pi) * view.size)) % view.size
        view[k] = min(view[k], np.hypot(points[p, 0], points[p, 1]))


@compiled
def _through(points: Floats, poses: Floats, views: Floats) -> tuple[int, int]:
    """Count the points that a view should have shown, and of these those it looked through."""
    compared, through = 0, 0
    bins = views.shape[1]
    for s in range(poses.shape[0]):
        c, sn = np.cos(poses[s, 2]), np.sin(poses[s, 2])
        for p in range(points.shape[0]):
            dx, dy = points[p, 0] - poses[s, 0], points[p, 1] - poses[s, 1]
            x, y = c * dx + sn * dy, -sn * dx + c * dy
            r = np.hypot(x, y)
            k = int(np.floor((np.arctan2(y, x) + np.pi) / (2.0 * np.pi) * bins)) % bins
            near, far = np.inf, 0.0
            for e in range(-1, 2):
                v = views[s, (k + e) % bins]
                near = min(near, v)
                far = max(far, v)
            if not np.isfinite(far):
                continue
            slack = MARGIN + SLOPE * r
            if r < near - slack:
                compared += 1
                through += 1
            elif r < far + slack:
                compared += 1
    return compared, through


def submap(
    scans: list[ScanPoints], poses: Floats, middle: int, members: Indices, cell: float
) -> Submap:
    """Return the map of the `members` among all `scans` at `poses` (N, 3), thinned to `cell`."""
    local = between(poses[middle], poses[members])
    views = np.empty((members.size, BINS))
    for k, m in enumerate(members):
        _views(scans[m].points, views[k])
    points = merge([scans[m] for m in members], local, cell)
    return Submap(middle, members, points, views, local)


def seen_through(first: Submap, second: Submap, relative: Floats) -> float:
    """Return the share of points in common view that the other map's beams passed through.

    `relative` (3,) is the second's pose in the first's axes. Both ways, the worse one counts;
    1 where nothing is in common view. O(S·P).
    """
    worst = 0.0
    for a, b, pose in ((first, second, relative), (second, first, inverse_of(relative))):
        points = b.points.moved(pose).points
        compared, through = _through(points, a.poses, a.views)
        worst = max(worst, through / compared if compared >= 30 else 1.0)
    return worst


def inverse_of(pose: Floats) -> Floats:
    """Return the inverse of one pose (3,)."""
    return np.asarray(between(pose, np.zeros(3)))


def around(travelled: Floats, middle: int, half: float, most: int) -> Indices:
    """Return the scans within `half` [m] of path around one, at most `most`, evenly chosen.

    `travelled` (N,) is the path's length to every scan [m].
    """
    low = int(np.searchsorted(travelled, travelled[middle] - half))
    high = int(np.searchsorted(travelled, travelled[middle] + half, side="right"))
    if high - low <= most:
        return np.arange(low, high)
    spread = np.linspace(low, high - 1, most).round().astype(np.int64)
    return np.unique(np.append(spread, middle))
