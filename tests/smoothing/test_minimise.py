"""The optimiser's loop: what a step means, that the cost only falls, what is reported."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from fgloc.core.measurements import Floats
from fgloc.core.preintegration import preintegrate
from fgloc.factors.tables import linearise
from fgloc.smoothing.arrow import solve
from fgloc.smoothing.build import build_problem
from fgloc.smoothing.minimise import CalibrationPrior, Point, linear_system, minimise, roll_out
from fgloc.smoothing.problem import Problem
from fgloc.smoothing.settings import Settings

from .drives import simulated

SPEC = "figure-eight?seed=4&duration=20&fix_every=2&yaw=on&gyro=on"


@pytest.fixture(scope="module")
def problem() -> Problem:
    return build_problem(simulated(SPEC), Settings())


def test_whitening_is_the_inverse_cholesky_factor(problem: Problem) -> None:
    pre = preintegrate(problem.split, problem.robot)
    whitening = Problem.whitening(pre)
    expected = np.linalg.inv(np.linalg.cholesky(pre.covariance))
    np.testing.assert_allclose(whitening, expected, rtol=1e-9, atol=1e-9 * expected.max())
    np.testing.assert_array_equal(whitening, np.tril(whitening))


@pytest.mark.parametrize(
    "bad", [np.diag([1.0, 0.0, 1.0]), np.diag([1.0, 1.0, -1.0]), np.full((3, 3), np.nan)]
)
def test_a_covariance_that_is_none_is_told(problem: Problem, bad: Floats) -> None:
    pre = preintegrate(problem.split, problem.robot)
    covariance = pre.covariance.copy()
    covariance[7] = bad
    with pytest.raises(np.linalg.LinAlgError):
        Problem.whitening(replace(pre, covariance=covariance))


def test_rolling_out_leaves_the_wheels_what_the_linear_step_predicts(problem: Problem) -> None:
    # The promise of roll_out: wheel residuals after it are the linear prediction, however large
    # the step; moving the poses one by one keeps it only to first order.
    point, _, _ = minimise(
        problem, Settings(max_iterations=1), problem.states, np.zeros(len(problem.parameters)), True
    )
    step = solve(linear_system(CalibrationPrior.of(problem), point))
    assert step is not None
    rng = np.random.default_rng(3)
    step = replace(step, step=step.step + 0.05 * rng.normal(size=step.step.shape))
    rows = point.linear[0]
    predicted = (
        rows.residual
        + np.einsum("kab,kb->ka", rows.by_first, step.step[:-1])
        + np.einsum("kab,kb->ka", rows.by_second, step.step[1:])
        + rows.by_calibration @ step.calibration_step[: len(problem.free)]
    )
    u = point.u + step.calibration_step
    table = problem.wheel_table(u, point.tables[0].sqrt_information)
    moved = roll_out(point, step, table)
    left = linearise(table, moved, u).residual
    np.testing.assert_allclose(left, predicted, atol=1e-6 * np.abs(predicted).max())
    # Drifting zeros of the sensors move by their own steps.
    assert moved.shape[1] > 3
    np.testing.assert_allclose(moved[:, 3:], point.states[:, 3:] + step.step[:, 3:])


@pytest.mark.parametrize("robust", [False, True])
@pytest.mark.parametrize("solver", ["arrow", "gtsam"])
def test_the_cost_never_rises(solver: str, robust: bool) -> None:
    # A track wrong by a half: plain Gauss-Newton steps overshoot here and must be refused.
    drive = simulated(
        "random?seed=14&duration=60&nominal_track=0.48&effective_track=0.72&fix_every=10"
    )
    problem = build_problem(drive, Settings())
    u = np.zeros(len(problem.parameters))
    costs, refused = [], 0
    point: Point | None = None
    for limit in range(1, 12):
        settings = Settings(max_iterations=limit, solver=solver)  # type: ignore[arg-type]
        before = point
        point, _, _ = minimise(problem, settings, problem.states, u, robust)
        refused += before is not None and point.cost == before.cost
        costs.append(point.cost)
    assert all(after <= before for before, after in itertools.pairwise(costs))
    assert costs[-1] < 0.5 * costs[0]
    assert refused > 0, "no step was refused: this drive tests nothing"
