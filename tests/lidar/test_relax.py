"""The plain pose graph."""

from __future__ import annotations

import numpy as np

from fgloc.core.geometry import between, chain
from fgloc.lidar.relax import in_moving_axes, relax


def test_axes_by_hand() -> None:
    """A relative pose that is turned by 90°: its x in the reference is -y of the moving frame."""
    covariance = in_moving_axes(
        np.array([[1.0, 2.0, np.pi / 2.0]]), np.diag([4.0, 1.0, 9.0])[None].copy()
    )
    np.testing.assert_allclose(covariance[0], np.diag([1.0, 4.0, 9.0]), atol=1e-12)


def test_closures_straighten_a_drive_and_a_wrong_one_lets_go() -> None:
    """Two rounds that drift by a steady turn; six right closures, one 2 m wrong."""
    steps = np.tile([1.0, 0.0, 2.0 * np.pi / 30.0], (60, 1))
    true = chain(steps, np.zeros(3))
    drifted = steps + np.array([0.01, 0.0, 0.004])
    start = chain(drifted, np.zeros(3))
    covariance = np.tile(np.diag([4e-4, 4e-4, 2.5e-5]), (60, 1, 1))
    first = np.array([2, 6, 10, 14, 18, 22, 26])
    second = first + 30
    relative = between(true[first], true[second])
    relative[3, 0] += 2.0
    spread = np.tile(np.diag([1e-4, 1e-4, 1e-5]), (7, 1, 1))
    poses, off = relax(start, (drifted, covariance), (first, second), (relative, spread))
    assert off[3] > 50.0
    assert np.delete(off, 3).max() < 4.0
    closed = between(poses[first], poses[second]) - between(true[first], true[second])
    assert np.abs(np.delete(closed, 3, axis=0)[:, :2]).max() < 0.05
    # Headings go on beyond a turn.
    assert 11.0 < poses[-1, 2] < 14.0
