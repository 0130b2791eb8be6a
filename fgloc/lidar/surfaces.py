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
def _surfaces(
    points: Floats,
    valid: Mask,
    step: float,
    noise: Floats,
    normals: Floats,
    tilt: Floats,
    variance: Floats,
) -> None:
    """Fit a line to the neighbours of every point of one scan; write normals and variances."""
    beams = points.shape[0]
    for i in range(beams):
        if not valid[i]:
            continue
        x, y = points[i, 0], points[i, 1]
        r = np.hypot(x, y)
        sigma = np.sqrt(noise[0] ** 2 + (noise[1] * r) ** 2)
        across = noise[2] * r
        spacing = r * step
        reach = min(max(max(0.2, 10.0 * max(sigma, across)), 2.5 * spacing), 1.2)
        gap = max(max(0.15, 4.0 * sigma), 5.0 * spacing)
        n, sx, sy, sxx, sxy, syy = 1.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for side in (-1, 1):
            j, px, py = i + side, x, y
            while 0 <= j < beams and valid[j]:
                qx, qy = points[j, 0], points[j, 1]
                dx, dy = qx - x, qy - y
                if np.hypot(qx - px, qy - py) > gap or np.hypot(dx, dy) > reach:
                    break
                n += 1.0
                sx += dx
                sy += dy
                sxx += dx * dx
                sxy += dx * dy
                syy += dy * dy
                j += side
                px, py = qx, qy
        variance[i] = sigma**2 + across**2 + 0.02**2
        if n < 4.0:
            continue
        sxx -= sx * sx / n
        sxy -= sx * sy / n
        syy -= sy * sy / n
        middle, half = 0.5 * (sxx + syy), np.hypot(0.5 * (sxx - syy), sxy)
        long, short = middle + half, max(middle - half, 0.0)
        angle = 0.5 * np.arctan2(2.0 * sxy, sxx - syy) + 0.5 * np.pi
        nx, ny = np.cos(angle), np.sin(angle)
        if nx * x + ny * y > 0.0:
            nx, ny = -nx, -ny
        along = abs(nx * x + ny * y) / r
        white = (sigma * along) ** 2 + across**2 * (1.0 - along**2)
        if short / (n - 2.0) > 6.0 * (white + UNEVEN**2) or long < 25.0 * short:
            continue
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
) -> None:
    """Do every scan."""
    for k in range(points.shape[0]):
        _surfaces(points[k], valid[k], step, noise, normals[k], tilt[k], variance[k])


def surfaces(points: Floats, valid: Mask, scans: Scans) -> list[ScanPoints]:
    """Return every scan's points with their normals, in the axes of `points`.

    `points` (N, B, 2) [m] in each lidar's axes in beam order and `valid` (N, B), as a `Cloud` has
    them; `scans` tells the noise. Points beyond 40 m are left out. O(N·B), about 20 µs a scan.
    FglocError where the shapes differ.
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
    noise = np.array([scans.range_sigma, scans.range_sigma_share, scans.bearing_sigma])
    _all_surfaces(
        np.ascontiguousarray(points, dtype=np.float64),
        usable,
        abs(scans.angle_increment),
        noise,
        normals,
        tilt,
        variance,
    )
    return [
        ScanPoints(points[k][u], normals[k][u], tilt[k][u], variance[k][u])
        for k, u in enumerate(usable)
    ]


@compiled
def _first_of_cell(keys: npt.NDArray[np.int64], order: npt.NDArray[np.int64], keep: Mask) -> None:
    """Mark the first point of every run of equal keys, in the order given."""
    last = np.int64(-1)
    for k in order:
        if keys[k] != last:
            keep[k] = True
            last = keys[k]


def thin(scan: ScanPoints, size: float) -> ScanPoints:
    """Return at most one point for every square of `size` [m] and quarter of normal directions.

    The one whose normal is known best stays. Front and back of a thin wall are kept apart.
    O(P log P).
    """
    if scan.size == 0:
        return scan
    cell = np.floor(scan.points / size).astype(np.int64)
    cell -= cell.min(axis=0)
    known = np.any(scan.normals != 0.0, axis=1)
    quarter = np.floor(np.arctan2(scan.normals[:, 1], scan.normals[:, 0]) / (np.pi / 2.0))
    side = np.where(known, quarter.astype(np.int64) + 2, 5)
    keys = (cell[:, 0] * (cell[:, 1].max() + 1) + cell[:, 1]) * 6 + side
    order = np.lexsort((np.where(known, scan.tilt, np.inf), keys))
    keep = np.zeros(scan.size, bool)
    _first_of_cell(keys, order, keep)
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
