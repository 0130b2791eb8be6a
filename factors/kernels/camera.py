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

    m = [camera motion (3) in the first camera frame, nominal mount (3)]; g = [mount x, y, yaw
    minus nominal, scale minus 1]. With t the base's motion (b, phi) and the mount (p, psi):
    c = R(-psi) (b + R(phi) p - p), heading phi; the prediction is (1 + g_3)·c.
    """
    px, py, psi = m[3] + g[0], m[4] + g[1], m[5] + g[2]
    scale = 1.0 + g[3]
    relative_pose(xi, xj, r, ji, jj)
    bx, by, phi = r[0], r[1], r[2]
    cf, sf = np.cos(phi), np.sin(phi)
    cm, sm = np.cos(psi), np.sin(psi)
    ux, uy = bx + cf * px - sf * py - px, by + sf * px + cf * py - py
    cx, cy = cm * ux + sm * uy, -sm * ux + cm * uy
    # d u / d phi, then both Jacobians of (bx, by, phi) mapped to the camera's axes.
    vx, vy = -sf * px - cf * py, cf * px - sf * py
    for k in range(3):
        for j in (ji, jj):
            a, b = j[0, k] + vx * j[2, k], j[1, k] + vy * j[2, k]
            j[0, k] = scale * (cm * a + sm * b)
            j[1, k] = scale * (-sm * a + cm * b)
    # d u / d p = R(phi) - 1
    jg[0, 0] = scale * (cm * (cf - 1.0) + sm * sf)
    jg[1, 0] = scale * (-sm * (cf - 1.0) + cm * sf)
    jg[0, 1] = scale * (-cm * sf + sm * (cf - 1.0))
    jg[1, 1] = scale * (sm * sf + cm * (cf - 1.0))
    jg[0, 2], jg[1, 2] = scale * cy, -scale * cx
    jg[0, 3], jg[1, 3] = cx, cy
    r[0] = scale * cx - m[0]
    r[1] = scale * cy - m[1]
    r[2] = wrap_scalar(phi - m[2])
