"""Loops of closures and path: covariances by Monte Carlo, wrong closures found out."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fgloc.core.geometry import between, chain, compose, inverse, wrap
from fgloc.core.measurements import Floats
from fgloc.lidar.consistency import accumulate, agreement, largest_agreeing, supported

Indices = npt.NDArray[np.int64]


def _drive(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return steps (60, 3) of two rounds and their covariances."""
    steps = np.tile([1.0, 0.1, 2.0 * np.pi / 30.0], (60, 1))
    a = rng.standard_normal((60, 3, 3)) * (0.01, 0.01, 0.003)
    return steps, np.asarray(a @ a.transpose(0, 2, 1)) + np.diag([1e-6, 1e-6, 1e-7])


def _noisy(
    values: Floats, covariance: Floats, rng: np.random.Generator, count: int
) -> list[Floats]:
    root = np.linalg.cholesky(covariance)
    return [
        values + np.einsum("nij,nj->ni", root, rng.standard_normal(values.shape))
        for _ in range(count)
    ]


def test_accumulate_agrees_with_monte_carlo() -> None:
    """The covariance of a stretch, as a small motion of the map, from 4000 noisy drives."""
    rng = np.random.default_rng(1)
    steps, covariance = _drive(rng)
    poses = chain(steps, np.zeros(3))
    path = accumulate(steps, covariance, poses)
    i, j = 10, 25
    motions = []
    for noisy in _noisy(steps[i:j], covariance[i:j], rng, 4000):
        end = chain(noisy, poses[i].copy())[-1]
        motion = compose(end, inverse(poses[j]))
        motions.append([motion[0], motion[1], wrap(motion[2])])
    np.testing.assert_allclose(np.cov(np.array(motions).T), path[j] - path[i], rtol=0.15, atol=2e-5)


def _closures(
    rng: np.random.Generator, wrong: dict[int, tuple[float, float, float]]
) -> tuple[Floats, Floats, Indices, Indices, Floats, Floats]:
    """Return a drifted drive of two rounds and closures between them, some of them wrong."""
    steps, covariance = _drive(rng)
    true = chain(steps, np.zeros(3))
    drifted = _noisy(steps, covariance, rng, 1)[0]
    poses = chain(drifted, np.zeros(3))
    first = np.arange(2, 28, 2)
    second = first + 30
    spread = np.tile(np.diag([4e-4, 4e-4, 2.5e-5]), (first.size, 1, 1))
    relative = _noisy(between(true[first], true[second]), spread, rng, 1)[0]
    for k, off in wrong.items():
        relative[k] += off
    return poses, accumulate(drifted, covariance, poses), first, second, relative, spread


def test_right_closures_agree_as_their_covariance_says() -> None:
    """Loops of right closures: three degrees of freedom, over 30 drives."""
    squared = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        distance = agreement(*_closures(rng, {}), 5)
        squared.append(distance[np.isfinite(distance)])
    assert 2.6 < np.mean(np.concatenate(squared)) < 3.4


def test_wrong_closures_are_left_out() -> None:
    """Three of thirteen are off by half a metre or 10°: these go, the others stay."""
    wrong = {1: (0.5, 0.0, 0.0), 6: (0.0, -0.6, 0.0), 9: (0.0, 0.0, 0.17)}
    for seed in range(10):
        rng = np.random.default_rng(seed)
        keep = largest_agreeing(agreement(*_closures(rng, wrong), 13))
        assert not keep[[1, 6, 9]].any()
        assert keep.sum() >= 9


def test_a_closure_that_claims_little_agrees() -> None:
    """One that is off by 3 m in a direction which its covariance leaves open is not wrong."""
    rng = np.random.default_rng(3)
    poses, path, first, second, relative, spread = _closures(rng, {4: (3.0, 0.0, 0.0)})
    spread[4, 0, 0] = 100.0
    keep = largest_agreeing(agreement(poses, path, first, second, relative, spread, 13))
    assert keep[4]


def test_company_is_near_and_agrees() -> None:
    """By hand: the second is near the first and agrees; the third is far, the fourth disagrees."""
    distance = np.full((4, 3), np.nan)
    distance[1, 0] = 1.0
    distance[2, :2] = 1.0
    distance[3, :3] = 99.0
    first = np.array([0.0, 2.0, 40.0, 3.0])
    has = supported(distance, first, first + 100.0, 10.0)
    assert has.tolist() == [True, True, False, False]


def test_no_closures() -> None:
    """None and one: nothing to compare."""
    steps, covariance = _drive(np.random.default_rng(1))
    poses = chain(steps, np.zeros(3))
    path = accumulate(steps, covariance, poses)
    for count in (0, 1):
        ends = np.zeros(count, np.int64)
        relative, spread = np.zeros((count, 3)), np.tile(np.eye(3), (count, 1, 1))
        distance = agreement(poses, path, ends, ends + 30, relative, spread, 4)
        assert largest_agreeing(distance).tolist() == [True] * count
        assert not supported(distance, np.zeros(count), np.zeros(count), 1.0).any()
