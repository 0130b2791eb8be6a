"""Where points fit best in a window of poses: exhaustive correlation with bounds, compiled.

A reference becomes a grid of likelihoods, one layer for every direction of normals, so that a wall
only attracts points that see it from the same side. The search is a branch and bound over grids
that hold the maximum of 2^h × 2^h cells: exact, whatever the guess. After Olson, "Real-time
correlative scan matching" (ICRA 2009), and Hess et al., "Real-time loop closure in 2D LIDAR SLAM"
(ICRA 2016).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats
from fgloc.lidar.surfaces import ScanPoints

Bytes = npt.NDArray[np.uint8]

LAYERS = 8
"""Directions of normals that are told apart; one more layer holds all points."""
LEVELS = 4
"""Grids: single cells, and maxima of 2, 4 and 8 cells' sides."""


@dataclass(frozen=True)
class Field:
    """Likelihoods of points, as a pyramid of grids."""

    corner: Floats
    """(2,) lower corner [m]."""
    cell: float
    """Side of a cell [m]."""
    grids: Bytes
    """(LEVELS, LAYERS + 1, nx, ny) 0…255; level h holds maxima of the 2^h cells from there on."""


@compiled
def _stamp(
    points: Floats, normals: Floats, corner: Floats, cell: float, kernel: Bytes, grid: Bytes
) -> None:
    """Write the kernel around every point into the layers of its normal and its neighbours'."""
    half = kernel.shape[0] // 2
    layers = grid.shape[0] - 1
    wanted = np.zeros(layers + 1, np.bool_)
    for p in range(points.shape[0]):
        i = int((points[p, 0] - corner[0]) / cell)
        j = int((points[p, 1] - corner[1]) / cell)
        nx, ny = normals[p, 0], normals[p, 1]
        wanted[:] = nx == 0.0 and ny == 0.0
        wanted[layers] = True
        if not (nx == 0.0 and ny == 0.0):
            at = np.arctan2(ny, nx) / (2.0 * np.pi) * layers
            middle = int(np.floor(at + 0.5))
            for k in range(middle - 1, middle + 2):
                wanted[(k + layers) % layers] = True
        for layer in range(layers + 1):
            if not wanted[layer]:
                continue
            for a in range(-half, half + 1):
                for b in range(-half, half + 1):
                    value = kernel[a + half, b + half]
                    if value > grid[layer, i + a, j + b]:
                        grid[layer, i + a, j + b] = value


def _pool(grids: Bytes) -> None:
    """Fill every level from the one before."""
    for h in range(1, grids.shape[0]):
        d = 2 ** (h - 1)
        below, level = grids[h - 1], grids[h]
        level[:] = below
        np.maximum(level[:, :-d], below[:, d:], out=level[:, :-d])
        # What is read must not have been written: hence the copy.
        np.maximum(level[:, :, :-d], level[:, :, d:].copy(), out=level[:, :, :-d])


def field(scan: ScanPoints, cell: float = 0.1, sigma: float = 0.15) -> Field:
    """Return the likelihoods exp(-d²/2σ²) of distances d to the points. O(P + cells).

    `cell` and `sigma` in m. No points: an empty field, in which nothing scores.
    """
    half = int(np.ceil(2.0 * sigma / cell))
    # Below and left of the points there must be room for the widest maximum.
    margin = half + 2 ** (LEVELS - 1) + 1
    low = scan.points.min(axis=0) if scan.size else np.zeros(2)
    high = scan.points.max(axis=0) if scan.size else np.zeros(2)
    corner = low - margin * cell
    nx, ny = (np.ceil((high - low) / cell).astype(int) + 2 * margin + 1).tolist()
    grids = np.zeros((LEVELS, LAYERS + 1, nx, ny), np.uint8)
    offset = np.arange(-half, half + 1) * cell
    square = offset[:, None] ** 2 + offset[None] ** 2
    kernel = np.round(255.0 * np.exp(-0.5 * square / sigma**2)).astype(np.uint8)
    _stamp(scan.points, scan.normals, corner, cell, kernel, grids[0])
    _pool(grids)
    return Field(corner, cell, grids)


@compiled
def _score(
    grid: Bytes,
    cells: npt.NDArray[np.int64],
    layer: npt.NDArray[np.int64],
    i: int,
    j: int,
) -> float:
    """Return the sum of the values at the points' cells, moved by (i, j)."""
    nx, ny = grid.shape[1], grid.shape[2]
    total = 0
    for p in range(cells.shape[0]):
        x, y = cells[p, 0] + i, cells[p, 1] + j
        if 0 <= x < nx and 0 <= y < ny:
            total += grid[layer[p], x, y]
    return float(total)


@compiled
def _penalty(low: int, size: int, cell: float, weight: float) -> float:
    """Return the least penalty of the offsets low … low + size - 1 [cells]."""
    nearest = max(low, -(low + size - 1))
    return weight * (max(nearest, 0) * cell) ** 2


