"""The inner loops of the kinematics: the equations of `fgloc.core.kinematics`, compiled.

Kinds of wheels are numbers here: 0 fixed, 1 roller, 2 passive, 3 linear, 4 scale.
"""

from __future__ import annotations

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats


@compiled
def solve3(m: Floats, inverse: Floats) -> bool:
    """Write the inverse of the symmetric 3×3 `m` into `inverse`; False if it is singular."""
    c00 = m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1]
    c01 = m[1, 2] * m[2, 0] - m[1, 0] * m[2, 2]
    c02 = m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0]
    det = m[0, 0] * c00 + m[0, 1] * c01 + m[0, 2] * c02
    if not abs(det) > 1e-12 * (abs(m[0, 0] * m[1, 1] * m[2, 2]) + 1e-300):
        return False
    inverse[0, 0] = c00 / det
    inverse[0, 1] = (m[0, 2] * m[2, 1] - m[0, 1] * m[2, 2]) / det
    inverse[0, 2] = (m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]) / det
    inverse[1, 0] = c01 / det
    inverse[1, 1] = (m[0, 0] * m[2, 2] - m[0, 2] * m[2, 0]) / det
    inverse[1, 2] = (m[0, 2] * m[1, 0] - m[0, 0] * m[1, 2]) / det
    inverse[2, 0] = c02 / det
    inverse[2, 1] = (m[0, 1] * m[2, 0] - m[0, 0] * m[2, 1]) / det
    inverse[2, 2] = (m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]) / det
    return True


@compiled
def _linear_displacement(
    angles: Floats,
    primitives: Floats,
    kinds: Floats,
    rows: Floats,
    xi: Floats,
    gain: Floats,
    jacobian: Floats,
) -> int:
    """Do `body_displacement` for linear wheels: the sum of the wheels' columns times their angles.

    A row's right side is the way its wheel rolls, as for any driven wheel, so that noise grows
    with it; a passive wheel's row says how side slip moves the base.
    """
    xi[0], xi[1], xi[2] = 0.0, 0.0, 0.0
    jacobian[:] = 0.0
    driven = n = 0
    for i in range(kinds.size):
        if kinds[i] == 4:
            continue
        passive = kinds[i] == 2
        rows[n, 5], rows[n, 6] = i, 1.0 if passive else 0.0
        rows[n, 3] = 0.0
        gain[0, n], gain[1, n], gain[2, n] = 0.0, 1.0, 0.0
        if not passive:
            rows[n, 3] = primitives[i, 3] * angles[driven]
            for a in range(3):
                xi[a] += primitives[i, a] * angles[driven]
                gain[a, n] = primitives[i, a] / primitives[i, 3]
                jacobian[a, 4 * i + a] = angles[driven]
            driven += 1
        n += 1
    return n


@compiled
def _scale_motion(
    scale: Floats, i: int, n: int, xi: Floats, gain: Floats, jacobian: Floats, with_jacobian: bool
) -> None:
    """Apply the `scale` primitives (4,) of wheel `i` to xi, to its gain (3, n) and its Jacobian.

    With q = (R w)², p = v², s = q / (q + p): turn' = w (1 + (x - 1) s), and by the chain rule
    d turn' = (1 + (x - 1)(s + 2 s (1 - s))) dw - 2 (x - 1) w s (1 - s) / p (v·dv) + w s dx.
    """
    radius, more = scale[3], scale[0] - 1.0
    q = radius * radius * xi[2] * xi[2]
    p = xi[0] * xi[0] + xi[1] * xi[1]
    total = q + p
    s = q / total if total > 0.0 else 0.0
    by_turn = 1.0 + more * s * (3.0 - 2.0 * s)
    # s (1 - s) / p = q / total², without a division by a standing base's speed.
    by_way = -2.0 * more * xi[2] * q / (total * total) if total > 1e-150 else 0.0
    for k in range(n):
        gain[2, k] = by_turn * gain[2, k] + by_way * (xi[0] * gain[0, k] + xi[1] * gain[1, k])
        gain[1, k] *= scale[1]
    if with_jacobian:
        for k in range(jacobian.shape[1]):
            turned = by_turn * jacobian[2, k]
            jacobian[2, k] = turned + by_way * (xi[0] * jacobian[0, k] + xi[1] * jacobian[1, k])
            jacobian[1, k] *= scale[1]
        jacobian[2, 4 * i] = xi[2] * s
        jacobian[1, 4 * i + 1] = xi[1]
        if total > 1e-150:
            jacobian[2, 4 * i + 3] = 2.0 * more * xi[2] * q * p / (total * total) / radius
    xi[1] *= scale[1]
    xi[2] *= 1.0 + more * s


