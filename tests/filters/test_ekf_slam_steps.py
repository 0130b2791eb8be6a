"""The single steps of EKF-SLAM against finite differences, numpy and numbers worked by hand."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from fgloc.core.measurements import Floats
from fgloc.filters.ekf_slam_steps import (
    birth,
    correct,
    known,
    point_seen,
    project,
    remove,
    sight,
    sight_jacobian,
    wall_foot,
)
from fgloc.lidar.nearest import nearest

MOUNT = np.array([0.3, -0.1, 0.4])


def differences(function: Callable[[Floats], Floats], at: Floats) -> Floats:
    """Return d function / d at by central differences; exact to about 1e-9."""
    steps = 1e-5 * np.eye(at.size)
    return np.stack([(function(at + h) - function(at - h)) / 2e-5 for h in steps], axis=-1)


def covariance(rng: np.random.Generator, n: int) -> Floats:
    root = rng.standard_normal((n, n))
    return np.asarray(root @ root.T + 0.1 * np.eye(n))


def test_the_jacobian_of_a_sighting_is_derived_right() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        state = rng.uniform(-3.0, 3.0, 5)

        def seen(s: Floats) -> Floats:
            z = np.empty(2)
            sight(s[:3], MOUNT, s[3], s[4], z)
            return z

        # Away from the jump of the bearing at half a turn.
        if abs(abs(seen(state)[1]) - math.pi) < 0.01:
            continue
        h = np.empty((2, 5))
        sight_jacobian(state[:3], MOUNT, state[3], state[4], h)
        np.testing.assert_allclose(h, differences(seen, state), rtol=1e-6, atol=1e-7)


def test_a_point_is_where_it_is_seen() -> None:
    x, z, point = np.array([1.0, 2.0, 0.7]), np.empty(2), np.empty(2)
    sight(x, MOUNT, -2.0, 3.0, z)
    point_seen(x, MOUNT, z[0], z[1], point)
    np.testing.assert_allclose(point, [-2.0, 3.0], atol=1e-14)


def test_birth_grows_the_covariance_by_both_jacobians() -> None:
    rng = np.random.default_rng(1)
    n = 7
    before = covariance(rng, n)
    pose, z, r = rng.standard_normal(3), np.array([2.5, -0.8]), np.array([0.04, 0.01])

    def place(s: Floats) -> Floats:
        point = np.empty(2)
        point_seen(s[:3], MOUNT, s[3], s[4], point)
        return point

    j = differences(place, np.concatenate([pose, z]))
    x, p = np.zeros(n + 4), np.full((n + 4, n + 4), np.nan)
    x[:3], p[:n, :n] = pose, before
    birth(x, p, n, MOUNT, z[0], z[1], r[0], r[1])
    np.testing.assert_allclose(x[n : n + 2], place(np.concatenate([pose, z])), atol=1e-14)
    cross = j[:, :3] @ before[:3]
    np.testing.assert_allclose(p[n : n + 2, :n], cross, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(p[:n, n : n + 2], cross.T, rtol=1e-6, atol=1e-8)
    own = j[:, :3] @ before[:3, :3] @ j[:, :3].T + j[:, 3:] @ np.diag(r) @ j[:, 3:].T
    np.testing.assert_allclose(p[n : n + 2, n : n + 2], own, rtol=1e-6, atol=1e-8)
    assert np.linalg.eigvalsh(p[: n + 2, : n + 2]).min() > 0.0


def test_a_correction_worked_by_hand() -> None:
    # At the origin, a surveyed landmark 2 m ahead. Range: H = (-1, 0, 0), S = 0.08, K = -1/2.
    # Bearing: H = (0, -1/2, -1), H P Hᵀ = 0.04/4 + 0.01 = 0.02, S = 0.04, P Hᵀ = (-0.02, -0.01).
    x, p = np.zeros(5), np.zeros((5, 5))
    p[np.arange(3), np.arange(3)] = [0.04, 0.04, 0.01]
    known(x, p, 3, 2.0, 0.0, 0.0, 0.0)
    h, root, white = np.empty((2, 5)), np.empty((2, 5)), np.empty(2)
    sight_jacobian(x, np.zeros(3), x[3], x[4], h)
    np.testing.assert_allclose(h, [[-1, 0, 0, 1, 0], [0, -0.5, -1, 0, 0.5]], atol=1e-15)
    squared = project(p, 5, 3, h, 0.04, 0.02, np.array([0.1, 0.1]), root, white)
    assert squared == pytest.approx(0.01 / 0.08 + 0.01 / 0.04)
    correct(x, p, 5, root, white)
    np.testing.assert_allclose(x, [-0.05, -0.05, -0.025, 2.0, 0.0], atol=1e-15)
    expected = [[0.02, 0.0, 0.0], [0.0, 0.03, -0.005], [0.0, -0.005, 0.0075]]
    np.testing.assert_allclose(p[:3, :3], expected, atol=1e-15)
    np.testing.assert_array_equal(p[3:], 0.0)


def test_a_correction_is_kalmans() -> None:
    rng = np.random.default_rng(2)
    n, j = 9, 5
    for _ in range(20):
        x, before = rng.standard_normal(n), covariance(rng, n)
        p = np.zeros((n + 2, n + 2))
        p[:n, :n] = before
        short, full = np.empty((2, 5)), np.zeros((2, n))
        sight_jacobian(x, MOUNT, x[j], x[j + 1], short)
        full[:, :3], full[:, j : j + 2] = short[:, :3], short[:, 3:]
        v, r = rng.standard_normal(2), np.diag([0.3, 0.2])
        s = full @ before @ full.T + r
        gain = before @ full.T @ np.linalg.inv(s)
        root, white = np.empty((2, n + 2)), np.empty(2)
        squared = project(p, n, j, short, 0.3, 0.2, v, root, white)
        assert squared == pytest.approx(v @ np.linalg.solve(s, v))
        moved = np.concatenate([x, np.zeros(2)])
        correct(moved, p, n, root, white)
        np.testing.assert_allclose(moved[:n], x + gain @ v, atol=1e-10)
        np.testing.assert_allclose(p[:n, :n], before - gain @ s @ gain.T, atol=1e-10)
        np.testing.assert_array_equal(p, p.T)


def test_what_is_not_positive_is_refused() -> None:
    p, root, white = -np.eye(5), np.empty((2, 5)), np.empty(2)
    h = np.array([[1.0, 0, 0, 0, 0], [0, 1.0, 0, 0, 0]])
    assert math.isnan(project(p, 5, 3, h, 0.1, 0.1, np.zeros(2), root, white))


def test_death_is_deletion_from_state_and_covariance() -> None:
    rng = np.random.default_rng(3)
    n = 11
    x, p = rng.standard_normal(n), covariance(rng, n)
    # The second of four landmarks goes, the last one takes its place.
    kept = [0, 1, 2, 3, 4, 9, 10, 7, 8]
    expected_x, expected_p = x[kept], p[np.ix_(kept, kept)]
    remove(x, p, n, 5)
    np.testing.assert_array_equal(x[: n - 2], expected_x)
    np.testing.assert_array_equal(p[: n - 2, : n - 2], expected_p)
    # The last one itself just goes.
    expected_x, expected_p = x[: n - 4].copy(), p[: n - 4, : n - 4].copy()
    remove(x, p, n - 2, n - 4)
    np.testing.assert_array_equal(x[: n - 4], expected_x)
    np.testing.assert_array_equal(p[: n - 4, : n - 4], expected_p)


def test_a_wall_is_the_foot_of_the_perpendicular_from_the_origin() -> None:
    # At (2, 1), turned by 90°, the lidar 0.5 m ahead of it at (2, 1.5), its axes turned by another
    # 90°: its x axis is -x of the map. A wall at y = 4 is seen with its middle at (1, 4), in lidar
    # axes (1, -2.5); its normal towards the lidar is -y of the map, +y of the lidar: 90°.
    x, mount, foot = (
        np.array([2.0, 1.0, math.pi / 2]),
        np.array([0.5, 0.0, math.pi / 2]),
        np.empty(2),
    )
    normal = wall_foot(x, mount, math.pi / 2, 1.0, -2.5, foot)
    np.testing.assert_allclose(foot, [0.0, 4.0], atol=1e-12)
    assert math.cos(normal + math.pi / 2) == pytest.approx(1.0)


def test_the_nearest_landmark_of_a_sensor_within_the_gate() -> None:
    places = np.array([[0.0, 0.0], [1.0, 0.0], [1.2, 0.0], [1.05, 0.0]])
    streams = np.array([0, 0, 0, 1])
    assert nearest(places, streams, 4, 0, 1.05, 0.0, 0.5) == (
        1,
        pytest.approx(0.05),
        pytest.approx(0.15),
    )
    assert nearest(places, streams, 4, 0, 1.05, 0.0, 0.1) == (1, pytest.approx(0.05), math.inf)
    assert nearest(places, streams, 4, 1, 1.05, 0.0, 0.1)[0] == 3
    assert nearest(places, streams, 1, 0, 1.05, 0.0, 0.5) == (-1, math.inf, math.inf)
