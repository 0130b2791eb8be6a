"""Landmarks that a sensor on the robot sees: straight walls, and points by range and bearing.

The second state xj is the landmark: two numbers in map axes, moved by adding. The sensor stands
at m's nominal mount (x, y, yaw) in the base frame, e.g. (L, 0, phi); g = mount minus nominal (3),
or empty where the mount is known exactly.
"""

from __future__ import annotations

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.geometry import Floats, wrap_scalar

NEAR = 1e-3
"""Distance [m] below which range and bearing are smoothed: at no distance a bearing has no
meaning, and both derivatives would be NaN. At 0.1 m it lengthens the range by 5 µm."""


@compiled
def wall(
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
    """Residual (turn of the normal, wrapped; distance of the seen midpoint from the wall).

    The wall is xj = (alpha, rho): the points p with n(alpha)·(p - anchor) = rho. With the anchor
    on the wall where it was first seen no wall is singular, through the origin or far from it,
    and rho stays small. m = [beta, midpoint (2), anchor (2), nominal mount (3)]: direction of the
    seen segment's normal and the middle of the segment in the sensor's axes, anchor in map axes.

    A line has two normals. The row says which: by convention beta points from the wall to the
    sensor, so that alpha is the side from which the wall is seen, and the far side of a thin wall
    is another wall (or this one if beta is given half a turn).
    """
    px, py, psi = m[5], m[6], m[7]
    if g.size >= 3:
        px += g[0]
        py += g[1]
        psi += g[2]
    cm, sm = np.cos(psi), np.sin(psi)
    qx, qy = cm * m[1] - sm * m[2], sm * m[1] + cm * m[2]
    bx, by = px + qx, py + qy
    c, s = np.cos(xi[2]), np.sin(xi[2])
    # From the anchor to the seen midpoint, map axes.
    dx, dy = xi[0] - m[3] + c * bx - s * by, xi[1] - m[4] + s * bx + c * by
    ca, sa = np.cos(xj[0]), np.sin(xj[0])
    # The wall's normal in the base's axes.
    ux, uy = ca * c + sa * s, -ca * s + sa * c
    r[0] = wrap_scalar(xi[2] + psi + m[0] - xj[0])
    r[1] = ca * dx + sa * dy - xj[1]
    ji[0, 2] = 1.0
    ji[1, 0], ji[1, 1], ji[1, 2] = ux, uy, uy * bx - ux * by
    jj[0, 0] = -1.0
    jj[1, 0], jj[1, 1] = ca * dy - sa * dx, -1.0
    if g.size >= 3:
        jg[0, 2] = 1.0
        jg[1, 0], jg[1, 1], jg[1, 2] = ux, uy, uy * qx - ux * qy


@compiled
def landmark_prior(
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
    """Residual (landmark minus what is known of it); m = [both numbers of the landmark]."""
    r[0], r[1] = xj[0] - m[0], xj[1] - m[1]
    jj[0, 0] = jj[1, 1] = 1.0


@compiled
def range_bearing(
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
    """Residual (predicted minus seen range; predicted minus seen bearing, wrapped).

    xj = (x, y) of the point; m = [range, bearing in the sensor's axes, nominal mount (3)]. With
    n the distance and e = NEAR the range is sqrt(n² + e²), and the bearing's residual fades as
    n²/(n² + e²), so that a landmark at the sensor says nothing of the direction instead of NaN.
    """
    px, py, psi = m[2], m[3], m[4]
    if g.size >= 3:
        px += g[0]
        py += g[1]
        psi += g[2]
    c, s = np.cos(xi[2]), np.sin(xi[2])
    dx, dy = xj[0] - xi[0], xj[1] - xi[1]
    # The point in the base's axes, and the way to it from the sensor in the same axes.
    bx, by = c * dx + s * dy, -s * dx + c * dy
    zx, zy = bx - px, by - py
    squared = zx * zx + zy * zy
    near = squared + NEAR * NEAR
    distance = np.sqrt(near)
    fade = squared / near
    turn = wrap_scalar(np.arctan2(zy, zx) - psi - m[1])
    r[0] = distance - m[0]
    r[1] = fade * turn
    # By z: the range is z/distance; the bearing turns by (-zy, zx)/near and fades.
    hx, hy = zx / distance, zy / distance
    bend = 2.0 * turn * NEAR * NEAR / (near * near)
    tx, ty = -zy / near + bend * zx, zx / near + bend * zy
    # z moves by -d and, as the base turns, by (by, -bx).
    ji[0, 0], ji[0, 1], ji[0, 2] = -hx, -hy, hx * by - hy * bx
    ji[1, 0], ji[1, 1], ji[1, 2] = -tx, -ty, tx * by - ty * bx
    jj[0, 0], jj[0, 1] = hx * c - hy * s, hx * s + hy * c
    jj[1, 0], jj[1, 1] = tx * c - ty * s, tx * s + ty * c
    if g.size >= 3:
        jg[0, 0], jg[0, 1] = -hx, -hy
        jg[1, 0], jg[1, 1], jg[1, 2] = -tx, -ty, -fade
