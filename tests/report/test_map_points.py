"""Scans lie in the map where the room's walls are, whatever the robot did while it scanned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from fgloc.errors import FglocError
from fgloc.estimator import CalibrationEstimate
from fgloc.report.map_points import all_points, place_scans, placed_scans
from fgloc.report.map_thinning import thin
from tests.report.mapped import HALF, MOUNT, drive, poses_at, result, room_scans, trajectory


def off_walls(points: np.ndarray) -> float:
    """The largest distance [m] of points from the room's walls."""
    return float(np.abs(np.abs(points).max(axis=1) - HALF).max())


def test_points_lie_on_the_walls_and_beams_start_at_the_lidar() -> None:
    placed = place_scans(room_scans(), trajectory(), MOUNT)
    assert placed.valid.all()
    assert off_walls(placed.returned) < 1e-9
    # Beam 90 of scan 3 left 0.6 s + a quarter of a turn after the start.
    x, y, heading = poses_at(np.array(0.6 + 0.025))
    c, s = np.cos(heading), np.sin(heading)
    at = [x + c * MOUNT[0] - s * MOUNT[1], y + s * MOUNT[0] + c * MOUNT[1]]
    np.testing.assert_allclose(placed.origins[3, 90], at, atol=1e-12)


def test_without_straightening_they_would_not() -> None:
    # The robot turns 0.04 rad in a scan, which moves a wall 3 m away by up to 12 cm.
    placed = place_scans(replace(room_scans(), beam_period=0.0), trajectory(), MOUNT)
    assert off_walls(placed.returned) > 0.05


def test_beams_without_return_are_left_out() -> None:
    scans = room_scans()
    ranges = scans.ranges.copy()
    ranges[0, :4] = (0.0, 8.0, 9.0, 0.05)
    placed = place_scans(replace(scans, ranges=ranges, min_range=0.1), trajectory(), MOUNT)
    assert placed.valid[0, :4].tolist() == [False] * 4
    assert placed.valid.sum() == scans.ranges.size - 4
    assert off_walls(placed.returned) < 1e-9


def test_scans_outside_the_trajectory_are_counted() -> None:
    # The scan at 1.0 s begins when the trajectory ends; that at 0.8 s ends at 0.9 s.
    placed = place_scans(room_scans(20), trajectory(1.0), MOUNT)
    assert placed.scan.tolist() == [0, 1, 2, 3, 4]
    assert placed.left_out == 15


def test_calibrated_mounting_is_used() -> None:
    scans = replace(room_scans(), mount=(0.0, 0.0, 0.0))
    found = tuple(
        CalibrationEstimate(f"lidar_{axis}", 0.0, value, 0.01, 0.1)
        for axis, value in zip(("x", "y", "yaw"), MOUNT, strict=True)
    )
    placed = placed_scans(replace(result(), calibration=found), drive(scans))
    assert off_walls(all_points(placed)) < 1e-9
    assert off_walls(all_points(placed_scans(result(), drive(scans)))) > 0.05
    assert all_points([]).shape == (0, 2)


def test_thinning_keeps_the_first_of_each_neighbourhood() -> None:
    # 0.06 itself is not farther than 0.06; 0.121 is farther from the first, and kept.
    x = np.array([0.0, 0.06, 0.03, 0.121, 0.1, -0.059, -0.0601])
    assert thin(np.column_stack([x, np.zeros(7)]), 0.06)[:, 0].tolist() == [0.0, 0.121, -0.0601]


@pytest.mark.parametrize("spread", [0.3, 30.0])
def test_thinning_against_the_rule_itself(spread: float) -> None:
    points = np.random.default_rng(3).normal(scale=spread, size=(2000, 2))
    kept: list[np.ndarray] = []
    for p in points:
        if not kept or float(np.min(np.hypot(*(np.array(kept) - p).T))) > 0.06:
            kept.append(p)
    np.testing.assert_array_equal(thin(points), np.array(kept))


def test_thinning_of_many_points_is_certain() -> None:
    points = np.random.default_rng(4).uniform(-20.0, 20.0, (200_000, 2))
    kept = thin(points)
    tree = cKDTree(kept)
    assert tree.query(kept, k=2)[0][:, 1].min() > 0.06
    assert tree.query(points)[0].max() <= 0.06
    assert thin(np.zeros((0, 2))).shape == (0, 2)


def test_thinning_refuses_what_it_cannot_number() -> None:
    for bad in (np.nan, np.inf, 1e9):
        with pytest.raises(FglocError, match="not finite, or too far"):
            thin(np.array([[0.0, bad]]))
    with pytest.raises(FglocError, match="must be positive"):
        thin(np.zeros((1, 2)), 0.0)
