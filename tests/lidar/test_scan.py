"""Beams as points: which are valid, and how the motion of a turn is undone."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from fgloc.core import geometry
from fgloc.core.measurements import Scans
from fgloc.errors import FglocError
from fgloc.lidar.scan import Cloud, cloud


def scans(*ranges: float, **others: float) -> Scans:
    """Return one scan of beams at 0°, 90°, 180°, …"""
    values = np.array([ranges], dtype=np.float64)
    stamps = np.zeros(1, np.int64)
    return replace(Scans("lidar", stamps, values, 0.0, math.pi / 2), **others)


def test_points_by_hand() -> None:
    # 1 m ahead, 2 m to the left, 3 m behind, 4 m to the right.
    found = cloud(scans(1.0, 2.0, 3.0, 4.0))
    np.testing.assert_allclose(found.points[0], [[1, 0], [0, 2], [-3, 0], [0, -4]], atol=1e-15)
    assert found.valid.all()


def test_limits_are_those_of_the_sensor() -> None:
    found = cloud(scans(0.0, 0.15, 0.14, 7.99, 8.0, 9.0, min_range=0.15, max_range=8.0))
    assert found.valid[0].tolist() == [False, True, False, True, False, False]
    assert found.ranges[0].tolist() == [0.0, 0.15, 0.0, 7.99, 0.0, 0.0]
    assert not found.points[0, ~found.valid[0]].any()


def test_a_turn_on_the_way_by_hand() -> None:
    # Four beams while the lidar drives 0.4 m ahead: the third is sent 0.2 m farther on.
    straight = cloud(scans(1.0, 1.0, 1.0, 1.0), np.array([[0.4, 0.0, 0.0]]))
    np.testing.assert_allclose(
        straight.points[0], [[1, 0], [0.1, 1], [-0.8, 0], [0.3, -1]], atol=1e-15
    )
    # While it turns by 90° on the spot, the second (of 4) is sent 22.5° later.
    turned = cloud(scans(1.0, 1.0, 1.0, 1.0), np.array([[0.0, 0.0, math.pi / 2]]))
    angle = math.pi / 2 + math.pi / 8
    np.testing.assert_allclose(turned.points[0, 1], [math.cos(angle), math.sin(angle)], atol=1e-15)


def test_any_motion_is_that_of_the_group() -> None:
    rng = np.random.default_rng(3)
    ranges, motion = rng.uniform(0.5, 5.0, (7, 50)), rng.normal(0.0, 0.3, (7, 3))
    given = Scans("lidar", np.arange(7, dtype=np.int64), ranges, 0.3, -0.07)
    found = cloud(given, motion).points
    angles = 0.3 - 0.07 * np.arange(50)
    for b in (0, 1, 25, 49):
        beam = np.stack(
            [ranges[:, b] * np.cos(angles[b]), ranges[:, b] * np.sin(angles[b]), np.zeros(7)],
            axis=1,
        )
        expected = geometry.compose(geometry.exp(motion * b / 50), beam)[:, :2]
        np.testing.assert_allclose(found[:, b], expected, atol=1e-12)


def test_bad_motion_and_shapes_are_refused() -> None:
    with pytest.raises(FglocError, match=r"motion must have shape \(1, 3\)"):
        cloud(scans(1.0, 2.0), np.zeros((2, 3)))
    with pytest.raises(FglocError, match="not finite"):
        cloud(scans(1.0, 2.0), np.array([[0.0, math.nan, 0.0]]))
    with pytest.raises(FglocError, match="points and valid"):
        Cloud(np.zeros((1, 3, 2)), np.zeros((1, 2)), np.zeros((1, 2), np.bool_))


def test_no_scans() -> None:
    none = Scans("lidar", np.zeros(0, np.int64), np.zeros((0, 5)), 0.0, 0.1)
    assert cloud(none, np.zeros((0, 3))).points.shape == (0, 5, 2)
