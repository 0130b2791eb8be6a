"""The batch optimiser: first guess, plain cost, robust cost, covariances."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.errors import FglocError
from fgloc.smoothing.arrow import solve
from fgloc.smoothing.minimise import CalibrationPrior, Point, linear_system, minimise
from fgloc.smoothing.problem import Problem
from fgloc.smoothing.rounding import without_rounding_bias
from fgloc.smoothing.settings import Settings
from fgloc.smoothing.sweep import reach, sweep


@dataclass(frozen=True)
class Solution:
    """Where the optimiser stopped."""

    point: Point
    """States, calibration, linearised tables, robust weights and cost at the end."""
    iterations: int
    """Steps tried, those of the first guess included."""
    converged: bool
    """False if the iteration limit or the damping limit was reached."""
    covariance: Floats | None = None
    """(K, B, B) marginal covariances in keyframe axes."""
    calibration_covariance: Floats | None = None
    """(G, G) covariance of u."""


def optimise(problem: Problem, settings: Settings) -> Solution:
    """Return the best trajectory and calibration of a problem.

    First with plain quadratic costs (one basin), then with the robust losses from there, then
    less the bias of rounded encoder counts.
    Raises FglocError if the system is indeterminate even with the largest damping. Each
    iteration is O(N): one linearisation, one elimination.
    """
    states, u = problem.states, np.zeros(len(problem.parameters))
    iterations = 0
    if (
        problem.fix_keyframes().size > 1
        and reach(problem, u, problem.prior_covariance, 0.0) < states.shape[0]
    ):
        states, u, iterations = sweep(problem, settings)
    point, more, converged = minimise(problem, settings, states, u, False)
    iterations += more
    if settings.robust:
        point, more, converged = minimise(problem, settings, point.states, point.u, True)
        iterations += more
    point, more = without_rounding_bias(problem, settings, point)
    iterations += more
    solution = Solution(point, iterations, converged)
    if not settings.covariances:
        return solution
    final = solve(linear_system(CalibrationPrior.of(problem), point), 0.0, with_covariance=True)
    if final is None:
        raise FglocError(
            "the smoother's system is indeterminate: a sensor's noise or the robot's dimensions "
            "may be wrong by orders of magnitude"
        )
    return replace(
        solution,
        covariance=final.covariance,
        calibration_covariance=final.calibration_covariance,
    )
