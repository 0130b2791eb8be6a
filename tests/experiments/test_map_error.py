"""Errors of walls and of associations against answers worked by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fgloc.core.geometry import Floats
from fgloc.experiments.map_error import (
    judge_associations,
    line_of_each,
    true_wall_of_each,
    wall_errors,
)
from fgloc.lidar.segments import Segments
from fgloc.lidar.walls import Walls

# A room of 4 m by 3 m; its left side has a door from y = 1 to y = 2.
ROOM = np.array(
    [
        [0.0, 0.0, 4.0, 0.0],
        [4.0, 0.0, 4.0, 3.0],
        [4.0, 3.0, 0.0, 3.0],
        [0.0, 3.0, 0.0, 2.0],
        [0.0, 1.0, 0.0, 0.0],
    ]
)


def walls(normal: list[float], anchor: list[list[float]], reach: list[list[float]]) -> Walls:
    n = len(normal)
    return Walls(
        np.array(normal),
        np.zeros(n),
        np.array(anchor),
        np.array(reach),
        np.full((n, 2, 2), np.nan),
        np.ones(n, dtype=np.int64),
    )


def test_what_is_left_and_right_of_a_door_is_one_line() -> None:
    lines = line_of_each(ROOM)
    assert lines[3] == lines[4]
    assert np.unique(lines).size == 4


def test_the_errors_of_a_turned_wall_are_those_of_its_line() -> None:
    # The lower wall, seen from 1 m to 3 m, 1 cm too high at x = 2 and turned by 1°: at x = 1 and 3
    # it is 0.01 ∓ tan 1° = -0.0075 and 0.0275 m from the true one.
    turn = math.radians(1.0)
    # The normal points up (into the room), so that the tangent points to -x.
    found = walls([math.pi / 2 + turn], [[2.0, 0.01]], [[-1.0, 1.0]])
    errors = wall_errors(found, ROOM)
    assert errors.truth.tolist() == [0]
    assert errors.direction_rad[0] == pytest.approx(turn, abs=1e-12)
    overlap = 2.0 * math.cos(turn)
    # The seen part's ends lie at x = 2 ± cos 1°.
    assert errors.overlap_m[0] == pytest.approx(overlap, abs=1e-12)
    assert errors.middle_m[0] == pytest.approx(0.01, abs=1e-12)
    assert errors.end_m[0] == pytest.approx(0.01 + math.sin(turn), abs=1e-12)
    assert errors.beyond_m[0] == 0.0


def test_a_wall_over_the_door_and_beyond_the_corner() -> None:
    # x = 0 seen from y = -0.3 to y = 2.5: 0.3 m beyond the corner; the door does not count.
    errors = wall_errors(walls([0.0], [[0.0, 0.0]], [[-0.3, 2.5]]), ROOM)
    assert errors.truth.tolist() == [4]
    assert errors.beyond_m[0] == pytest.approx(0.3)
    assert errors.end_m[0] == 0.0
    # One that ends in the middle of the door is half a metre from any wall.
    errors = wall_errors(walls([0.0], [[0.0, 0.0]], [[0.2, 1.5]]), ROOM)
    assert errors.beyond_m[0] == pytest.approx(0.5)


def test_of_two_sides_of_a_thin_wall_the_nearer_one_counts() -> None:
    sides = np.array([[0.0, 0.0, 4.0, 0.0], [0.0, 0.1, 4.2, 0.1]])
    low, high = 0.03, 0.08
    found = walls([math.pi / 2] * 2, [[2.0, low], [2.0, high]], [[-2.1, 2.0]] * 2)
    errors = wall_errors(found, sides)
    assert errors.truth.tolist() == [0, 1]
    np.testing.assert_allclose(errors.middle_m, [0.03, 0.02], atol=1e-12)


def test_a_wall_that_is_none_has_no_errors() -> None:
    # In the middle of the room; on a wall but across it; on no part of its line.
    found = walls(
        [math.pi / 2, 0.0, math.pi / 2],
        [[2.0, 1.5], [2.0, 0.0], [7.0, 0.0]],
        [[-1.0, 1.0], [-0.2, 0.2], [-1.0, 1.0]],
    )
    errors = wall_errors(found, ROOM)
    assert errors.truth.tolist() == [-1, -1, -1]
    assert np.isnan(errors.middle_m).all()


def pieces(ends: Floats, scan: list[int]) -> Segments:
    """Return segments with these ends (M, 2, 2) in the lidar's axes, right one first."""
    middle = ends.mean(axis=1)
    along = ends[:, 1] - ends[:, 0]
    half = 0.5 * np.hypot(along[:, 0], along[:, 1])
    m = len(ends)
    return Segments(
        np.array(scan),
        np.arctan2(along[:, 1], along[:, 0]) - math.pi / 2,
        middle,
        np.stack([-half, half], axis=1),
        np.zeros((m, 2, 2)),
        np.full(m, 20),
    )


def test_pieces_belong_to_the_true_wall_that_they_lie_on() -> None:
    # The lidar at (2, 1), turned by 90°: its x axis is the map's y axis, its y axis the map's -x.
    lidar = np.array([[0.0, 0.0, 0.0], [2.0, 1.0, math.pi / 2]])
    # In the map: (3, 0)-(1, 0) on the lower wall; (4, 1)-(4, 2) on the right one; a piece in the
    # middle of the room; one on the door of the left side; one 0.1 m off the right side.
    in_map = np.array(
        [
            [[3.0, 0.0], [1.0, 0.0]],
            [[4.0, 1.0], [4.0, 2.0]],
            [[2.5, 1.5], [1.5, 1.5]],
            [[0.0, 1.2], [0.0, 1.8]],
            [[4.1, 1.0], [4.1, 2.0]],
        ]
    )
    d = in_map - lidar[1, :2]
    own = np.stack([d[..., 1], -d[..., 0]], axis=-1)
    found = true_wall_of_each(pieces(own, [1] * 5), lidar, ROOM)
    assert found.tolist() == [0, 1, -1, -1, 1]


def test_wrong_associations_are_those_of_another_line_than_most() -> None:
    # Wall 0 of the map: three pieces left of the door, one right of it, one of the lower wall.
    # Wall 1: one piece of no true wall. The last piece is given to no wall.
    wall = np.array([0, 0, 0, 0, 0, 1, -1])
    true_wall = np.array([3, 3, 3, 4, 0, -1, 1])
    found = judge_associations(wall, true_wall, ROOM)
    assert (found.used, found.wrong, found.spurious) == (6, 1, 1)
    none = judge_associations(np.full(2, -1), np.array([0, 1]), ROOM)
    assert (none.used, none.wrong, none.spurious) == (0, 0, 0)
