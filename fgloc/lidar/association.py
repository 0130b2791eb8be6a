"""Which segments of a drive are the same wall, given where the lidar was when it saw them.

Segments are taken in order of time. Each goes to the known wall that explains it best: one that
faces the lidar, was seen about there, and whose line is as near as noise and what is left of the
poses' errors allow; else it is a new wall. Walls are refined with every sighting. What the graph
makes of them is associated again, with less room for the poses' errors, until nothing changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fgloc.core.compiled import compiled
from fgloc.core.geometry import compose, wrap, wrap_scalar
from fgloc.core.measurements import Floats, Stamps
from fgloc.lidar.segments import Segments
from fgloc.lidar.walls import Walls

GATE = 11.8
"""Squared normalised distance up to which a segment is of a wall: 99.7 % of two numbers."""

NEAR_M, NEAR_RAD, OFTEN = 0.15, np.radians(10.0), 4
"""A wall this near [m], [rad] to one that was seen so many times as often is a bad view of it."""


@dataclass(frozen=True)
class Slack:
    """How far the poses may be off, and walls be interrupted, while segments are associated."""

    position_m: float
    """Standard deviation of a pose's position [m]."""
    heading: float
    """Standard deviation of a pose's heading [rad]."""
    gap_m: float = 1.0
    """A segment may lie this far from what was seen of its wall so far, along it [m]."""


def lidar_poses(poses: Floats, mount: tuple[float, float, float]) -> Floats:
    """Return the (N, 3) poses of a lidar on a robot at (N, 3) poses."""
    return compose(poses, np.array(mount))


