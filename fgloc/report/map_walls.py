"""Walls as a user meets them: ends, lengths, standard deviations, and their 2σ bands."""

from __future__ import annotations

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.lidar.walls import Walls

STATIONS = 9
"""Points along a wall at which its band is computed; its borders are hyperbolas, not lines."""


def wall_lengths(walls: Walls) -> Floats:
    """Return (L,) lengths of what was seen of each wall [m]."""
    return np.asarray(walls.reach[:, 1] - walls.reach[:, 0])


def wall_sigmas(walls: Walls) -> tuple[Floats, Floats]:
    """Return (L,) standard deviations of each wall: of its offset [m], of its direction [rad].

    The offset's is that at the middle of what was seen: at the anchor's foot, which may lie far
    from it, the direction's error would be in it as well.
    """
    middle = walls.reach.mean(axis=1)
    return offset_sigma(walls, middle[:, None])[:, 0], np.sqrt(_positive(walls.covariance[:, 0, 0]))


def offset_sigma(walls: Walls, along: Floats) -> Floats:
    """Return (L, K) standard deviation [m] of each wall across itself, at `along` its tangent.

    `along` (L, K) is measured from the anchor's foot [m]. Turning the normal by a small angle
    moves the point at s by -s times that angle along the normal, so the variance is
    P_dd - 2 s P_φd + s² P_φφ. NaN where the covariance is not known.
    """
    p = walls.covariance[:, :, :, None]
    variance = p[:, 1, 1] - 2.0 * along * p[:, 0, 1] + along**2 * p[:, 0, 0]
    return np.asarray(np.sqrt(_positive(variance)))


def wall_bands(walls: Walls, times: float = 2.0) -> Floats:
    """Return (L, 2·STATIONS, 2) closed outlines of each wall's ± `times` σ band in map axes [m].

    Up one side and down the other. NaN for walls without covariance.
    """
    share = np.linspace(0.0, 1.0, STATIONS)
    along = walls.reach[:, :1] + (walls.reach[:, 1:] - walls.reach[:, :1]) * share
    normal = np.stack([np.cos(walls.normal), np.sin(walls.normal)], axis=1)[:, None]
    tangent = np.stack([-normal[..., 1], normal[..., 0]], axis=-1)
    foot = walls.anchor[:, None] + walls.offset[:, None, None] * normal
    line = foot + along[..., None] * tangent
    across = times * offset_sigma(walls, along)[..., None] * normal
    return np.asarray(np.concatenate([line + across, (line - across)[:, ::-1]], axis=1))


def _positive(variance: Floats) -> Floats:
    """Return variances with what rounding left below zero as zero; NaN stays."""
    return np.where(variance < 0.0, 0.0, variance)
