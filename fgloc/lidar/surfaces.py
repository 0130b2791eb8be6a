"""Scan points with the directions of the surfaces they lie on: what matching compares.

The normal of a point comes from its neighbours in beam order. How far to both sides they are taken
follows from the sensor's noise, so that one setting serves a laser of 1 cm and one of 1 % of range.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats, Scans
from fgloc.errors import FglocError

Mask = npt.NDArray[np.bool_]

FARTHEST = 40.0
"""Points beyond [m] are left out: beams are too far apart there to tell a surface."""
PATCH = 0.5
"""Length of wall [m] over which what a wall deviates from its line is taken as one error."""
GRAZING = 1.5
"""Distance [m] up to which a few beams in line are taken for a wall seen at a grazing angle."""
UNEVEN = 0.01
"""How far walls deviate from straight lines, range bias included [m]."""


@dataclass(frozen=True)
class ScanPoints:
    """Points that a lidar saw, in one frame, with their surfaces' normals."""

    points: Floats
    """(P, 2) [m]; only valid ones."""
    normals: Floats
    """(P, 2) unit normals that point to the lidar; zero where the surface is unknown."""
    tilt: Floats
    """(P,) variance of the normal's direction [rad²]; 0 where there is none."""
    variance: Floats
    """(P,) variance [m²] of a point along its normal, for one of as many as its patch of wall
    has: what they share is counted in, so that a wall seen by many beams is not known better than
    it is even."""

    @property
    def size(self) -> int:
        """Return how many points there are."""
        return int(self.tilt.size)

    def moved(self, pose: Floats) -> ScanPoints:
        """Return the same points in the frame in which their own is at `pose` (3,). O(P)."""
        c, s = math.cos(pose[2]), math.sin(pose[2])
        turn = np.array([[c, s], [-s, c]])
        points = self.points @ turn + pose[:2]
        return ScanPoints(points, self.normals @ turn, self.tilt, self.variance)

    def select(self, which: npt.NDArray[np.int64] | Mask) -> ScanPoints:
        """Return some of the points, by index or mask."""
        return ScanPoints(
            self.points[which], self.normals[which], self.tilt[which], self.variance[which]
        )


@compiled
def _neighbours(
    points: Floats, valid: Mask, i: int, reach: float, gap: float, beams: int, sums: Floats
) -> bool:
    """Sum up a point's neighbours relative to it: n, x, y, xx, xy, yy.

    They reach to both sides as far as `reach` [m], no gap between two wider than `gap` [m], at
    most so many beams. Returns whether the surface goes on beyond.
    """
    sums[:] = 0.0
    sums[0] = 1.0
    goes_on = False
    for side in (-1, 1):
        j, before = i + side, i
        while 0 <= j < points.shape[0] and valid[j] and abs(j - i) <= beams:
            dx, dy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
            if np.hypot(points[j, 0] - points[before, 0], points[j, 1] - points[before, 1]) > gap:
                break
            if np.hypot(dx, dy) > reach:
                goes_on = True
                break
            sums[0] += 1.0
            sums[1] += dx
            sums[2] += dy
            sums[3] += dx * dx
            sums[4] += dx * dy
            sums[5] += dy * dy
            before = j
            j += side
    return goes_on


@compiled
def _surfaces(
    points: Floats,
    valid: Mask,
    step: float,
    noise: Floats,
    normals: Floats,
    tilt: Floats,
    variance: Floats,
    useful: Mask,
) -> None:
    """Fit a line to the neighbours of every point of one scan; write normals and variances.

    `useful` is set for points with a normal, and for those on something small or rugged. Not for
    those of a wall that is too noisy: they would pull along it.
    """
    sums = np.empty(6)
    for i in range(points.shape[0]):
        if not valid[i]:
            continue
        x, y = points[i, 0], points[i, 1]
        r = np.hypot(x, y)
        sigma = np.sqrt(noise[0] ** 2 + (noise[1] * r) ** 2)
        across = noise[2] * r
        spacing = r * step
        reach = min(max(max(0.2, 12.0 * max(sigma, across)), 2.5 * spacing), 1.2)
        gap = max(max(0.15, 4.0 * sigma), 5.0 * spacing)
        variance[i] = sigma**2 + across**2 + 0.02**2
        goes_on = _neighbours(points, valid, i, reach, gap, points.shape[0], sums)
        thinly = sums[0] < 4.0
        if thinly:
            # Perhaps a wall at a grazing angle: few beams, far apart, but in one line.
            goes_on = False
            _neighbours(points, valid, i, GRAZING, GRAZING, 3, sums)
            if sums[0] < 4.0:
                continue
        n, mx, my = sums[0], sums[1] / sums[0], sums[2] / sums[0]
        sxx, syy = sums[3] - n * mx * mx, sums[5] - n * my * my
        sxy = sums[4] - n * mx * my
        middle, half = 0.5 * (sxx + syy), np.hypot(0.5 * (sxx - syy), sxy)
        long, short = middle + half, max(middle - half, 0.0)
        angle = 0.5 * np.arctan2(2.0 * sxy, sxx - syy) + 0.5 * np.pi
        nx, ny = np.cos(angle), np.sin(angle)
        if nx * x + ny * y > 0.0:
            nx, ny = -nx, -ny
        along = abs(nx * x + ny * y) / r
        white = (sigma * along) ** 2 + across**2 * (1.0 - along**2)
        # Six times what noise makes, or what chance makes of few points once in ten thousand.
        freedom = n - 2.0
        limit = max(6.0 * freedom, freedom + 4.0 * np.sqrt(2.0 * freedom) + 8.0)
        rugged = short > limit * (white + UNEVEN**2)
        if rugged or long < 25.0 * short:
            useful[i] = rugged or not goes_on
            continue
        useful[i] = True
        normals[i, 0], normals[i, 1] = nx, ny
        tilt[i] = (white + UNEVEN**2) / long
        # n points lie on a piece of wall of about sqrt(12 long / n).
        shared = max(1.0, n * PATCH / np.sqrt(12.0 * long / n))
        variance[i] = white + shared * UNEVEN**2


