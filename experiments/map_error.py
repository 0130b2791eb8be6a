"""How far a map's walls are from the true ones, and which sightings were given to a wrong wall.

True walls are straight pieces with two ends, (W, 4): x1, y1, x2, y2 [m], in the map frame in which
the walls were estimated. Nothing is aligned: a map that is turned is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.core.geometry import Floats
from fgloc.core.measurements import Stamps
from fgloc.lidar.segments import Segments
from fgloc.lidar.walls import Walls

FARTHEST_M, STEEPEST = 0.5, np.radians(15.0)
"""A wall further from a true one [m] or turned more against it [rad] is not that wall."""
SEEN_M = 0.15
"""Both ends of a piece that a scan shows lie as near to the true wall [m] that it is of."""
SAME_M, SAME_RAD = 1e-3, 1e-3
"""True walls that lie on one line to this [m, rad] are one: what is left and right of a door."""


@dataclass(frozen=True)
class WallErrors:
    """How far each wall of a map is from the true one that it overlaps; NaN where there is none."""

    truth: Stamps
    """(L,) index of the true wall, -1 where there is none."""
    direction_rad: Floats
    """(L,) angle between the lines [rad]."""
    middle_m: Floats
    """(L,) distance of the lines at the middle of what both have [m]."""
    end_m: Floats
    """(L,) distance of the lines at the ends of it, the larger of the two [m]."""
    beyond_m: Floats
    """(L,) how far the wall reaches along the line where there is no true wall [m]; a gap between
    two walls of one line, such as a door, does not count."""
    overlap_m: Floats
    """(L,) length of what both have [m]."""


@dataclass(frozen=True)
class Associations:
    """What a map made of the pieces of wall that scans showed."""

    used: int
    """Pieces that were given to a wall of the map."""
    wrong: int
    """Those of another true line than most of that wall's pieces."""
    spurious: int
    """Those that lie on no true wall."""


def line_of_each(truth: Floats) -> Stamps:
    """Return (W,) the number of the line that each true wall lies on, collinear ones sharing it."""
    begin, tangent, _ = _lines(truth)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    apart = np.stack(
        [np.abs(np.einsum("wk,vwk->vw", normal, p[:, None] - begin[None])) for p in _ends(truth)]
    ).max(axis=0)
    same = (apart <= SAME_M) & (_angles(tangent, tangent) <= SAME_RAD)
    same |= same.T
    # Walls that reach one another over a third one are on its line, too.
    while True:
        wider = (same.astype(np.int64) @ same.astype(np.int64)) > 0
        if bool(np.all(wider == same)):
            return np.unique(np.argmax(same, axis=1), return_inverse=True)[1].astype(np.int64)
        same = wider


def wall_errors(walls: Walls, truth: Floats) -> WallErrors:
    """Return the errors of L walls against W true ones. O(L W).

    A wall is compared with the true wall within 0.5 m and 15° that it overlaps most; of several
    that it overlaps for at least half as long, with the nearest: both sides of a thin wall.
    """
    count = walls.normal.size
    out = WallErrors(
        np.full(count, -1, dtype=np.int64), *(np.full(count, np.nan) for _ in range(5))
    )
    if count == 0 or truth.shape[0] == 0:
        return out
    begin, tangent, length = _lines(truth)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    ends = walls.ends
    own = np.stack([-np.sin(walls.normal), np.cos(walls.normal)], axis=1)
    relative = ends[:, None] - begin[None, :, None]
    along = np.sort(np.einsum("lwek,wk->lwe", relative, tangent), axis=2)
    lower, upper = np.maximum(along[..., 0], 0.0), np.minimum(along[..., 1], length)
    overlap = upper - lower
    turned = _angles(own, tangent)
    # Where the wall's line crosses the perpendicular at a place along the true wall.
    across = np.einsum("lk,wk->lw", own, normal)
    ahead = np.einsum("lk,wk->lw", own, tangent)
    offset = np.einsum("lwk,wk->lw", relative[:, :, 0], normal)
    start = np.einsum("lwk,wk->lw", relative[:, :, 0], tangent)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = across / ahead
        at_lower = np.abs(offset + slope * (lower - start))
        at_upper = np.abs(offset + slope * (upper - start))
        at_middle = np.abs(offset + slope * (0.5 * (lower + upper) - start))
    near = (overlap > 0.0) & (turned <= STEEPEST) & (at_middle <= FARTHEST_M)
    most = np.where(near, overlap, 0.0).max(axis=1)
    eligible = near & (overlap >= 0.5 * most[:, None])
    # Of two that are as near, pieces of one line, the one that it overlaps more.
    chosen = np.argmin(np.where(eligible, at_middle - 1e-6 * overlap, np.inf), axis=1)
    rows = np.flatnonzero(eligible.any(axis=1))
    picked = chosen[rows]
    out.truth[rows] = picked
    out.direction_rad[rows] = turned[rows, picked]
    out.middle_m[rows] = at_middle[rows, picked]
    out.end_m[rows] = np.maximum(at_lower, at_upper)[rows, picked]
    out.overlap_m[rows] = overlap[rows, picked]
    lines = line_of_each(truth)
    for row, wall in zip(rows, picked, strict=True):
        out.beyond_m[row] = _beyond(ends[row], truth[lines == lines[wall]], tangent[wall])
    return out


