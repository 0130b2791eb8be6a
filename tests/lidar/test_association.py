"""Which segments are the same wall: answers worked by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgloc.core.geometry import Floats, compose
from fgloc.lidar.association import (
    GATE,
    Slack,
    associate,
    duplicates,
    lidar_poses,
    single_noise,
)
from fgloc.lidar.segments import Segments
from fgloc.lidar.walls import Walls

SLACK = Slack(0.03, 0.005)
SIGMA = (np.radians(0.5), 0.01)
"""Standard deviations of one segment: direction [rad], offset [m]."""
UP, DOWN, LEFT, RIGHT = np.pi / 2, -np.pi / 2, np.pi, 0.0
"""Where the normal of a wall points."""


def seen(rows: list[tuple[int, float, float, float, float]], poses: Floats) -> Segments:
    """Return segments of (scan, normal, middle x, middle y, length), all but the scan in map axes.

    They are turned into the axes of the lidar, which is at `poses` (N, 3).
    """
    table = np.array(rows, dtype=np.float64).reshape(-1, 5)
    scan = table[:, 0].astype(np.int64)
    x, y, theta = poses[scan].T
    dx, dy = table[:, 2] - x, table[:, 3] - y
    c, s = np.cos(theta), np.sin(theta)
    half = 0.5 * table[:, 4]
    return Segments(
        scan,
        table[:, 1] - theta,
        np.stack([c * dx + s * dy, -s * dx + c * dy], axis=1),
        np.stack([-half, half], axis=1),
        np.tile(np.diag(np.square(SIGMA)), (scan.size, 1, 1)),
        np.full(scan.size, 30),
    )


def walls(
    rows: list[tuple[float, float, float, float, float]],
    sightings: list[int] | None = None,
    sigma: tuple[float, float] = (1e-3, 1e-3),
) -> Walls:
    """Return walls of (normal, anchor x, anchor y, right end, left end), each on its anchor."""
    table = np.array(rows, dtype=np.float64).reshape(-1, 5)
    n = len(table)
    return Walls(
        table[:, 0].copy(),
        np.zeros(n),
        table[:, 1:3].copy(),
        table[:, 3:].copy(),
        np.tile(np.diag(np.square(sigma)), (n, 1, 1)),
        np.array([5] * n if sightings is None else sightings, dtype=np.int64),
    )


# A room from (0, 0) to (4, 3): each wall's normal points into the room.
ROOM = [(UP, 2.0, 0.0, 3.0), (LEFT, 4.0, 1.5, 2.0), (DOWN, 2.0, 3.0, 3.0), (RIGHT, 0.0, 1.5, 2.0)]
TWO = np.array([[1.0, 1.0, 0.3], [3.0, 2.0, -2.5]])


def test_two_scans_of_a_room_show_the_same_four_walls() -> None:
    rows = [(0, *w) for w in ROOM] + [(1, *ROOM[k]) for k in (2, 0, 3, 1)]
    found, wall = associate(seen(rows, TWO), TWO, SLACK)
    # In the order in which they were seen first.
    assert wall.tolist() == [0, 1, 2, 3, 2, 0, 3, 1]
    assert found.sightings.tolist() == [2, 2, 2, 2]
    np.testing.assert_allclose(np.cos(found.normal - [UP, LEFT, DOWN, RIGHT]), 1.0, atol=1e-12)
    np.testing.assert_allclose(found.offset, 0.0, atol=1e-12)
    np.testing.assert_allclose(found.anchor, [[2, 0], [4, 1.5], [2, 3], [0, 1.5]], atol=1e-12)
    # Exact sightings: reach is that of the single ones.
    np.testing.assert_allclose(found.reach[:, 1], [1.5, 1.0, 1.5, 1.0], atol=1e-9)
    np.testing.assert_allclose(found.reach[:, 0], [-1.5, -1.0, -1.5, -1.0], atol=1e-9)


def test_the_two_faces_of_a_thin_wall_stay_two() -> None:
    # A wall of 1 cm along y = 0, seen from below and from above: nearer than any noise, but the
    # normals are opposite.
    poses = np.array([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
    rows = [(0, DOWN, 0.0, -0.005, 2.0), (1, UP, 0.0, 0.005, 2.0)]
    found, wall = associate(seen(rows, poses), poses, SLACK)
    assert wall.tolist() == [0, 1]
    same = duplicates(found, SLACK, np.full((2, 2), 1.0))
    assert same.tolist() == [0, 1]


@pytest.mark.parametrize(("gap", "expected"), [(0.95, [0, 0]), (1.05, [0, 1])])
def test_a_wall_is_interrupted_by_so_much_at_most(gap: float, expected: list[int]) -> None:
    # Two pieces of 1 m along y = 0: middles at 0 and at 1 + gap, ends `gap` apart; 1 m may be.
    poses = np.array([[0.0, 2.0, 1.0]])
    rows = [(0, UP, 0.0, 0.0, 1.0), (0, UP, 1.0 + gap, 0.0, 1.0)]
    found, wall = associate(seen(rows, poses), poses, Slack(0.03, 0.005, gap_m=1.0))
    assert wall.tolist() == expected
    if expected[1] == 0:
        # The tangent is the normal turned by +90°, -x here: the second piece is to the right.
        np.testing.assert_allclose(found.reach[0], [-(1.5 + gap), 0.5], atol=1e-9)


def test_how_far_off_a_sighting_may_be() -> None:
    # Both sightings from right before the middle at 1 m: the variance of the offset between the
    # first one, as it is remembered, and the second one is twice that of a sighting and of the
    # pose, and what 1 m of lever makes of the heading, once: 2 (0.01² + 0.03²) + 0.005².
    limit = np.sqrt(GATE * (2 * (0.01**2 + 0.03**2) + 0.005**2))
    poses = np.array([[0.0, 1.0, 0.7]])
    for off, expected in ((0.99 * limit, [0, 0]), (1.01 * limit, [0, 1])):
        rows = [(0, UP, 0.0, 0.0, 1.0), (0, UP, 0.0, -off, 1.0)]
        assert associate(seen(rows, poses), poses, SLACK)[1].tolist() == expected, off


def test_a_segment_goes_to_the_nearer_of_two_walls() -> None:
    poses = np.array([[0.0, 2.0, 0.0]])
    known = walls([(UP, 0.0, 0.0, -1.0, 1.0), (UP, 0.0, 0.06, -1.0, 1.0)])
    rows = [(0, UP, 0.2, y, 1.0) for y in (0.02, 0.04, 0.01)]
    found, wall = associate(seen(rows, poses), poses, SLACK, known)
    assert wall.tolist() == [0, 1, 0]
    assert found.sightings.tolist() == [2, 1]


def test_known_walls_keep_their_numbers_and_their_places() -> None:
    known = walls([(RIGHT, 0.0, 1.5, -1.0, 1.0), (UP, 2.0, 0.0, -0.5, 0.5)])
    rows = [(0, *ROOM[0]), (0, *ROOM[1]), (0, *ROOM[2])]
    found, wall = associate(seen(rows, TWO), TWO, SLACK, known)
    # The lower wall is known as 1, the others are new; the left one was not seen.
    assert wall.tolist() == [1, 2, 3]
    assert found.sightings.tolist() == [0, 1, 1, 1]
    # Where walls are known, the graph refines them and not the association; only reach grows.
    np.testing.assert_array_equal(found.normal[:2], known.normal)
    np.testing.assert_array_equal(found.offset[:2], known.offset)
    np.testing.assert_array_equal(found.anchor[:2], known.anchor)
    np.testing.assert_allclose(found.reach[:2], [[-1.0, 1.0], [-1.5, 1.5]], atol=1e-9)
    # What was handed in is as it was.
    np.testing.assert_array_equal(known.reach[1], [-0.5, 0.5])


def test_walls_without_covariance_are_taken_as_certain() -> None:
    known = walls([(UP, 2.0, 0.0, -1.5, 1.5)], sigma=(np.nan, np.nan))
    # 0.01² + 0.03² + 0.005² (1 m of lever below the lidar): the limit of a certain wall.
    limit = np.sqrt(GATE * (0.01**2 + 0.03**2 + 0.005**2))
    poses = np.array([[2.0, 1.0, 0.0]])
    for off, expected in ((0.98 * limit, 0), (1.02 * limit, 1)):
        rows = [(0, UP, 2.0, off, 1.0)]
        # The lever is shorter by the offset; that is within 2 %.
        assert associate(seen(rows, poses), poses, SLACK, known)[1].tolist() == [expected]


@pytest.mark.parametrize("normal", [0.0, 0.4, np.pi - 1e-3, -2.0])
def test_a_wall_through_the_origin_is_one_like_others(normal: float) -> None:
    # The direction of a wall's foot from the origin has no meaning there: an anchor has.
    n, t = np.array([np.cos(normal), np.sin(normal)]), np.array([-np.sin(normal), np.cos(normal)])
    poses = np.array([[*(n + 0.3 * t), 0.2], [*(1.5 * n - 0.3 * t), -3.0]])
    rows = [(0, normal, *(0.2 * t), 2.0), (1, normal + 2 * np.pi, *(-0.1 * t), 2.0)]
    found, wall = associate(seen(rows, poses), poses, SLACK)
    assert wall.tolist() == [0, 0]
    assert found.offset[0] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(np.sort(found.ends[0] @ t), [-1.1, 1.2], atol=1e-9)


def test_a_wall_far_from_the_origin_is_refined_where_it_is() -> None:
    # At (1000, 1000) a turn of 1e-3 about the origin would be a metre.
    rng = np.random.default_rng(3)
    poses = np.tile([1000.0, 1001.0, 0.5], (40, 1))
    rows = [
        (k, UP + 3e-3 * e, 1000.0, 1000.0 + 0.01 * f, 2.0)
        for k, (e, f) in enumerate(rng.standard_normal((40, 2)))
    ]
    found, wall = associate(seen(rows, poses), poses, SLACK)
    assert wall.tolist() == [0] * 40
    foot = found.anchor[0] + found.offset[0] * np.array(
        [np.cos(found.normal[0]), np.sin(found.normal[0])]
    )
    # The mean of 40: 0.01/√40 = 1.6 mm and 3e-3/√40 = 0.5 mrad, within four of these; no more
    # than a tenth of a pose's error is believed.
    assert foot[1] - 1000.0 == pytest.approx(0.0, abs=4 * 0.0016 + 0.003)
    assert found.normal[0] == pytest.approx(UP, abs=4 * 5e-4 + 5e-4)
    assert found.covariance[0, 1, 1] >= (0.1 * SLACK.position_m) ** 2
    assert found.covariance[0, 0, 0] >= (0.1 * SLACK.heading) ** 2


def test_nothing_seen_is_no_wall() -> None:
    found, wall = associate(seen([], TWO), TWO, SLACK)
    assert found.normal.size == wall.size == 0
    assert duplicates(found, SLACK, np.zeros((0, 2))).size == 0
    assert single_noise(seen([], TWO), wall, 0).shape == (0, 2)
    known = walls([(UP, 2.0, 0.0, -1.5, 1.5)])
    found, wall = associate(seen([], TWO), TWO, SLACK, known)
    assert (found.normal.size, wall.size) == (1, 0)
    assert found.sightings.tolist() == [0]


def test_duplicates_are_joined_into_the_one_seen_more_often() -> None:
    # 0 and 1 are one line with 0.5 m between, 2 is 0.5 m behind, 3 at a right angle, 4 the line
    # of 0 and 1 but 3 m further on.
    found = walls(
        [
            (UP, 0.0, 0.0, -1.0, 1.0),
            (UP, 2.5, 0.001, -1.0, 1.0),
            (UP, 0.0, -0.5, -1.0, 1.0),
            (RIGHT, 0.0, 0.0, -1.0, 1.0),
            (UP, 8.0, 0.0, -1.0, 1.0),
        ],
        sightings=[5, 9, 7, 7, 7],
    )
    assert duplicates(found, SLACK, np.zeros((5, 2))).tolist() == [1, 1, 2, 3, 4]


def test_a_wall_that_half_covers_another_may_be_further_off() -> None:
    # 0.2 m apart, walls known to 1 mm and poses to 3 cm: (0.2)² / (0.03² + 2e-6) = 44 > 11.8, so
    # they are two, unless one sighting alone may err by 0.1 m: 0.04 / 0.0109 = 3.7. That counts
    # where more than half of the shorter one covers the other.
    noise = np.tile([1e-4, 0.1**2], (2, 1))
    for shift, expected in ((0.9, [0, 0]), (1.1, [0, 1])):
        found = walls([(UP, 0.0, 0.0, -1.0, 1.0), (UP, shift, 0.2, -1.0, 1.0)])
        assert duplicates(found, SLACK, noise).tolist() == expected, shift
        assert duplicates(found, SLACK, np.zeros((2, 2))).tolist() == [0, 1]


def test_of_a_row_of_like_walls_each_joins_one_that_stays() -> None:
    # Neighbours are 0.09 m apart, 0.0081 / (0.03² + 2e-6) = 9 < 11.8; the outer ones 0.18 m.
    found = walls([(UP, 0.0, 0.09 * k, -1.0, 1.0) for k in range(3)], sightings=[9, 3, 4])
    same = duplicates(found, SLACK, np.zeros((3, 2)))
    # The middle one joins one of the others: what joined does not take a third one along.
    assert same[[0, 2]].tolist() == [0, 2]
    assert same[1] in (0, 2)
    # Seen most often, it is what both of them join.
    more = replace(found, sightings=np.array([3, 9, 4]))
    assert duplicates(more, SLACK, np.zeros((3, 2))).tolist() == [1, 1, 1]


def test_mean_noise_of_the_sightings_of_each_wall() -> None:
    segments = seen([(0, *ROOM[0]), (0, *ROOM[1]), (1, *ROOM[0])], TWO)
    segments.covariance[2] = np.diag([4.0, 9.0])
    wall = np.array([1, -1, 1])
    mean = single_noise(segments, wall, 3)
    np.testing.assert_allclose(mean[0], 0.0)
    np.testing.assert_allclose(mean[1], [(SIGMA[0] ** 2 + 4) / 2, (SIGMA[1] ** 2 + 9) / 2])
    np.testing.assert_allclose(mean[2], 0.0)


def test_poses_of_a_lidar_that_is_mounted_askew() -> None:
    # 0.2 m ahead of a robot that looks along +y, turned right by 90°: looks along +x.
    poses = np.array([[1.0, 2.0, np.pi / 2]])
    np.testing.assert_allclose(
        lidar_poses(poses, (0.2, 0.0, -np.pi / 2)), [[1.0, 2.2, 0.0]], atol=1e-12
    )
    np.testing.assert_allclose(lidar_poses(poses, (0.0, 0.0, 0.0)), compose(poses, np.zeros(3)))
