"""Put pieces of one wall together again: neighbours, across small gaps, and behind what hides it.

Pieces are numbers into first and last beam (cyclic) and fit; `order` lists those that are left.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.geometry import wrap_scalar
from fgloc.core.measurements import Floats, Stamps
from fgloc.lidar.beams import Beams, Rules
from fgloc.lidar.fitting import (
    BEAMS,
    LEFT,
    MIDDLE_X,
    MIDDLE_Y,
    MISFIT,
    NORMAL,
    NORMAL_VARIANCE,
    OFFSET_VARIANCE,
    RIGHT,
    WIDTH,
    fit_line,
)

FARTHEST = 4
"""Of two pieces to be merged the second is at most so many after the first."""


class Pieces(NamedTuple):
    """Straight pieces of one scan."""

    first: Stamps
    """First beam."""
    last: Stamps
    """Last beam; as many more as there are beams if that comes before the first."""
    order: Stamps
    """The pieces that are left, in the order of their beams."""
    fits: Floats
    """(pieces, WIDTH) their lines."""


@compiled
def fit_pieces(count: int, rules: Rules, beams: Beams, pieces: Pieces) -> int:
    """Fit a line to every piece; those without one become clutter. Return how many are left."""
    first, last, label = pieces.first, pieces.last, beams.label
    for p in range(count):
        first[p], last[p] = -1, -1
    for k in range(label.size):
        p = label[k]
        if p >= 0:
            if first[p] < 0:
                first[p] = k
            last[p] = k
    left = 0
    for p in range(count):
        if last[p] - first[p] >= 3 and fit_line(first[p], last[p], p, rules, beams, pieces.fits[p]):
            pieces.order[left] = p
            left += 1
        else:
            for k in range(first[p], last[p] + 1):
                label[k] = -1
    return left


@compiled
def merge(left: int, rules: Rules, beams: Beams, pieces: Pieces) -> int:
    """Merge pieces of one wall, near ones first; return how many pieces are left in `order`."""
    first, last, order, fits, label = (
        pieces.first,
        pieces.last,
        pieces.order,
        pieces.fits,
        beams.label,
    )
    n = label.size
    trial = np.empty(WIDTH)
    step = 1
    while step <= FARTHEST and step < left:
        merged = False
        q = 0
        while q < left and step < left and (rules.turn or q + step < left):
            a, b = order[q], order[(q + step) % left]
            if not _mergeable(a, b, rules, beams, pieces):
                q += 1
                continue
            end = last[b] if first[b] > last[a] else last[b] + n
            for i in range(first[b], last[b] + 1):
                if label[i % n] == b:
                    label[i % n] = a
            fitted = fit_line(first[a], end, a, rules, beams, trial)
            allowed = fits[a, MISFIT] + fits[b, MISFIT] + 2.0 * rules.same
            if fitted and trial[MISFIT] <= allowed * rules.noise_margin**2:
                last[a] = end
                for i in range(WIDTH):
                    fits[a, i] = trial[i]
                gone = (q + step) % left
                for i in range(gone, left - 1):
                    order[i] = order[i + 1]
                left -= 1
                merged = True
                if gone < q:
                    q -= 1
            else:
                # What was b's lies outside of a's own run.
                for i in range(first[b], last[b] + 1):
                    j = i % n
                    inside = first[a] <= j <= last[a] or first[a] <= j + n <= last[a]
                    if label[j] == a and not inside:
                        label[j] = b
                q += 1
        step = 1 if merged and step > 1 else step + 1
    return left


@compiled
def _mergeable(a: int, b: int, rules: Rules, beams: Beams, pieces: Pieces) -> bool:
    """Return whether piece b, the next after a but for some, shows the same wall as a."""
    fa, fb = pieces.fits[a], pieces.fits[b]
    if a == b or difference(fa, fb, rules.flatness_m) > rules.same:
        return False
    n = beams.r.size
    begin, end = pieces.first[b], pieces.last[b]
    while begin <= pieces.last[a]:
        begin, end = begin + n, end + n
    # One of them stands before the other, which goes on behind it.
    if end >= pieces.first[a] + n:
        return False
    # No wall takes up half a turn: the way round the other side of the lidar is no gap.
    turned = (beams.beam[end % n] - beams.beam[pieces.first[a]]) % rules.beams
    if turned * rules.increment >= np.pi:
        return False
    better, other = (fa, fb) if fa[BEAMS] >= fb[BEAMS] else (fb, fa)
    wide = _gap(better, other)
    if wide <= rules.gap_m:
        return True
    k = pieces.last[a] % n
    cosine = abs(np.cos(better[NORMAL]) * beams.ux[k] + np.sin(better[NORMAL]) * beams.uy[k])
    spacing = beams.r[k] * rules.increment / max(cosine, 0.05)
    return wide <= max(rules.hidden_m, 3.0 * spacing) and not passes(
        better, pieces.last[a] + 1, begin - 1, rules, beams
    )


@compiled
def floors(fit: Floats, flatness: float) -> tuple[float, float]:
    """Return the variances of normal and offset, with those of a wall that is not quite plane.

    What is off by `flatness` [m] at any place turns a wall of length L by sqrt(12)·flatness/L.
    """
    length = max(fit[LEFT] - fit[RIGHT], 1e-9)
    floor = flatness * flatness
    return fit[NORMAL_VARIANCE] + 12.0 * floor / (length * length), fit[OFFSET_VARIANCE] + floor


@compiled
def difference(a: Floats, b: Floats, flatness: float) -> float:
    """Return the squared normalised difference (2 degrees of freedom) of the lines of two fits.

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
    # A normal that turns by e moves the distance at s along the tangent by e·s.
    sa, sb = ay * nax - ax * nay, by * nbx - bx * nby
    step = (nax * ax + nay * ay) - (nbx * bx + nby * by)
    c00 = va + vb
    c01 = sa * va + sb * vb
    c11 = oa + ob + sa * sa * va + sb * sb * vb
    det = c00 * c11 - c01 * c01
    if not det > 0.0:
        return np.inf
    return float((turn * turn * c11 - 2.0 * turn * step * c01 + step * step * c00) / det)


@compiled
def _gap(a: Floats, b: Floats) -> float:
    """Return how far [m] fit b begins from where fit a ends, along a; 0 where they overlap."""
    nx, ny = np.cos(a[NORMAL]), np.sin(a[NORMAL])
    low, high = np.inf, -np.inf
    for side in range(2):
        reach = b[RIGHT + side]
        px = b[MIDDLE_X] - reach * np.sin(b[NORMAL]) - a[MIDDLE_X]
        py = b[MIDDLE_Y] + reach * np.cos(b[NORMAL]) - a[MIDDLE_Y]
        s = py * nx - px * ny
        low, high = min(low, s), max(high, s)
    return float(max(0.0, low - a[LEFT], a[RIGHT] - high))


@compiled
def passes(fit: Floats, first: int, last: int, rules: Rules, beams: Beams) -> bool:
    """Return whether the beams first..last, beside a fit, see through its line.

    They do if one ends more than the gap beyond it, or too many in a row did not return.
    """
    n = beams.r.size
    nx, ny = np.cos(fit[NORMAL]), np.sin(fit[NORMAL])
    for q in range(first, last + 1):
        k = q % n
        h = nx * (beams.x[k] - fit[MIDDLE_X]) + ny * (beams.y[k] - fit[MIDDLE_Y])
        if h < -rules.gap_m:
            return True
    for q in range(first, last + 2):
        if (beams.beam[q % n] - beams.beam[(q - 1) % n]) % rules.beams > rules.most_missing + 1:
            return True
    return False