@compiled
def body_displacement(
    angles: Floats,
    steering: Floats,
    primitives: Floats,
    kinds: Floats,
    rollers: Floats,
    weights: Floats,
    rows: Floats,
    xi: Floats,
    gain: Floats,
    jacobian: Floats,
    with_jacobian: bool,
) -> int:
    """Solve one interval; return the number of rows, or 0 if the base is not determined.

    Fills `rows` (2W, 8: a_x a_y a_w, right side, weight, wheel, is-lateral, direction), the
    displacement `xi` (3,), the gain d xi / d right side in `gain` (3, 2W) and, on request,
    `jacobian` (3, 4W) = d xi / d primitives. With N = AᵀWA, differentiating N xi = AᵀW b gives
    d xi = N⁻¹ [dAᵀ W (b - A xi) + AᵀW (db - dA xi)]. A wheel of kind scale is applied last.
    """
    linear, scale, n = False, -1, 0
    for i in range(kinds.size):
        linear = linear or kinds[i] == 3
        scale = i if kinds[i] == 4 else scale
    if linear:
        n = _linear_displacement(angles, primitives, kinds, rows, xi, gain, jacobian)
    else:
        n = _solve_wheels(
            angles,
            steering,
            primitives,
            kinds,
            rollers,
            weights,
            rows,
            xi,
            gain,
            jacobian,
            with_jacobian,
        )
    if scale >= 0:
        _scale_motion(primitives[scale], scale, n, xi, gain, jacobian, with_jacobian)
    return n


@compiled
def _solve_wheels(
    angles: Floats,
    steering: Floats,
    primitives: Floats,
    kinds: Floats,
    rollers: Floats,
    weights: Floats,
    rows: Floats,
    xi: Floats,
    gain: Floats,
    jacobian: Floats,
    with_jacobian: bool,
) -> int:
    """Do `body_displacement` for wheels of a geometry."""
    n = 0
    normal = np.zeros((3, 3))
    right = np.zeros(3)
    driven = 0
    for i in range(kinds.size):
        x, y, steer, radius = primitives[i, 0], primitives[i, 1], primitives[i, 2], primitives[i, 3]
        kind = int(kinds[i])
        turn = 0.0
        if kind == 4:
            continue
        if kind != 2:
            steer += steering[driven]
            turn = angles[driven]
            driven += 1
            direction = steer + rollers[i] if kind == 1 else steer
            c, s = np.cos(direction), np.sin(direction)
            rows[n, 0], rows[n, 1], rows[n, 2] = c, s, x * s - y * c
            rows[n, 3] = radius * turn * (np.cos(rollers[i]) if kind == 1 else 1.0)
            rows[n, 4], rows[n, 5], rows[n, 6], rows[n, 7] = weights[0], i, 0.0, direction
            n += 1
        if kind != 1:
            c, s = np.cos(steer), np.sin(steer)
            rows[n, 0], rows[n, 1], rows[n, 2] = -s, c, x * c + y * s
            rows[n, 3] = 0.0
            rows[n, 4], rows[n, 5], rows[n, 6], rows[n, 7] = weights[1], i, 1.0, steer
            n += 1
    for k in range(n):
        w = rows[k, 4]
        for a in range(3):
            right[a] += w * rows[k, a] * rows[k, 3]
            for b in range(3):
                normal[a, b] += w * rows[k, a] * rows[k, b]
    inverse = np.empty((3, 3))
    if not solve3(normal, inverse):
        return 0
    for a in range(3):
        xi[a] = inverse[a, 0] * right[0] + inverse[a, 1] * right[1] + inverse[a, 2] * right[2]
    for k in range(n):
        for a in range(3):
            gain[a, k] = rows[k, 4] * (
                inverse[a, 0] * rows[k, 0] + inverse[a, 1] * rows[k, 1] + inverse[a, 2] * rows[k, 2]
            )
    if not with_jacobian:
        return n
    jacobian[:] = 0.0
    for k in range(n):
        i = int(rows[k, 5])
        w = rows[k, 4]
        residual = rows[k, 3] - (rows[k, 0] * xi[0] + rows[k, 1] * xi[1] + rows[k, 2] * xi[2])
        ax, ay = rows[k, 0], rows[k, 1]
        # The row is (ax, ay, x·ay - y·ax); turning it by the steering angle swaps ax, ay.
        dsx, dsy = -ay, ax
        x, y = primitives[i, 0], primitives[i, 1]
        dsw = x * dsy - y * dsx
        for a in range(3):
            jacobian[a, 4 * i] += inverse[a, 2] * w * ay * residual - gain[a, k] * ay * xi[2]
            jacobian[a, 4 * i + 1] += -inverse[a, 2] * w * ax * residual + gain[a, k] * ax * xi[2]
            jacobian[a, 4 * i + 2] += (
                (inverse[a, 0] * dsx + inverse[a, 1] * dsy + inverse[a, 2] * dsw) * w * residual
            ) - gain[a, k] * (dsx * xi[0] + dsy * xi[1] + dsw * xi[2])
            if rows[k, 6] == 0.0:
                jacobian[a, 4 * i + 3] += gain[a, k] * rows[k, 3] / primitives[i, 3]
    return n


@compiled
def all_displacements(
    angles: Floats,
    steering: Floats,
    primitives: Floats,
    kinds: Floats,
    rollers: Floats,
    weights: Floats,
    out: Floats,
) -> bool:
    """Fill `out` (N, 3) with the body displacement of every interval; False if undetermined."""
    w = kinds.size
    rows = np.empty((2 * w, 8))
    gain = np.empty((3, 2 * w))
    unused = np.empty((3, 4 * w))
    for k in range(angles.shape[0]):
        n = body_displacement(
            angles[k],
            steering[k],
            primitives,
            kinds,
            rollers,
            weights,
            rows,
            out[k],
            gain,
            unused,
            False,
        )
        if n == 0:
            return False
    return True
