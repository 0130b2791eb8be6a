"""The seed's line extraction by random draws: the baseline that the default one is held to.

A random reading and its neighbours, 25 in all, give a least squares line; if at least 21 of them
are nearer than 15 mm it is accepted and fitted to those once more. With a noise of 1 % of the
range that finds walls nearer than about 1.5 m, and a near wall once for every 25 of its beams.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats, Scans, Stamps
from fgloc.errors import FglocError
from fgloc.lidar.scan import Cloud
from fgloc.lidar.segments import Segments


@dataclass(frozen=True)
class RansacSettings:
    """What the seed says, and how often to draw, which it does not say."""

    neighbours: int = 25
    """Beams of one draw: a random one and as many to both sides of it."""
    tolerance_m: float = 0.015
    """Distance from the line [m] up to which a beam belongs to it."""
    inliers: int = 21
    """Beams of a draw that have to."""
    attempts: int = 40
    """Draws in one scan."""

    def __post_init__(self) -> None:
        if self.neighbours < 3 or not 3 <= self.inliers <= self.neighbours:
            raise FglocError(
                "ransac: neighbours must be at least 3, inliers between 3 and neighbours"
            )
        if not 0.0 < self.tolerance_m < math.inf or self.attempts < 1:
            raise FglocError("ransac: tolerance_m and attempts must be positive")


def extract_ransac(
    cloud: Cloud,
    scans: Scans,
    rng: np.random.Generator,
    settings: RansacSettings = RansacSettings(),
) -> Segments:
    """Return the lines that the seed's draws find in the scans of a cloud.

    Beams that made a line are not used again, neither as centre of a draw nor as neighbours.
    Neighbours are so by index, round the end of a full turn. Covariances are those of least
    squares without weights under the noise of `scans`, as if the beams had not been chosen by
    their errors. Draws depend on the generator only. O(N·attempts·neighbours), compiled.
    """
    n, beams = cloud.ranges.shape
    increment = abs(scans.angle_increment)
    turn = beams > 1 and abs(increment * beams - 2.0 * math.pi) < 1.5 * increment
    draws = rng.random((n, settings.attempts))
    room = max(1, n * min(settings.attempts, beams // settings.inliers))
    scan, points = np.empty(room, np.int64), np.empty(room, np.int64)
    line, covariance = np.empty((room, 5)), np.empty((room, 2, 2))
    filled = _draw(
        np.ascontiguousarray(cloud.points),
        np.ascontiguousarray(cloud.valid),
        draws,
        turn,
        settings.neighbours,
        settings.tolerance_m,
        settings.inliers,
        np.array([scans.range_sigma, scans.range_sigma_share, scans.bearing_sigma]),
        scan,
        line,
        covariance,
        points,
    )
    return Segments(
        scan[:filled].copy(),
        line[:filled, 0].copy(),
        line[:filled, 1:3].copy(),
        line[:filled, 3:5].copy(),
        covariance[:filled].copy(),
        points[:filled].copy(),
    )


@compiled
def least_squares(points: Floats, chosen: Stamps, count: int, line: Floats) -> bool:
    """Write normal (towards the origin) and centre of the total least squares line of points.

    `chosen` (count,) are indices into `points`. False if they do not determine a line.
    """
    mx = my = 0.0
    for i in range(count):
        mx += points[chosen[i], 0]
        my += points[chosen[i], 1]
    mx, my = mx / count, my / count
    xx = xy = yy = 0.0
    for i in range(count):
        dx, dy = points[chosen[i], 0] - mx, points[chosen[i], 1] - my
        xx += dx * dx
        xy += dx * dy
        yy += dy * dy
    if not (xx + yy > 0.0 and np.hypot(xx - yy, 2.0 * xy) > 1e-12 * (xx + yy)):
        return False
    # The direction of largest spread, turned by a right angle.
    normal = 0.5 * np.arctan2(2.0 * xy, xx - yy) + 0.5 * np.pi
    if np.cos(normal) * mx + np.sin(normal) * my > 0.0:
        normal += np.pi
    line[0] = (normal + np.pi) % (2.0 * np.pi) - np.pi
    line[1], line[2] = mx, my
    return True


@compiled
def inliers(
    points: Floats, chosen: Stamps, count: int, line: Floats, tolerance: float, found: Stamps
) -> int:
    """Write which of the chosen points are nearer to a line than the tolerance; return how many."""
    nx, ny = np.cos(line[0]), np.sin(line[0])
    n = 0
    for i in range(count):
        k = chosen[i]
        if abs(nx * (points[k, 0] - line[1]) + ny * (points[k, 1] - line[2])) < tolerance:
            found[n] = k
            n += 1
    return n


@compiled
def _draw(
    points: Floats,
    valid: npt.NDArray[np.bool_],
    draws: Floats,
    turn: bool,
    neighbours: int,
    tolerance: float,
    least: int,
    noise: Floats,
    scan: Stamps,
    line: Floats,
    covariance: Floats,
    counts: Stamps,
) -> int:
    """Fill the lines of all scans; return how many."""
    beams = valid.shape[1]
    free = np.empty(beams, np.bool_)
    chosen, found = np.empty(neighbours, np.int64), np.empty(neighbours, np.int64)
    filled = 0
    for k in range(valid.shape[0]):
        left = 0
        for b in range(beams):
            free[b] = valid[k, b]
            left += free[b]
        for a in range(draws.shape[1]):
            if left < least:
                break
            rank = int(draws[k, a] * left)
            centre = 0
            for b in range(beams):
                if free[b]:
                    if rank == 0:
                        centre = b
                        break
                    rank -= 1
            count = 0
            for step in range(min(neighbours, beams)):
                b = centre + step - neighbours // 2
                if turn or 0 <= b < beams:
                    b %= beams
                    if free[b]:
                        chosen[count] = b
                        count += 1
            if count < least or not least_squares(points[k], chosen, count, line[filled]):
                continue
            n = inliers(points[k], chosen, count, line[filled], tolerance, found)
            if n < least or not least_squares(points[k], found, n, line[filled]):
                continue
            if not _describe(points[k], found, n, noise, line[filled], covariance[filled]):
                continue
            for i in range(n):
                free[found[i]] = False
            left -= n
            scan[filled], counts[filled] = k, n
            filled += 1
    return filled


@compiled
def _describe(
    points: Floats, found: Stamps, n: int, noise: Floats, line: Floats, covariance: Floats
) -> bool:
    """Write how far a line reaches, and the covariance of its normal and its middle's offset.

    False for a line through the lidar, which has no side.
    """
    nx, ny = np.cos(line[0]), np.sin(line[0])
    if not nx * line[1] + ny * line[2] < 0.0:
        return False
    right, left = np.inf, -np.inf
    squares = c00 = c01 = c11 = 0.0
    for i in range(n):
        x, y = points[found[i], 0], points[found[i], 1]
        s = nx * (y - line[2]) - ny * (x - line[1])
        r = np.hypot(x, y)
        cosine = (nx * x + ny * y) / r
        across = noise[0] ** 2 + (noise[1] * r) ** 2
        variance = across * cosine * cosine + (noise[2] * r) ** 2 * (1.0 - cosine * cosine)
        right, left = min(right, s), max(left, s)
        squares += s * s
        # The normal turns by -Σ s h / Σ s², the middle moves by the mean of h.
        c00 += s * s * variance
        c01 -= s * variance
        c11 += variance
    line[3], line[4] = right, left
    covariance[0, 0], covariance[1, 1] = c00 / (squares * squares), c11 / (n * n)
    covariance[0, 1] = covariance[1, 0] = c01 / (squares * n)
    return True
