"""Poses that no robot can have driven: resets, stray messages, two robots under one topic name."""

from __future__ import annotations

from collections import Counter

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.geometry import between, wrap
from fgloc.core.measurements import Floats, Stamps
from fgloc.datasets.plausible import FASTEST_M_S, FASTEST_RAD_S
from fgloc.datasets.text import Integers, Mask, count

STEP_M, STEP_RAD = 0.1, 0.5
"""A pose may step by so much at once, whatever the time since the one before [m], [rad]."""
TIMES, MORE = 5.0, 1.0
"""A robot is at most so many times as fast, and so much faster [m/s], [rad/s], than in the middle
of the WINDOW steps around."""
WINDOW = 11
STALE = 1.0
"""A second of silence makes a source as unlikely as a metre away, or a radian."""
MOST_SOURCES = 64
"""So many sources are told apart; poses that jump about more belong to none."""
STRAY = 0.02
"""A source of fewer of the messages than this is a stray one."""


def one_source(
    stamps: Stamps, poses: Floats, topic: str, role: str, rejected: Counter[str], notes: list[str]
) -> tuple[Integers, Mask]:
    """Return indices (M,) of the poses of one source, and which of the M-1 steps are its resets.

    A pose that cannot follow the one before, by the speed around it and by what any robot drives,
    belongs to another source: to the nearest of those seen so far that it can follow, else to a
    new one. The source of most poses is kept; one that
    begins after it ends, or ends before it begins, is the same robot after a reset of its
    odometry. Everything else is dropped and counted. O(N), where poses jump O(N · sources).
    """
    everything = np.arange(stamps.size, dtype=np.int64)
    step = between(poses[:-1], poses[1:])
    seconds = np.diff(stamps) * 1e-9
    way, turn = np.hypot(step[:, 0], step[:, 1]), np.abs(wrap(step[:, 2]))
    limits = np.stack(
        [_limit(way / seconds, FASTEST_M_S), _limit(turn / seconds, FASTEST_RAD_S)], axis=1
    )
    allowed = limits * seconds[:, None] + (STEP_M, STEP_RAD)
    jumps = (way > allowed[:, 0]) | (turn > allowed[:, 1])
    if not jumps.any():
        return everything, jumps
    # Each pose has the limit of the step that leads to it.
    source = _sources(
        stamps, poses, np.concatenate([limits[:1], limits]), np.empty(stamps.size, np.int64)
    )
    number, size = np.unique(source[source >= 0], return_counts=True)
    kept: list[tuple[int, int, int]] = []
    beside: list[int] = []
    for k in np.argsort(-size, kind="stable"):
        at = np.flatnonzero(source == number[k])
        apart = all(at[0] > last or at[-1] < first for _, first, last in kept)
        if not kept or (apart and size[k] >= STRAY * stamps.size):
            kept.append((int(number[k]), int(at[0]), int(at[-1])))
        elif size[k] >= STRAY * stamps.size:
            beside.append(int(size[k]))
    chosen = everything[np.isin(source, [n for n, _, _ in kept])]
    count(rejected, f"{role} pose of another source", stamps.size - chosen.size)
    if beside:
        notes.append(
            f"{topic} carries several sources at once ({int(chosen.size)} messages, and "
            f"{' and '.join(map(str, beside))} elsewhere): two robots under one name? "
            "The first is used."
        )
    resets = np.diff(source[chosen]) != 0
    if resets.any():
        number_of = "once" if resets.sum() == 1 else f"{int(resets.sum())} times"
        steady = "the motion across a jump is taken as steady."
        then = "it was lost in between, or set anew." if role == "truth" else steady
        notes.append(f"{topic} jumps {number_of} and goes on from there, as after a reset: {then}")
    return chosen, resets


def _limit(speed: Floats, fastest: float) -> Floats:
    """Return (N,) the speed that is believed of each of N steps, never above `fastest`."""
    from scipy.ndimage import median_filter

    middle = median_filter(speed, WINDOW, mode="nearest")
    return np.asarray(np.minimum(TIMES * middle + MORE, fastest))


@compiled
def _sources(stamps: Stamps, poses: Floats, limits: Floats, out: Integers) -> Integers:
    """Return which source each pose belongs to, -1 where there would be too many.

    `limits` (N, 2) are the largest speed and rate of turning believed of each pose.
    """
    latest = np.empty(MOST_SOURCES, np.int64)
    n = 0
    for k in range(stamps.size):
        best, nearest = -1, np.inf
        for s in range(n):
            before = latest[s]
            seconds = (stamps[k] - stamps[before]) * 1e-9
            away = np.hypot(poses[k, 0] - poses[before, 0], poses[k, 1] - poses[before, 1])
            turn = abs((poses[k, 2] - poses[before, 2] + np.pi) % (2.0 * np.pi) - np.pi)
            if away > limits[k, 0] * seconds + STEP_M or turn > limits[k, 1] * seconds + STEP_RAD:
                continue
            # A source long silent would have moved on: who comes by its last pose is another.
            if away + turn + STALE * seconds < nearest:
                best, nearest = s, away + turn + STALE * seconds
        if best < 0 and n < MOST_SOURCES:
            best = n
            n += 1
        out[k] = best
        if best >= 0:
            latest[best] = k
    return out


def bridge(increments: Floats, seconds: Floats, unknown: Mask) -> Floats:
    """Return increments (N, W) with those that are `unknown` (N,) at the rate of their neighbours.

    The rate is interpolated between the nearest known intervals; zero where none is known.
    """
    if not unknown.any():
        return increments
    out = increments.copy()
    good, lost = np.flatnonzero(~unknown), np.flatnonzero(unknown)
    out[lost] = 0.0
    if good.size:
        for w in range(increments.shape[1]):
            rate = np.interp(lost, good, increments[good, w] / seconds[good])
            out[lost, w] = rate * seconds[lost]
    return out
