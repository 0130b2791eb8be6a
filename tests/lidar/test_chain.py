"""Scan after scan against the map of those before."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fgloc.core.geometry import between, chain, wrap
from fgloc.core.measurements import Floats
from fgloc.lidar.chain import key_scans, match_chain
from fgloc.lidar.surfaces import ScanPoints

Look = Callable[..., list[ScanPoints]]


def _wheels(poses: Floats, seed: int, heading: float = 0.05) -> Floats:
    """Return a path that drifts: 5 cm and `heading` [rad] (σ) a step, 3 % too long."""
    rng = np.random.default_rng(seed)
    steps = between(poses[:-1], poses[1:])
    steps[:, 2] = wrap(steps[:, 2])
    steps[:, 0] *= 1.03
    return chain(steps + rng.standard_normal(steps.shape) * (0.05, 0.05, heading), np.zeros(3))


def test_follows_a_drive_through_corridors(look: Look, ring: Floats) -> None:
    """Two sides of the ring, 24 m: 10 cm and 1° at the end, wheels off by far more."""
    poses = np.array([(1.0 + 0.25 * k, 1.0, 0.0) for k in range(56)])
    poses = np.vstack([poses, [(15.0, 1.0, 0.5), (15.0, 1.0, 1.1)]])
    poses = np.vstack([poses, [(15.0, 1.0 + 0.25 * k, np.pi / 2.0) for k in range(28)]])
    scans = look(ring, poses, 1)
    guess = _wheels(poses, 2)
    found = match_chain(scans, guess, np.tile([0.06, 0.06, 0.05], (len(poses) - 1, 1)))
    assert found.matched.all()
    end = chain(found.relative, poses[0].copy())[-1]
    assert np.hypot(*(end - poses[-1])[:2]) < 0.1
    assert abs(wrap(end[2] - poses[-1, 2])) < 0.0175
    off = found.relative - between(poses[:-1], poses[1:])
    off[:, 2] = wrap(off[:, 2])
    squared = np.einsum("ni,nij,nj->n", off, np.linalg.inv(found.covariance), off)
    # Three degrees of freedom; nine of ten below 6.25 if the covariance is honest.
    assert np.mean(squared < 6.25) > 0.8
    assert np.median(squared) > 0.3


def test_a_corridor_is_left_to_the_guess(look: Look) -> None:
    """Endless walls: the way along them is as guessed, unknown to the match, known when fused."""
    walls = np.array([[-40.0, 1.0, 40.0, 1.0], [-40.0, -1.0, 40.0, -1.0]])
    poses = np.array([(0.2 * k, 0.0, 0.0) for k in range(8)])
    guess = poses * (1.05, 1.0, 1.0)
    sigma = np.array([0.03, 0.03, 0.02])
    found = match_chain(look(walls, poses, 1), guess, np.tile(sigma, (7, 1)))
    np.testing.assert_allclose(found.relative[:, 0], 0.21, atol=0.03)
    assert np.all(found.covariance[:, 0, 0] > 1.0)
    steps, covariance = found.fused(guess, sigma)
    np.testing.assert_allclose(steps[:, 0], 0.21, atol=0.005)
    np.testing.assert_allclose(np.sqrt(covariance[:, 0, 0]), 0.03, rtol=0.05)
    assert np.all(np.sqrt(covariance[:, 1, 1]) < 0.03)


def test_places_without_walls_are_bridged_by_the_guess(look: Look, room: Floats) -> None:
    """Scans of nothing: not matched, the guess's displacement, unknown; matched again after."""
    poses = np.array([(1.0 + 0.1 * k, 1.2, 0.1 * k) for k in range(12)])
    scans = look(room, poses, 1)
    for k in (5, 6):
        scans[k] = scans[k].select(np.zeros(scans[k].size, bool))
    found = match_chain(scans, poses + np.array([3.0, 0.0, 0.0]), None)
    assert found.matched.tolist() == [k not in (4, 5) for k in range(11)]
    np.testing.assert_allclose(found.relative[4], between(poses[4], poses[5]), atol=1e-12)
    assert np.all(np.isfinite(found.covariance))
    assert np.sqrt(found.covariance[4, 0, 0]) > 5.0
    end = chain(found.relative, poses[0].copy())[-1]
    np.testing.assert_allclose(end, poses[-1], atol=0.03)


def test_short_drives() -> None:
    """No scan and one scan: no displacement."""
    nothing = ScanPoints(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    for count in (0, 1):
        found = match_chain([nothing] * count, np.zeros((count, 3)))
        assert found.relative.shape == (0, 3)
        assert found.covariance.shape == (0, 3, 3)


def test_key_scans_by_hand() -> None:
    """0.1 m a scan: every third; on the spot every second of 0.1 rad."""
    poses = np.array([(0.1 * k, 0.0, 0.0) for k in range(7)])
    assert key_scans(poses, 0.29, 0.15).tolist() == [0, 3, 6]
    turning = np.array([(0.0, 0.0, 0.1 * k) for k in range(5)])
    assert key_scans(turning, 0.29, 0.15).tolist() == [0, 2, 4]
    assert key_scans(np.zeros((0, 3))).size == 0


def test_wheels_that_slipped_are_found_out(look: Look, room: Floats) -> None:
    """One displacement is guessed 18 cm and 17° wrong, 4 and 7 times what it may be."""
    poses = np.array([(1.0 + 0.1 * k, 1.2, 0.1 * k) for k in range(10)])
    steps = between(poses[:-1], poses[1:])
    steps[5] += (-0.15, 0.1, 0.3)
    found = match_chain(look(room, poses, 1), chain(steps, poses[0].copy()))
    assert found.matched.all()
    np.testing.assert_allclose(found.relative[5], between(poses[5], poses[6]), atol=0.02)
