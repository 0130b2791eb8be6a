"""Which parts of a wall were seen, and that segments of a real estimate lie on their walls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgloc.lidar.walls import Walls
from fgloc.report.map_points import placed_scans
from fgloc.report.map_segments import PlacedSegments, place_segments, seen_lines, seen_parts
from fgloc.smoothing.batch import BatchSmoother
from tests.report.mapped import drive, room_scans, room_walls


def on_north(*parts: tuple[float, float]) -> PlacedSegments:
    """Pieces of the room's wall y = 3 (wall 1), from x to x, a centimetre off it."""
    ends = np.array([[[a, 3.01], [b, 3.01]] for a, b in parts])
    n = len(parts)
    return PlacedSegments(np.zeros(n, np.int64), ends, np.ones(n, np.int64))


def test_parts_of_a_wall_with_a_door() -> None:
    # Seen from inside, the right end of y = 3 is at x = -3 and its tangent runs along x.
    seen = seen_parts(room_walls(), on_north((-2.0, -1.0), (-3.0, -1.5), (0.0, 3.0), (1.0, 2.0)))
    np.testing.assert_allclose(seen[1], [[-3.0, -1.0], [0.0, 3.0]], atol=1e-12)
    assert [p.shape for p in seen] == [(0, 2), (2, 2), (0, 2), (0, 2)]
    # 0.3 m apart is no door, and the order of the ends does not matter.
    joined = seen_parts(room_walls(), on_north((-1.0, -2.0), (-0.75, 2.0)))
    np.testing.assert_allclose(joined[1], [[-2.0, 2.0]], atol=1e-12)


def test_lines_lie_on_the_wall() -> None:
    lines = seen_lines(room_walls(), on_north((-2.0, -1.0), (0.0, 3.0)))
    # Wall 0, of which no segment tells, is there from end to end.
    np.testing.assert_allclose(lines[0], [[3.0, 3.0], [3.0, -3.0]], atol=1e-12)
    np.testing.assert_allclose(lines[1], [[-2.0, 3.0], [-1.0, 3.0]], atol=1e-12)
    np.testing.assert_allclose(lines[2], [[0.0, 3.0], [3.0, 3.0]], atol=1e-12)
    # Measured from the foot of the anchor, wherever that is.
    moved = replace(room_walls(), anchor=room_walls().anchor + [[0.0, 0.0], [1.0, 0.0]] * 2)
    away: Walls = replace(moved, reach=moved.reach - [[0.0], [1.0], [0.0], [1.0]])
    again = seen_lines(away, on_north((-2.0, -1.0), (0.0, 3.0)))
    np.testing.assert_allclose(again[1:3], lines[1:3], atol=1e-12)


def test_segments_of_an_estimate_lie_on_their_walls() -> None:
    told = drive(room_scans())
    found = BatchSmoother().estimate(told)
    assert found.map is not None
    assert found.map.walls is not None
    segments = place_segments(found.map, placed_scans(found, told)[0])
    assert segments is not None
    own = segments.wall >= 0
    assert np.count_nonzero(own) > 20
    wall = segments.wall[own]
    walls = found.map.walls
    normal = np.stack([np.cos(walls.normal), np.sin(walls.normal)], axis=1)
    away = np.einsum("mkd,md->mk", segments.ends[own] - walls.anchor[wall][:, None], normal[wall])
    # The scans have no noise; the batch states what it has.
    assert np.abs(away - walls.offset[wall][:, None]).max() < 0.02
    assert len(np.unique(wall)) == 4
