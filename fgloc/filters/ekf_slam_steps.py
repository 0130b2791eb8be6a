"""The single steps of EKF-SLAM, compiled: what is expected, correction, birth and death.

State x = (pose x, y [m], heading [rad]; x, y of every landmark), its covariance P, both in arrays
with room for more: the first n rows count. A sensor stands at `mount` (x, y [m], yaw [rad]) on the
robot. All steps are O(n²) at most. Source: seed B, with the Jacobians derived, not as printed.
"""

from __future__ import annotations

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.geometry import wrap_scalar
from fgloc.core.measurements import Floats

NEAR = 1e-3
"""Nearer than this [m] a point has no direction, and tells nothing."""


@compiled
def point_seen(x: Floats, mount: Floats, distance: float, bearing: float, point: Floats) -> None:
    """Write where in the map (2,) [m] the point lies that the sensor sees so far away there."""
    c, s = np.cos(x[2]), np.sin(x[2])
    direction = x[2] + mount[2] + bearing
    point[0] = x[0] + c * mount[0] - s * mount[1] + distance * np.cos(direction)
    point[1] = x[1] + s * mount[0] + c * mount[1] + distance * np.sin(direction)


@compiled
def sight(x: Floats, mount: Floats, px: float, py: float, z: Floats) -> float:
    """Write range [m] and bearing [rad] of a point of the map into `z` (2,); return the range."""
    c, s = np.cos(x[2]), np.sin(x[2])
    dx = px - x[0] - (c * mount[0] - s * mount[1])
    dy = py - x[1] - (s * mount[0] + c * mount[1])
    z[0] = np.sqrt(dx * dx + dy * dy)
    z[1] = wrap_scalar(np.arctan2(dy, dx) - x[2] - mount[2])
    return float(z[0])


@compiled
def sight_jacobian(x: Floats, mount: Floats, px: float, py: float, h: Floats) -> None:
    """Write d (range, bearing) / d (pose, point) into `h` (2, 5).

    With the sensor at s = (x, y) + R(heading) (mx, my), d = point - s and R(heading)(mx, my) =
    (lx, ly): d s / d heading = (-ly, lx), so d range / d heading = (dx ly - dy lx) / range and
    d bearing / d heading = -(dx lx + dy ly) / range² - 1. The point must not be at the sensor.
    """
    c, s = np.cos(x[2]), np.sin(x[2])
    lx, ly = c * mount[0] - s * mount[1], s * mount[0] + c * mount[1]
    dx, dy = px - x[0] - lx, py - x[1] - ly
    squared = dx * dx + dy * dy
    distance = np.sqrt(squared)
    h[0, 0], h[0, 1] = -dx / distance, -dy / distance
    h[0, 2] = (dx * ly - dy * lx) / distance
    h[0, 3], h[0, 4] = dx / distance, dy / distance
    h[1, 0], h[1, 1] = dy / squared, -dx / squared
    h[1, 2] = -(dx * lx + dy * ly) / squared - 1.0
    h[1, 3], h[1, 4] = -dy / squared, dx / squared


@compiled
def project(
    p: Floats,
    n: int,
    j: int,
    h: Floats,
    r0: float,
    r1: float,
    innovation: Floats,
    root: Floats,
    white: Floats,
) -> float:
    """Return the squared Mahalanobis distance of an innovation (2,); NaN if S is not positive.

    The landmark's coordinates are states j and j + 1; r0 and r1 are the variances of range and
    bearing. With S = H P Hᵀ + R = L Lᵀ, writes P Hᵀ L⁻ᵀ into the first n columns of `root` (2, n)
    and L⁻¹ ν into `white` (2,): all that `correct` needs. O(n).
    """
    for a in range(2):
        h0, h1, h2, h3, h4 = h[a, 0], h[a, 1], h[a, 2], h[a, 3], h[a, 4]
        # P is symmetric: its rows lie in one piece in memory, its columns do not.
        for k in range(n):
            root[a, k] = (
                h0 * p[0, k] + h1 * p[1, k] + h2 * p[2, k] + h3 * p[j, k] + h4 * p[j + 1, k]
            )
    s00, s10, s11 = r0, 0.0, r1
    for a in range(5):
        k = a if a < 3 else j + a - 3
        s00 += h[0, a] * root[0, k]
        s10 += h[1, a] * root[0, k]
        s11 += h[1, a] * root[1, k]
    if not s00 > 0.0:
        return np.nan
    l00 = np.sqrt(s00)
    l10 = s10 / l00
    rest = s11 - l10 * l10
    if not rest > 0.0:
        return np.nan
    l11 = np.sqrt(rest)
    white[0] = innovation[0] / l00
    white[1] = (innovation[1] - l10 * white[0]) / l11
    for k in range(n):
        first = root[0, k] / l00
        root[1, k] = (root[1, k] - l10 * first) / l11
        root[0, k] = first
    return float(white[0] * white[0] + white[1] * white[1])


