"""The pose EKF's loop over a drive, compiled: predict with the wheels, correct with the sensors."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fgloc.core.compiled import compiled
from fgloc.core.geometry import compose_scalar, wrap_scalar
from fgloc.core.measurements import Floats, Stamps
from fgloc.filters.kalman import correct, whiten

Codes = npt.NDArray[np.int64]

CAMERA, POSE, POSITION, YAW = range(4)
"""What an event measures: pose since the camera's first, pose in the map, position, heading."""
REJECTED, ACCEPTED, REFERENCE, RECOVERED = range(4)
"""What became of it; REFERENCE: set the zero of its own frame, RECOVERED: accepted after all."""
DIMENSION = np.array([3, 3, 2, 1])
"""Numbers in an event of each kind."""
DOUBT = 0.5
"""Largest sigma of a heading [rad] that rejected readings lead to."""


@compiled
def predict(x: Floats, p: Floats, step: Floats, q: Floats) -> None:
    """Move the pose in x[:3] by the relative pose `step` with covariance `q`, both in body axes.

    P ← A P Aᵀ + G q Gᵀ, in place; states beyond the pose stay as they are and keep their
    covariance with it. O(n).
    """
    n = p.shape[0]
    c, s = np.cos(x[2]), np.sin(x[2])
    along, across = -(s * step[0] + c * step[1]), c * step[0] - s * step[1]
    for j in range(n):
        p[0, j] += along * p[2, j]
        p[1, j] += across * p[2, j]
    for i in range(n):
        p[i, 0] += along * p[i, 2]
        p[i, 1] += across * p[i, 2]
    xx = c * c * q[0, 0] - 2.0 * c * s * q[0, 1] + s * s * q[1, 1]
    yy = s * s * q[0, 0] + 2.0 * c * s * q[0, 1] + c * c * q[1, 1]
    xy = c * s * (q[0, 0] - q[1, 1]) + (c * c - s * s) * q[0, 1]
    xt, yt = c * q[0, 2] - s * q[1, 2], s * q[0, 2] + c * q[1, 2]
    p[0, 0] += xx
    p[1, 1] += yy
    p[2, 2] += q[2, 2]
    p[0, 1] += xy
    p[1, 0] += xy
    p[0, 2] += xt
    p[2, 0] += xt
    p[1, 2] += yt
    p[2, 1] += yt
    x[0] += c * step[0] - s * step[1]
    x[1] += s * step[0] + c * step[1]
    x[2] += step[2]


@compiled
def fuse_turn(step: Floats, q: Floats, innovation: float, r: float, rounding: float) -> None:
    """Correct a displacement (3,) and its covariance `q` by a gyro's turn, in place.

    `innovation` is gyro minus wheels [rad], `r` its variance. The rounding of counts [rad] makes
    the gain trust the gyro more but is no part of `q`: the next increment takes it back.
    """
    total = q[2, 2] + 2.0 * rounding * rounding + r
    k0, k1 = q[0, 2] / total, q[1, 2] / total
    k2 = (q[2, 2] + 2.0 * rounding * rounding) / total
    step[0] += k0 * innovation
    step[1] += k1 * innovation
    step[2] += k2 * innovation
    # Joseph's form with H = (0, 0, 1); right for any gain.
    a, b, c, v = q[0, 2], q[1, 2], 1.0 - k2, q[2, 2]
    q[0, 0] += -2.0 * k0 * a + k0 * k0 * (v + r)
    q[1, 1] += -2.0 * k1 * b + k1 * k1 * (v + r)
    q[0, 1] += -k1 * a - k0 * b + k0 * k1 * (v + r)
    q[1, 0] = q[0, 1]
    q[0, 2] = c * (a - k0 * v) + k0 * k2 * r
    q[1, 2] = c * (b - k1 * v) + k1 * k2 * r
    q[2, 2] = c * c * v + k2 * k2 * r
    q[2, 0], q[2, 1] = q[0, 2], q[1, 2]


