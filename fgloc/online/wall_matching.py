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
"""The second best wall must be this much less likely (difference of normalised squares)."""
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
) -> tuple[Stamps, Floats]:
    """Return the wall (M,) of each segment, or NONE, DOUBTFUL or NEAR, and its squares (M,).

    `rows` (M, 8) are the measurement rows of the wall kernel, anchors left out; `reach` (M, 2) how
    far a segment reaches along its tangent, `noise` (M, 2, 2) its covariance; `pose` (3,) and the
    sensor's `calibration` (g,), 0 or 3, with W walls are known to `joint` (3+g+2W, 3+g+2W), the
    pose in body axes. O(M²·W) and O(M·(3+2W)²) for every choice, compiled.
    """
    m, w = rows.shape[0], walls.lines.shape[0]
    if m == 0 or w == 0:
        return np.full(m, NONE, np.int64), np.full(m, np.inf)
    residual = np.zeros((m, w, 2))
    by_pose = np.zeros((m, w, 2, 3 + calibration.size))
    by_wall = np.zeros((m, w, 2, 2))
    open_ = np.zeros((m, w), dtype=np.bool_)
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
        residual,
        by_pose,
        by_wall,
        open_,
    )
    return _choose(residual, by_pose, by_wall, open_, noise, joint, gates)


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


def _choose(
    residual: Floats,
    by_pose: Floats,
    by_wall: Floats,
    open_: npt.NDArray[np.bool_],
    noise: Floats,
    joint: Floats,
    gates: Gates,
) -> tuple[Stamps, Floats]:
    """Try the first choices that there are, and return the best match of all."""
    m = residual.shape[0]
    squares = np.full(open_.shape, np.inf)
    _squares(residual, by_pose, by_wall, open_, noise, joint, squares)
    inside = squares < gates.single
    clear = inside.any(axis=1) & (inside.sum(axis=1) == 1)
    starts = [(-1, -1)]
    if inside.any() and not clear.any():
        # The segment with the fewest choices, by all of them.
        several = np.where(inside.any(axis=1), inside.sum(axis=1), open_.shape[1] + 1)
        first = int(np.argmin(several))
        starts = [(first, int(k)) for k in np.flatnonzero(inside[first])]
    results = []
    for first, k in starts:
        chosen, total = np.full(m, NONE, np.int64), np.full(m, np.inf)
        score = _follow(
            residual,
            by_pose,
            by_wall,
            open_,
            noise,
            joint,
            gates.single,
            gates.near,
            gates.joint,
            MARGIN,
            first,
            k,
            chosen,
            total,
        )
        results.append((-int((chosen >= 0).sum()), score, chosen, total))
    results.sort(key=lambda r: (r[0], r[1]))
    as_many = len(results) > 1 and results[1][0] == results[0][0]
    if as_many and results[1][1] - results[0][1] < MARGIN:
        best = results[0][2]
        return np.where(best >= 0, DOUBTFUL, best), results[0][3]
    return results[0][2], results[0][3]


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
    return (s[1, 1] * r[0] * r[0] - 2.0 * s[0, 1] * r[0] * r[1] + s[0, 0] * r[1] * r[1]) / det


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
    first: int,
    first_wall: int,
    chosen: Stamps,
    squares: Floats,
) -> float:
    """Match segment after segment, beginning with a given pair (or none: -1).

    Fills `chosen` and `squares`; returns the normalised square of the joint innovation.
    """
    m, w = open_.shape
    g, n = by_pose.shape[3], prior.shape[0]
    p, moved = prior.copy(), np.zeros(n)
    s, v, r = np.empty((2, 2)), np.empty((2, n)), np.empty(2)
    best_v, best_s, best_r = np.empty((2, n)), np.empty((2, 2)), np.empty(2)
    total, count = 0.0, 0
    done = np.zeros(m, np.bool_)
    while True:
        pick, pick_wall, pick_square, pick_rank = -1, -1, np.inf, np.inf
        for i in range(m):
            if done[i] or (count == 0 and first >= 0 and i != first):
                continue
            low, low_wall, second, inside = np.inf, -1, np.inf, 0
            for k in range(w):
                if not open_[i, k] or (count == 0 and first >= 0 and k != first_wall):
                    continue
                at = g + 2 * k
                for a in range(2):
                    r[a] = residual[i, k, a] + by_wall[i, k, a, 0] * moved[at]
                    r[a] += by_wall[i, k, a, 1] * moved[at + 1]
                    for q in range(g):
                        r[a] += by_pose[i, k, a, q] * moved[q]
                d = _square(r, by_pose[i, k], by_wall[i, k], noise[i], p, at, s, v)
                inside += d < single
                if d < low:
                    low, low_wall, second = d, k, low
                elif d < second:
                    second = d
            squares[i] = low
            chosen[i] = NEAR if low < near else NONE
            if low >= single:
                continue
            if inside > 1 and second - low < margin:
                chosen[i] = DOUBTFUL
                continue
            # Those without a second candidate first, among them the likeliest.
            rank = low if inside == 1 else low + 1e3
            if rank < pick_rank:
                pick, pick_wall, pick_square, pick_rank = i, low_wall, low, rank
        if pick < 0:
            return total
        done[pick] = True
        chosen[pick] = NEAR
        if total + pick_square >= joint[min(count, joint.size - 1)]:
            continue
        chosen[pick] = pick_wall
        total += pick_square
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
