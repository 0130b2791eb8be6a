"""Absolute fixes of a sensor mounted somewhere on the robot: position, or position and heading."""

from __future__ import annotations

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.geometry import Floats, wrap_scalar


@compiled
def position_fix(
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
    """Residual p + R(theta)·lever - fix in map axes; m = [fix (2), nominal lever (2)].

    g = lever minus nominal (2), or empty where the lever is known exactly.
    """
    lx, ly = m[2], m[3]
    c, s = np.cos(xi[2]), np.sin(xi[2])
    if g.size >= 2:
        lx += g[0]
        ly += g[1]
        jg[0, 0], jg[0, 1] = c, -s
        jg[1, 0], jg[1, 1] = s, c
    ax, ay = c * lx - s * ly, s * lx + c * ly
    r[0] = xi[0] + ax - m[0]
    r[1] = xi[1] + ay - m[1]
    ji[0, 0], ji[0, 1], ji[0, 2] = c, -s, -ay
    ji[1, 0], ji[1, 1], ji[1, 2] = s, c, ax


@compiled
def pose_fix(
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
    """Residual x ∘ mount - fix in map axes, heading wrapped; m = [fix (3), nominal mount (3)].

    g = mount minus nominal (3), or empty where the mount is known exactly.
    """
    lx, ly, turn = m[3], m[4], m[5]
    c, s = np.cos(xi[2]), np.sin(xi[2])
    if g.size >= 3:
        lx += g[0]
        ly += g[1]
        turn += g[2]
        jg[0, 0], jg[0, 1] = c, -s
        jg[1, 0], jg[1, 1] = s, c
        jg[2, 2] = 1.0
    ax, ay = c * lx - s * ly, s * lx + c * ly
    r[0] = xi[0] + ax - m[0]
    r[1] = xi[1] + ay - m[1]
    r[2] = wrap_scalar(xi[2] + turn - m[2])
    ji[0, 0], ji[0, 1], ji[0, 2] = c, -s, -ay
    ji[1, 0], ji[1, 1], ji[1, 2] = s, c, ax
    ji[2, 2] = 1.0
