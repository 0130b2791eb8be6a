"""Where rays first hit straight walls and round obstacles, in compiled code."""

from __future__ import annotations

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats


@compiled
def cast(origins: Floats, directions: Floats, beams: int, walls: Floats, limit: float) -> Floats:
    """Return the (M,) distance [m] to the first wall along each ray; inf beyond `limit`.

    `origins` (M, 2) and `directions` (M,) [rad] are in the axes of the walls (W, 4), x1 y1 x2 y2.
    Rays come in groups of `beams` whose origins are near each other, as those of one scan: walls
    out of reach are left out once for all of them. O(M·W) at worst.
    """
    m = origins.shape[0]
    out = np.full(m, np.inf)
    near = np.empty(walls.shape[0], np.int64)
    for group in range(0, m, beams):
        end = min(group + beams, m)
        x, y = origins[group, 0], origins[group, 1]
        apart = 0.0
        for k in range(group + 1, end):
            apart = max(apart, np.hypot(origins[k, 0] - x, origins[k, 1] - y))
        count = 0
        for w in range(walls.shape[0]):
            if _distance(x, y, walls[w]) <= limit + apart:
                near[count] = w
                count += 1
        for k in range(group, end):
            x, y = origins[k, 0], origins[k, 1]
            c, s = np.cos(directions[k]), np.sin(directions[k])
            best = limit
            for j in range(count):
                w = near[j]
                dx, dy = walls[w, 2] - walls[w, 0], walls[w, 3] - walls[w, 1]
                qx, qy = walls[w, 0] - x, walls[w, 1] - y
                # Ray o + t·r meets wall p + u·d where t = q×d / r×d and u = q×r / r×d, q = p - o.
                across = c * dy - s * dx
                if across == 0.0:
                    continue
                t = (qx * dy - qy * dx) / across
                u = (qx * s - qy * c) / across
                if 0.0 <= u <= 1.0 and 0.0 < t <= best:
                    best = t
                    out[k] = t
    return out


@compiled
def _distance(x: float, y: float, wall: Floats) -> float:
    """Return the distance of a point from a piece of wall (4,)."""
    dx, dy = wall[2] - wall[0], wall[3] - wall[1]
    u = ((x - wall[0]) * dx + (y - wall[1]) * dy) / (dx * dx + dy * dy)
    u = min(max(u, 0.0), 1.0)
    return float(np.hypot(wall[0] + u * dx - x, wall[1] + u * dy - y))


@compiled
def cut_by_discs(
    origins: Floats, directions: Floats, centres: Floats, radius: float, ranges: Floats
) -> None:
    """Shorten `ranges` (M,) where a disc stands before what was hit.

    `centres` (M, 2) is where the disc is at the time of each ray. A disc round the origin is not
    seen: nobody stands inside a robot. O(M).
    """
    for k in range(origins.shape[0]):
        qx, qy = centres[k, 0] - origins[k, 0], centres[k, 1] - origins[k, 1]
        c, s = np.cos(directions[k]), np.sin(directions[k])
        along, across = qx * c + qy * s, qy * c - qx * s
        square = radius * radius - across * across
        if along <= 0.0 or square <= 0.0 or qx * qx + qy * qy <= radius * radius:
            continue
        t = along - np.sqrt(square)
        if t < ranges[k]:
            ranges[k] = t