def associate(
    segments: Segments, poses: Floats, slack: Slack, known: Walls | None = None
) -> tuple[Walls, Stamps]:
    """Return walls and, for each segment (M,), which of them it shows.

    `poses` (N, 3) are the lidar's in the map at each scan; `known` are walls to begin with, which
    keep their numbers and anchors, others are added. O(M·L), compiled.
    """
    m = segments.scan.size
    start = 0 if known is None else known.normal.size
    most = start + m
    # normal, offset, anchor (2), right, left, covariance (3: aa, ao, oo), sightings
    table = np.zeros((most, 10))
    if known is not None and start:
        table[:start, 0], table[:start, 1] = known.normal, known.offset
        table[:start, 2:4] = known.anchor
        table[:start, 4:6] = known.reach
        covariance = np.nan_to_num(known.covariance)
        table[:start, 6] = covariance[:, 0, 0]
        table[:start, 7] = covariance[:, 0, 1]
        table[:start, 8] = covariance[:, 1, 1]
    wall = np.full(m, -1, dtype=np.int64)
    count = _associate(
        segments.scan,
        segments.normal,
        segments.middle,
        segments.reach,
        segments.covariance,
        np.ascontiguousarray(poses),
        slack.position_m**2,
        slack.heading**2,
        slack.gap_m,
        known is None,
        start,
        table,
        wall,
    )
    table = table[:count]
    covariance = np.empty((count, 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = table[:, 6], table[:, 8]
    covariance[:, 0, 1] = covariance[:, 1, 0] = table[:, 7]
    return (
        Walls(
            table[:, 0].copy(),
            table[:, 1].copy(),
            table[:, 2:4].copy(),
            table[:, 4:6].copy(),
            covariance,
            np.bincount(wall[wall >= 0], minlength=count).astype(np.int64),
        ),
        wall,
    )


@compiled
def _associate(
    scan: Stamps,
    normal: Floats,
    middle: Floats,
    reach: Floats,
    covariance: Floats,
    poses: Floats,
    position: float,
    heading: float,
    gap: float,
    refine: bool,
    start: int,
    table: Floats,
    wall: Stamps,
) -> int:
    """Fill `wall` (M,) and add walls to `table`; return how many there are. See `associate`."""
    count = start
    for m in range(scan.size):
        x, y, theta = poses[scan[m], 0], poses[scan[m], 1], poses[scan[m], 2]
        c, s = np.cos(theta), np.sin(theta)
        a = wrap_scalar(theta + normal[m])
        px, py = x + c * middle[m, 0] - s * middle[m, 1], y + s * middle[m, 0] + c * middle[m, 1]
        best, least, best_shift = -1, GATE, 0.0
        for w in range(count):
            turn = wrap_scalar(a - table[w, 0])
            if abs(turn) > 0.35:
                continue
            ca, sa = np.cos(table[w, 0]), np.sin(table[w, 0])
            dx, dy = px - table[w, 2], py - table[w, 3]
            along = -sa * dx + ca * dy
            apart = max(along + reach[m, 0] - table[w, 5], table[w, 4] - along - reach[m, 1])
            if apart > gap:
                continue
            off = ca * dx + sa * dy - table[w, 1]
            lever = np.hypot(middle[m, 0], middle[m, 1])
            by_angle = covariance[m, 0, 0] + heading + table[w, 6]
            by_offset = (
                covariance[m, 1, 1]
                + position
                + heading * lever * lever
                + table[w, 8]
                + 2.0 * along * table[w, 7]
                + along * along * table[w, 6]
            )
            squared = turn * turn / by_angle + off * off / by_offset
            if squared < least:
                best, least, best_shift = w, squared, along
        if best < 0:
            best = count
            count += 1
            table[best, 0], table[best, 1] = a, 0.0
            table[best, 2], table[best, 3] = px, py
            table[best, 4], table[best, 5] = reach[m, 0], reach[m, 1]
            table[best, 6] = covariance[m, 0, 0] + heading
            table[best, 7] = 0.0
            table[best, 8] = covariance[m, 1, 1] + position
            wall[m] = best
            continue
        wall[m] = best
        table[best, 4] = min(table[best, 4], best_shift + reach[m, 0])
        table[best, 5] = max(table[best, 5], best_shift + reach[m, 1])
        if refine:
            _refine(table[best], a, px, py, covariance[m], position, heading)
    return count


@compiled
def _refine(
    wall: Floats, a: float, px: float, py: float, noise: Floats, position: float, heading: float
) -> None:
    """Update one wall with a sighting, as a Kalman filter does.

    Poses err alike for a while: half of what they may be off counts for each sighting, and a wall
    is never known better than a tenth of it.
    """
    ca, sa = np.cos(wall[0]), np.sin(wall[0])
    dx, dy = px - wall[2], py - wall[3]
    # The middle lies off the line by off; turned by d, the line moves there by -along d.
    along = -sa * dx + ca * dy
    r0, r1 = wrap_scalar(a - wall[0]), ca * dx + sa * dy - wall[1]
    p00, p01, p11 = wall[6], wall[7], wall[8]
    # H = [[1, 0], [-along, 1]] of (normal, offset).
    s00 = p00 + noise[0, 0] + heading
    s01 = p01 - along * p00 + noise[0, 1]
    s11 = p11 - 2.0 * along * p01 + along * along * p00 + noise[1, 1] + position
    determinant = s00 * s11 - s01 * s01
    if not determinant > 0.0:
        return
    h00, h01 = p00, p01 - along * p00
    h10, h11 = p01, p11 - along * p01
    k00, k01 = (h00 * s11 - h01 * s01) / determinant, (h01 * s00 - h00 * s01) / determinant
    k10, k11 = (h10 * s11 - h11 * s01) / determinant, (h11 * s00 - h10 * s01) / determinant
    wall[0] = wrap_scalar(wall[0] + k00 * r0 + k01 * r1)
    wall[1] += k10 * r0 + k11 * r1
    wall[6] = max(p00 - k00 * h00 - k01 * h01, 0.01 * heading)
    wall[7] = p01 - k00 * h10 - k01 * h11
    wall[8] = max(p11 - k10 * h10 - k11 * h11, 0.01 * position)


def single_noise(segments: Segments, wall: Stamps, count: int) -> Floats:
    """Return (L, 2) mean variances of direction [rad²] and offset [m²] of each wall's sightings."""
    used = np.flatnonzero(wall >= 0)
    each = np.diagonal(segments.covariance[used], axis1=1, axis2=2)
    total = np.zeros((count, 2))
    np.add.at(total, wall[used], each)
    sightings = np.bincount(wall[used], minlength=count)
    return np.asarray(total / np.maximum(sightings, 1)[:, None])


def duplicates(walls: Walls, slack: Slack, noise: Floats) -> Stamps:
    """Return (L,) for each wall the number of the one that it is the same as, perhaps itself.

    Two walls are one if they face the same way, lie on one line as far as is known, and overlap
    or are nearly so. Where half of one covers the other, they need not be nearer than two single
    sightings of a wall may be, whose variances are `noise` (L, 2): of two surfaces one would hide
    the other. O(L²) numpy.
    """
    n = walls.normal.size
    same = np.arange(n)
    if n < 2:
        return same
    turn, along, off = _seen(walls)
    apart = np.maximum(
        along.min(axis=2) - walls.reach[:, 1][:, None],
        walls.reach[:, 0][:, None] - along.max(axis=2),
    )
    centre = along.mean(axis=2)
    variance = walls.covariance
    by_angle = variance[:, 0, 0][:, None] + variance[:, 0, 0][None] + slack.heading**2
    by_offset = (
        variance[:, 1, 1][:, None]
        + centre**2 * variance[:, 0, 0][:, None]
        - 2.0 * centre * variance[:, 0, 1][:, None]
        + variance[:, 1, 1][None]
        + slack.position_m**2
    )
    length = np.diff(walls.reach, axis=1)[:, 0]
    covered = -apart > 0.5 * np.minimum(length[:, None], length[None])
    one = np.maximum(noise[:, None], noise[None])
    by_angle = by_angle + np.where(covered, one[:, :, 0], 0.0)
    by_offset = by_offset + np.where(covered, one[:, :, 1], 0.0)
    squared = turn**2 / by_angle + off**2 / by_offset
    fits = (squared < GATE) & (apart < slack.gap_m) & (np.abs(turn) < 0.35)
    fits &= fits.T
    np.fill_diagonal(fits, False)
    order = np.argsort(np.where(np.triu(fits), squared, np.inf), axis=None)
    for flat in order[: int(np.triu(fits).sum())].tolist():
        i, j = divmod(flat, n)
        if same[i] == i and same[j] == j:
            keep, gone = (i, j) if walls.sightings[i] >= walls.sightings[j] else (j, i)
            same[same == gone] = keep
    return same


def hidden(walls: Walls) -> npt.NDArray[np.bool_]:
    """Return (L,) which walls lie so close to a far better known one that it would hide them.

    They are bad sightings of that wall: within 15 cm and 10° of one that was seen four times as
    often, along more than half of their length. O(L²) numpy.
    """
    if walls.normal.size < 2:
        return np.zeros(walls.normal.size, np.bool_)
    turn, along, off = _seen(walls)
    low, high = along.min(axis=2), along.max(axis=2)
    right, left = walls.reach[:, :1], walls.reach[:, 1:]
    overlap = np.minimum(high, left) - np.maximum(low, right)
    close = (np.abs(off) < NEAR_M) & (np.abs(turn) < NEAR_RAD) & (overlap > 0.5 * (high - low))
    often = walls.sightings[:, None] >= OFTEN * walls.sightings[None]
    return np.asarray((close & often).any(axis=0))


def _seen(walls: Walls) -> tuple[Floats, Floats, Floats]:
    """Return how wall i sees wall j: turned by (L, L), ends along i (L, L, 2), middle off (L, L).

    Along the tangent and the normal of wall i, from its anchor's foot.
    """
    turn = wrap(walls.normal[:, None] - walls.normal[None])
    tangent = np.stack([-np.sin(walls.normal), np.cos(walls.normal)], axis=1)
    facing = np.stack([np.cos(walls.normal), np.sin(walls.normal)], axis=1)
    ends = walls.ends
    along = np.einsum("jek,ik->ije", ends, tangent)
    along -= np.einsum("ik,ik->i", walls.anchor, tangent)[:, None, None]
    off = np.einsum("jk,ik->ij", ends.mean(axis=1), facing)
    off -= (np.einsum("ik,ik->i", walls.anchor, facing) + walls.offset)[:, None]
    return turn, along, off
