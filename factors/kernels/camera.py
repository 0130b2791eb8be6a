"""Camera odometry: relative motion of a camera with unknown mounting and scale."""

from __future__ import annotations

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.geometry import Floats, wrap_scalar
from fgloc.factors.kernels.wheel import relative_pose


@compiled
def camera_odometry(
    xi: Floats,
    xj: Floats,
    g: Floats,
    m: Floats,
    slot: int,
    r: Floats,
    ji: Floats,
    jj: Floats,
    jg: Floats,
) -> None:
    """Residual between mount⁻¹ ∘ (xi⁻¹ ∘ xj) ∘ mount, translation scaled, and the camera's motion.

    m = [camera motion (3) in the first camera frame, nominal mount (3), base motion (3) that the
    wheels predict]; g = [mount x, y, yaw minus nominal, scale minus 1]. With a base motion (b, phi)
    and the mount (p, psi) the camera moves by R(-psi) (b + (R(phi) - 1) p), and turns by phi.

    What errors of position and scale add to that is taken in the predicted motion, not in the
    estimated one: to first order the same, but free of the estimate's noise. A slope that holds
    noise of the residual it belongs to is an old trap (errors in variables). With it the noise of
    each interval shrinks a little as the scale grows, and a thousand intervals outweigh every
    prior: slow drives came out too small by more than the scale's prior sigma, and a robot that
    trembles about another point than its origin moved the camera's lever arm. The wheels'
    prediction serves as the instrument.
    """
    px, py, psi = m[3], m[4], m[5] + g[2]
    error = g[3]
    relative_pose(xi, xj, r, ji, jj)
    bx, by, phi = r[0], r[1], r[2]
    cf, sf = np.cos(phi), np.sin(phi)
    cm, sm = np.cos(psi), np.sin(psi)
    ux, uy = bx + cf * px - sf * py - px, by + sf * px + cf * py - py
    # d u / d phi, then both Jacobians of (bx, by, phi) mapped to the camera's axes.
    vx, vy = -sf * px - cf * py, cf * px - sf * py
    for k in range(3):
        for j in (ji, jj):
            a, b = j[0, k] + vx * j[2, k], j[1, k] + vy * j[2, k]
            j[0, k] = cm * a + sm * b
            j[1, k] = -sm * a + cm * b
    # What the errors of position and scale add, in the predicted motion.
    c, s = np.cos(m[8]) - 1.0, np.sin(m[8])
    wx, wy = m[6] + c * (px + g[0]) - s * (py + g[1]), m[7] + s * (px + g[0]) + c * (py + g[1])
    ux += c * g[0] - s * g[1] + error * wx
    uy += s * g[0] + c * g[1] + error * wy
    c, s = (1.0 + error) * c, (1.0 + error) * s
    jg[0, 0], jg[0, 1] = cm * c + sm * s, -cm * s + sm * c
    jg[1, 0], jg[1, 1] = -sm * c + cm * s, sm * s + cm * c
    cx, cy = cm * ux + sm * uy, -sm * ux + cm * uy
    jg[0, 2], jg[1, 2] = cy, -cx
    jg[0, 3], jg[1, 3] = cm * wx + sm * wy, -sm * wx + cm * wy
    r[0] = cx - m[0]
    r[1] = cy - m[1]
    r[2] = wrap_scalar(phi - m[2])
