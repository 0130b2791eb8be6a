"""Matching segments to walls, on cases that can be worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from fgloc.core.measurements import Floats, Stamps
from fgloc.online.duplicates import difference, first_pair
from fgloc.online.wall_matching import Candidates, Gates, match, possible
from fgloc.online.wall_pairs import DOUBTFUL, NEAR, NONE

GATES = Gates.of(0.999)
NOISE = np.diag([0.01**2, 0.01**2])


def walls(*lines: tuple[float, float, float, float, float]) -> Candidates:
    """Return walls given by normal [deg], anchor (2), reach (2); the offset is zero."""
    rows = np.array(lines)
    angles = np.radians(rows[:, 0])
    return Candidates(
        np.column_stack([angles, np.zeros(len(lines))]), rows[:, 1:3].copy(), rows[:, 3:5].copy()
    )


def segments(*seen: tuple[float, float, float]) -> tuple[Floats, Floats, Floats]:
    """Return rows, reaches and covariances of segments of 1 m: normal [deg] and middle (2)."""
    rows = np.zeros((len(seen), 8))
    rows[:, 0] = np.radians([s[0] for s in seen])
    rows[:, 1:3] = [s[1:] for s in seen]
    return rows, np.tile([-0.5, 0.5], (len(seen), 1)), np.tile(NOISE, (len(seen), 1, 1))


def joint(known: Candidates, pose: Floats, wall: float = 0.01) -> Floats:
    """Return a covariance: pose sigmas (3,), all walls' sigmas alike, nothing in common."""
    sigma = np.concatenate([pose, np.full(2 * known.lines.shape[0], wall)])
    return np.diag(sigma**2)


def find(known: Candidates, seen: tuple[Floats, Floats, Floats], p: Floats) -> Stamps:
    """Match segments seen from the origin, the lidar being there too."""
    chosen, _ = match(*seen, np.zeros(3), np.zeros(0), p, known, GATES)
    return chosen


# A corner: a wall 2 m ahead, whose normal looks back (180 deg), one 1 m to the left (-90 deg).
CORNER = walls((180.0, 2.0, 0.0, -2.0, 2.0), (-90.0, 0.0, 1.0, -2.0, 2.0))


def test_each_segment_finds_its_wall() -> None:
    """And one where no wall is finds none."""
    seen = segments((180.0, 2.01, 0.3), (-90.0, 0.5, 0.99), (90.0, 0.0, -3.0))
    chosen = find(CORNER, seen, joint(CORNER, np.array([0.05, 0.05, 0.02])))
    assert chosen.tolist() == [0, 1, NONE]


def test_the_far_side_of_a_wall_is_another_wall() -> None:
    """Half a turn of the normal, the line being the same."""
    chosen = find(CORNER, segments((0.0, 2.0, 0.0)), joint(CORNER, np.full(3, 0.05)))
    assert chosen.tolist() == [NONE]


def test_a_wall_ends_somewhere() -> None:
    """Two metres past its end there is no wall, half a metre past it there may be."""
    p = joint(CORNER, np.full(3, 0.01))
    assert find(CORNER, segments((180.0, 2.0, 3.0)), p).tolist() == [0]
    assert find(CORNER, segments((180.0, 2.0, 5.0)), p).tolist() == [NONE]


def test_near_a_wall_is_no_new_wall() -> None:
    """5 sigmas off: S = 0.01² (pose) + 0.01² (wall) + 0.01² (noise), so 0.09 m are 27/1."""
    p = joint(CORNER, np.array([0.01, 0.01, 0.001]))
    assert find(CORNER, segments((180.0, 2.09, 0.0)), p).tolist() == [NEAR]
    assert find(CORNER, segments((180.0, 2.5, 0.0)), p).tolist() == [NONE]


TWINS = walls((180.0, 2.0, 0.0, -2.0, 2.0), (180.0, 2.3, 0.0, -2.0, 2.0))


def test_two_walls_that_fit_alike_leave_doubt() -> None:
    """0.3 m apart, seen in between by a robot that knows its place to 0.2 m."""
    chosen = find(TWINS, segments((180.0, 2.15, 0.0)), joint(TWINS, np.array([0.2, 0.2, 0.01])))
    assert chosen.tolist() == [DOUBTFUL]