@compiled
def _all_surfaces(
    points: Floats,
    valid: Mask,
    step: float,
    noise: Floats,
    normals: Floats,
    tilt: Floats,
    variance: Floats,
    useful: Mask,
) -> None:
    """Do every scan."""
    for k in range(points.shape[0]):
        _surfaces(points[k], valid[k], step, noise, normals[k], tilt[k], variance[k], useful[k])


def surfaces(points: Floats, valid: Mask, scans: Scans) -> list[ScanPoints]:
    """Return every scan's points with their normals, in the axes of `points`.

    `points` (N, B, 2) [m] in each lidar's axes in beam order and `valid` (N, B), as a `Cloud` has
    them; `scans` tells the noise. Points beyond 40 m are left out, and so are points of walls that
    are sampled too thinly to tell a normal: they would pull along the wall. O(N·B), about
    0.2 ms a scan. FglocError where the shapes differ.
    """
    if points.shape != (*valid.shape, 2) or valid.shape != scans.ranges.shape:
        raise FglocError(
            f"{scans.sensor}: points {points.shape} and valid {valid.shape} must have one row a "
            f"scan and one entry a beam, as ranges {scans.ranges.shape}"
        )
    near = np.hypot(points[..., 0], points[..., 1])
    usable = valid & np.isfinite(near) & (near < FARTHEST) & (near > 0.0)
    normals = np.zeros(points.shape)
    tilt, variance = np.zeros(valid.shape), np.zeros(valid.shape)
    useful = np.zeros(valid.shape, np.bool_)
    noise = np.array([scans.range_sigma, scans.range_sigma_share, scans.bearing_sigma])
    _all_surfaces(
        np.ascontiguousarray(points, dtype=np.float64),
        usable,
        abs(scans.angle_increment),
        noise,
        normals,
        tilt,
        variance,
        useful,
    )
    return [
        ScanPoints(points[k][u], normals[k][u], tilt[k][u], variance[k][u])
        for k, u in enumerate(useful)
    ]


@compiled
def _best_of_cells(points: Floats, normals: Floats, tilt: Floats, size: float, keep: Mask) -> None:
    """Mark the point of every cell and side whose normal is known best; unknown ones come last."""
    n = points.shape[0]
    slots = 16
    while slots < 3 * n:
        slots *= 2
    table = np.full(slots, -1, np.int64)
    keys = np.empty((n, 3), np.int64)
    for p in range(n):
        keys[p, 0] = int(np.floor(points[p, 0] / size))
        keys[p, 1] = int(np.floor(points[p, 1] / size))
        nx, ny = normals[p, 0], normals[p, 1]
        keys[p, 2] = -1
        if nx != 0.0 or ny != 0.0:
            keys[p, 2] = int(np.floor(np.arctan2(ny, nx) / (0.5 * np.pi))) + 2
        slot = (keys[p, 0] * 73856093 ^ keys[p, 1] * 19349663 ^ keys[p, 2] * 83492791) & (slots - 1)
        while True:
            q = table[slot]
            if q < 0:
                table[slot] = p
                keep[p] = True
                break
            if keys[q, 0] == keys[p, 0] and keys[q, 1] == keys[p, 1] and keys[q, 2] == keys[p, 2]:
                if tilt[p] < tilt[q]:
                    keep[q] = False
                    table[slot] = p
                    keep[p] = True
                break
            slot = (slot + 1) & (slots - 1)


def thin(scan: ScanPoints, size: float) -> ScanPoints:
    """Return at most one point for every square of `size` [m] and quarter of normal directions.

    The one whose normal is known best stays. Front and back of a thin wall are kept apart. O(P).
    """
    keep = np.zeros(scan.size, bool)
    _best_of_cells(scan.points, scan.normals, scan.tilt, size, keep)
    return scan.select(keep)


def merge(scans: Sequence[ScanPoints], poses: Floats, size: float) -> ScanPoints:
    """Return scans at their `poses` (S, 3) as one set of points, thinned to `size` [m]. O(P)."""
    moved = [scan.moved(pose) for scan, pose in zip(scans, poses, strict=True)]
    both = ScanPoints(
        np.concatenate([s.points for s in moved]) if moved else np.zeros((0, 2)),
        np.concatenate([s.normals for s in moved]) if moved else np.zeros((0, 2)),
        np.concatenate([s.tilt for s in moved]) if moved else np.zeros(0),
        np.concatenate([s.variance for s in moved]) if moved else np.zeros(0),
    )
    return thin(both, size)
