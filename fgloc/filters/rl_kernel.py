"""The loop of the robot_localization-like filter: constant acceleration in the plane, compiled.

The state is x, y, yaw in the frame of the start, and v_x, v_y, yaw rate, a_x, a_y of the body. It
moves as

    x' = x + (v_x cos − v_y sin) dt + ½ (a_x cos − a_y sin) dt²
    y' = y + (v_x sin + v_y cos) dt + ½ (a_x sin + a_y cos) dt²
    yaw' = yaw + rate dt,   v' = v + a dt,   rate' = rate,   a' = a

with sin and cos of the old yaw, and its covariance as F P Fᵀ + Q dt. In the plane (roll and pitch
zero) this is what robot_localization does with its fifteen states: the other seven are then
independent of these eight.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fgloc.core.compiled import compiled
from fgloc.core.geometry import wrap_scalar
from fgloc.core.measurements import Floats, Stamps
from fgloc.filters.kalman import correct, whiten

Codes = npt.NDArray[np.int64]

STATES = 8
X, Y, YAW, VX, VY, RATE, AX, AY = range(STATES)
"""Where each state stands; as `fgloc.io.ekf_config.PLANAR`."""
SMALLEST_VARIANCE = 1e-9
"""No measurement is taken to be better than this [unit²]."""


@compiled
def transition(x: Floats, dt: float, f: Floats) -> None:
    """Write the derivative (8, 8) of the state after `dt` by the state before it into `f`."""
    c, s = np.cos(x[YAW]), np.sin(x[YAW])
    half = 0.5 * dt * dt
    for i in range(STATES):
        for j in range(STATES):
            f[i, j] = 1.0 if i == j else 0.0
    f[X, YAW] = -(s * x[VX] + c * x[VY]) * dt - (s * x[AX] + c * x[AY]) * half
    f[Y, YAW] = (c * x[VX] - s * x[VY]) * dt + (c * x[AX] - s * x[AY]) * half
    f[X, VX], f[X, VY], f[X, AX], f[X, AY] = c * dt, -s * dt, c * half, -s * half
    f[Y, VX], f[Y, VY], f[Y, AX], f[Y, AY] = s * dt, c * dt, s * half, c * half
    f[YAW, RATE] = dt
    f[VX, AX] = dt
    f[VY, AY] = dt


@compiled
def advance(
    x: Floats, p: Floats, dt: float, q: Floats, dynamic: bool, f: Floats, work: Floats
) -> None:
    """Move state and covariance by `dt` seconds, in place; `f` and `work` (8, 8) are scratch.

    `dynamic`: the process noise of the pose is multiplied by the squared norm of the velocities.
    """
    transition(x, dt, f)
    c, s = np.cos(x[YAW]), np.sin(x[YAW])
    scale = 1.0
    if dynamic:
        scale = x[VX] * x[VX] + x[VY] * x[VY] + x[RATE] * x[RATE]
    along = x[VX] * dt + 0.5 * x[AX] * dt * dt
    across = x[VY] * dt + 0.5 * x[AY] * dt * dt
    x[X] += c * along - s * across
    x[Y] += s * along + c * across
    x[YAW] += x[RATE] * dt
    x[VX] += x[AX] * dt
    x[VY] += x[AY] * dt
    for i in range(STATES):
        for j in range(STATES):
            total = 0.0
            for k in range(STATES):
                if f[i, k] != 0.0:
                    total += f[i, k] * p[k, j]
            work[i, j] = total
    for i in range(STATES):
        for j in range(i + 1):
            total = q[i, j] * dt
            if i <= YAW and j <= YAW:
                total *= scale
            for k in range(STATES):
                if f[j, k] != 0.0:
                    total += work[i, k] * f[j, k]
            p[i, j] = total
            p[j, i] = total


@compiled
def run_filter(
    times_ns: Stamps,
    sizes: Codes,
    states: Codes,
    values: Floats,
    noises: Floats,
    levers: Floats,
    thresholds: Floats,
    outputs_ns: Stamps,
    predicting: bool,
    timeout_ns: int,
    begin_ns: int,
    q: Floats,
    dynamic: bool,
    x: Floats,
    p: Floats,
    stamps: Stamps,
    poses: Floats,
    covariances: Floats,
    accepted: Codes,
    innovations: Floats,
    whitened: Floats,
) -> int:
    """Filter measurements (E,) in the order of time and return how many poses were put out.

    A measurement k holds the first `sizes[k]` of `states[k]` with `values[k]` and `noises[k]`; a
    lever arm `levers[k]` is taken off a position with the filter's own yaw. At every one of
    `outputs_ns` (K,) the measurements up to it are filtered. Then the state is that of the last one
    (`predicting`: predicted to the output); where nothing came for `timeout_ns` it is predicted.
    A pose that is not newer than the one before is not put out. O(E + K).
    """
    h, s, white = np.zeros((3, STATES)), np.zeros((3, 3)), np.zeros(3)
    gain, left = np.zeros((STATES, 3)), np.zeros((STATES, STATES))
    work, f = np.zeros((STATES, STATES)), np.zeros((STATES, STATES))
    r, v = np.zeros((3, 3)), np.zeros(3)
    now, e, written = begin_ns, 0, 0
    for output in range(outputs_ns.size):
        heard = False
        while e < times_ns.size and times_ns[e] <= outputs_ns[output]:
            if times_ns[e] > now:
                advance(x, p, (times_ns[e] - now) * 1e-9, q, dynamic, f, work)
                now = times_ns[e]
            heard = True
            d = sizes[e]
            c, sn = np.cos(x[YAW]), np.sin(x[YAW])
            for i in range(d):
                state = states[e, i]
                for j in range(STATES):
                    h[i, j] = 1.0 if j == state else 0.0
                z = values[e, i]
                if state == X:
                    z -= c * levers[e, 0] - sn * levers[e, 1]
                elif state == Y:
                    z -= sn * levers[e, 0] + c * levers[e, 1]
                v[i] = z - x[state]
                if state == YAW:
                    v[i] = wrap_scalar(v[i])
                for j in range(d):
                    r[i, j] = noises[e, i, j]
                r[i, i] = max(r[i, i], SMALLEST_VARIANCE)
            squared = whiten(p, h, r, v, d, s, white)
            for i in range(d):
                innovations[e, i] = v[i]
                whitened[e, i] = white[i]
            if squared < thresholds[e] * thresholds[e]:
                correct(x, p, h, r, v, d, s, gain, left, work)
                accepted[e] = 1
            e += 1
        waited = outputs_ns[output] - now
        if waited > 0 and (predicting or (not heard and waited >= timeout_ns)):
            advance(x, p, waited * 1e-9, q, dynamic, f, work)
            now = outputs_ns[output]
        if written == 0 or now > stamps[written - 1]:
            stamps[written] = now
            for i in range(3):
                poses[written, i] = x[i]
                for j in range(3):
                    covariances[written, i, j] = p[i, j]
            written += 1
    return written
