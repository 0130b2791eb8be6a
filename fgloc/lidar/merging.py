"""Put pieces of one wall together again, and find the pieces that are chords of a curve."""

from __future__ import annotations

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.geometry import wrap_scalar
from fgloc.core.kinematics import solve3
from fgloc.core.measurements import Floats, Stamps
from fgloc.lidar.fitting import (
    LEFT,
    MIDDLE_X,
    MIDDLE_Y,
    MISFIT,
    NORMAL,
    NORMAL_VARIANCE,
    OFFSET_VARIANCE,
    RIGHT,
)

BROADEST = np.radians(45.0)
"""Neighbours that meet at a larger angle are a corner, not chords of a curve."""


@compiled
def floors(fit: Floats, flatness: float) -> tuple[float, float]:
    """Return the variances of normal and offset, with those of a wall that is not quite plane."""
    length = max(fit[LEFT] - fit[RIGHT], 1e-9)
    floor = flatness * flatness
    return fit[NORMAL_VARIANCE] + 12.0 * floor / (length * length), fit[OFFSET_VARIANCE] + floor


@compiled
def difference(a: Floats, b: Floats, flatness: float) -> float:
    """Return the squared normalised difference (2 degrees of freedom) of two fits' lines.

    They are compared half way between their nearer ends, where neither has to reach far.
    """
    va, oa = floors(a, flatness)
    vb, ob = floors(b, flatness)
    nax, nay, nbx, nby = np.cos(a[NORMAL]), np.sin(a[NORMAL]), np.cos(b[NORMAL]), np.sin(b[NORMAL])
    dx, dy = b[MIDDLE_X] - a[MIDDLE_X], b[MIDDLE_Y] - a[MIDDLE_Y]
    way = dy * nax - dx * nay
    end_a = a[LEFT] if way > 0.0 else a[RIGHT]
    end_b = b[RIGHT] if way > 0.0 else b[LEFT]
    qx = 0.5 * (a[MIDDLE_X] - end_a * nay + b[MIDDLE_X] - end_b * nby)
    qy = 0.5 * (a[MIDDLE_Y] + end_a * nax + b[MIDDLE_Y] + end_b * nbx)
    ax, ay, bx, by = qx - a[MIDDLE_X], qy - a[MIDDLE_Y], qx - b[MIDDLE_X], qy - b[MIDDLE_Y]
    turn = wrap_scalar(a[NORMAL] - b[NORMAL])
    # A normal that is turned by e lowers the line by e times the way s along the tangent.
    sa, sb = ay * nax - ax * nay, by * nbx - bx * nby
    step = (nax * ax + nay * ay) - (nbx * bx + nby * by)
    c00 = va + vb
    c01 = sa * va + sb * vb
    c11 = oa + ob + sa * sa * va + sb * sb * vb
    det = c00 * c11 - c01 * c01
    if not det > 0.0:
        return np.inf
    return (turn * turn * c11 - 2.0 * turn * step * c01 + step * step * c00) / det


@compiled
def gap(a: Floats, b: Floats) -> float:
    """Return how far [m] fit b begins from where fit a ends, along a; 0 where they overlap."""
    nx, ny = np.cos(a[NORMAL]), np.sin(a[NORMAL])
    low, high = np.inf, -np.inf
    for side in range(2):
        reach = b[RIGHT + side]
        px = b[MIDDLE_X] - reach * np.sin(b[NORMAL]) - a[MIDDLE_X]
        py = b[MIDDLE_Y] + reach * np.cos(b[NORMAL]) - a[MIDDLE_Y]
        s = py * nx - px * ny
        low, high = min(low, s), max(high, s)
    return max(0.0, low - a[LEFT], a[RIGHT] - high)


@compiled
def open_between(
    a: Floats,
    b: Floats,
    first: int,
    last: int,
    n: int,
    beam: Stamps,
    beams: int,
    x: Floats,
    y: Floats,
    behind: float,
    most_missing: int,
) -> bool:
    """Return whether the beams first..last between two fits see through their common line.

    They do if one ends more than `behind` [m] beyond it, or more than `most_missing` in a row
    did not return.
    """
    better = a if a[NORMAL_VARIANCE] < b[NORMAL_VARIANCE] else b
    nx, ny = np.cos(better[NORMAL]), np.sin(better[NORMAL])
    for q in range(first, last + 1):
        k = q % n
        if nx * (x[k] - better[MIDDLE_X]) + ny * (y[k] - better[MIDDLE_Y]) < -behind:
            return True
    for q in range(first, last + 2):
        if (beam[q % n] - beam[(q - 1) % n]) % beams > most_missing + 1:
            return True
    return False


@compiled
def curved_pair(
    a: Floats,
    b: Floats,
    piece_a: int,
    piece_b: int,
    first: int,
    last: int,
    n: int,
    label: Stamps,
    x: Floats,
    y: Floats,
    weights: Floats,
    limit: float,
) -> bool:
    """Return whether one parabola fits the beams of two neighbours as well as their two lines.

    If so, nothing says that either is straight. `weights` are those of the fits, `limit` is what
    the parabola's chi-square may be above the lines'. O(last - first).
    """
    turn = abs(wrap_scalar(a[NORMAL] - b[NORMAL]))
    if turn > BROADEST:
        return False
    ax, ay, bx, by = a[MIDDLE_X], a[MIDDLE_Y], b[MIDDLE_X], b[MIDDLE_Y]
    size = np.hypot(bx - ax, by - ay)
    if not size > 0.0:
        return False
    tx, ty = (bx - ax) / size, (by - ay) / size
    ox, oy = 0.5 * (ax + bx), 0.5 * (ay + by)
    normal = np.zeros((3, 3))
    right = np.zeros(3)
    squares = 0.0
    for q in range(first, last + 1):
        k = q % n
        if (label[k] == piece_a or label[k] == piece_b) and weights[k] > 0.0:
            s = ((x[k] - ox) * tx + (y[k] - oy) * ty) / size
            h = (y[k] - oy) * tx - (x[k] - ox) * ty
            w = weights[k]
            s2 = s * s
            normal[0, 0] += w
            normal[0, 1] += w * s
            normal[0, 2] += w * s2
            normal[1, 2] += w * s2 * s
            normal[2, 2] += w * s2 * s2
            right[0] += w * h
            right[1] += w * h * s
            right[2] += w * h * s2
            squares += w * h * h
    normal[1, 1] = normal[0, 2]
    normal[1, 0], normal[2, 0], normal[2, 1] = normal[0, 1], normal[0, 2], normal[1, 2]
    inverse = np.empty((3, 3))
    if not solve3(normal, inverse):
        return False
    for i in range(3):
        for j in range(3):
            squares -= right[i] * inverse[i, j] * right[j]
    return squares <= a[MISFIT] + b[MISFIT] + limit