@compiled
def run_filter(
    begin: int,
    end: int,
    cuts_ns: Stamps,
    steps: Floats,
    step_covariances: Floats,
    emit: Codes,
    first: Codes,
    kinds: Codes,
    streams: Codes,
    begins: Codes,
    values: Floats,
    noises: Floats,
    levers: Floats,
    gates: Floats,
    listening: Codes,
    zero_of: Codes,
    zero_walk: Floats,
    lasting: Floats,
    turns: Floats,
    turn_variances: Floats,
    turn_gates: Floats,
    rounding: Floats,
    horizon_s: float,
    patience: Codes,
    x: Floats,
    p: Floats,
    anchors: Floats,
    anchor_covariances: Floats,
    memory: Codes,
    poses: Floats,
    covariances: Floats,
    status: Codes,
    innovations: Floats,
    whitened: Floats,
    turn_status: Codes,
    turn_innovations: Floats,
) -> None:
    """Filter the cuts from `begin` up to, not including, `end`; O(C + E).

    See `fgloc.filters.pose_ekf_events` for the arrays that describe a drive. The state is in
    x (n,), p (n, n), the poses (S, 3) and covariances (S, 3, 3) at which cameras began and `memory`
    (S, 2): rejections in a row, stamp of the first of them. What comes out are poses and
    covariances at the wheel stamps and what became of every event and turned angle. Of streams
    that are not listened to (`listening` 0) only innovations are written.
    """
    n = x.size
    h, s, white = np.zeros((3, n)), np.zeros((3, 3)), np.zeros(3)
    gain, left, work = np.zeros((n, 3)), np.zeros((n, n)), np.zeros((n, n))
    r, v, z = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    step, q = np.zeros(3), np.zeros((3, 3))
    for cut in range(begin, end):
        if cut > 0:
            for i in range(3):
                step[i] = steps[cut - 1, i]
                for j in range(3):
                    q[i, j] = step_covariances[cut - 1, i, j]
            for g in range(turns.shape[0]):
                variance = turn_variances[g, cut - 1]
                if variance > 0.0:
                    v0 = turns[g, cut - 1] - step[2]
                    total = q[2, 2] + 2.0 * rounding[2] * rounding[2] + variance
                    turn_innovations[g, cut - 1, 0] = v0
                    turn_innovations[g, cut - 1, 1] = v0 / np.sqrt(total)
                    if v0 * v0 <= turn_gates[g] * total:
                        fuse_turn(step, q, v0, variance, rounding[2])
                        turn_status[g, cut - 1] = ACCEPTED
            seconds = (cuts_ns[cut] - cuts_ns[cut - 1]) * 1e-9
            bent = _second_order(p[2, 2], step) * horizon_s / seconds
            q[0, 0] += bent
            q[1, 1] += bent
            predict(x, p, step, q)
            for k in range(3, n):
                p[k, k] += zero_walk[k - 3] * seconds
        for e in range(first[cut], first[cut + 1]):
            kind, stream = kinds[e], streams[e]
            d = DIMENSION[kind]
            zero = zero_of[stream]
            if kind == YAW and begins[e] == 1:
                # Such a reading tells the zero and nothing of the heading.
                status[e] = REFERENCE
                memory[stream, 0] = 0
                x[zero] = values[e, 0] - x[2]
                for j in range(n):
                    if j != zero:
                        p[zero, j] = -p[2, j]
                        p[j, zero] = -p[2, j]
                p[zero, zero] = p[2, 2] + noises[e, 0, 0]
                continue
            if kind == CAMERA and begins[e] == 1:
                status[e] = REFERENCE
                memory[stream, 0] = 0
                for i in range(3):
                    anchors[stream, i] = x[i]
                    for j in range(3):
                        anchor_covariances[stream, i, j] = p[i, j]
                continue
            # Entry by entry: assigning whole arrays would take seconds to compile.
            for i in range(d):
                for j in range(n):
                    h[i, j] = 0.0
                for j in range(d):
                    r[i, j] = noises[e, i, j]
            if kind == YAW:
                h[0, 2] = 1.0
                h[0, zero] = 1.0
                v[0] = wrap_scalar(values[e, 0] - x[2] - x[zero])
            else:
                for i in range(3):
                    z[i] = values[e, i]
                if kind == CAMERA:
                    compose_scalar(anchors[stream], z, z)
                    _turn_noise(r, anchors[stream, 2])
                    _add_anchor(r, anchors[stream], anchor_covariances[stream], z, lasting[stream])
                c, sn = np.cos(x[2]), np.sin(x[2])
                lx, ly = levers[stream, 0], levers[stream, 1]
                ox, oy = c * lx - sn * ly, sn * lx + c * ly
                h[0, 0], h[0, 2] = 1.0, -oy
                h[1, 1], h[1, 2] = 1.0, ox
                v[0] = z[0] - x[0] - ox
                v[1] = z[1] - x[1] - oy
                if d == 3:
                    h[2, 2] = 1.0
                    v[2] = wrap_scalar(z[2] - x[2] - levers[stream, 2])
            squared = whiten(p, h, r, v, d, s, white)
            for i in range(d):
                innovations[e, i] = v[i]
                whitened[e, i] = white[i]
            if listening[stream] == 0:
                continue
            verdict = ACCEPTED
            if not squared <= gates[stream]:
                if memory[stream, 0] == 0:
                    memory[stream, 1] = cuts_ns[cut]
                memory[stream, 0] += 1
                waited = cuts_ns[cut] - memory[stream, 1]
                if memory[stream, 0] < patience[0] or waited < patience[1]:
                    status[e] = REJECTED
                    continue
                # It says so for long: the state must be less sure than it claims.
                _doubt(p, squared / d)
                squared = whiten(p, h, r, v, d, s, white)
                verdict = RECOVERED
            if not np.isfinite(squared):
                status[e] = REJECTED
                continue
            memory[stream, 0] = 0
            status[e] = verdict
            correct(x, p, h, r, v, d, s, gain, left, work)
        k = emit[cut]
        if k >= 0:
            c, sn = np.cos(x[2]), np.sin(x[2])
            a, b = rounding[0] * rounding[0], rounding[1] * rounding[1]
            for i in range(3):
                poses[k, i] = x[i]
                for j in range(3):
                    covariances[k, i, j] = p[i, j]
            covariances[k, 0, 0] += c * c * a + sn * sn * b
            covariances[k, 1, 1] += sn * sn * a + c * c * b
            covariances[k, 0, 1] += c * sn * (a - b)
            covariances[k, 1, 0] = covariances[k, 0, 1]
            covariances[k, 2, 2] += rounding[2] * rounding[2]


