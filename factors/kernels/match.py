"""Two scans laid on each other: the relative pose of a lidar between any two keyframes."""

from __future__ import annotations

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.geometry import Floats, wrap_scalar
from fgloc.factors.kernels.wheel import relative_pose


@compiled
def scan_match(
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
    """Residual between mount⁻¹ ∘ (xi⁻¹ ∘ xj) ∘ mount and the match, in the first lidar's axes.

    m = [pose of the second lidar in the first one's axes (3), nominal mount (3)]; g = mount minus
    nominal (3), or empty where the mount is known exactly.
    """
    px, py, psi = m[3], m[4], m[5]
    if g.size >= 3:
        px += g[0]
        py += g[1]
        psi += g[2]
    relative_pose(xi, xj, r, ji, jj)
    phi = r[2]
    cf, sf = np.cos(phi), np.sin(phi)
    cm, sm = np.cos(psi), np.sin(psi)
    ux, uy = r[0] + cf * px - sf * py - px, r[1] + sf * px + cf * py - py
    # d u / d phi, then both Jacobians of (base motion, phi) mapped to the lidar's axes.
    vx, vy = -sf * px - cf * py, cf * px - sf * py
    for k in range(3):
        for j in (ji, jj):
            a, b = j[0, k] + vx * j[2, k], j[1, k] + vy * j[2, k]
            j[0, k] = cm * a + sm * b
            j[1, k] = -sm * a + cm * b
    lx, ly = cm * ux + sm * uy, -sm * ux + cm * uy
    if g.size >= 3:
        c, s = cf - 1.0, sf
        jg[0, 0], jg[0, 1], jg[0, 2] = cm * c + sm * s, -cm * s + sm * c, ly
        jg[1, 0], jg[1, 1], jg[1, 2] = -sm * c + cm * s, sm * s + cm * c, -lx
    r[0] = lx - m[0]
    r[1] = ly - m[1]
    r[2] = wrap_scalar(phi - m[2])
