"""Compiled loops of `fgloc.online.wall_matching`: every segment against every wall."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats, Stamps
from fgloc.factors.kernels.lidar import wall as wall_kernel

FACING = 0.7
"""A wall seen at an angle that differs by more [rad] is another one, whatever the uncertainty."""
NONE, DOUBTFUL, NEAR = -1, -2, -3
"""No wall; one of several; a wall is near but does not fit well."""


@compiled
def mark_possible(
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
            evaluate_pairs(
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


@compiled
def evaluate_pairs(
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
def write_squares(
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
def follow(
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
