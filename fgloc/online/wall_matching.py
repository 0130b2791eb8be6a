"""Which known wall each segment of a scan shows: gates that grow tighter as walls are recognised.

Segments are taken one after the other, those that leave no doubt first. A wall is a candidate if
it faces the sensor, reaches as far as the segment, and the innovation is inside its gate:
S = H P Hᵀ + R, with P the joint covariance of the pose and all walls. Each match then updates pose
and walls as a Kalman filter would, so that the next one is judged given those before; their
normalised innovations add up to that of the joint innovation, which must be compatible as well (the
sequential form of Neira and Tardós' joint compatibility). Where the first choice is not clear,
every choice is tried, and the one that explains most segments wins, if no other does as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fgloc.core.consistency import gate_threshold
from fgloc.core.measurements import Floats, Stamps
from fgloc.online.wall_pairs import (
    DOUBTFUL,
    NONE,
    evaluate_pairs,
    follow,
    mark_possible,
    write_squares,
)

MARGIN = 9.0
"""The second best wall must be this much less likely (difference of -2 log likelihood)."""
SURE, SHARE = 3, 0.7
"""A robot that was lost has found its place if so many segments, and this share of all, fit."""
ELSEWHERE = np.array([0.1, 0.1, 0.05])
"""Matches that move the robot to places this far apart [m, m, rad] contradict each other."""
TRIES = 400
"""First choices that are tried at most."""


@dataclass(frozen=True)
class Candidates:
    """Known walls that a scan may show."""

    lines: Floats
    """(W, 2) normal's direction [rad] and offset from the anchor [m]."""
    anchors: Floats
    """(W, 2) anchors [m]."""
    reach: Floats
    """(W, 2) where each was seen along its tangent from the anchor's foot [m]."""


@dataclass(frozen=True)
class Gates:
    """Bounds of normalised innovations squared."""

    single: float
    """Of one segment."""
    near: float
    """A segment beyond the gate of a wall but inside this one is not a new wall either."""
    joint: Floats
    """(N,) of the first, the first two, … matches together."""
    slack_m: float = 0.5
    """A segment may be this far from where a wall was seen so far, along it [m]."""

    @staticmethod
    def of(probability: float, most: int = 64) -> Gates:
        """Return the gates that true matches pass with a probability."""
        joint = np.array([gate_threshold(probability, 2 * (k + 1)) for k in range(most)])
        return Gates(float(joint[0]), 4.0 * float(joint[0]), joint)


def match(
    rows: Floats,
    reach: Floats,
    noise: Floats,
    pose: Floats,
    calibration: Floats,
    joint: Floats,
    walls: Candidates,
    gates: Gates,
    lost: bool = False,
) -> tuple[Stamps, Floats]:
    """Return the wall (M,) of each segment, or NONE, DOUBTFUL or NEAR, and its squares (M,).

    `rows` (M, 8) are the measurement rows of the wall kernel, anchors left out; `reach` (M, 2) how
    far a segment reaches along its tangent, `noise` (M, 2, 2) its covariance; `pose` (3,) and the
    sensor's `calibration` (g,), 0 or 3, with W walls are known to `joint` (3+g+2W, 3+g+2W), the
    pose in body axes. A robot that is `lost` is not content with the first place that fits.
    O(M²·W) and O(M·(3+2W)²) for every choice, compiled.
    """
    m, w = rows.shape[0], walls.lines.shape[0]
    if m == 0 or w == 0:
        return np.full(m, NONE, np.int64), np.full(m, np.inf)
    pairs = _Pairs(
        np.zeros((m, w, 2)),
        np.zeros((m, w, 2, 3 + calibration.size)),
        np.zeros((m, w, 2, 2)),
        np.zeros((m, w), dtype=np.bool_),
        noise,
    )
    sigma = np.sqrt(np.diag(joint)[:3])
    evaluate_pairs(
        rows,
        reach,
        np.ascontiguousarray(pose),
        np.ascontiguousarray(calibration),
        walls.lines,
        walls.anchors,
        walls.reach,
        gates.slack_m + 3.0 * float(np.hypot(sigma[0], sigma[1])),
        *pairs.arrays[:4],
    )
    return _choose(pairs, joint, gates, lost)