def test_another_wall_takes_the_doubt_away() -> None:
    """Both walls of the pair are seen: together they fit in one way only."""
    seen = segments((180.0, 2.12, 0.0), (180.0, 2.42, 1.0))
    chosen = find(TWINS, seen, joint(TWINS, np.array([0.2, 0.2, 0.01])))
    # Alone the first could be either (0.12 and 0.18 off); the second is in the gate of both too,
    # but as the first wall it would need 0.42 m, two sigmas, and leave none for the other.
    assert chosen.tolist() == [0, 1]


def test_correlated_walls_are_recognised_by_a_robot_that_drifted() -> None:
    """Pose and walls are off together by 1 m; beside each other they are known to centimetres."""
    p = joint(CORNER, np.array([0.01, 0.01, 0.001]))
    drift = np.zeros(p.shape[0])
    drift[0] = 1.0  # the pose along x …
    drift[4] = -1.0  # … and the offset of the wall ahead, whose normal is -x
    together = p + np.outer(drift, drift)
    shifted = Candidates(CORNER.lines.copy(), CORNER.anchors, CORNER.reach)
    seen = segments((180.0, 2.09, 0.0))
    assert find(shifted, seen, together).tolist() == [NEAR]
    # As if they had nothing in common the gate is wide: such a wall is worth fetching.
    apart = np.array([[1e-4, 0.0], [0.0, 1.0]])
    wide = possible(
        *seen, np.zeros(3), np.zeros(0), np.diag([1.0, 1e-4, 1e-6]), shifted,
        np.array([apart, apart]), GATES,
    )  # fmt: skip
    assert wide.tolist() == [True, False]


def test_a_lost_robot_wants_more_than_one_wall() -> None:
    """One wall fits many places; three that fit together are a place."""
    room = walls(
        (180.0, 2.0, 0.0, -2.0, 2.0), (-90.0, 0.0, 1.0, -2.0, 2.0), (90.0, 0.0, -2.0, -2.0, 2.0)
    )
    p = joint(room, np.array([1.0, 1.0, 0.1]))
    one, three = (
        segments((180.0, 2.4, 0.0)),
        segments((180.0, 2.4, 0.0), (-90.0, 0.0, 0.7), (90.0, 0.0, -2.3)),
    )
    lost = [
        match(*seen, np.zeros(3), np.zeros(0), p, room, GATES, lost=True)[0].tolist()
        for seen in (one, three)
    ]
    assert lost == [[DOUBTFUL], [0, 1, 2]]


def test_parts_of_one_wall_are_found_and_those_of_two_are_not() -> None:
    """Left and right of a door; and a wall 0.2 m behind the first."""
    parts = walls((180.0, 2.0, 0.0, -1.0, 1.0), (180.0, 2.003, 3.0, -1.0, 1.0))
    assert first_pair(parts, 1e-4 * np.eye(4)) == (0, 1)
    niche = walls((180.0, 2.0, 0.0, -1.0, 1.0), (180.0, 2.2, 3.0, -1.0, 1.0))
    assert first_pair(niche, 1e-4 * np.eye(4)) is None
    # Of walls that are hardly known nothing can be said.
    assert first_pair(parts, 0.1 * np.eye(4)) is None
    far = walls((180.0, 2.0, 0.0, -1.0, 1.0), (180.0, 2.0, 9.0, -1.0, 1.0))
    assert first_pair(far, 1e-4 * np.eye(4)) is None


@pytest.mark.parametrize("column", range(4))
def test_derivative_of_the_difference_of_two_walls(column: int) -> None:
    """Against central differences."""
    pair = Candidates(
        np.array([[0.3, 0.2], [0.4, -0.1]]), np.array([[1.0, 2.0], [0.5, 4.0]]), np.zeros((2, 2))
    )
    _, by = difference(pair, 0, 1)
    h, ends = 1e-6, []
    for sign in (1.0, -1.0):
        lines = pair.lines.copy()
        lines.ravel()[column] += sign * h
        ends.append(difference(Candidates(lines, pair.anchors, pair.reach), 0, 1)[0])
    np.testing.assert_allclose(by[:, column], (ends[0] - ends[1]) / (2.0 * h), atol=1e-8)
