"""Fit one straight line to beams, with a covariance that can be believed.

The least squares are those of the ranges: a beam errs along itself, and where it would have met
the line does not depend on its error. Total least squares of the points with the same weights has
a bias for oblique walls, since a beam that is too long also pulls the middle outwards.
"""

from __future__ import annotations

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats, Stamps
from fgloc.lidar.splitting import STEEPEST

ROUNDS = 4
"""Gauss-Newton steps; the first comes within a few percent of a sigma of the last."""

(
    NORMAL,
    MIDDLE_X,
    MIDDLE_Y,
    RIGHT,
    LEFT,
    NORMAL_VARIANCE,
    OFFSET_VARIANCE,
    MISFIT,
    BEAMS,
    SAGITTA,
    SAGITTA_VARIANCE,
) = range(11)
"""What a fit holds: the line, its ends along the tangent from the middle, variances without any
floor, chi-square and the number of beams used, and how far the beams bulge out between the ends."""
WIDTH = 11


@compiled
def fit_line(
    first: int,
    last: int,
    piece: int,
    n: int,
    label: Stamps,
    x: Floats,
    y: Floats,
    r: Floats,
    noise: Floats,
    outlier: float,
    along: Floats,
    across: Floats,
    weights: Floats,
    out: Floats,
) -> bool:
    """Fit a line to the beams first..last (cyclic, last may exceed n) that carry label `piece`.

    noise is that of `fgloc.lidar.splitting.prepare`; beams farther than `outlier` sigmas from the
    line do not count. Fills `out` (WIDTH,), and position along the tangent, distance towards the
    lidar and weight of every beam of the piece into `along`, `across`, `weights` (n,), weight
    0 where it does not count. False if the beams do not determine a line. O(last - first).
    """
    m11 = m12 = m22 = b1 = b2 = 0.0
    axis = -1
    count = 0
    for q in range(first, last + 1):
        k = q % n
        if label[k] != piece:
            continue
        if axis < 0:
            axis = k
        ci, si = x[axis] / r[axis], y[axis] / r[axis]
        c, s = (x[k] * ci + y[k] * si) / r[k], (y[k] * ci - x[k] * si) / r[k]
        w = r[k] ** 4 / (noise[0] ** 2 + (noise[1] * r[k]) ** 2 + noise[3] ** 2)
        m11 += w * c * c
        m12 += w * c * s
        m22 += w * s * s
        b1 += w * c / r[k]
        b2 += w * s / r[k]
        count += 1
    det = m11 * m22 - m12 * m12
    if count < 3 or not det > 1e-12 * m11 * m22:
        return False
    u, v = (b1 * m22 - b2 * m12) / det, (b2 * m11 - b1 * m12) / det
    size = np.hypot(u, v)
    if not size > 0.0:
        return False
    ci, si = x[axis] / r[axis], y[axis] / r[axis]
    # (u, v)·p = 1 along the line: the normal towards the lidar is the other way.
    nx, ny = -(ci * u - si * v) / size, -(si * u + ci * v) / size
    mx, my = -nx / size, -ny / size
    for turn in range(ROUNDS):
        total = moment = 0.0
        used = 0
        for q in range(first, last + 1):
            k = q % n
            if label[k] != piece:
                continue
            ux, uy = x[k] / r[k], y[k] / r[k]
            # Cosine between the beam and the way into the wall.
            cosine = max(-(nx * ux + ny * uy), 1.0 / STEEPEST / 5.0)
            h = nx * (x[k] - mx) + ny * (y[k] - my)
            # Where the beam would have met the line: h is measured along the normal.
            ahead = h / cosine
            px, py = x[k] + ahead * ux, y[k] + ahead * uy
            s = nx * (py - my) - ny * (px - mx)
            seen = r[k] + ahead
            sine2 = 1.0 - cosine * cosine
            bent = (noise[2] * seen) ** 2
            variance = (
                (noise[0] ** 2 + (noise[1] * seen) ** 2) * cosine * cosine
                + bent * sine2
                + noise[3] ** 2
            )
            # A beam that errs in direction meets the wall farther away on average.
            if seen > 0.0:
                h += 0.5 * bent / seen * (1.0 + 2.0 * sine2 / (cosine * cosine)) * cosine
            along[k], across[k] = s, h
            weights[k] = 1.0 / variance
            if turn > 0 and h * h > outlier * outlier * variance:
                weights[k] = 0.0
            else:
                used += 1
                total += weights[k]
                moment += weights[k] * s
        if used < 3:
            return False
        centre = moment / total
        spread = shift = twist = 0.0
        for q in range(first, last + 1):
            k = q % n
            if label[k] == piece and weights[k] > 0.0:
                s = along[k] - centre
                spread += weights[k] * s * s
                shift += weights[k] * across[k]
                twist -= weights[k] * across[k] * s
        if not spread > 0.0:
            return False
        shift /= total
        twist = np.tan(max(-0.5, min(0.5, twist / spread)))
        # The middle goes along the tangent (-ny, nx) and onto the line; the normal turns.
        mx, my = mx - ny * centre + nx * shift, my + nx * centre + ny * shift
        nx, ny = nx - twist * ny, ny + twist * nx
        size = np.hypot(nx, ny)
        nx, ny = nx / size, ny / size
    if not nx * mx + ny * my < 0.0:
        return False
    misfit = 0.0
    third = fourth = bend = 0.0
    right, left = np.inf, -np.inf
    for q in range(first, last + 1):
        k = q % n
        if label[k] == piece and weights[k] > 0.0:
            s = along[k] - centre
            h = across[k] - shift + twist * s
            along[k], across[k] = s, h
            misfit += weights[k] * h * h
            third += weights[k] * s**3
            fourth += weights[k] * s**4
            bend += weights[k] * h * s * s
            right, left = min(right, s), max(left, s)
    # What is left of s² beside 1 and s, and how much of it the residuals hold.
    curved = fourth - third * third / spread - spread * spread / total
    half = 0.25 * (left - right) ** 2
    out[SAGITTA], out[SAGITTA_VARIANCE] = 0.0, np.inf
    if used > 3 and curved > 1e-9 * fourth:
        out[SAGITTA] = bend / curved * half
        out[SAGITTA_VARIANCE] = half * half / curved
    out[NORMAL] = np.arctan2(ny, nx)
    out[MIDDLE_X], out[MIDDLE_Y] = mx, my
    out[RIGHT], out[LEFT] = right, left
    out[NORMAL_VARIANCE], out[OFFSET_VARIANCE] = 1.0 / spread, 1.0 / total
    out[MISFIT], out[BEAMS] = misfit, used
    return True
