"""Fit one straight line to beams, with a covariance that can be believed.

The least squares are those of the ranges: a beam errs along itself, and where it would have met
the line does not depend on its error. Total least squares of the points with the same weights has
a bias for oblique walls, since a beam that is too long also pulls the middle outwards.
"""

from __future__ import annotations

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats
from fgloc.lidar.beams import FLATTEST, Beams, Rules

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
def across_variance(rules: Rules, r: float, cosine: float) -> float:
    """Return the variance across a wall at range r, met at an angle of that cosine to its normal.

    A beam that errs along itself is off by the cosine of that, one that errs in direction by the
    sine of r times that.
    """
    square = cosine * cosine
    along = rules.range_sigma**2 + (rules.range_sigma_share * r) ** 2
    return along * square + (rules.bearing_sigma * r) ** 2 * (1.0 - square) + rules.roughness_m**2


@compiled
def _cut(rules: Rules, r: float, excess: float) -> bool:
    """Return whether a beam that meets its wall at r may be missing for its error alone.

    Of beams near the longest range those that err to be longer are no returns: what is left is
    too short on average. The same holds near the shortest range.
    """
    margin = 3.0 * np.sqrt(excess * (rules.range_sigma**2 + (rules.range_sigma_share * r) ** 2))
    return bool(r + margin > rules.max_range or r - margin < rules.min_range)


@compiled
def _begin(first: int, last: int, piece: int, rules: Rules, beams: Beams, out: Floats) -> bool:
    """Write normal and a point of the line that is linear in 1/r; False if there is none."""
    ux, uy, r, label = beams.ux, beams.uy, beams.r, beams.label
    n = r.size
    m11 = m12 = m22 = b1 = b2 = 0.0
    axis = -1
    count = 0
    for q in range(first, last + 1):
        k = q % n
        if label[k] != piece:
            continue
        if axis < 0:
            axis = k
        c, s = ux[k] * ux[axis] + uy[k] * uy[axis], uy[k] * ux[axis] - ux[k] * uy[axis]
        w = beams.weight[k]
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
    # (u, v)·p = 1 along the line: the normal towards the lidar is the other way.
    out[0] = -(ux[axis] * u - uy[axis] * v) / size
    out[1] = -(uy[axis] * u + ux[axis] * v) / size
    out[2], out[3] = -out[0] / size, -out[1] / size
    return True


@compiled
def fit_line(first: int, last: int, piece: int, rules: Rules, beams: Beams, out: Floats) -> bool:
    """Fit a line to the beams first..last (cyclic, last may exceed n) whose label is `piece`.

    Beams farther from the line than `rules.outlier` sigmas do not count. Fills `out` (WIDTH,),
    and `along`, `across` and `trust` of the piece's beams. False if the beams do not determine a
    line that the lidar is in front of. O(last - first).
    """
    label, along, across, trust = beams.label, beams.along, beams.across, beams.trust
    n = label.size
    if not _begin(first, last, piece, rules, beams, out):
        return False
    nx, ny, mx, my = out[0], out[1], out[2], out[3]
    limit = rules.outlier * rules.outlier
    used = 0
    total = spread = shift = twist = centre = 0.0
    for turn in range(ROUNDS):
        total = moment = 0.0
        used = 0
        for q in range(first, last + 1):
            k = q % n
            if label[k] != piece:
                continue
            # Between the beam and the way into the wall.
            cosine = max(-(nx * beams.ux[k] + ny * beams.uy[k]), FLATTEST)
            h = nx * (beams.x[k] - mx) + ny * (beams.y[k] - my)
            # Where the beam would have met the line: h is measured along the normal.
            ahead = h / cosine
            px, py = beams.x[k] + ahead * beams.ux[k] - mx, beams.y[k] + ahead * beams.uy[k] - my
            s = nx * py - ny * px
            seen = max(beams.r[k] + ahead, 0.0)
            variance = beams.excess[k] * across_variance(rules, seen, cosine)
            # A beam that errs in direction meets the wall farther away on average.
            bent = 0.5 * rules.bearing_sigma**2 * seen
            h += bent * (2.0 / cosine - cosine)
            along[k], across[k], trust[k] = s, h, 1.0 / variance
            if turn > 0 and (h * h > limit * variance or _cut(rules, seen, beams.excess[k])):
                trust[k] = 0.0
            else:
                used += 1
                total += trust[k]
                moment += trust[k] * s
        if used < 3:
            return False
        centre = moment / total
        spread = shift = twist = 0.0
        for q in range(first, last + 1):
            k = q % n
            if label[k] == piece and trust[k] > 0.0:
                s = along[k] - centre
                spread += trust[k] * s * s
                shift += trust[k] * across[k]
                twist -= trust[k] * across[k] * s
        if not spread > 0.0:
            return False
        shift /= total
        twist = max(-0.5, min(0.5, twist / spread))
        # The middle goes along the tangent (-ny, nx) and onto the line; the normal turns.
        mx, my = mx - ny * centre + nx * shift, my + nx * centre + ny * shift
        nx, ny = nx - twist * ny, ny + twist * nx
        size = np.hypot(nx, ny)
        nx, ny = nx / size, ny / size
    if not nx * mx + ny * my < 0.0:
        return False
    out[NORMAL] = np.arctan2(ny, nx)
    out[MIDDLE_X], out[MIDDLE_Y] = mx, my
    out[NORMAL_VARIANCE], out[OFFSET_VARIANCE] = 1.0 / spread, 1.0 / total
    out[BEAMS] = used
    misfit = third = fourth = bend = 0.0
    right, left = np.inf, -np.inf
    for q in range(first, last + 1):
        k = q % n
        if label[k] == piece and trust[k] > 0.0:
            s = along[k] - centre
            h = across[k] - shift + twist * s
            along[k], across[k] = s, h
            misfit += trust[k] * h * h
            third += trust[k] * s**3
            fourth += trust[k] * s**4
            bend += trust[k] * h * s * s
            right, left = min(right, s), max(left, s)
    out[RIGHT], out[LEFT], out[MISFIT] = right, left, misfit
    # What is left of s² beside 1 and s, and how much of it the residuals hold.
    curved = fourth - third * third / spread - spread * spread / total
    half = 0.25 * (left - right) ** 2
    out[SAGITTA], out[SAGITTA_VARIANCE] = 0.0, np.inf
    if used > 3 and curved > 1e-9 * fourth:
        out[SAGITTA] = bend / curved * half
        out[SAGITTA_VARIANCE] = half * half / curved
    return True
