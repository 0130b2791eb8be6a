"""The batch optimiser: first guess, plain cost, robust cost, covariances."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.errors import FglocError
from fgloc.factors.tables import Kind
from fgloc.smoothing.arrow import ArrowSolution
from fgloc.smoothing.forward import forward, placed
from fgloc.smoothing.graduate import GIVEN_UP, MANY, doubtful, second_look
from fgloc.smoothing.minimise import CalibrationPrior, Point, linear_system, minimise
from fgloc.smoothing.network import step_of
from fgloc.smoothing.problem import Problem
from fgloc.smoothing.rounding import without_rounding_bias
from fgloc.smoothing.settings import Settings
from fgloc.smoothing.sweep import reach, sweep

FALLS_NO_FURTHER = "the cost falls no further"


@dataclass(frozen=True)
class Solution:
    """Where the optimiser stopped."""

    point: Point
    """States, calibration, linearised tables, robust weights and cost at the end."""
    iterations: int
    """Steps tried, those of the first guess included."""
    converged: bool
    """False if the iteration limit or the damping limit was reached."""
    stopped: str
    """Why the last run stopped, in words."""
    covariance: Floats | None = None
    """(K, B, B) marginal covariances in keyframe axes."""
    calibration_covariance: Floats | None = None
    """(G, G) covariance of u."""
    landmark_covariance: Floats | None = None
    """(L, 2, 2) marginal covariances of the landmarks."""
    next_step: float | None = None
    """Largest component of the step that would come next, in its own marginal sigmas: what is
    left to gain. Known where covariances are."""


def optimise(problem: Problem, settings: Settings) -> Solution:
    """Return the best trajectory and calibration of a problem.

    First with plain quadratic costs (one basin), then with the robust losses from there; where
    the result is doubtful, again by graduation from every plain solution there is; then less the
    bias of rounded encoder counts. Landmarks are tried with the robust losses from dead reckoning
    first: plain costs do not survive a fifth of the sightings wrong, and dead reckoning mostly is
    good enough. Where it is not, many sightings are given up, and the drive is taken piece by piece
    (`smoothing.forward`); the better one of both stays.
    Raises FglocError if the system is indeterminate even with the largest damping. Each
    iteration is O(N): one linearisation, one elimination.
    """
    nominal, tried = np.zeros(len(problem.parameters)), 0
    states, u = problem.states, nominal
    marks, iterations = problem.landmarks, 0
    swept = (
        not marks.size
        and problem.fix_keyframes().size > 1
        and reach(problem, u, problem.prior_covariance, 0.0) < states.shape[0]
    )
    if swept:
        states, u, iterations = sweep(problem, settings)
    direct, settled = None, False
    if marks.size:
        if settings.robust:
            direct, tried, settled = minimise(
                problem, settings, states, u, True, landmarks=placed(problem, states)
            )
            if settled and not doubtful(direct) and _given_up(direct) < MANY:
                return finish(problem, settings, direct, tried, True, FALLS_NO_FURTHER)
        states, u, marks, iterations = forward(problem, settings)
    point, last, converged = minimise(problem, settings, states, u, False, landmarks=marks)
    iterations += last
    if settings.robust:
        plain = [point]
        point, last, converged = minimise(
            problem, settings, point.states, point.u, True, landmarks=point.landmarks
        )
        iterations += last
        if settings.graduated and doubtful(point):
            if swept:
                # Wild fixes lead the sweep astray; all fixes at once at least average them.
                other, more, _ = minimise(problem, settings, problem.states, nominal, False)
                iterations += more
                plain.append(other)
            found, more = second_look(problem, settings, plain, point)
            iterations += more
            if found is not None:
                point, last, converged = minimise(
                    problem, settings, found.states, found.u, True, landmarks=found.landmarks
                )
                iterations += last
    if direct is not None:
        iterations += tried
        if direct.cost < point.cost:
            point, last, converged = direct, tried, settled
    stopped = FALLS_NO_FURTHER
    if not converged:
        reached = last >= settings.max_iterations
        stopped = "the iteration limit was reached" if reached else "no step lowers the cost"
    return finish(problem, settings, point, iterations, converged, stopped)


def _given_up(point: Point) -> float:
    """Return the share of the sightings of landmarks that the losses gave up; 0 without any."""
    pairs = zip(point.tables, point.weights, strict=True)
    weights = [w for table, w in pairs if table.kind == Kind.RANGE_BEARING]
    return float(np.mean(np.concatenate(weights) < GIVEN_UP)) if weights else 0.0


def finish(
    problem: Problem,
    settings: Settings,
    minimum: Point,
    iterations: int,
    converged: bool,
    stopped: str,
) -> Solution:
    """Return the solution at a minimum: less the bias of rounded counts, with covariances.

    Raises FglocError if the system is indeterminate there.
    """
    point, more = without_rounding_bias(problem, settings, minimum)
    solution = Solution(point, iterations + more, converged, stopped)
    if not settings.covariances:
        return solution
    prior = CalibrationPrior.of(problem)
    final = step_of(linear_system(prior, point), with_covariance=True)
    if final is None:
        raise FglocError(
            "the smoother's system is indeterminate: a sensor's noise or the robot's dimensions "
            "may be wrong by orders of magnitude"
        )
    return replace(
        solution,
        covariance=final.covariance,
        calibration_covariance=final.calibration_covariance,
        landmark_covariance=final.landmark_covariance,
        # What was taken away as bias is no step that is still to be made.
        next_step=_in_sigmas(
            final if point is minimum else step_of(linear_system(prior, minimum)), final
        ),
    )


def _in_sigmas(step: ArrowSolution | None, final: ArrowSolution) -> float | None:
    """Return the largest component of a step in marginal sigmas of the final solution."""
    if step is None or final.covariance is None or final.calibration_covariance is None:
        return None
    variance = np.diagonal(final.covariance, axis1=1, axis2=2)
    shared = np.diag(final.calibration_covariance)
    squared = [step.step**2 / variance, step.calibration_step**2 / shared]
    if final.landmark_covariance is not None:
        seen = np.diagonal(final.landmark_covariance, axis1=1, axis2=2)
        squared.append(step.landmark_step**2 / seen)
    return float(np.sqrt(max(np.max(each, initial=0.0) for each in squared)))
