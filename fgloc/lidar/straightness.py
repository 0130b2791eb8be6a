"""Which pieces are straight walls: the final fit, and what tells a wall from a curve."""

from __future__ import annotations

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.geometry import wrap_scalar
from fgloc.core.kinematics_kernels import solve3
from fgloc.core.measurements import Floats
from fgloc.lidar.beams import FLATTEST, Beams, Rules
from fgloc.lidar.fitting import (
    BEAMS,
    LEFT,
    MIDDLE_X,
    MIDDLE_Y,
    MISFIT,
    NORMAL,
    RIGHT,
    SAGITTA,
    SAGITTA_VARIANCE,
    across_variance,
    fit_line,
)
from fgloc.lidar.merging import Pieces, passes

BROADEST = np.radians(45.0)
"""Neighbours that meet at a larger angle are a corner, not chords of a curve."""
AMBIGUOUS = 3.0
"""A beam this many sigmas from the next wall may belong to that."""
FEWEST = 4
"""Beams that a fit must be left with."""


@compiled
def chi_square_bound(dof: int, sigmas: float) -> float:
    """Return the quantile of chi-square at so many sigmas of a normal number (Wilson, Hilferty)."""
    if dof < 1:
        return 0.0
    share = 2.0 / (9.0 * dof)
    return float(dof * (1.0 - share + sigmas * np.sqrt(share)) ** 3)


@compiled
def neighbour(q: int, side: int, left: int, rules: Rules, beams: Beams, pieces: Pieces) -> int:
    """Return the piece that touches the q-th at its end (side 1) or beginning (-1); -1 if none.

    Two pieces touch if they come one after the other and are no farther apart than beams are.
    Pieces on both sides of an opening that beams pass do not touch.
    """
    if left < 2 or (not rules.turn and not 0 <= q + side < left):
        return -1
    n = beams.r.size
    one, other = pieces.order[q], pieces.order[(q + side) % left]
    a, b = (one, other) if side > 0 else (other, one)
    begin = pieces.first[b] if pieces.first[b] > pieces.last[a] else pieces.first[b] + n
    if not 0 < begin - pieces.last[a] <= 3:
        return -1
    i, j = pieces.last[a] % n, pieces.first[b] % n
    spacing = 0.0
    for c in (a, b):
        fit = pieces.fits[c]
        spacing += (fit[LEFT] - fit[RIGHT]) / max(fit[BEAMS] - 1.0, 1.0)
    apart = np.hypot(beams.x[i] - beams.x[j], beams.y[i] - beams.y[j])
    if apart > 2.0 * spacing:
        return -1
    passed = passes(pieces.fits[a], pieces.last[a] + 1, begin - 1, rules, beams)
    return -1 if passed else other


@compiled
def off(fit: Floats, k: int, rules: Rules, beams: Beams) -> float:
    """Return how many sigmas beam k is off the line of a fit, towards the lidar."""
    nx, ny = np.cos(fit[NORMAL]), np.sin(fit[NORMAL])
    h = nx * (beams.x[k] - fit[MIDDLE_X]) + ny * (beams.y[k] - fit[MIDDLE_Y])
    cosine = max(-(nx * beams.ux[k] + ny * beams.uy[k]), FLATTEST)
    return float(h / np.sqrt(beams.excess[k] * across_variance(rules, beams.r[k], cosine)))


@compiled
def refine(piece: int, before: int, after: int, rules: Rules, beams: Beams, pieces: Pieces) -> bool:
    """Fit a piece once more without the beams at its ends that may belong to something else.

    Those are the very last one, which may have met an edge half, and those that the neighbour's
    line (before, after; -1: none) explains as well: whichever of them are taken for this wall are
    chosen by their errors. They still say how far the wall reaches, and so do beams beyond them
    that are on the line and in no other piece. False if nothing is left.
    """
    first, last, fit, label = (
        pieces.first[piece],
        pieces.last[piece],
        pieces.fits[piece],
        beams.label,
    )
    n = label.size
    begin, end = first + 1, last - 1
    if before >= 0:
        while begin < end and _explained(begin % n, piece, before, rules, beams, pieces):
            begin += 1
    if after >= 0:
        while begin < end and _explained(end % n, piece, after, rules, beams, pieces):
            end -= 1
    if end - begin + 1 < FEWEST or not fit_line(begin, end, piece, rules, beams, fit):
        return False
    for q in range(first, last + 1):
        if label[q % n] == piece and not begin <= q <= end:
            beams.trust[q % n] = 0.0
            _reach_to(q % n, fit, rules, beams)
    for step in (-1, 1):
        q = first - 1 if step < 0 else last + 1
        while 0 <= q < n or rules.turn:
            k = q % n
            # The later of this beam and the one before it on the way.
            broken = beams.breaks[(q + 1) % n if step < 0 else k]
            if label[k] >= 0 or broken or not _reach_to(k, fit, rules, beams):
                break
            q += step
    return True