@compiled
def _search(
    grids: Bytes,
    corner: Floats,
    cell: float,
    points: Floats,
    directions: Floats,
    guess: Floats,
    half: Floats,
    turn: float,
    weights: Floats,
    least: float,
    apart: Floats,
) -> Floats:
    """Return (x, y, heading, score) of the best pose in the window; score < 0 where none is."""
    n = points.shape[0]
    layers = grids.shape[1] - 1
    top = grids.shape[0] - 1
    block = 2**top
    turns = int(np.ceil(half[2] / turn))
    wx, wy = int(np.ceil(half[0] / cell)), int(np.ceil(half[1] / cell))
    bx, by = (2 * wx) // block + 1, (2 * wy) // block + 1
    cells = np.empty((2 * turns + 1, n, 2), np.int64)
    layer = np.empty((2 * turns + 1, n), np.int64)
    bounds = np.empty((2 * turns + 1) * bx * by)
    share = 1.0 / (255.0 * n)
    for t in range(2 * turns + 1):
        angle = guess[2] + (t - turns) * turn
        c, s = np.cos(angle), np.sin(angle)
        for p in range(n):
            x = c * points[p, 0] - s * points[p, 1] + guess[0]
            y = s * points[p, 0] + c * points[p, 1] + guess[1]
            cells[t, p, 0] = int(np.floor((x - corner[0]) / cell))
            cells[t, p, 1] = int(np.floor((y - corner[1]) / cell))
            if np.isnan(directions[p]):
                layer[t, p] = layers
            else:
                at = (directions[p] + angle) / (2.0 * np.pi) * layers
                layer[t, p] = int(np.floor(at + 0.5)) % layers
        turned = weights[2] * ((t - turns) * turn) ** 2
        for i in range(bx):
            for j in range(by):
                u, v = -wx + i * block, -wy + j * block
                value = _score(grids[top], cells[t], layer[t], u, v) * share - turned
                value -= _penalty(u, block, cell, weights[0])
                value -= _penalty(v, block, cell, weights[1])
                bounds[(t * bx + i) * by + j] = value
    best = np.array([guess[0], guess[1], guess[2], -1.0])
    limit = least
    stack = np.empty((4 * top + 4, 3), np.int64)
    for b in np.argsort(-bounds):
        if bounds[b] <= limit:
            break
        t = b // (bx * by)
        turned = weights[2] * ((t - turns) * turn) ** 2
        stack[0, 0] = top
        stack[0, 1] = -wx + (b // by) % bx * block
        stack[0, 2] = -wy + b % by * block
        depth = 1
        while depth > 0:
            depth -= 1
            h, u, v = stack[depth, 0], stack[depth, 1], stack[depth, 2]
            if u > wx or v > wy:
                continue
            value = _score(grids[h], cells[t], layer[t], u, v) * share - turned
            value -= _penalty(u, 2**h, cell, weights[0])
            value -= _penalty(v, 2**h, cell, weights[1])
            if value <= limit:
                continue
            if h == 0:
                if (
                    np.hypot(u * cell + guess[0] - apart[0], v * cell + guess[1] - apart[1])
                    < apart[3]
                    and abs((t - turns) * turn + guess[2] - apart[2]) < apart[4]
                ):
                    continue
                limit = value
                best[0] = guess[0] + u * cell
                best[1] = guess[1] + v * cell
                best[2] = guess[2] + (t - turns) * turn
                best[3] = value
                continue
            d = 2 ** (h - 1)
            for a in range(2):
                for c2 in range(2):
                    stack[depth, 0], stack[depth, 1], stack[depth, 2] = h - 1, u + a * d, v + c2 * d
                    depth += 1
    return best


def search(
    likelihood: Field,
    moving: ScanPoints,
    guess: Floats,
    half: Floats,
    turn: float = 0.0175,
    sigma: Floats | None = None,
    least: float = 0.0,
    apart: Floats | None = None,
) -> tuple[Floats, float]:
    """Return the best pose (3,) of `moving` in the window guess ± `half` (3,), and its score.

    The score is the mean likelihood of the points, 0…1; it loses half a hundredth for a distance of
    one `sigma` (3,) from the guess, so that what the points leave open stays there. -1: nothing in
    the window scores above `least`. `turn` [rad] is the step of the heading. `apart` (5,) leaves
    out the poses about the pose in its first three entries, by so many metres and radians as the
    last two say: how good is the best of the others?
    """
    if moving.size == 0:
        return np.asarray(guess, float), -1.0
    known = np.any(moving.normals != 0.0, axis=1)
    directions = np.where(known, np.arctan2(moving.normals[:, 1], moving.normals[:, 0]), np.nan)
    weights = np.zeros(3) if sigma is None else 0.005 / np.asarray(sigma) ** 2
    best = _search(
        likelihood.grids,
        likelihood.corner,
        likelihood.cell,
        moving.points,
        directions,
        np.asarray(guess, dtype=np.float64),
        np.asarray(half, dtype=np.float64),
        turn,
        weights,
        least,
        np.zeros(5) if apart is None else apart,
    )
    return best[:3], float(best[3])