@dataclass(frozen=True)
class _Pairs:
    """Every segment against every wall."""

    residual: Floats
    """(M, W, 2)."""
    by_pose: Floats
    """(M, W, 2, 3+g)."""
    by_wall: Floats
    """(M, W, 2, 2)."""
    open: npt.NDArray[np.bool_]
    """(M, W) pairs that are possible at all."""
    noise: Floats
    """(M, 2, 2) of the segments."""

    @property
    def arrays(self) -> tuple[Floats, Floats, Floats, npt.NDArray[np.bool_], Floats]:
        """Return all of them, as compiled code takes them."""
        return self.residual, self.by_pose, self.by_wall, self.open, self.noise


def possible(
    rows: Floats,
    reach: Floats,
    noise: Floats,
    pose: Floats,
    calibration: Floats,
    joint: Floats,
    walls: Candidates,
    covariances: Floats,
    gates: Gates,
) -> npt.NDArray[np.bool_]:
    """Return (W,) which walls some segment may show, each for itself.

    As if walls, with `covariances` (W, 2, 2), and pose and calibration, with `joint` (3+g, 3+g),
    had nothing in common: for walls that do, the gates are wider than they need be. Other
    arguments as `match` takes them. O(M·W), compiled.
    """
    w = walls.lines.shape[0]
    found = np.zeros(w, dtype=np.bool_)
    sigma = np.sqrt(np.diag(joint)[:2])
    mark_possible(
        rows,
        reach,
        noise,
        np.ascontiguousarray(pose),
        np.ascontiguousarray(calibration),
        np.ascontiguousarray(joint),
        walls.lines,
        walls.anchors,
        walls.reach,
        np.ascontiguousarray(covariances),
        gates.slack_m + 3.0 * float(np.hypot(sigma[0], sigma[1])),
        gates.single,
        found,
    )
    return found


def _choose(pairs: _Pairs, joint: Floats, gates: Gates, lost: bool) -> tuple[Stamps, Floats]:
    """Return the match that explains most segments, or none where another does as well."""
    m = pairs.residual.shape[0]
    squares = np.full(pairs.open.shape, np.inf)
    write_squares(*pairs.arrays, joint, squares)
    results: dict[tuple[int, ...], tuple[float, Floats, Floats]] = {}
    inside = squares < gates.single
    for seeds in _seeds(inside, lost):
        chosen, total = np.full(m, NONE, np.int64), np.full(m, np.inf)
        shift = np.zeros(3)
        score = follow(
            *pairs.arrays,
            joint,
            gates.single,
            gates.near,
            gates.joint,
            MARGIN,
            seeds,
            chosen,
            total,
            shift,
        )
        results.setdefault(tuple(chosen.tolist()), (score, total, shift))
    # Most segments explained first, then the likeliest.
    order = sorted(results, key=lambda c: (-sum(k >= 0 for k in c), results[c][0]))
    best, (score, total, shift) = np.array(order[0], dtype=np.int64), results[order[0]]
    found = int((best >= 0).sum())
    doubtful = lost and (found < SURE or found < SHARE * m)
    for other in order[1:]:
        if sum(k >= 0 for k in other) < found:
            break
        rival, _, there = results[other]
        apart = np.abs(there - shift) > ELSEWHERE
        doubtful |= bool(apart.any()) and rival - score < MARGIN
    return (np.where(best >= 0, DOUBTFUL, best), total) if doubtful else (best, total)


def _seeds(inside: npt.NDArray[np.bool_], lost: bool) -> list[Stamps]:
    """Return what to begin with: pairs (S, 2) of segment and wall, S up to 2.

    Where some segment leaves no doubt, with none. Else with all walls of the segment that has the
    fewest; and for a robot that is lost, with those of every other segment besides.
    """
    count = inside.sum(axis=1)
    nothing = np.zeros((0, 2), np.int64)
    if not inside.any() or ((count == 1).any() and not lost):
        return [nothing]
    order = [int(i) for i in np.argsort(count, kind="stable") if count[i]]
    first = order[0]
    seeds = [np.array([[first, k]]) for k in np.flatnonzero(inside[first])]
    if lost:
        seeds = [
            np.concatenate([seed, [[i, k]]])
            for seed in seeds
            for i in order[1:4]
            for k in np.flatnonzero(inside[i])
        ] or seeds
    return seeds[:TRIES]