@compiled
def _reach_to(k: int, fit: Floats, rules: Rules, beams: Beams) -> bool:
    """Let a fit reach to beam k if that is on its line; return whether it is."""
    if abs(off(fit, k, rules, beams)) > AMBIGUOUS:
        return False
    dx, dy = beams.x[k] - fit[MIDDLE_X], beams.y[k] - fit[MIDDLE_Y]
    s = np.cos(fit[NORMAL]) * dy - np.sin(fit[NORMAL]) * dx
    fit[RIGHT], fit[LEFT] = min(fit[RIGHT], s), max(fit[LEFT], s)
    return True


@compiled
def _explained(k: int, piece: int, other: int, rules: Rules, beams: Beams, pieces: Pieces) -> bool:
    """Return whether beam k is not the piece's, or meets it too near to the line of another.

    Where the beam meets the piece's line is asked, not where it ended, so that the answer does
    not depend on its error.
    """
    if beams.label[k] != piece:
        return True
    own, next_wall = pieces.fits[piece], pieces.fits[other]
    ux, uy = beams.ux[k], beams.uy[k]
    nx, ny = np.cos(own[NORMAL]), np.sin(own[NORMAL])
    cosine = max(-(nx * ux + ny * uy), FLATTEST)
    r = -(nx * own[MIDDLE_X] + ny * own[MIDDLE_Y]) / cosine
    nx, ny = np.cos(next_wall[NORMAL]), np.sin(next_wall[NORMAL])
    h = nx * (r * ux - next_wall[MIDDLE_X]) + ny * (r * uy - next_wall[MIDDLE_Y])
    cosine = max(-(nx * ux + ny * uy), FLATTEST)
    variance = beams.excess[k] * across_variance(rules, r, cosine)
    return bool(h * h < AMBIGUOUS * AMBIGUOUS * variance)


@compiled
def straight(fit: Floats, rules: Rules) -> bool:
    """Return whether a fit is long enough, of enough beams, as good as its noise, and not bent."""
    if fit[BEAMS] < FEWEST or fit[LEFT] - fit[RIGHT] < rules.min_length_m:
        return False
    if fit[MISFIT] > rules.noise_margin**2 * chi_square_bound(int(fit[BEAMS]) - 2, 3.0):
        return False
    bulge = abs(fit[SAGITTA])
    return bool(bulge <= rules.curved * (np.sqrt(fit[SAGITTA_VARIANCE]) + rules.flatness_m))


@compiled
def chords(a: int, b: int, rules: Rules, beams: Beams, pieces: Pieces) -> bool:
    """Return whether piece b, which begins where a ends, and a may be chords of one curve.

    They may if one parabola fits the beams of both as well as their two lines do: then nothing
    says that either is straight. O(beams of both).
    """
    fa, fb = pieces.fits[a], pieces.fits[b]
    if abs(wrap_scalar(fa[NORMAL] - fb[NORMAL])) > BROADEST:
        return False
    size = np.hypot(fb[MIDDLE_X] - fa[MIDDLE_X], fb[MIDDLE_Y] - fa[MIDDLE_Y])
    if not size > 0.0:
        return False
    tx, ty = (fb[MIDDLE_X] - fa[MIDDLE_X]) / size, (fb[MIDDLE_Y] - fa[MIDDLE_Y]) / size
    ox, oy = 0.5 * (fa[MIDDLE_X] + fb[MIDDLE_X]), 0.5 * (fa[MIDDLE_Y] + fb[MIDDLE_Y])
    n = beams.r.size
    end = pieces.last[b] if pieces.last[b] > pieces.last[a] else pieces.last[b] + n
    m = np.zeros((3, 3))
    right = np.zeros(3)
    power = np.empty(3)
    squares = lines = 0.0
    for q in range(pieces.first[a], end + 1):
        k = q % n
        w = beams.trust[k]
        if w == 0.0 or (beams.label[k] != a and beams.label[k] != b):
            continue
        dx, dy = beams.x[k] - ox, beams.y[k] - oy
        s, h = (dx * tx + dy * ty) / size, dy * tx - dx * ty
        power[0], power[1], power[2] = 1.0, s, s * s
        for i in range(3):
            right[i] += w * h * power[i]
            for j in range(3):
                m[i, j] += w * power[i] * power[j]
        squares += w * h * h
        lines += w * beams.across[k] ** 2
    inverse = np.empty((3, 3))
    if not solve3(m, inverse):
        return False
    for i in range(3):
        for j in range(3):
            squares -= right[i] * inverse[i, j] * right[j]
    return squares <= lines + rules.same
