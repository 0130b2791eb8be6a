"""Geographic positions on the WGS84 ellipsoid as metres east and north of a first one."""

from __future__ import annotations

import numpy as np

from fgloc.core.measurements import Floats

SEMI_MAJOR = 6_378_137.0
"""Equatorial radius of WGS84 [m]."""
FLATTENING = 1.0 / 298.257223563
"""Flattening of WGS84."""


def to_ecef(latitude: Floats, longitude: Floats) -> Floats:
    """Return (..., 3) earth-centred coordinates [m] of points on the ellipsoid (degrees in)."""
    phi, lam = np.radians(latitude), np.radians(longitude)
    squared = FLATTENING * (2.0 - FLATTENING)
    # Radius of curvature across the meridian; along the polar axis it shrinks by 1 - e².
    normal = SEMI_MAJOR / np.sqrt(1.0 - squared * np.sin(phi) ** 2)
    x = normal * np.cos(phi) * np.cos(lam)
    y = normal * np.cos(phi) * np.sin(lam)
    return np.stack([x, y, normal * (1.0 - squared) * np.sin(phi)], axis=-1)


def to_east_north(latitude: Floats, longitude: Floats, origin: tuple[float, float]) -> Floats:
    """Return (N, 2) metres east and north in the plane that touches the ellipsoid at `origin`.

    `latitude`, `longitude` and the origin in degrees. Exact projection along the origin's
    vertical; heights are taken as zero.
    """
    at = np.radians(origin)
    (s_phi, s_lam), (c_phi, c_lam) = np.sin(at), np.cos(at)
    step = to_ecef(latitude, longitude) - to_ecef(np.array(origin[0]), np.array(origin[1]))
    east = -s_lam * step[..., 0] + c_lam * step[..., 1]
    north = -s_phi * (c_lam * step[..., 0] + s_lam * step[..., 1]) + c_phi * step[..., 2]
    return np.stack([east, north], axis=-1)
