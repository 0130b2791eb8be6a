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

from fgloc.core.compiled import compiled
from fgloc.core.consistency import gate_threshold
from fgloc.core.measurements import Floats, Stamps
from fgloc.factors.kernels.lidar import wall as wall_kernel

FACING = 0.7
"""A wall seen at an angle that differs by more [rad] is another one, whatever the uncertainty."""
MARGIN = 9.0
"""The second best wall must be this much less likely (difference of -2 log likelihood)."""
SURE, SHARE = 3, 0.7
"""A robot that was lost has found its place if so many segments, and this share of all, fit."""
ELSEWHERE = np.array([0.1, 0.1, 0.05])
"""Matches that move the robot to places this far apart [m, m, rad] contradict each other."""
TRIES = 400
"""First choices that are tried at most."""
NONE, DOUBTFUL, NEAR = -1, -2, -3
"""No wall; one of several; a wall is near but does not fit well."""


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
    _pairs(
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
    _possible(
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


@compiled
def _possible(
    rows: Floats,
    reach: Floats,
    noise: Floats,
    pose: Floats,
    calibration: Floats,
    joint: Floats,
    lines: Floats,
    anchors: Floats,
    extent: Floats,
    covariances: Floats,
    slack: float,
    single: float,
    found: npt.NDArray[np.bool_],
) -> None:
    """Mark the walls that are inside some segment's gate."""
    g = joint.shape[0]
    one = np.zeros((g + 2, g + 2))
    one[:g, :g] = joint
    s, v = np.empty((2, 2)), np.empty((2, g + 2))
    residual, by_pose = np.zeros((1, 1, 2)), np.zeros((1, 1, 2, g))
    by_wall, open_ = np.zeros((1, 1, 2, 2)), np.zeros((1, 1), np.bool_)
    for k in range(lines.shape[0]):
        one[g:, g:] = covariances[k]
        for i in range(rows.shape[0]):
            if found[k]:
                break
            open_[0, 0] = False
            _pairs(
                rows[i : i + 1],
                reach[i : i + 1],
                pose,
                calibration,
                lines[k : k + 1],
                anchors[k : k + 1],
                extent[k : k + 1],
                slack,
                residual,
                by_pose,
                by_wall,
                open_,
            )
            if open_[0, 0]:
                d = _square(residual[0, 0], by_pose[0, 0], by_wall[0, 0], noise[i], one, g, s, v)
                found[k] = d < single


def _choose(pairs: _Pairs, joint: Floats, gates: Gates, lost: bool) -> tuple[Stamps, Floats]:
    """Return the match that explains most segments, or none where another does as well."""
    m = pairs.residual.shape[0]
    squares = np.full(pairs.open.shape, np.inf)
    _squares(*pairs.arrays, joint, squares)
    results: dict[tuple[int, ...], tuple[float, Floats, Floats]] = {}
    inside = squares < gates.single
    for seeds in _seeds(inside, lost):
        chosen, total = np.full(m, NONE, np.int64), np.full(m, np.inf)
        shift = np.zeros(3)
        score = _follow(
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


@compiled
def _pairs(
    rows: Floats,
    reach: Floats,
    pose: Floats,
    calibration: Floats,
    lines: Floats,
    anchors: Floats,
    extent: Floats,
    slack: float,
    residual: Floats,
    by_pose: Floats,
    by_wall: Floats,
    open_: npt.NDArray[np.bool_],
) -> None:
    """Evaluate every segment against every wall, and say which pairs are possible at all."""
    g = calibration.size
    r, row = np.zeros(2), np.zeros(8)
    for i in range(rows.shape[0]):
        for k in range(lines.shape[0]):
            row[:] = rows[i]
            row[3], row[4] = anchors[k, 0], anchors[k, 1]
            ji, jj, jg = np.zeros((2, 3)), np.zeros((2, 2)), np.zeros((2, g))
            wall_kernel(pose, lines[k], calibration, row, -1, r, ji, jj, jg)
            residual[i, k] = r
            by_pose[i, k, :, :3] = ji
            by_pose[i, k, :, 3:] = jg
            by_wall[i, k] = jj
            if abs(r[0]) > FACING:
                continue
            # Where its middle is along the wall: the offset's derivative by the direction.
            along = jj[1, 0]
            low, high = along + reach[i, 0], along + reach[i, 1]
            open_[i, k] = low < extent[k, 1] + slack and high > extent[k, 0] - slack


@compiled
def _square(
    r: Floats, hp: Floats, hw: Floats, r_noise: Floats, p: Floats, at: int, s: Floats, v: Floats
) -> float:
    """Return the normalised innovation squared of one pair; `s` (2, 2) gets S, `v` (2, n) H P.

    `at` is the wall's first column in `p`.
    """
    g, n = hp.shape[1], p.shape[0]
    for a in range(2):
        for c in range(n):
            t = hw[a, 0] * p[at, c] + hw[a, 1] * p[at + 1, c]
            for q in range(g):
                t += hp[a, q] * p[q, c]
            v[a, c] = t
    for a in range(2):
        for b in range(2):
            t = r_noise[a, b] + v[a, at] * hw[b, 0] + v[a, at + 1] * hw[b, 1]
            for q in range(g):
                t += v[a, q] * hp[b, q]
            s[a, b] = t
    det = s[0, 0] * s[1, 1] - s[0, 1] * s[1, 0]
    if not det > 0.0:
        return np.inf
    square = s[1, 1] * r[0] * r[0] - 2.0 * s[0, 1] * r[0] * r[1] + s[0, 0] * r[1] * r[1]
    return float(square / det)


@compiled
def _squares(
    residual: Floats,
    by_pose: Floats,
    by_wall: Floats,
    open_: npt.NDArray[np.bool_],
    noise: Floats,
    p: Floats,
    squares: Floats,
) -> None:
    """Write the normalised innovations squared of all possible pairs."""
    g = by_pose.shape[3]
    s, v = np.empty((2, 2)), np.empty((2, p.shape[0]))
    for i in range(residual.shape[0]):
        for k in range(residual.shape[1]):
            if open_[i, k]:
                squares[i, k] = _square(
                    residual[i, k], by_pose[i, k], by_wall[i, k], noise[i], p, g + 2 * k, s, v
                )


@compiled
def _follow(
    residual: Floats,
    by_pose: Floats,
    by_wall: Floats,
    open_: npt.NDArray[np.bool_],
    noise: Floats,
    prior: Floats,
    single: float,
    near: float,
    joint: Floats,
    margin: float,
    seeds: Stamps,
    chosen: Stamps,
    squares: Floats,
    shift: Floats,
) -> float:
    """Match segment after segment, beginning with the pairs `seeds` (S, 2).

    Fills `chosen`, `squares` and the pose's `shift` (3,); returns -2 log of
    the joint likelihood, but for a constant.
    """
    m, w = open_.shape
    g, n = by_pose.shape[3], prior.shape[0]
    p, moved = prior.copy(), np.zeros(n)
    s, v, r = np.empty((2, 2)), np.empty((2, n)), np.empty(2)
    best_v, best_s, best_r = np.empty((2, n)), np.empty((2, 2)), np.empty(2)
    total, score, count = 0.0, 0.0, 0
    done = np.zeros(m, np.bool_)
    while True:
        pick, pick_wall, pick_square, pick_rank, pick_cost = -1, -1, np.inf, np.inf, 0.0
        for i in range(m):
            given = count < seeds.shape[0]
            if done[i] or (given and i != seeds[count, 0]):
                continue
            least, low, low_wall, second, inside = np.inf, np.inf, -1, np.inf, 0
            square = np.inf
            for k in range(w):
                if not open_[i, k] or (given and k != seeds[count, 1]):
                    continue
                at = g + 2 * k
                for a in range(2):
                    r[a] = residual[i, k, a] + by_wall[i, k, a, 0] * moved[at]
                    r[a] += by_wall[i, k, a, 1] * moved[at + 1]
                    for q in range(g):
                        r[a] += by_pose[i, k, a, q] * moved[q]
                d = _square(r, by_pose[i, k], by_wall[i, k], noise[i], p, at, s, v)
                least = min(least, d)
                if d >= single:
                    continue
                inside += 1
                # The likelihood: a vague prediction fits everything, and says little by that.
                cost = d + np.log(s[0, 0] * s[1, 1] - s[0, 1] * s[1, 0])
                if cost < low:
                    low, low_wall, square, second = cost, k, d, low
                elif cost < second:
                    second = cost
            squares[i] = least
            chosen[i] = NEAR if least < near else NONE
            if inside == 0:
                continue
            if inside > 1 and second - low < margin:
                chosen[i] = DOUBTFUL
                continue
            # Those without a second candidate first, among them the likeliest.
            rank = square if inside == 1 else square + 1e3
            if rank < pick_rank:
                pick, pick_wall, pick_square, pick_rank = i, low_wall, square, rank
                pick_cost = low
        if pick < 0:
            shift[:] = moved[:3]
            return score
        done[pick] = True
        chosen[pick] = NEAR
        if total + pick_square >= joint[min(count, joint.size - 1)]:
            continue
        chosen[pick] = pick_wall
        total += pick_square
        score += pick_cost
        count += 1
        at = g + 2 * pick_wall
        for a in range(2):
            best_r[a] = residual[pick, pick_wall, a] + by_wall[pick, pick_wall, a, 0] * moved[at]
            best_r[a] += by_wall[pick, pick_wall, a, 1] * moved[at + 1]
            for q in range(g):
                best_r[a] += by_pose[pick, pick_wall, a, q] * moved[q]
        _square(
            best_r,
            by_pose[pick, pick_wall],
            by_wall[pick, pick_wall],
            noise[pick],
            p,
            at,
            best_s,
            best_v,
        )
        _kalman(best_r, best_s, best_v, p, moved)


@compiled
def _kalman(r: Floats, s: Floats, v: Floats, p: Floats, moved: Floats) -> None:
    """Take an innovation into the covariance `p` (n, n) and the mean's change `moved` (n,)."""
    det = s[0, 0] * s[1, 1] - s[0, 1] * s[1, 0]
    i00, i01, i11 = s[1, 1] / det, -s[0, 1] / det, s[0, 0] / det
    n = p.shape[0]
    for a in range(n):
        k0 = v[0, a] * i00 + v[1, a] * i01
        k1 = v[0, a] * i01 + v[1, a] * i11
        moved[a] -= k0 * r[0] + k1 * r[1]
        for b in range(n):
            p[a, b] -= k0 * v[0, b] + k1 * v[1, b]
