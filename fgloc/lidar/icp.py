"""The inner loops of scan matching: nearest surfaces by a grid, and the point-to-line fit."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats

Indices = npt.NDArray[np.int64]

CELL = 0.5
"""Side of a square of the grid [m]; a gate must not be wider."""
OPPOSED = 0.6
"""Cosine of the angle between normals below which two points are not of one surface."""
CLUTTER = 0.1
"""Standard deviation [m] with which points of unknown surface attract one another."""
CHANCE = 3
"""How many pairs of such points tell nothing."""
CORRELATED = 2.0
"""By how much the covariance is larger than the points' own noise makes it: what a turn of the
lidar leaves in the scan, and pairs that are not of one place, are common to many of them. Measured
on simulated drives, where errors of the matches have then the size they should."""
UNKNOWN = 10.0
"""Standard deviation [m] that a direction gets which nothing constrains."""
SETTLED = 0.01
"""A last step below this [m] counts as settled."""
DOUBT = 3.0
"""By how much what noise in the normals seems to tell is taken off the information, at least as
often as it is in it."""


@compiled
def grid_index(points: Floats) -> tuple[Floats, Indices, Indices, Indices]:
    """Return (corner [m], shape, starts, order): the points sorted by squares of `CELL`.

    Square (i, j) holds order[starts[i·ny + j] : starts[i·ny + j + 1]]. O(P + squares).
    """
    lo, hi = np.zeros(2), np.zeros(2)
    n = points.shape[0]
    for axis in range(2):
        if n:
            lo[axis], hi[axis] = points[0, axis], points[0, axis]
        for k in range(n):
            lo[axis] = min(lo[axis], points[k, axis])
            hi[axis] = max(hi[axis], points[k, axis])
    shape = np.empty(2, np.int64)
    shape[0] = int((hi[0] - lo[0]) / CELL) + 1
    shape[1] = int((hi[1] - lo[1]) / CELL) + 1
    starts = np.zeros(shape[0] * shape[1] + 1, np.int64)
    where = np.empty(n, np.int64)
    for k in range(n):
        i, j = int((points[k, 0] - lo[0]) / CELL), int((points[k, 1] - lo[1]) / CELL)
        where[k] = i * shape[1] + j
        starts[where[k] + 1] += 1
    for k in range(starts.size - 1):
        starts[k + 1] += starts[k]
    fill = starts[:-1].copy()
    order = np.empty(n, np.int64)
    for k in range(n):
        order[fill[where[k]]] = k
        fill[where[k]] += 1
    return lo, shape, starts, order


@compiled
def nearest(
    x: float,
    y: float,
    nx: float,
    ny: float,
    gate: float,
    points: Floats,
    normals: Floats,
    lo: Floats,
    shape: Indices,
    starts: Indices,
    order: Indices,
) -> int:
    """Return the index of the nearest point within the gate [m] whose side fits; -1: none.

    (nx, ny) is the seeking point's normal, zero where unknown; an unknown one fits every other.
    """
    best, found = gate * gate, -1
    i0 = max(int(np.floor((x - gate - lo[0]) / CELL)), 0)
    i1 = min(int(np.floor((x + gate - lo[0]) / CELL)), shape[0] - 1)
    j0 = max(int(np.floor((y - gate - lo[1]) / CELL)), 0)
    j1 = min(int(np.floor((y + gate - lo[1]) / CELL)), shape[1] - 1)
    blind = nx == 0.0 and ny == 0.0
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            s = i * shape[1] + j
            for e in range(starts[s], starts[s + 1]):
                k = order[e]
                dx, dy = points[k, 0] - x, points[k, 1] - y
                d = dx * dx + dy * dy
                if d >= best:
                    continue
                mx, my = normals[k, 0], normals[k, 1]
                if not (blind or (mx == 0.0 and my == 0.0)) and nx * mx + ny * my < OPPOSED:
                    continue
                best, found = d, k
    return found


@compiled
def _sums(
    pose: Floats,
    gate: float,
    spread: float,
    points: Floats,
    normals: Floats,
    tilt: Floats,
    variance: Floats,
    lo: Floats,
    shape: Indices,
    starts: Indices,
    order: Indices,
    moving: Floats,
    moving_normals: Floats,
    moving_variance: Floats,
    info: Floats,
    noise_info: Floats,
    slope: Floats,
    residuals: Floats,
) -> tuple[int, int, float, float]:
    """Pair the moving points at `pose` and sum up the normal equations.

    `spread` multiplies the stated sigmas in the loss (Geman–McClure). Writes the information, how
    much of it noise in the normals makes, the slope, and the residuals in sigmas of paired points
    (NaN elsewhere). Returns (paired, inliers, sum of weighted squares, sum of weights).
    """
    c, s = np.cos(pose[2]), np.sin(pose[2])
    info[:] = 0.0
    noise_info[:] = 0.0
    slope[:] = 0.0
    paired, inliers, small = 0, 0, 0
    squares, weights = 0.0, 0.0
    small_info, small_slope = np.zeros((3, 3)), np.zeros(3)
    row = np.empty(3)
    across = np.empty(3)
    for p in range(moving.shape[0]):
        residuals[p] = np.nan
        px, py = c * moving[p, 0] - s * moving[p, 1], s * moving[p, 0] + c * moving[p, 1]
        mx = c * moving_normals[p, 0] - s * moving_normals[p, 1]
        my = s * moving_normals[p, 0] + c * moving_normals[p, 1]
        x, y = px + pose[0], py + pose[1]
        k = nearest(x, y, mx, my, gate, points, normals, lo, shape, starts, order)
        if k < 0:
            continue
        paired += 1
        dx, dy = x - points[k, 0], y - points[k, 1]
        nx, ny = normals[k, 0], normals[k, 1]
        if nx == 0.0 and ny == 0.0:
            distance = np.hypot(dx, dy)
            v = CLUTTER**2
            z = distance / np.sqrt(v)
            w = 1.0 / (1.0 + (z / (2.0 * spread)) ** 2) ** 2 / v
            residuals[p] = z
            inliers += z < 2.0 * spread
            row[0], row[1], row[2] = 1.0, 0.0, -py
            across[0], across[1], across[2] = 0.0, 1.0, px
            small += 1
            for a in range(3):
                small_slope[a] += w * (row[a] * dx + across[a] * dy)
                for b in range(3):
                    small_info[a, b] += w * (row[a] * row[b] + across[a] * across[b])
            continue
        e = nx * dx + ny * dy
        v = variance[k] + moving_variance[p]
        z = e / np.sqrt(v)
        w = 1.0 / (1.0 + (z / (3.0 * spread)) ** 2) ** 2
        residuals[p] = z
        inliers += abs(z) < 3.0 * spread
        squares += w * z * z
        weights += w
        w /= v
        row[0], row[1], row[2] = nx, ny, nx * -py + ny * px
        across[0], across[1], across[2] = -ny, nx, ny * py + nx * px
        for a in range(3):
            slope[a] += w * row[a] * e
            for b in range(3):
                info[a, b] += w * row[a] * row[b]
                noise_info[a, b] += w * tilt[k] * across[a] * across[b]
    # A few such pairs come about by chance.
    share = max(0.0, 1.0 - CHANCE / max(small, 1))
    for a in range(3):
        slope[a] += share * small_slope[a]
        for b in range(3):
            info[a, b] += share * small_info[a, b]
    return paired, inliers, squares, weights


@compiled
def icp(
    points: Floats,
    normals: Floats,
    tilt: Floats,
    variance: Floats,
    lo: Floats,
    shape: Indices,
    starts: Indices,
    order: Indices,
    moving: Floats,
    moving_normals: Floats,
    moving_variance: Floats,
    start: Floats,
    guess: Floats,
    guess_information: Floats,
    gates: Floats,
    iterations: int,
    covariance: Floats,
) -> tuple[Floats, int, int, float, int]:
    """Fit the moving points to the reference from `start`.

    Returns (pose, paired, inliers, rms, iterations). `gates` = (first, last) width of the search
    [m], narrowed step by step; the rms is in sigmas.
    `iterations` comes back as the limit + 1 where it did not settle. The guess has the information
    (3,), so that it counts in directions of which the points tell less. Writes the covariance.
    """
    n = moving.shape[0]
    pose = start.copy()
    info, noise_info, slope = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    residuals = np.empty(n)
    gate, spread = gates[0], gates[0] / gates[1]
    paired, inliers, squares, weights = 0, 0, 0.0, 0.0
    # Rotation is measured at the points' typical distance, so that all three are lengths.
    arm = 1e-3
    for p in range(n):
        arm += np.hypot(moving[p, 0], moving[p, 1]) / max(n, 1)
    scale = np.array([1.0, 1.0, 1.0 / arm])
    used = iterations + 1
    for iteration in range(iterations + 1):
        paired, inliers, squares, weights = _sums(
            pose, gate, max(spread, 1.0), points, normals, tilt, variance, lo, shape, starts,
            order, moving, moving_normals, moving_variance, info, noise_info, slope, residuals,
        )  # fmt: skip
        known = np.empty((3, 3))
        for a in range(3):
            for b in range(3):
                known[a, b] = (info[a, b] - DOUBT * noise_info[a, b]) * scale[a] * scale[b]
        values, vectors = np.linalg.eigh(known)
        if iteration == iterations or paired < 3:
            break
        step = np.zeros(3)
        for e in range(3):
            along, prior, off, told = 0.0, 0.0, 0.0, 0.0
            for a in range(3):
                along += vectors[a, e] * slope[a] * scale[a]
                prior += (vectors[a, e] * scale[a]) ** 2 * guess_information[a]
                off += vectors[a, e] * (pose[a] - guess[a]) / scale[a]
                for b in range(3):
                    told += vectors[a, e] * vectors[b, e] * info[a, b] * scale[a] * scale[b]
            # The slope counts by the share of its information that is not noise.
            total = max(values[e], 0.0)
            along *= total / max(told, 1e-9)
            length = -(along + prior * off) / (total + prior)
            for a in range(3):
                step[a] += vectors[a, e] * scale[a] * min(max(length, -0.5), 0.5)
        pose += step
        size = np.sqrt((step[0]) ** 2 + step[1] ** 2 + (step[2] * arm) ** 2)
        # Where pairs keep changing to and fro the step never gets small; by then it hardly matters.
        last = iteration == iterations - 1
        settled = gate <= gates[1] and size < (SETTLED if last else 1e-4)
        gate, spread = max(0.7 * gate, gates[1]), max(0.7 * spread, 1.0)
        if settled:
            used = iteration + 1
            break
    rms = np.sqrt(squares / weights) if weights > 0.0 else np.nan
    doubt = CORRELATED * (max(squares / weights, 1.0) if weights > 0.0 else 1.0)
    for a in range(3):
        for b in range(3):
            covariance[a, b] = 0.0
            for e in range(3):
                v = doubt / max(values[e], 1e-9)
                v = min(v, UNKNOWN**2)
                covariance[a, b] += v * vectors[a, e] * vectors[b, e] * scale[a] * scale[b]
    return pose, paired, inliers, rms, used
