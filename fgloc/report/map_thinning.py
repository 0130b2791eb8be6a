"""Thinning of scan points: none that is kept has another one near it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats
from fgloc.errors import FglocError

SPACING_M = 0.06
"""Distance below which a point adds nothing to a map [m]. Source: seed C."""
FARTHEST_CELL = 2.0**30
"""Cells are numbered up to here in each direction, so that two numbers fit into one integer."""

Indices = npt.NDArray[np.int64]


def thin(points: Floats, spacing: float = SPACING_M) -> Floats:
    """Return those of the points (N, 2) [m] that are kept, in their order.

    A point is kept only if it is farther than `spacing` [m] from every point kept before it
    (seed C's rule), so the first of a cluster stands for it. This is no voxel grid, whose points
    may come as near as they like across a border. O(N) on average: points are hashed into cells
    whose diagonal is the spacing, so that a cell holds one kept point at most and 24 neighbours
    have to be looked at. Raises FglocError for points that are not finite or too far away to be
    numbered (2³⁰ cells, 45,000 km at 6 cm).
    """
    if not 0.0 < spacing < np.inf:
        raise FglocError(f"the spacing of points must be positive and finite, got {spacing}")
    # NaN compares false, so this refuses what is not finite as well.
    if not bool(np.all(np.abs(points) < FARTHEST_CELL * spacing / np.sqrt(2.0))):
        raise FglocError(f"points to be thinned to {spacing} m are not finite, or too far away")
    kept: Floats = points[_thin(np.ascontiguousarray(points, dtype=np.float64), spacing)]
    return kept


@compiled
def _slot(keys: Indices, key: int) -> int:
    """Return where `key` stands in the table of keys, or the free place (-1) where it belongs."""
    mask = keys.size - 1
    # Fibonacci hashing: neighbouring cells are spread over the whole table.
    k = ((key * -7046029254386353131) >> 20) & mask
    while keys[k] != -1 and keys[k] != key:
        k = (k + 1) & mask
    return k


@compiled
def _thin(points: Floats, spacing: float) -> Indices:
    """Return the indices of the points that are kept; see `thin`."""
    size = 1024
    keys = np.full(size, -1, np.int64)
    holds = np.zeros(size, np.int64)
    kept = np.empty(points.shape[0], np.int64)
    number = 0
    scale = np.sqrt(2.0) / spacing
    # Shifted so that cell numbers are positive and pack into one integer.
    middle = 1 << 30
    for k in range(points.shape[0]):
        x, y = points[k, 0], points[k, 1]
        column = int(np.floor(x * scale)) + middle
        row = int(np.floor(y * scale)) + middle
        own = _slot(keys, (column << 32) | row)
        if keys[own] != -1:
            continue
        free = True
        for i in range(-2, 3):
            for j in range(-2, 3):
                near = _slot(keys, ((column + i) << 32) | (row + j))
                if keys[near] != -1:
                    other = holds[near]
                    dx, dy = points[other, 0] - x, points[other, 1] - y
                    if dx * dx + dy * dy <= spacing * spacing:
                        free = False
                        break
            if not free:
                break
        if not free:
            continue
        keys[own] = (column << 32) | row
        holds[own] = k
        kept[number] = k
        number += 1
        if 2 * number > size:
            # More than half full: twice as large, or looking up would get slow.
            before, held = keys, holds
            size *= 2
            keys = np.full(size, -1, np.int64)
            holds = np.zeros(size, np.int64)
            for n in range(before.size):
                if before[n] != -1:
                    place = _slot(keys, before[n])
                    keys[place] = before[n]
                    holds[place] = held[n]
    return kept[:number]
