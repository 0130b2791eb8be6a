"""Scans of rooms made by hand, with noise that is drawn here and nowhere else."""

from __future__ import annotations

import math

import numpy as np

from fgloc.core.measurements import Floats, Scans
from fgloc.datasets.simulator.rays import cast

TURN = 2.0 * math.pi
Wall = tuple[float, float, float, float]
BOX: tuple[Wall, ...] = ((-3, -2, 5, -2), (5, -2, 5, 3), (5, 3, -3, 3), (-3, 3, -3, -2))
"""A room of 8 m by 5 m around the lidar."""


def scan_room(
    walls: tuple[Wall, ...],
    count: int,
    *,
    sigma: float = 1e-3,
    share: float = 0.01,
    bearing: float = 0.0,
    beams: int = 400,
    angle_min: float = -math.pi,
    increment: float = TURN / 400,
    max_range: float = 12.0,
    dropout: float = 0.0,
    seed: int = 1,
) -> Scans:
    """Return scans from the origin of the walls' axes, the lidar standing still."""
    rng = np.random.default_rng(seed)
    nominal = angle_min + increment * np.arange(beams)
    directions = np.tile(nominal, count) + bearing * rng.standard_normal(count * beams)
    origins = np.zeros((count * beams, 2))
    exact = cast(origins, directions, beams, np.array(walls, dtype=np.float64), 100.0)
    finite = np.isfinite(exact)
    exact[~finite] = 0.0
    ranges = exact + np.hypot(sigma, share * exact) * rng.standard_normal(exact.size)
    ranges[~finite | (ranges >= max_range) | (rng.random(exact.size) < dropout)] = 0.0
    return Scans(
        "lidar",
        np.arange(count, dtype=np.int64) * 100_000_000,
        ranges.reshape(count, beams),
        angle_min,
        increment,
        range_sigma=sigma,
        range_sigma_share=share,
        bearing_sigma=bearing,
        min_range=0.15,
        max_range=max_range,
    )


def arc(radius: float, x: float, y: float, pieces: int = 720) -> tuple[Wall, ...]:
    """Return a circle of straight pieces that are short beside the noise."""
    a = np.linspace(0.0, TURN, pieces + 1)
    px, py = x + radius * np.cos(a), y + radius * np.sin(a)
    rows: Floats = np.stack([px[:-1], py[:-1], px[1:], py[1:]], axis=1)
    return tuple((float(r[0]), float(r[1]), float(r[2]), float(r[3])) for r in rows)
