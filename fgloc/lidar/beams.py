"""The beams of one scan as compiled extraction sees them, and what it goes by."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats, Stamps

STEEPEST = 20.0
"""Largest tangent of the angle between a beam and a wall's normal that noise is adapted to before
there is a line."""
SLOPE_BEAMS = 4
"""Beams to each side that tell how obliquely a beam meets its wall."""
NEARBY = 10
"""Beams to each side that tell whether the noise is as stated."""
EXCESSES = (1.8, 2.5, 3.5)
"""Steps of the noise as a multiple of what is stated. Chance stays below the first."""
USUAL = 0.455
"""Median of the square of a normal number."""
FLATTEST = 0.01
"""Smallest cosine of that angle: a beam nearer to parallel does not say where it met the wall."""


class Rules(NamedTuple):
    """The sensor's properties and the settings, by the names of `Scans` and `LineSettings`."""

    beams: int
    """Beams of a scan, valid or not."""
    increment: float
    """Angle between beams [rad], not signed."""
    turn: bool
    """Whether a scan is a full turn, so that its last beam is a neighbour of its first."""
    range_sigma: float
    range_sigma_share: float
    bearing_sigma: float
    min_range: float
    max_range: float
    roughness_m: float
    flatness_m: float
    min_points: int
    min_length_m: float
    gap_m: float
    hidden_m: float
    most_missing: int
    noise_margin: float
    outlier: float
    curved: float
    penalty: float
    clutter: float
    same: float


class Beams(NamedTuple):
    """The n valid beams of a scan in order: where they ended, and what is found out about them."""

    beam: Stamps
    """Index of the beam in the scan."""
    x: Floats
    """Where it ended [m], lidar axes."""
    y: Floats
    """Where it ended [m], lidar axes."""
    r: Floats
    """Distance of that from the origin of the axes [m]."""
    ux: Floats
    """Direction of that, x of the unit vector."""
    uy: Floats
    """Direction of that, y of the unit vector."""
    breaks: npt.NDArray[np.bool_]
    """Whether so many beams are missing before this one that no piece goes on."""
    excess: Floats
    """How many times the stated variance the beams around this one show, 1 or more."""
    weight: Floats
    """One over the variance of 1/r."""
    label: Stamps
    """Piece that the beam belongs to; -1: to none."""
    along: Floats
    """Position [m] along the tangent of the piece's line, from its middle."""
    across: Floats
    """Distance [m] from the line towards the lidar."""
    trust: Floats
    """One over the variance of `across`; 0 where the beam did not count for the line."""


@compiled
def room(beams: int) -> Beams:
    """Return beams to be filled."""
    return Beams(
        np.empty(beams, np.int64),
        np.empty(beams),
        np.empty(beams),
        np.empty(beams),
        np.empty(beams),
        np.empty(beams),
        np.empty(beams, np.bool_),
        np.empty(beams),
        np.empty(beams),
        np.empty(beams, np.int64),
        np.empty(beams),
        np.empty(beams),
        np.empty(beams),
    )


@compiled
def gather(points: Floats, valid: npt.NDArray[np.bool_], rules: Rules, into: Beams) -> Beams:
    """Return the valid beams of a scan (B, 2), (B,) in order, as the first part of `into`.

    A full turn begins behind missing beams or the largest jump of the range, so that few walls
    lie across the seam. Weights take how obliquely a beam meets its wall from the flatter side of
    its neighbourhood, and shrink where neighbours differ by more than the stated noise: a SICK
    scanner takes every other beam half a scan later, in which the robot has moved, and dark or
    shiny walls are noisier than others. O(B).
    """
    n = 0
    for b in range(valid.size):
        distance = np.hypot(points[b, 0], points[b, 1])
        if valid[b] and 0.0 < distance < np.inf:
            into.label[n], into.along[n] = b, distance
            n += 1
    start = 0
    if rules.turn and n > 1:
        largest = 0.0
        for k in range(n):
            before, here = into.along[k - 1 if k > 0 else n - 1], into.along[k]
            jump = abs(here - before) / min(here, before)
            apart = (into.label[k] - into.label[k - 1 if k > 0 else n - 1]) % rules.beams
            if apart > rules.most_missing + 1:
                # Nothing goes on here in any case.
                jump = np.inf
            if jump > largest:
                largest, start = jump, k
    for k in range(n):
        i = (k + start) % n
        b = into.label[i]
        into.beam[k], into.r[k] = b, into.along[i]
        into.x[k], into.y[k] = points[b, 0], points[b, 1]
        into.ux[k], into.uy[k] = into.x[k] / into.r[k], into.y[k] / into.r[k]
        if k > 0:
            missed = (b - into.beam[k - 1]) % rules.beams
            into.breaks[k] = missed > rules.most_missing + 1
    if n > 0:
        missed = (into.beam[0] - into.beam[n - 1]) % rules.beams
        into.breaks[0] = not rules.turn or missed > rules.most_missing + 1
    beams = Beams(
        into.beam[:n],
        into.x[:n],
        into.y[:n],
        into.r[:n],
        into.ux[:n],
        into.uy[:n],
        into.breaks[:n],
        into.excess[:n],
        into.weight[:n],
        into.label[:n],
        into.along[:n],
        into.across[:n],
        into.trust[:n],
    )
    for k in range(n):
        slope = _slope(beams, k)
        beams.weight[k] = beams.r[k] ** 4 / range_variance(rules, beams.r[k], slope)
        beams.trust[k] = 0.0
    _find_excess(beams)
    return beams