@compiled
def correct(x: Floats, p: Floats, n: int, root: Floats, white: Floats) -> None:
    """Correct x and P in place with what `project` wrote: x += K ν, P -= K S Kᵀ.

    With `root` = P Hᵀ L⁻ᵀ, K ν = root L⁻¹ν and K S Kᵀ = root rootᵀ, which stays symmetric to the
    last bit. O(n²), nothing is allocated.
    """
    for k in range(n):
        x[k] += root[0, k] * white[0] + root[1, k] * white[1]
    for i in range(n):
        a, b = root[0, i], root[1, i]
        row = p[i]
        for k in range(n):
            row[k] -= a * root[0, k] + b * root[1, k]


@compiled
def birth(
    x: Floats,
    p: Floats,
    n: int,
    mount: Floats,
    distance: float,
    bearing: float,
    r0: float,
    r1: float,
) -> None:
    """Add the landmark seen at a distance and bearing of variances r0, r1 as states n, n + 1.

    m = s + ρ (cos, sin)(θ + ψ + φ) with the Jacobians J_xr by the pose and J_z by the sighting:
    P_mm = J_xr P_rr J_xrᵀ + J_z R J_zᵀ, P_mk = J_xr P_rk for every other state k. O(n).
    """
    c, s = np.cos(x[2]), np.sin(x[2])
    lx, ly = c * mount[0] - s * mount[1], s * mount[0] + c * mount[1]
    direction = x[2] + mount[2] + bearing
    ux, uy = np.cos(direction), np.sin(direction)
    x[n], x[n + 1] = x[0] + lx + distance * ux, x[1] + ly + distance * uy
    # By the heading; by x and y J_xr is the identity.
    tx, ty = -ly - distance * uy, lx + distance * ux
    for k in range(n):
        p[n, k] = p[0, k] + tx * p[2, k]
        p[n + 1, k] = p[1, k] + ty * p[2, k]
        p[k, n], p[k, n + 1] = p[n, k], p[n + 1, k]
    across = distance * distance * r1
    p[n, n] = p[n, 0] + tx * p[n, 2] + ux * ux * r0 + uy * uy * across
    p[n, n + 1] = p[n + 1, 0] + tx * p[n + 1, 2] + ux * uy * (r0 - across)
    p[n + 1, n] = p[n, n + 1]
    p[n + 1, n + 1] = p[n + 1, 1] + ty * p[n + 1, 2] + uy * uy * r0 + ux * ux * across


@compiled
def known(
    x: Floats, p: Floats, n: int, px: float, py: float, variance_x: float, variance_y: float
) -> None:
    """Add a landmark whose place somebody measured as states n, n + 1. O(n)."""
    x[n], x[n + 1] = px, py
    for k in range(n + 2):
        p[n, k], p[n + 1, k], p[k, n], p[k, n + 1] = 0.0, 0.0, 0.0, 0.0
    p[n, n], p[n + 1, n + 1] = variance_x, variance_y


@compiled
def remove(x: Floats, p: Floats, n: int, j: int) -> None:
    """Take states j, j + 1 out: the last landmark, states n - 2 and n - 1, moves there. O(n)."""
    last = n - 2
    if j == last:
        return
    for a in range(2):
        x[j + a] = x[last + a]
        for k in range(last):
            if k != j and k != j + 1:
                p[j + a, k] = p[last + a, k]
                p[k, j + a] = p[last + a, k]
    for a in range(2):
        for b in range(2):
            p[j + a, j + b] = p[last + a, last + b]


@compiled
def wall_foot(x: Floats, mount: Floats, normal: float, mx: float, my: float, foot: Floats) -> float:
    """Write the foot (2,) of the perpendicular from the map's origin onto a seen wall [m].

    `normal` [rad] and the wall's middle (mx, my) [m] are in the sensor's axes; returns the normal's
    direction in the map [rad]. Source: seed C. A wall through the origin has its foot there
    whatever its direction: such a landmark tells nothing of the heading.
    """
    c, s = np.cos(x[2]), np.sin(x[2])
    ox, oy = x[0] + c * mount[0] - s * mount[1], x[1] + s * mount[0] + c * mount[1]
    turn = x[2] + mount[2]
    ct, st = np.cos(turn), np.sin(turn)
    wx, wy = ox + ct * mx - st * my, oy + st * mx + ct * my
    direction = turn + normal
    nx, ny = np.cos(direction), np.sin(direction)
    distance = nx * wx + ny * wy
    foot[0], foot[1] = distance * nx, distance * ny
    return float(direction)