@compiled
def _second_order(variance: float, step: Floats) -> float:
    """Return the variance [m²] of a step that linearising at an uncertain heading leaves out.

    A step of length l along a heading wrong by e ~ N(0, v) falls short by l e² / 2, which varies by
    l² v² / 2. That is nothing for a good heading; without it, a filter whose heading is off by a
    radian believes fixes to tell more of the heading than they do, then rejects the next ones. On a
    winding way it lies in every direction. Beyond one radian nothing is known anyway.
    """
    v = min(variance, 1.0)
    squared: float = step[0] * step[0] + step[1] * step[1]
    return 0.5 * v * v * squared


@compiled
def _doubt(p: Floats, factor: float) -> None:
    """Multiply a covariance by `factor` in place, but no heading's sigma to more than DOUBT.

    A linear filter can do nothing with a heading that is not known at all.
    """
    n = p.shape[0]
    for k in range(n):
        scale = np.sqrt(max(factor, 1.0))
        if k >= 2 and p[k, k] > 0.0:
            scale = min(scale, max(DOUBT / np.sqrt(p[k, k]), 1.0))
        for j in range(n):
            p[k, j] *= scale
            p[j, k] *= scale


@compiled
def _turn_noise(r: Floats, angle: float) -> None:
    """Turn a covariance (3, 3) of x, y, heading by `angle`, in place."""
    c, s = np.cos(angle), np.sin(angle)
    xx, xy, yy, xt, yt = r[0, 0], r[0, 1], r[1, 1], r[0, 2], r[1, 2]
    r[0, 0] = c * c * xx - 2.0 * c * s * xy + s * s * yy
    r[1, 1] = s * s * xx + 2.0 * c * s * xy + c * c * yy
    r[0, 1] = c * s * (xx - yy) + (c * c - s * s) * xy
    r[0, 2] = c * xt - s * yt
    r[1, 2] = s * xt + c * yt
    r[1, 0], r[2, 0], r[2, 1] = r[0, 1], r[0, 2], r[1, 2]


@compiled
def _add_anchor(r: Floats, anchor: Floats, covariance: Floats, z: Floats, factor: float) -> None:
    """Add to `r` what is not known of the pose at which a camera began, `factor` times.

    An error of that pose turns and shifts all that the camera says, so z is wrong by A e with
    A = (1, 0, -Δy; 0, 1, Δx; 0, 0, 1).
    """
    dx, dy = z[0] - anchor[0], z[1] - anchor[1]
    xx, xy, yy = covariance[0, 0], covariance[0, 1], covariance[1, 1]
    xt, yt, tt = covariance[0, 2], covariance[1, 2], covariance[2, 2]
    r[0, 0] += factor * (xx - 2.0 * dy * xt + dy * dy * tt)
    r[1, 1] += factor * (yy + 2.0 * dx * yt + dx * dx * tt)
    r[0, 1] += factor * (xy + dx * xt - dy * yt - dx * dy * tt)
    r[0, 2] += factor * (xt - dy * tt)
    r[1, 2] += factor * (yt + dx * tt)
    r[2, 2] += factor * tt
    r[1, 0], r[2, 0], r[2, 1] = r[0, 1], r[0, 2], r[1, 2]
