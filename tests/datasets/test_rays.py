"""Rays against walls and round obstacles, with distances worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fgloc.core.measurements import Floats
from fgloc.datasets.simulator.rays import cast, cut_by_discs

ROOM = np.array(
    [[0.0, 0.0, 6.0, 0.0], [6.0, 0.0, 6.0, 5.0], [6.0, 5.0, 0.0, 5.0], [0.0, 5.0, 0.0, 0.0]]
)


def rays(x: float, y: float, *degrees: float) -> tuple[Floats, Floats]:
    """Return origins and directions of rays from one place."""
    return np.tile([x, y], (len(degrees), 1)), np.radians(degrees)


def test_a_room() -> None:
    # From (2, 1): 4 m to the east, 4 north, 2 west, 1 south; at 45° the north wall comes at y = 5,
    # x = 6, in the corner: 4·√2; at -45° the south wall after 1·√2; at 135° x = 0 after 2·√2.
    # At 30° the east wall: 4 / cos 30°.
    directions = (0, 90, 180, 270, 45, -45, 135, 30)
    found = cast(*rays(2, 1, *directions), 8, ROOM, 100.0)
    root = math.sqrt(2)
    expected = [4, 4, 2, 1, 4 * root, root, 2 * root, 4 / math.cos(math.radians(30))]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_the_nearest_wall_counts_and_what_is_behind_does_not() -> None:
    walls = np.array([[3.0, -1.0, 3.0, 1.0], [2.0, -1.0, 2.0, 1.0], [-1.0, -1.0, -1.0, 1.0]])
    # Straight on 2 m; backwards 1 m; past the ends of both, at 40°, tan 40°·2 > 1: nothing.
    found = cast(*rays(0, 0, 0, 180, 40), 3, walls, 10.0)
    np.testing.assert_allclose(found, [2, 1, math.inf])


def test_an_oblique_wall() -> None:
    # x + y = 4 seen along x from (1, 1) is at (3, 1), along the diagonal at (2, 2).
    wall = np.array([[4.0, 0.0, 0.0, 4.0]])
    found = cast(*rays(1, 1, 0, 45, -135), 3, wall, 10.0)
    np.testing.assert_allclose(found, [2, math.sqrt(2), math.inf])


def test_nothing_beyond_the_limit() -> None:
    found = cast(*rays(2, 1, 0, 90), 2, ROOM, 3.999)
    assert np.isinf(found).all()
    np.testing.assert_allclose(cast(*rays(2, 1, 0, 90), 2, ROOM, 4.0), [4, 4])


def test_walls_are_not_left_out_for_rays_that_moved_on() -> None:
    # Both rays are of one scan; only from the second origin is the wall within reach.
    origins = np.array([[0.0, 0.0], [5.0, 0.0]])
    found = cast(origins, np.zeros(2), 2, np.array([[9.0, -1.0, 9.0, 1.0]]), 5.0)
    np.testing.assert_allclose(found, [math.inf, 4])


def test_it_agrees_with_a_plain_solution_of_every_pair() -> None:
    rng = np.random.default_rng(3)
    walls = rng.uniform(-5, 5, (30, 4))
    origins, directions = rng.uniform(-3, 3, (200, 2)), rng.uniform(-4, 4, 200)
    found = cast(origins, directions, 50, walls, 6.0)
    for k in range(200):
        best = math.inf
        along = np.array([math.cos(directions[k]), math.sin(directions[k])])
        for w in walls:
            # o + t·r = p + u·d as two equations in t and u.
            matrix = np.stack([along, w[:2] - w[2:]], axis=1)
            t, u = np.linalg.solve(matrix, w[:2] - origins[k])
            if t > 0 and 0 <= u <= 1 and t <= 6:
                best = min(best, t)
        assert found[k] == pytest.approx(best, rel=1e-9)


def test_discs() -> None:
    # A disc of 0.5 m at (3, 0): 2.5 m straight on; its edge at asin(0.5 / 3) = 9.59°.
    origins, directions = rays(0, 0, 0, 9.5, 9.7, 180, 90)
    ranges = np.array([10.0, 10.0, 10.0, 10.0, 1.0])
    cut_by_discs(origins, directions, np.tile([3.0, 0.0], (5, 1)), 0.5, ranges)
    a = math.radians(9.5)
    edge = 3 * math.cos(a) - math.sqrt(0.25 - (3 * math.sin(a)) ** 2)
    np.testing.assert_allclose(ranges, [2.5, edge, 10, 10, 1])


def test_a_disc_behind_a_wall_or_round_the_lidar_is_not_seen() -> None:
    origins, directions = rays(0, 0, 0, 0)
    ranges = np.array([2.0, np.inf])
    cut_by_discs(origins, directions, np.array([[3.0, 0.0], [0.3, 0.0]]), 0.5, ranges)
    assert ranges.tolist() == [2.0, math.inf]
