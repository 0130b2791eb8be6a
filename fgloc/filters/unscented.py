"""The unscented filter of Model 3 in compiled code: state x, y [m], heading [rad], track [m].

Merwe's scaled sigma points with additive noise. Points are drawn anew from the predicted mean and
covariance before a reading is used, so that the process noise is in them: MATLAB's
unscentedKalmanFilter, which the seed used, does so, and filterpy since 2.0 (filterpy 1.4.5 reuses
the points of the prediction, which lack it). A heading reading is linear in the state, and of a
linear function the unscented transform is exact: the update with points drawn anew is the Kalman
update in closed form, which is what is written here.
"""

from __future__ import annotations

import math

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.geometry import wrap_scalar
from fgloc.core.measurements import Floats, Stamps

NONE, UPDATE, ANCHOR = 0, 1, 2
"""What is known at a stamp: nothing; a heading; a heading whose zero is set to the estimate."""
SMALL = 1e-9
"""A variance that is negative by less than this part of itself is zero but for rounding."""


@compiled
def square_root(p: Floats, scale: float, out: Floats) -> bool:
    """Write the lower factor of scale·p (4×4) into `out`; False if p has a negative direction.

    A direction without variance (a state that is known exactly) gets a column of zeros.
    """
    for j in range(4):
        pivot = p[j, j]
        for k in range(j):
            pivot -= out[j, k] * out[j, k] / scale
        if not pivot >= -SMALL * abs(p[j, j]):
            return False
        diagonal = math.sqrt(scale * max(pivot, 0.0))
        for i in range(4):
            out[i, j] = 0.0
        out[j, j] = diagonal
        if diagonal > 0.0:
            for i in range(j + 1, 4):
                total = scale * p[i, j]
                for k in range(j):
                    total -= out[i, k] * out[j, k]
                out[i, j] = total / diagonal
    return True


@compiled
def move(points: Floats, forward: float, sides: float, arm: float, floor: float) -> None:
    """Drive each of the points (9, 4) along by one wheel packet.

    `forward` is the mean of both sides' ways [m], `sides` right minus left [m]. Each point turns
    with its own track, but none below `floor` [m], and steps along its mean heading; `arm` [m] is
    how far ahead of the origin the base turns about (icr_x).
    """
    for i in range(9):
        turn = sides / max(points[i, 3], floor)
        c, s = math.cos(points[i, 2] + 0.5 * turn), math.sin(points[i, 2] + 0.5 * turn)
        left = -arm * turn
        points[i, 0] += c * forward - s * left
        points[i, 1] += s * forward + c * left
        points[i, 2] += turn


@compiled
def mean_point(points: Floats, centre: float, other: float, near: float, out: Floats) -> None:
    """Write the weighted mean (4,) of the points (9, 4) into `out`, the heading's on the circle.

    `centre` and `other` are the weights of the first point and of each other one. Sums are taken
    from the first point on, which loses no digits to weights of -99. Where headings are spread by
    a radian the sum of unit vectors so weighted is short or points the other way; its direction is
    used only where it differs from the plain mean by less than `near` [rad]. With `near` no more
    than the sigma of the heading's process noise, and beta = 2, the covariance about this mean
    always stays positive: about the plain mean it is a sum of squares, and half the square of the
    difference is all that it can lose.
    """
    sine, cosine = 0.0, centre
    dx, dy, dtheta, dtrack = 0.0, 0.0, 0.0, 0.0
    for i in range(1, 9):
        off = points[i, 2] - points[0, 2]
        dx += other * (points[i, 0] - points[0, 0])
        dy += other * (points[i, 1] - points[0, 1])
        dtheta += other * off
        dtrack += other * (points[i, 3] - points[0, 3])
        sine += other * math.sin(off)
        cosine += other * math.cos(off)
    circular = math.atan2(sine, cosine)
    if abs(circular - dtheta) < near:
        dtheta = circular
    out[0] = points[0, 0] + dx
    out[1] = points[0, 1] + dy
    out[2] = points[0, 2] + dtheta
    out[3] = points[0, 3] + dtrack


@compiled
def unscented_filter(
    forward: Floats,
    sides: Floats,
    arm: float,
    packets: Floats,
    measured: Floats,
    kinds: Stamps,
    start: Floats,
    start_covariance: Floats,
    process: Floats,
    reading: float,
    shape: Floats,
    floor: float,
    states: Floats,
    covariances: Floats,
) -> int:
    """Filter a drive; return the number of stamps done, N+1 unless it broke down on the way. O(N).

    `forward`, `sides` (N,) [m] are the wheels' ways as in `move`; `packets` (N,) how long an
    interval is in units of that for which `process` (4,) [m², m², rad², m²] is stated; `measured`
    (N+1,) headings [rad] with any zero, wrapped or not, and `kinds` (N+1,) what to do with them;
    `reading` their variance [rad²]; `shape` the sigma points' alpha, beta, kappa; `floor` the least
    track [m], to which an estimate below is set. Writes `states` (N+1, 4), headings continuous, and
    `covariances` (N+1, 4, 4). With exact numbers it never breaks down (see `mean_point`); it does
    where the points are so close that they lose the digits, or beta is far below 2.
    """
    alpha, beta, kappa = shape[0], shape[1], shape[2]
    scale = alpha * alpha * (4.0 + kappa)
    other = 0.5 / scale
    centre = (scale - 4.0) / scale
    centre_covariance = centre + 1.0 - alpha * alpha + beta
    points = np.empty((9, 4))
    root = np.empty((4, 4))
    x = start.copy()
    p = start_covariance.copy()
    gain = np.empty(4)
    zero = 0.0
    for k in range(kinds.size):
        if k > 0:
            if not square_root(p, scale, root):
                return k
            for i in range(4):
                points[0, i] = x[i]
                for j in range(4):
                    points[1 + j, i] = x[i] + root[i, j]
                    points[5 + j, i] = x[i] - root[i, j]
            move(points, forward[k - 1], sides[k - 1], arm, floor)
            near = math.sqrt(packets[k - 1] * process[2])
            mean_point(points, centre, other, near, x)
            for i in range(4):
                for j in range(i + 1):
                    a, b = points[0, i] - x[i], points[0, j] - x[j]
                    total = centre_covariance * a * b
                    for m in range(1, 9):
                        total += other * (points[m, i] - x[i]) * (points[m, j] - x[j])
                    if i == j:
                        total += packets[k - 1] * process[i]
                    p[i, j] = total
                    p[j, i] = total
        if kinds[k] == ANCHOR:
            zero = x[2] - measured[k]
        elif kinds[k] == UPDATE:
            innovation = wrap_scalar(measured[k] + zero - x[2])
            variance = p[2, 2] + reading
            for i in range(4):
                gain[i] = p[i, 2] / variance
            for i in range(4):
                x[i] += gain[i] * innovation
                for j in range(4):
                    p[i, j] -= gain[i] * variance * gain[j]
        x[3] = max(x[3], floor)
        if not math.isfinite(x[0] + x[1] + x[2] + p[2, 2]):
            return k
        for i in range(4):
            states[k, i] = x[i]
            for j in range(4):
                covariances[k, i, j] = p[i, j]
    return int(kinds.size)
