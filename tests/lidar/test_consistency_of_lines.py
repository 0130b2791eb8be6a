"""Errors of extracted lines beside the covariance that is stated for them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fgloc.core.consistency import average, each_squared_normalised
from fgloc.core.geometry import wrap
from fgloc.core.measurements import Floats
from fgloc.lidar.lines import LineSettings, extract
from fgloc.lidar.scan import cloud
from fgloc.lidar.segments import Segments
from tests.lidar.rooms import BOX, Wall, scan_room

PLANE = LineSettings(flatness_m=0.0, roughness_m=0.0)
"""Walls here are planes."""
SCANS = 500
OBLIQUE: tuple[Wall, ...] = ((-2, -2, 7, 1), (7, 1, 5, 5), (5, 5, -3, 2), (-3, 2, -2, -2))
CASES: dict[str, tuple[tuple[Wall, ...], float]] = {
    # The walls, of which the first is looked at, and how many of 100 scans must show it.
    "long and near": (BOX, 98),
    "across the room": ((BOX[1], *BOX[2:], BOX[0]), 98),
    "oblique": (OBLIQUE, 97),
    "short and near": (((1, -0.3, 1, 0.3), (3, -5, 3, 5)), 98),
    "short and far": (((5.5, -0.6, 5.5, 0.6), (9, -9, 9, 9)), 98),
    "from 11° to 6°": (((1, -1, 6, -0.8),), 98),
    "ends at a corner of 162°": (((3, -3, 3, 0), (3, 0, 2, 3)), 98),
    # Total least squares of the points is off by 0.3 sigma here.
    "short, far and at 45°": (((6.0, -0.6, 7.2, 0.6),), 98),
    "long and far": (((7, -5, 7, 5),), 98),
}
NOISE = {
    "1 cm": {"sigma": 0.01, "share": 0.0},
    "1 %": {"sigma": 1e-3, "share": 0.01},
    "1 % and 0.3°": {"sigma": 1e-3, "share": 0.01, "bearing": math.radians(0.3)},
}


def errors(wall: Wall, segments: Segments) -> tuple[Segments, Floats]:
    """Return the segments that show a wall, and (M, 2) the errors of normal and middle."""
    x1, y1, x2, y2 = wall
    length = math.hypot(x2 - x1, y2 - y1)
    along = np.array([x2 - x1, y2 - y1]) / length
    normal = np.array([-along[1], along[0]])
    if normal @ np.array([x1, y1]) > 0.0:
        normal = -normal
    turn = wrap(segments.normal - math.atan2(normal[1], normal[0]))
    off = (segments.middle - np.array([x1, y1])) @ normal
    at = (segments.middle - np.array([x1, y1])) @ along
    shows = (np.abs(turn) < 0.5) & (np.abs(off) < 0.5) & (at > 0.0) & (at < length)
    return segments.select(shows), np.stack([turn, off], axis=1)[shows]


@pytest.fixture(scope="module")
def results() -> dict[tuple[str, str], tuple[Segments, Floats]]:
    """Return the segments of every case's first wall and their errors."""
    out = {}
    for seed, noise in enumerate(NOISE):
        for case, (walls, _) in CASES.items():
            scans = scan_room(walls, SCANS, seed=seed, **NOISE[noise])
            out[case, noise] = errors(walls[0], extract(cloud(scans), scans, PLANE))
    return out


@pytest.mark.parametrize("noise", NOISE)
@pytest.mark.parametrize("case", CASES)
def test_errors_are_as_large_as_stated(
    results: dict[tuple[str, str], tuple[Segments, Floats]], case: str, noise: str
) -> None:
    segments, error = results[case, noise]
    assert np.unique(segments.scan).size == segments.scan.size, "found twice"
    assert segments.scan.size >= CASES[case][1] / 100 * SCANS
    nees = average(each_squared_normalised(error, segments.covariance), 2, 0.999)
    assert nees.verdict == "inside", nees
    # No bias: the mean of n errors has a sigma of a n-th, in squares; 3.3 of those are 0.1 %.
    sigma = np.sqrt(np.diagonal(segments.covariance, axis1=1, axis2=2))
    mean = np.mean(error / sigma, axis=0)
    assert np.abs(mean).max() < 3.3 / math.sqrt(segments.scan.size)


def test_errors_of_all_cases_together(
    results: dict[tuple[str, str], tuple[Segments, Floats]],
) -> None:
    squared = [each_squared_normalised(e, s.covariance) for s, e in results.values()]
    # All of them tell a few percent of the sigma: neither confident nor, by more, cautious.
    assert 0.93 < np.mean(np.concatenate(squared)) / 2.0 < 1.03
    inside = [average(each, 2).verdict == "inside" for each in squared]
    assert np.mean(inside) > 0.8


def test_walls_that_are_not_plane() -> None:
    # Every scan sees another wall, off by 3 mm and turned as the default flatness says.
    rng = np.random.default_rng(4)
    squared = []
    for seed in range(150):
        off, turn = 0.003 * rng.standard_normal(2)
        tilt = math.sqrt(12.0) * turn / 4.0
        wall = (2.0 + off - 2.0 * tilt, -2.0, 2.0 + off + 2.0 * tilt, 2.0)
        scans = scan_room((wall,), 1, sigma=0.005, share=0.0, seed=seed)
        segments, error = errors((2.0, -2.0, 2.0, 2.0), extract(cloud(scans), scans))
        squared.append(each_squared_normalised(error, segments.covariance))
    # The default also allows for 3 mm of roughness, which is not there.
    assert average(np.concatenate(squared), 2, 0.99).verdict == "inside"


def test_ends_of_walls() -> None:
    # A free end of a wall lies between its last beam and the next: the ends are short of it by
    # half a beam's spacing, 4 cm here, on average; noise does not make walls longer.
    wall: Wall = (4.0, -1.5, 4.0, 1.5)
    scans = scan_room((wall,), SCANS, sigma=0.01, share=0.0)
    shown, _ = errors(wall, extract(cloud(scans), scans))
    right, left = shown.ends[:, 0, 1], shown.ends[:, 1, 1]
    spacing = 4.0 * (1.0 + (1.5 / 4.0) ** 2) * 2.0 * math.pi / 400
    short = np.concatenate([1.5 - right, left + 1.5])
    assert short.max() < 3.0 * spacing
    assert short.min() > -0.02
    assert 0.0 < np.mean(short) < spacing