@compiled
def range_variance(rules: Rules, r: float, slope: float) -> float:
    """Return the variance of a range r that meets its wall at an angle with tangent `slope`."""
    return (
        rules.range_sigma**2
        + (rules.range_sigma_share * r) ** 2
        + (rules.bearing_sigma * r * slope) ** 2
        + rules.roughness_m**2 * (1.0 + slope * slope)
    )


@compiled
def _slope(beams: Beams, k: int) -> float:
    """Return about how obliquely beam k meets its wall: the tangent of the angle to the normal."""
    x, y, r, breaks = beams.x, beams.y, beams.r, beams.breaks
    slope = STEEPEST
    for side in range(2):
        step = 1 if side == 0 else -1
        i = k
        for _ in range(SLOPE_BEAMS):
            j = i + step
            if j < 0 or j >= r.size or breaks[max(i, j)]:
                break
            i = j
        if i != k:
            across = abs(x[k] * y[i] - y[k] * x[i])
            along = abs(r[i] - r[k]) * 0.5 * (r[i] + r[k])
            if along < slope * across:
                slope = along / across
    return slope


@compiled
def _find_excess(beams: Beams) -> None:
    """Fill the excess and apply it to the weights.

    A beam is compared with the line through its two neighbours, which is exact for a straight
    wall; corners and jumps are few among the beams of a neighbourhood, so the median is taken, in
    steps.
    """
    ux, uy, r = beams.ux, beams.uy, beams.r
    n, steps = r.size, len(EXCESSES)
    # Number of steps that the squared, normalised difference of each beam exceeds; -1: none.
    height = beams.label
    for k in range(n):
        height[k] = -1
        if k == 0 or k == n - 1 or beams.breaks[k] or beams.breaks[k + 1]:
            continue
        whole = ux[k - 1] * uy[k + 1] - uy[k - 1] * ux[k + 1]
        after = ux[k] * uy[k + 1] - uy[k] * ux[k + 1]
        before = ux[k - 1] * uy[k] - uy[k - 1] * ux[k]
        d = whole / r[k] - after / r[k - 1] - before / r[k + 1]
        variance = (
            whole**2 / beams.weight[k]
            + after**2 / beams.weight[k - 1]
            + before**2 / beams.weight[k + 1]
        )
        height[k] = 0
        for step in range(steps):
            if d * d > USUAL * EXCESSES[step] ** 2 * variance:
                height[k] = step + 1
    known = 0
    above = np.zeros(steps, np.int64)
    for k in range(-NEARBY, n):
        for i, change in ((k + NEARBY, 1), (k - NEARBY - 1, -1)):
            if 0 <= i < n and height[i] >= 0:
                known += change
                for step in range(height[i]):
                    above[step] += change
        if k < 0:
            continue
        factor = 1.0
        for step in range(steps):
            if known >= NEARBY and 2 * above[step] > known:
                # Half way to the next step, which the median does not exceed.
                factor = np.sqrt(EXCESSES[step] * EXCESSES[min(step + 1, steps - 1)])
        beams.excess[k] = factor * factor
    for k in range(n):
        beams.weight[k] /= beams.excess[k]
