"""The arrow solver against dense linear algebra, and against GTSAM on a real small graph."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
import pytest

from fgloc.core.measurements import Floats
from fgloc.datasets.simulator import load_sim
from fgloc.factors.tables import FactorTable, Linearised, linearise
from fgloc.smoothing.arrow import ArrowSolution, NormalEquations, accumulate, solve
from fgloc.smoothing.build import build_problem
from fgloc.smoothing.elimination import solve_with_gtsam
from fgloc.smoothing.settings import Settings

SIZES = [(1, 3, 2), (1, 1, 1), (2, 3, 0), (5, 3, 4), (7, 5, 3), (30, 4, 9), (3, 6, 25)]
"""(K keyframes, B state width, G calibration variables)."""


def random_system(k: int, b: int, g: int, seed: int = 1) -> NormalEquations:
    """Return a positive definite arrow system with a gradient: a sum of random factors."""
    rng = np.random.default_rng(seed)
    system = NormalEquations.zeros(k, b, g)
    for i in range(k):
        rows = rng.normal(size=(b + 2, 2 * b + g))
        if i == k - 1:
            rows[:, b : 2 * b] = 0.0
        own, other, shared = rows[:, :b], rows[:, b : 2 * b], rows[:, 2 * b :]
        system.diagonal[i] += own.T @ own
        system.border[i] += own.T @ shared
        system.corner[:] += shared.T @ shared
        if i + 1 < k:
            system.diagonal[i + 1] += other.T @ other
            system.upper[i] += own.T @ other
            system.border[i + 1] += other.T @ shared
    system.diagonal[:] += 0.1 * np.eye(b)
    system.corner[:] += 0.1 * np.eye(g)
    system.gradient[:] = rng.normal(size=(k, b))
    system.gradient_corner[:] = rng.normal(size=g)
    return system


def dense(system: NormalEquations) -> tuple[Floats, Floats]:
    """Return the whole matrix and gradient, keyframes first."""
    k, b, g = system.border.shape
    matrix = np.zeros((k * b + g, k * b + g))
    for i in range(k):
        at = slice(i * b, (i + 1) * b)
        matrix[at, at] = system.diagonal[i]
        matrix[at, k * b :] = system.border[i]
        matrix[k * b :, at] = system.border[i].T
        if i + 1 < k:
            after = slice((i + 1) * b, (i + 2) * b)
            matrix[at, after] = system.upper[i]
            matrix[after, at] = system.upper[i].T
    matrix[k * b :, k * b :] = system.corner
    return matrix, np.concatenate([system.gradient.ravel(), system.gradient_corner])


def flat(solution: ArrowSolution) -> Floats:
    return np.concatenate([solution.step.ravel(), solution.calibration_step])


@pytest.mark.parametrize(("k", "b", "g"), SIZES)
@pytest.mark.parametrize("damping", [0.0, 1e-3, 10.0])
def test_step_is_that_of_a_dense_solve(k: int, b: int, g: int, damping: float) -> None:
    system = random_system(k, b, g)
    matrix, gradient = dense(system)
    damped = matrix + damping * np.diag(np.diag(matrix))
    solution = solve(system, damping)
    assert solution is not None
    np.testing.assert_allclose(
        flat(solution), -np.linalg.solve(damped, gradient), rtol=1e-9, atol=1e-11
    )
    # The sums are the caller's: solving must leave them as they were.
    np.testing.assert_array_equal(dense(system)[0], matrix)


@pytest.mark.parametrize(("k", "b", "g"), SIZES)
def test_covariances_are_blocks_of_the_dense_inverse(k: int, b: int, g: int) -> None:
    system = random_system(k, b, g)
    inverse = np.linalg.inv(dense(system)[0])
    solution = solve(system, 0.0, with_covariance=True)
    assert solution is not None
    assert solution.covariance is not None
    assert solution.calibration_covariance is not None
    for i in range(k):
        at = slice(i * b, (i + 1) * b)
        np.testing.assert_allclose(solution.covariance[i], inverse[at, at], rtol=1e-8, atol=1e-11)
    np.testing.assert_allclose(
        solution.calibration_covariance, inverse[k * b :, k * b :], rtol=1e-8, atol=1e-11
    )


@pytest.mark.parametrize("where", ["first", "middle", "last", "calibration", "gradient"])
def test_a_system_without_a_minimum_is_told(where: str) -> None:
    system = random_system(6, 3, 2)
    if where == "calibration":
        system.corner[0, 0] = -1.0
    elif where == "gradient":
        system.gradient[2, 1] = np.nan
    else:
        i = {"first": 0, "middle": 3, "last": 5}[where]
        system.diagonal[i, 1, 1] = -1.0
    assert solve(system) is None


def test_a_free_chain_is_told() -> None:
    # Relative factors alone: the whole chain may be moved about, so nothing determines it.
    system = NormalEquations.zeros(4, 2, 0)
    for i in range(3):
        system.diagonal[i] += np.eye(2)
        system.diagonal[i + 1] += np.eye(2)
        system.upper[i] -= np.eye(2)
    assert solve(system) is None
    system.diagonal[2] += np.eye(2)
    assert solve(system) is not None


@dataclass(frozen=True)
class Graph:
    """A linearised drive."""

    linear: list[tuple[FactorTable, Linearised, Floats]]
    """Tables, linearisations and robust weights."""
    system: NormalEquations
    """Their normal equations, the calibration prior included."""
    prior: tuple[Floats, Floats]
    """Square-root information and whitened residual of the calibration prior."""


SPEC = (
    "figure-eight?seed=4&duration=20&robot=differential&yaw=on&gyro=on&camera=on"
    "&fix_every=2&fix_mount_sigma=0.05&fix_x=0.1"
)


@pytest.fixture(scope="module")
def graph() -> Graph:
    """Return wheels, drifting yaw, drifting gyro, camera and fixes away from their minimum."""
    problem = build_problem(load_sim(SPEC), Settings())
    rng = np.random.default_rng(2)
    sigma = np.sqrt(np.diag(problem.prior_covariance))
    u = 0.3 * np.minimum(sigma, 0.1) * rng.normal(size=sigma.size)
    states = problem.states + 0.02 * rng.normal(size=problem.states.shape)
    linear = []
    k, b = states.shape
    system = NormalEquations.zeros(k, b, u.size)
    for table in (problem.wheel_table(u), *problem.tables):
        rows = linearise(table, states, u)
        weight = table.loss.weight(np.einsum("md,md->m", rows.residual, rows.residual))
        linear.append((table, rows, weight))
        accumulate(
            table.first,
            table.pairwise,
            weight,
            rows.residual,
            rows.by_first,
            rows.by_second,
            rows.by_calibration,
            table.calibration.start,
            system.diagonal,
            system.upper,
            system.border,
            system.corner,
            system.gradient,
            system.gradient_corner,
        )
    system.corner[:] += np.diag(1.0 / sigma**2)
    system.gradient_corner[:] += u / sigma**2
    assert b > 3, "the drifting zeros must be in the state"
    assert min(float(w.min()) for _, _, w in linear) < 0.5, "some factors must be down-weighted"
    return Graph(linear, system, (1.0 / sigma, u / sigma))


@pytest.mark.parametrize("damping", [0.0, 1e-4, 1.0])
def test_gtsam_takes_the_same_step(graph: Graph, damping: float) -> None:
    k, b, _ = graph.system.border.shape
    ours = solve(graph.system, damping)
    extra = None
    if damping > 0.0:
        extra = np.sqrt(damping * np.diag(dense(graph.system)[0]))
    theirs = solve_with_gtsam(graph.linear, k, b, graph.prior, extra)
    assert ours is not None
    assert theirs is not None
    scale = np.abs(ours.step).max(axis=0)
    np.testing.assert_allclose(ours.step / scale, theirs.step / scale, atol=1e-6)
    unit = np.abs(ours.calibration_step)
    np.testing.assert_allclose(
        ours.calibration_step / unit, theirs.calibration_step / unit, atol=1e-5
    )


def test_marginals_are_gtsams(graph: Graph) -> None:
    # One Hessian factor a keyframe pair is the same quadratic as thousands of rows; GTSAM
    # then marginalises by its own elimination.
    k, b, g = graph.system.border.shape
    quadratic = gtsam.GaussianFactorGraph()
    zeros, border = np.zeros(b), np.zeros(g)
    for table, rows, weight in graph.linear:
        root = np.sqrt(weight)
        columns = table.calibration
        for m, i in enumerate(table.first.tolist()):
            shared = np.zeros((table.dimension, g))
            shared[:, columns] = rows.by_calibration[m] * root[m]
            first, second = rows.by_first[m] * root[m], rows.by_second[m] * root[m]
            model = gtsam.noiseModel.Unit.Create(table.dimension)
            terms = [(i, first), (i + 1, second)] if table.pairwise else [(i, first)]
            terms.append((k, shared))
            arguments = [x for term in terms for x in term]
            right = np.zeros(table.dimension)
            quadratic.add(gtsam.JacobianFactor(*arguments, right, model))
    unit = gtsam.noiseModel.Unit.Create(g)
    quadratic.add(gtsam.JacobianFactor(k, np.diag(graph.prior[0]), border, unit))
    values = gtsam.VectorValues()
    for i in range(k):
        values.insert(i, zeros)
    values.insert(k, border)
    marginals = gtsam.Marginals(quadratic, values)
    ours = solve(graph.system, 0.0, with_covariance=True)
    assert ours is not None
    assert ours.covariance is not None
    assert ours.calibration_covariance is not None
    for i in (0, 1, k // 3, k // 2, k - 1):
        theirs = marginals.marginalCovariance(i)
        unit_of = np.sqrt(np.outer(np.diag(theirs), np.diag(theirs)))
        np.testing.assert_allclose((ours.covariance[i] - theirs) / unit_of, 0.0, atol=1e-6)
    theirs = marginals.marginalCovariance(k)
    unit_of = np.sqrt(np.outer(np.diag(theirs), np.diag(theirs)))
    np.testing.assert_allclose((ours.calibration_covariance - theirs) / unit_of, 0.0, atol=1e-6)
