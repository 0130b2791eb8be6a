"""The exhaustive search against the same sums done by numpy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fgloc.core.geometry import between
from fgloc.core.measurements import Floats
from fgloc.lidar.correlative import LAYERS, Field, field, search
from fgloc.lidar.surfaces import ScanPoints, thin

Look = Callable[..., list[ScanPoints]]


def _score(likelihood: Field, moving: ScanPoints, pose: Floats) -> float:
    """Return the mean likelihood of points at a pose, one by one."""
    moved = moving.moved(pose)
    total = 0.0
    for point, normal in zip(moved.points, moved.normals, strict=True):
        i, j = np.floor((point - likelihood.corner) / likelihood.cell).astype(int)
        layer = LAYERS
        if normal.any():
            at = np.arctan2(normal[1], normal[0]) / (2.0 * np.pi) * LAYERS
            layer = int(np.floor(at + 0.5)) % LAYERS
        shape = likelihood.grids.shape[2:]
        if 0 <= i < shape[0] and 0 <= j < shape[1]:
            total += float(likelihood.grids[0, layer, i, j]) / 255.0
    return total / moving.size


def test_finds_what_trying_every_pose_finds(look: Look, room: Floats) -> None:
    """Bounds leave out no better pose of the window, and the score is the one of its pose."""
    poses = np.array([[1.2, 1.0, 0.3], [1.9, 1.4, 0.6]])
    fixed, moving = look(room, poses, 1)
    moving = thin(moving, 0.4)
    likelihood = field(fixed)
    guess = between(poses[0], poses[1]) + np.array([0.2, -0.1, 0.05])
    half, turn = np.array([0.5, 0.5, 0.15]), 0.05
    pose, score = search(likelihood, moving, guess, half, turn)
    best = max(
        _score(likelihood, moving, guess + np.array([0.1 * i, 0.1 * j, 0.05 * k]))
        for i in range(-5, 6)
        for j in range(-5, 6)
        for k in range(-3, 4)
    )
    np.testing.assert_allclose(score, best, atol=1e-9)
    np.testing.assert_allclose(_score(likelihood, moving, pose), best, atol=1e-9)


def test_pools_hold_maxima(look: Look, room: Floats) -> None:
    """Level h at a cell: the largest value of 2^h by 2^h cells from there on."""
    (scan,) = look(room, np.array([[1.2, 1.0, 0.3]]), 1)
    grids = field(scan).grids
    rng = np.random.default_rng(1)
    for _ in range(200):
        h, layer = rng.integers(1, 4), rng.integers(0, LAYERS + 1)
        i, j = rng.integers(0, grids.shape[2]), rng.integers(0, grids.shape[3])
        block = grids[0, layer, i : i + 2**h, j : j + 2**h]
        assert grids[h, layer, i, j] == block.max()


def test_finds_a_pose_metres_and_many_degrees_off(look: Look, room: Floats) -> None:
    """The guess is 1.5 m and 30° wrong: one cell and one step of heading at the end."""
    poses = np.array([[1.2, 1.0, 0.3], [4.0, 3.0, 1.2]])
    fixed, moving = look(room, poses, 1)
    true = between(poses[0], poses[1])
    pose, score = search(
        field(fixed),
        thin(moving, 0.2),
        true + np.array([1.2, -0.9, 0.52]),
        np.array([2.0, 2.0, 0.7]),
    )
    assert np.hypot(*(pose - true)[:2]) < 0.2
    assert abs(pose[2] - true[2]) < 0.03
    assert score > 0.5


def test_the_other_poses_of_a_room_score_less_than_those_of_a_corridor(look: Look) -> None:
    """What leaves out the best pose tells whether it is the only one."""
    corridor = np.array([[-40.0, 1.0, 40.0, 1.0], [-40.0, -1.0, 40.0, -1.0]])
    fixed, moving = look(corridor, np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]), 1)
    half = np.array([3.0, 3.0, 0.2])
    pose, score = search(field(fixed), thin(moving, 0.2), np.zeros(3), half)
    _, other = search(
        field(fixed), thin(moving, 0.2), np.zeros(3), half, apart=np.array([*pose, 1.0, 0.15])
    )
    assert other > 0.9 * score


def test_nothing_scores_nothing(look: Look, room: Floats) -> None:
    """No points to place, none to place them by, or a least score that is not reached."""
    (scan,) = look(room, np.array([[1.2, 1.0, 0.3]]), 1)
    nothing = scan.select(np.zeros(scan.size, bool))
    half = np.ones(3)
    assert search(field(scan), nothing, np.zeros(3), half)[1] < 0.0
    assert search(field(nothing), scan, np.zeros(3), half)[1] < 0.0
    assert search(field(scan), scan, np.zeros(3), half, least=1.0)[1] < 0.0
