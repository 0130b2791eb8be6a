"""Normals of scan points, and what is kept of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from fgloc.core.measurements import Floats, Scans
from fgloc.errors import FglocError
from fgloc.lidar.surfaces import ScanPoints, merge, surfaces, thin


def test_normals_of_a_wall_point_to_the_lidar_and_are_as_good_as_stated(
    look: Callable[..., list[ScanPoints]],
) -> None:
    """A wall 2 m to the left: its normal points to -y; errors have the size of `tilt`."""
    walls = np.array([[-30.0, 2.0, 30.0, 2.0]])
    scans = look(walls, np.zeros((40, 3)), 1)
    z = []
    for scan in scans:
        known = scan.tilt > 0.0
        assert known.mean() > 0.9
        angle = np.arctan2(scan.normals[known, 0], -scan.normals[known, 1])
        z.append(angle / np.sqrt(scan.tilt[known]))
    rms = np.sqrt(np.mean(np.concatenate(z) ** 2))
    # `tilt` also allows for 1 cm of unevenness, which this wall has not.
    assert 0.3 < rms < 1.1


def test_variance_counts_neighbours_in(look: Callable[..., list[ScanPoints]]) -> None:
    """A close wall has many beams in a patch, and each of them counts for less."""
    near = look(np.array([[-3.0, 0.5, 3.0, 0.5]]), np.zeros((1, 3)), 1, 0.0)[0]
    far = look(np.array([[-3.0, 4.0, 3.0, 4.0]]), np.zeros((1, 3)), 1, 0.0)[0]
    assert np.median(near.variance) > 5.0 * np.median(far.variance)


def _scans(ranges: Floats) -> Scans:
    count = len(ranges)
    return Scans("lidar", np.arange(count, dtype=np.int64), ranges, 0.0, 0.1)


def test_scans_of_nothing_give_no_points() -> None:
    """No return, NaN, a single return: no points, no exception."""
    points = np.zeros((3, 5, 2))
    valid = np.zeros((3, 5), bool)
    points[1] = np.nan
    valid[1] = True
    points[2, 2] = (1.0, 0.0)
    valid[2, 2] = True
    found = surfaces(points, valid, _scans(np.zeros((3, 5))))
    assert [scan.size for scan in found] == [0, 0, 0]
    assert merge(found, np.zeros((3, 3)), 0.1).size == 0
    assert merge([], np.zeros((0, 3)), 0.1).size == 0


def test_shapes_are_checked() -> None:
    """Points must fit the scans."""
    with pytest.raises(FglocError, match="one row a scan"):
        surfaces(np.zeros((2, 4, 2)), np.zeros((2, 5), bool), _scans(np.zeros((2, 5))))


def test_moved_turns_points_and_normals() -> None:
    """By hand: (1, 0) with normal (-1, 0), seen from a pose at (2, 3) turned by 90°."""
    scan = ScanPoints(np.array([[1.0, 0.0]]), np.array([[-1.0, 0.0]]), np.ones(1), np.ones(1))
    moved = scan.moved(np.array([2.0, 3.0, np.pi / 2.0]))
    np.testing.assert_allclose(moved.points, [[2.0, 4.0]], atol=1e-12)
    np.testing.assert_allclose(moved.normals, [[0.0, -1.0]], atol=1e-12)


def test_thin_keeps_the_best_of_a_cell_and_both_sides_of_a_wall() -> None:
    """Four points in one cell: two of one side, one of the other, one of unknown side."""
    points = np.full((4, 2), 0.02) + np.arange(4)[:, None] * 0.001
    normals = np.array([[1.0, 0.1], [1.0, 0.1], [-1.0, 0.1], [0.0, 0.0]])
    scan = ScanPoints(points, normals, np.array([2.0, 1.0, 5.0, 0.0]), np.arange(4.0))
    kept = thin(scan, 0.1)
    assert sorted(kept.variance.tolist()) == [1.0, 2.0, 3.0]
    assert thin(kept, 0.1).size == 3
