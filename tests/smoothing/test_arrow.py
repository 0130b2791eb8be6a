"""The arrow solver against dense linear algebra, and against GTSAM on a real small graph."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
import pytest

from fgloc.core.measurements import Floats
from fgloc.datasets.simulator import load_sim
from fgloc.errors import FglocError
from fgloc.factors.tables import FactorTable, Kind, Linearised, linearise
from fgloc.smoothing.arrow import ArrowSolution, ChainRows, eliminate, solve, stack
from fgloc.smoothing.build import build_problem
from fgloc.smoothing.elimination import add_chain, solve_with_gtsam
from fgloc.smoothing.settings import Settings

SIZES = [(1, 3, 2), (1, 1, 1), (2, 3, 0), (5, 3, 4), (7, 5, 3), (30, 4, 9), (3, 6, 25)]
"""(K keyframes, B state width, G calibration variables)."""


def random_system(k: int, b: int, g: int, seed: int = 1) -> ChainRows:
    """Return random rows, some more of them at every other keyframe, and a calibration prior."""
    rng = np.random.default_rng(seed)
    rows, bounds = [], [0]
    for i in range(k):
        own = rng.normal(size=(b + 2 + 2 * (i % 2), 2 * b + g + 1))
        if i == k - 1:
            own[:, b : 2 * b] = 0.0
        rows.append(own)
        bounds.append(bounds[-1] + own.shape[0])
    prior = np.append(0.3 * np.eye(g), rng.normal(size=(g, 1)), axis=1)
    return ChainRows(np.concatenate(rows), np.array(bounds), b, prior)


def dense(system: ChainRows) -> tuple[Floats, Floats]:
    """Return the whole Jacobian and right side, keyframes first."""
    b, g = system.width, system.calibration
    k = system.bounds.size - 1
    first = np.repeat(np.arange(k), np.diff(system.bounds))
    matrix = np.zeros((first.size + system.prior.shape[0], (k + 1) * b + g))
    for row, i in enumerate(first):
        matrix[row, i * b : (i + 2) * b] = system.rows[row, : 2 * b]
        matrix[row, (k + 1) * b :] = system.rows[row, 2 * b : -1]
    matrix[first.size :, (k + 1) * b :] = system.prior[:, :-1]
    # Nothing may reach beyond the last keyframe.
    matrix = np.delete(matrix, np.s_[k * b : (k + 1) * b], axis=1)
    return matrix, np.concatenate([system.rows[:, -1], system.prior[:, -1]])


def flat(solution: ArrowSolution) -> Floats:
    return np.concatenate([solution.step.ravel(), solution.calibration_step])


@pytest.mark.parametrize(("k", "b", "g"), SIZES)
@pytest.mark.parametrize("damping", [0.0, 1e-3, 10.0])
def test_step_is_that_of_a_dense_solve(k: int, b: int, g: int, damping: float) -> None:
    system = random_system(k, b, g)
    before = system.rows.copy()
    matrix, right = dense(system)
    normal = matrix.T @ matrix
    damped = normal + damping * np.diag(np.diag(normal))
    solution = solve(system, damping)
    assert solution is not None
    np.testing.assert_allclose(
        flat(solution), np.linalg.solve(damped, matrix.T @ right), rtol=1e-8, atol=1e-10
    )
    # The rows are the caller's: solving must leave them as they were.
    np.testing.assert_array_equal(system.rows, before)


@pytest.mark.parametrize(("k", "b", "g"), SIZES)
@pytest.mark.parametrize("damping", [0.0, 10.0])
def test_gtsams_step_is_that_of_a_dense_solve(k: int, b: int, g: int, damping: float) -> None:
    system = random_system(k, b, g)
    matrix, right = dense(system)
    normal = matrix.T @ matrix
    damped = normal + damping * np.diag(np.diag(normal))
    solution = solve_with_gtsam(system, damping)
    assert solution is not None
    np.testing.assert_allclose(
        flat(solution), np.linalg.solve(damped, matrix.T @ right), rtol=1e-8, atol=1e-10
    )


def ill_conditioned() -> ChainRows:
    """Return two keyframes whose normal equations have no digits left, though the rows have."""
    e = 1e-9
    rows = np.array([[1.0, 1.0, 0.0, 0.0, 2.0], [1.0, 1.0 + e, 0.0, 0.0, 2.0 + e]])
    tie = np.array([[-1.0, 0.0, 1.0, 0.0, 0.0], [0.0, -1.0, 0.0, 1.0, 0.0]])
    return ChainRows(np.concatenate([rows, tie]), np.array([0, 4, 4]), 2, np.zeros((0, 1)))


def test_where_cholesky_fails_qr_steps_in() -> None:
    system = ill_conditioned()
    graph = gtsam.GaussianFactorGraph()
    add_chain(graph, system, 2)
    with pytest.raises(RuntimeError, match="Indeterminate"):
        graph.eliminateMultifrontal(gtsam.Ordering([0, 1]))
    solution = solve_with_gtsam(system)
    assert solution is not None
    np.testing.assert_allclose(solution.step, 1.0, atol=1e-5)


def test_gtsam_tells_a_free_chain() -> None:
    relative = np.concatenate([-np.eye(2), np.eye(2), np.zeros((2, 1))], axis=1)
    rows, bounds = np.tile(relative, (3, 1)), np.array([0, 2, 4, 6, 6])
    assert solve_with_gtsam(ChainRows(rows, bounds, 2, np.zeros((0, 1)))) is None


@pytest.mark.parametrize(("k", "b", "g"), SIZES)
def test_covariances_are_blocks_of_the_dense_inverse(k: int, b: int, g: int) -> None:
    system = random_system(k, b, g)
    matrix = dense(system)[0]
    inverse = np.linalg.inv(matrix.T @ matrix)
    solution = solve(system, 0.0, with_covariance=True)
    assert solution is not None
    assert solution.covariance is not None
    assert solution.calibration_covariance is not None
    for i in range(k):
        at = slice(i * b, (i + 1) * b)
        np.testing.assert_allclose(solution.covariance[i], inverse[at, at], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(
        solution.calibration_covariance, inverse[k * b :, k * b :], rtol=1e-8, atol=1e-10
    )


@pytest.mark.parametrize("where", ["first", "middle", "last", "calibration", "right side"])
def test_a_system_without_a_minimum_is_told(where: str) -> None:
    system = random_system(6, 3, 2)
    if where == "calibration":
        # Not a single row knows the first parameter.
        system.rows[:, 6] = 0.0
        system.prior[:, 0] = 0.0
    elif where == "right side":
        system.rows[4, -1] = np.nan
    else:
        # Nor the second component of one keyframe.
        i = {"first": 0, "middle": 3, "last": 5}[where]
        system.rows[system.bounds[i] : system.bounds[i + 1], 1] = 0.0
        if i:
            system.rows[system.bounds[i - 1] : system.bounds[i], 3 + 1] = 0.0
    assert solve(system) is None


def test_a_free_chain_is_told() -> None:
    # Relative factors alone: the whole chain may be moved about, so nothing determines it.
    relative = np.concatenate([-np.eye(2), np.eye(2), np.zeros((2, 1))], axis=1)
    rows, bounds = np.tile(relative, (3, 1)), np.array([0, 2, 4, 6, 6])
    nothing = np.zeros((0, 1))
    assert solve(ChainRows(rows, bounds, 2, nothing)) is None
    held = np.concatenate([np.eye(2), np.zeros((2, 3))], axis=1)
    rows = np.concatenate([rows, held])
    assert solve(ChainRows(rows, np.array([0, 2, 4, 6, 8]), 2, nothing)) is not None


@dataclass(frozen=True)
class Graph:
    """A linearised drive."""

    linear: list[tuple[FactorTable, Linearised, Floats]]
    """Tables, linearisations and robust weights."""
    system: ChainRows
    """Their rows, the calibration prior included."""
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
    covariance = problem.prior_covariance
    sigma = np.sqrt(np.diag(covariance))
    u = 0.3 * np.minimum(sigma, 0.1) * rng.normal(size=sigma.size)
    states = problem.states + 0.02 * rng.normal(size=problem.states.shape)
    linear = []
    for table in (problem.wheel_table(u), *problem.tables):
        rows = linearise(table, states, u)
        weight = table.loss.weight(np.einsum("md,md->m", rows.residual, rows.residual))
        linear.append((table, rows, weight))
    k, b = states.shape
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    prior = np.append(root, -(root @ u)[:, None], axis=1)
    system = stack(linear, k, b, prior)
    assert b > 3, "the drifting zeros must be in the state"
    assert min(float(w.min()) for _, _, w in linear) < 0.5, "some factors must be down-weighted"
    return Graph(linear, system, (root, root @ u))


@pytest.mark.parametrize("damping", [0.0, 1e-4, 1.0])
def test_gtsam_takes_the_same_step(graph: Graph, damping: float) -> None:
    ours = solve(graph.system, damping)
    theirs = solve_with_gtsam(graph.system, damping)
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
    system = graph.system
    k, b, g = system.bounds.size - 1, system.width, system.calibration
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
    quadratic.add(gtsam.JacobianFactor(k, graph.prior[0], border, unit))
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


def test_what_is_carried_to_a_keyframe_is_what_the_ones_before_tell() -> None:
    system = random_system(6, 3, 2)
    found = eliminate(system)
    assert found is not None
    at, b = 4, system.width
    # The rows of the keyframes before it, with nothing of its own, and the prior.
    matrix, _ = dense(system)
    before = np.r_[0 : system.bounds[at], system.bounds[-1] : matrix.shape[0]]
    live = np.r_[0 : (at + 1) * b, 6 * b : matrix.shape[1]]
    information = matrix[np.ix_(before, live)].T @ matrix[np.ix_(before, live)]
    drop = at * b
    marginal = information[drop:, drop:] - information[drop:, :drop] @ np.linalg.solve(
        information[:drop, :drop], information[:drop, drop:]
    )
    carry = found.carries[at][:, :-1]
    np.testing.assert_allclose(carry.T @ carry, marginal, atol=1e-9)


def test_the_newest_root_is_the_inverse_of_its_joint_marginal() -> None:
    system = random_system(6, 3, 2)
    found = eliminate(system)
    assert found is not None
    matrix, _ = dense(system)
    covariance = np.linalg.inv(matrix.T @ matrix)
    root = found.newest_root()
    np.testing.assert_allclose(np.linalg.inv(root.T @ root), covariance[-5:, -5:], atol=1e-9)


def test_landmarks_are_refused() -> None:
    point = FactorTable(
        Kind.RANGE_BEARING,
        "marks",
        np.zeros(1, np.int64),
        np.ones((1, 5)),
        np.eye(2)[None],
        slice(0, 0),
        second=np.zeros(1, np.int64),
    )
    linear = linearise(point, np.zeros((1, 3)), np.zeros(0), np.ones((1, 2)))
    with pytest.raises(FglocError, match="landmarks"):
        stack([(point, linear, np.ones(1))], 1, 3, np.zeros((0, 1)))
