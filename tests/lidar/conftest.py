"""Scans of simulated walls, for tests of matching."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from fgloc.core.measurements import Floats, Scans
from fgloc.datasets.simulator.rays import cast
from fgloc.lidar.scan import cloud
from fgloc.lidar.surfaces import ScanPoints, surfaces

Look = Callable[..., list[ScanPoints]]


@pytest.fixture(scope="session")
def look() -> Look:
    """Return a function that scans walls (W, 4) from poses (N, 3), 400 beams all around.

    A range is off by 3 mm and `share` of it (σ), 2 % of the beams do not return.
    """

    def scan(
        walls: Floats, poses: Floats, seed: int, share: float = 0.01, limit: float = 8.0
    ) -> list[ScanPoints]:
        rng = np.random.default_rng(seed)
        beams = 400
        step = 2.0 * np.pi / beams
        ranges = np.zeros((len(poses), beams))
        for k, pose in enumerate(poses):
            angles = pose[2] - np.pi + step * np.arange(beams)
            origins = np.tile(pose[:2], (beams, 1))
            ranges[k] = cast(origins, angles, beams, np.asarray(walls, float), limit)
        sigma = np.hypot(0.003, share * np.where(np.isfinite(ranges), ranges, 0.0))
        ranges += sigma * rng.standard_normal(ranges.shape)
        missing = ~np.isfinite(ranges) | (rng.random(ranges.shape) < 0.02)
        ranges[missing] = 0.0
        stamps = 100_000_000 * np.arange(len(poses), dtype=np.int64)
        scans = Scans(
            "lidar",
            stamps,
            ranges,
            -np.pi,
            step,
            range_sigma=0.003,
            range_sigma_share=share,
            min_range=0.15,
            max_range=limit + 1.0,
        )
        seen = cloud(scans)
        return surfaces(seen.points, seen.valid, scans)

    return scan


def box(x0: float, y0: float, x1: float, y1: float) -> list[list[float]]:
    """Return the four walls of a rectangle [m]."""
    return [[x0, y0, x1, y0], [x1, y0, x1, y1], [x1, y1, x0, y1], [x0, y1, x0, y0]]


@pytest.fixture(scope="session")
def room() -> Floats:
    """Return the walls of a room of 6 m by 5 m with a cupboard and a pillar."""
    return np.array(box(0, 0, 6, 5) + box(4.2, 4.3, 6, 5) + box(2.0, 2.4, 2.3, 2.7))


@pytest.fixture(scope="session")
def ring() -> Floats:
    """Return a ring of corridors, 16 m by 10 m outside and 2 m wide, with niches and cupboards."""
    walls = box(0, 0, 16, 10) + box(2, 2, 14, 8)
    for x0, y0, x1, y1 in (
        (3, 0, 4.1, 0.5),
        (7.7, 1.6, 8.4, 2),
        (11, 0, 11.5, 0.4),
        (15.4, 3, 16, 4.2),
        (14, 6, 14.4, 6.5),
        (12, 9.5, 13.3, 10),
        (9, 8, 9.6, 8.5),
        (5, 9.4, 5.7, 10),
        (0, 7, 0.5, 7.7),
        (1.6, 4, 2, 5.2),
    ):
        walls += box(x0, y0, x1, y1)
    return np.array(walls, float)


@pytest.fixture(scope="session")
def around_the_ring() -> Floats:
    """Return poses (N, 3) of a drive once and a quarter round the ring, one each 0.25 m."""
    corners = np.array([(1.0, 1.0), (15.0, 1.0), (15.0, 9.0), (1.0, 9.0)])
    poses: list[tuple[float, float, float]] = []
    for side in range(5):
        a, b = corners[side % 4], corners[(side + 1) % 4]
        length = float(np.hypot(*(b - a)))
        heading = side * np.pi / 2.0
        for way in np.arange(0.0, length if side < 4 else 10.0, 0.25):
            poses.append((*(a + (b - a) * way / length), heading))
        poses += [(*b, heading + np.pi / 2.0 * t) for t in (0.25, 0.5, 0.75) if side < 4]
    return np.array(poses)
