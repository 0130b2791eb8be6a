"""Point-to-line matching: accuracy, honest covariance, and what cannot be known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from fgloc.core.geometry import between, wrap
from fgloc.core.measurements import Floats
from fgloc.lidar.matching import match, reference
from fgloc.lidar.surfaces import ScanPoints

Look = Callable[..., list[ScanPoints]]
HERE = np.array([1.2, 1.0, 0.3])


def test_finds_the_displacement_without_noise(look: Look, room: Floats) -> None:
    """Exact ranges: a few millimetres, from a guess that is 15 cm and 6° off."""
    there = np.array([1.6, 1.3, 0.5])
    fixed, moving = look(room, np.array([HERE, there]), 1, 0.0)
    true = between(HERE, there)
    found = match(fixed, moving, true + np.array([0.12, -0.09, 0.1]))
    np.testing.assert_allclose(found.relative, true, atol=0.004)
    assert found.converged
    assert found.overlap > 0.9
    assert found.inliers > 0.95


def test_agrees_with_open3d(look: Look, room: Floats) -> None:
    """open3d's point-to-plane ICP of the same points and normals ends at the same pose."""
    from fgloc.lazy import import_open3d

    o3d = import_open3d()
    there = np.array([1.5, 1.2, 0.4])
    fixed, moving = look(room, np.array([HERE, there]), 3, 0.002)
    true = between(HERE, there)
    clouds = []
    for scan in (fixed, moving):
        known = scan.select(scan.tilt > 0.0)
        one = o3d.geometry.PointCloud()
        flat = np.zeros((known.size, 1))
        one.points = o3d.utility.Vector3dVector(np.hstack([known.points, flat]))
        one.normals = o3d.utility.Vector3dVector(np.hstack([known.normals, flat]))
        clouds.append(one)
    registration = o3d.pipelines.registration
    plane = registration.TransformationEstimationPointToPlane(registration.TukeyLoss(0.05))
    start = np.eye(4)
    start[:2, :2] = [[np.cos(0.1), -np.sin(0.1)], [np.sin(0.1), np.cos(0.1)]]
    start[:2, 3] = true[:2]
    pose = registration.registration_icp(clouds[1], clouds[0], 0.2, start, plane).transformation
    theirs = np.array([pose[0, 3], pose[1, 3], np.arctan2(pose[1, 0], pose[0, 0])])
    np.testing.assert_allclose(match(fixed, moving, true).relative, theirs, atol=0.004)


def test_covariance_is_honest(look: Look, room: Floats) -> None:
    """Over 150 pairs of scans at 1 % noise the squared errors in sigmas are what three unknowns
    should give, or less: 3 on average, by a stated factor of 2 for correlation 1.5.
    """
    there = np.array([1.7, 1.1, 0.2])
    scans = look(room, np.tile([HERE, there], (150, 1)), 5)
    true = between(HERE, there)
    squared = []
    for k in range(150):
        found = match(scans[2 * k], scans[2 * k + 1], true + np.array([0.05, 0.05, 0.03]))
        off = found.relative - true
        squared.append(off @ np.linalg.solve(found.covariance, off))
    assert 0.3 < np.mean(squared) < 4.0


def test_says_that_a_corridor_leaves_its_direction_open(look: Look) -> None:
    """Two endless walls: along them the guess stays and the covariance says 10 m."""
    walls = np.array([[-40.0, 1.0, 40.0, 1.0], [-40.0, -1.0, 40.0, -1.0]])
    fixed, moving = look(walls, np.array([[0.0, 0.0, 0.0], [0.4, 0.1, 0.05]]), 2)
    found = match(fixed, moving, np.array([0.6, 0.0, 0.0]))
    assert found.relative[0] == pytest.approx(0.6, abs=0.02)
    np.testing.assert_allclose(found.relative[1:], [0.1, 0.05], atol=0.02)
    assert np.sqrt(found.covariance[0, 0]) > 5.0
    # The narrow direction is across the walls, as exactly as their direction is known.
    assert np.sqrt(np.linalg.eigvalsh(found.covariance[:2, :2])[0]) < 0.02


def test_start_is_not_the_guess(look: Look) -> None:
    """Where to begin does not pull: along a corridor the guess counts."""
    walls = np.array([[-40.0, 1.0, 40.0, 1.0], [-40.0, -1.0, 40.0, -1.0]])
    fixed, moving = look(walls, np.array([[0.0, 0.0, 0.0], [0.4, 0.1, 0.05]]), 2)
    found = match(fixed, moving, np.array([0.4, 0.1, 0.0]), start=np.array([0.7, 0.1, 0.0]))
    assert found.relative[0] == pytest.approx(0.4, abs=0.05)


def test_the_two_sides_of_a_thin_wall_do_not_match(look: Look) -> None:
    """A wall seen from below and one 5 cm above it seen from above have no pair."""
    below, above = look(
        np.array([[-2.0, 1.0, 2.0, 1.0], [-2.0, 1.05, 2.0, 1.05]]),
        np.array([[0.0, 0.0, 0.0], [0.0, 2.05, 0.0]]),
        1,
        0.0,
    )
    found = match(below, above, np.array([0.0, 2.05, 0.0]))
    assert found.overlap == 0.0
    assert not found.converged


def test_without_points_the_guess_comes_back(look: Look, room: Floats) -> None:
    """No points on one side or both: not converged, unknown, no exception."""
    (scan,) = look(room, HERE[None], 1)
    nothing = scan.select(np.zeros(scan.size, bool))
    guess = np.array([0.1, 0.2, 0.3])
    for fixed, moving in ((nothing, scan), (scan, nothing), (nothing, nothing)):
        found = match(reference(fixed), moving, guess)
        assert not found.converged
        np.testing.assert_array_equal(found.relative, guess)
        assert np.all(np.isfinite(found.covariance))
        assert np.sqrt(found.covariance[0, 0]) > 5.0


def test_a_moving_obstacle_does_not_pull(look: Look, room: Floats) -> None:
    """A person beside the lidar in one scan only: within a centimetre of the rest's answer."""
    there = np.array([1.6, 1.3, 0.5])
    person = np.array([[1.0, 2.0, 1.3, 2.3], [1.3, 2.3, 1.5, 2.0], [1.5, 2.0, 1.0, 2.0]])
    (fixed,) = look(room, HERE[None], 1, 0.0)
    (moving,) = look(np.vstack([room, person]), there[None], 1, 0.0)
    true = between(HERE, there)
    off = match(fixed, moving, true + np.array([0.1, 0.0, 0.05])).relative - true
    assert np.hypot(off[0], off[1]) < 0.01
    assert abs(wrap(off[2])) < 0.01