def true_wall_of_each(segments: Segments, lidar: Floats, truth: Floats) -> Stamps:
    """Return (M,) the true wall that each piece is of; -1 where it lies on none. O(M W).

    `lidar` (N, 3) is the lidar's true pose in the map at the first beam of each scan. Both ends of
    a piece lie within 0.15 m of its wall's line, it is turned by no more than 15° against it and
    lies beside the wall for half of its length at least. Of several it is the one nearest to the
    lidar, which hides the others: the near face of a thin wall, however noisy the beams.
    """
    if segments.scan.size == 0 or truth.shape[0] == 0:
        return np.full(segments.scan.size, -1, dtype=np.int64)
    begin, tangent, length = _lines(truth)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    pose = lidar[segments.scan]
    c, s = np.cos(pose[:, 2])[:, None], np.sin(pose[:, 2])[:, None]
    ends = segments.ends
    ends = pose[:, None, :2] + np.stack(
        [c * ends[..., 0] - s * ends[..., 1], s * ends[..., 0] + c * ends[..., 1]], axis=-1
    )
    relative = ends[:, None] - begin[None, :, None]
    along = np.sort(np.einsum("mwek,wk->mwe", relative, tangent), axis=2)
    apart = np.abs(np.einsum("mwek,wk->mwe", relative, normal)).max(axis=2)
    overlap = np.minimum(along[..., 1], length) - np.maximum(along[..., 0], 0.0)
    direction = segments.normal + pose[:, 2]
    own = np.stack([-np.sin(direction), np.cos(direction)], axis=1)
    good = (apart <= SEEN_M) & (_angles(own, tangent) <= STEEPEST)
    good &= overlap >= 0.5 * segments.lengths[:, None]
    across = np.abs(np.einsum("mwk,wk->mw", pose[:, None, :2] - begin[None], normal))
    # Of pieces of one line, the one that is nearer.
    best = np.argmin(np.where(good, across + 1e-3 * apart, np.inf), axis=1)
    return np.where(good.any(axis=1), best, -1).astype(np.int64)


def judge_associations(wall: Stamps, true_wall: Stamps, truth: Floats) -> Associations:
    """Return how many of M pieces were given to a wrong wall.

    `wall` (M,) is the map's wall of each piece (-1: none), `true_wall` (M,) the true one (-1: on
    none). Walls on one line are one.
    """
    used = wall >= 0
    lines = line_of_each(truth) if truth.shape[0] else np.zeros(0, dtype=np.int64)
    judged = used & (true_wall >= 0)
    wrong = 0
    if judged.any():
        table = np.zeros((int(wall.max()) + 1, int(lines.max()) + 1), dtype=np.int64)
        np.add.at(table, (wall[judged], lines[true_wall[judged]]), 1)
        wrong = int(table.sum() - table.max(axis=1).sum())
    return Associations(int(used.sum()), wrong, int(np.count_nonzero(used & (true_wall < 0))))


def _ends(truth: Floats) -> tuple[Floats, Floats]:
    """Return both ends (W, 2) of the true walls."""
    return truth[:, :2], truth[:, 2:]


def _lines(truth: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the first end (W, 2), the direction (W, 2) and the length (W,) of true walls."""
    begin, end = _ends(truth)
    length = np.hypot(*(end - begin).T)
    return begin, (end - begin) / length[:, None], length


def _angles(a: Floats, b: Floats) -> Floats:
    """Return (A, B) angles between lines of directions (A, 2) and (B, 2), in [0, π/2]."""
    cross = a[:, None, 0] * b[None, :, 1] - a[:, None, 1] * b[None, :, 0]
    return np.asarray(np.arctan2(np.abs(cross), np.abs(a @ b.T)))


def _beyond(ends: Floats, line: Floats, tangent: Floats) -> float:
    """Return how far the ends (2, 2) of a wall are from all true walls (V, 4) of its line."""
    where = np.sort(np.stack([line[:, :2] @ tangent, line[:, 2:] @ tangent], axis=1), axis=1)
    at = (ends @ tangent)[:, None]
    gaps = np.maximum(np.maximum(where[:, 0] - at, at - where[:, 1]), 0.0)
    return float(gaps.min(axis=1).max())
