"""The optimiser's loop: linearise tables, take a step, keep it only if it lowers the cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.geometry import compose, compose_scalar
from fgloc.core.measurements import Floats
from fgloc.factors.tables import FactorTable, Linearised, linearise
from fgloc.smoothing.arrow import ArrowSolution
from fgloc.smoothing.network import LinearSystem, gather, step_of
from fgloc.smoothing.problem import Problem, predicting, without_loss
from fgloc.smoothing.settings import Settings

FIRST_DAMPING = 1e-4
LARGEST_DAMPING = 1e8
ROUNDING = 1e-9
"""A change of the cost by less is rounding: the minimum is reached."""
SHORTER = (1.0, 0.3, 0.1, 0.03)
"""Parts of a step that are tried one after the other in a graph that is no chain."""


@dataclass(frozen=True)
class Point:
    """One linearisation: a state with its cost."""

    states: Floats
    """(K, B) keyframe states: x, y, theta and drifting sensor zeros."""
    u: Floats
    """(G,) calibration in solver variables."""
    landmarks: Floats
    """(L, 2) landmarks, as their kernels mean them."""
    tables: tuple[FactorTable, ...]
    """All factor tables, the wheels' first, integrated at u."""
    linear: tuple[Linearised, ...]
    """Their whitened residuals and Jacobians."""
    weights: tuple[Floats, ...]
    """Robust weights (M,) of every factor."""
    cost: float
    """Half the sum of squared whitened residuals, robust losses and priors applied."""


@dataclass(frozen=True)
class CalibrationPrior:
    """A Gaussian prior on the calibration, in solver variables."""

    mean: Floats
    """(G,)."""
    root: Floats
    """(G, G) square-root information: rootᵀ root is the inverse covariance."""

    @staticmethod
    def gaussian(mean: Floats, covariance: Floats) -> CalibrationPrior:
        """Return the prior with mean (G,) and covariance (G, G)."""
        return CalibrationPrior(mean, np.linalg.inv(np.linalg.cholesky(covariance)))

    @staticmethod
    def flat(size: int) -> CalibrationPrior:
        """Return no prior on (G,) variables: another factor holds what is known of them."""
        return CalibrationPrior(np.zeros(size), np.zeros((size, size)))

    @staticmethod
    def of(problem: Problem) -> CalibrationPrior:
        """Return the prior of a problem: solver variables are zero at nominal."""
        mean = np.zeros(len(problem.parameters))
        return CalibrationPrior.gaussian(mean, problem.prior_covariance)


def _evaluate(
    prior: CalibrationPrior,
    states: Floats,
    u: Floats,
    landmarks: Floats,
    tables: Sequence[FactorTable],
    wheels: FactorTable,
) -> Point:
    """Linearise all tables at a state and sum up the cost."""
    everything = (wheels, *tables)
    linear = tuple(linearise(t, states, u, landmarks) for t in everything)
    weights = []
    off = prior.root @ (u - prior.mean)
    cost = 0.5 * float(off @ off)
    for table, rows in zip(everything, linear, strict=True):
        squared = rows.squared
        cost += float(np.sum(table.loss.cost(squared)))
        weights.append(table.loss.weight(squared))
    return Point(states, u, landmarks, everything, linear, tuple(weights), cost)


def linear_system(prior: CalibrationPrior, point: Point) -> LinearSystem:
    """Return the weighted rows of a linearisation, the calibration prior included."""
    keyframes, width = point.states.shape
    rows = np.append(prior.root, -(prior.root @ (point.u - prior.mean))[:, None], axis=1)
    linear = list(zip(point.tables, point.linear, point.weights, strict=True))
    return gather(linear, keyframes, width, point.landmarks.shape[0], rows)


def retract(point: Point, step: ArrowSolution, _: FactorTable) -> Floats:
    """Return states ⊕ step: poses composed in the body frame, sensor zeros added."""
    moved = point.states + step.step
    moved[:, :3] = compose(point.states[:, :3], step.step[:, :3])
    return moved


def _shortened(step: ArrowSolution, part: float) -> ArrowSolution:
    """Return a part of a step."""
    return replace(
        step,
        step=part * step.step,
        calibration_step=part * step.calibration_step,
        landmark_step=part * step.landmark_step,
    )


def roll_out(point: Point, step: ArrowSolution, wheels: FactorTable) -> Floats:
    """Return the states that a step means in terms of motion: dead reckoning plus its errors.

    The linear step predicts what is left of each wheel residual. Driving the chain again from
    its new first pose, with the wheels' displacements at the new calibration and those residuals,
    keeps long arcs arcs: moving the poses one by one would tear them, and the damping needed to
    prevent that would take a hundred iterations. (The forward pass of iterative LQR.)
    """
    rows = point.linear[0]
    free = wheels.calibration.stop
    moved = point.states + step.step
    moved[0, :3] = compose(point.states[0, :3], step.step[0, :3])
    _drive(
        rows.residual,
        rows.by_first,
        rows.by_second,
        rows.by_calibration,
        point.tables[0].sqrt_information,
        wheels.measurements,
        point.u[:free] + step.calibration_step[:free],
        step.step,
        step.calibration_step[:free],
        wheels.slot,
        moved,
    )
    return moved


@compiled
def _drive(
    residual: Floats,
    by_first: Floats,
    by_second: Floats,
    by_calibration: Floats,
    whitening: Floats,
    measurements: Floats,
    at: Floats,
    step: Floats,
    calibration_step: Floats,
    slot: int,
    states: Floats,
) -> None:
    """Write the poses in `states` (K, B) one after the other, beginning with the first one.

    The arguments are those of the wheels' table: its linearisation, lower triangular whitening,
    and measurements at the new calibration `at`; slips, from column `slot`, are in `states`.
    """
    b, f = step.shape[1], at.size
    slips = (measurements.shape[1] - 3 - 3 * f) // 3 if slot >= 0 else 0
    left = np.empty(3)
    for k in range(residual.shape[0]):
        for a in range(3):
            v = residual[k, a]
            for c in range(b):
                v += by_first[k, a, c] * step[k, c] + by_second[k, a, c] * step[k + 1, c]
            for c in range(f):
                v += by_calibration[k, a, c] * calibration_step[c]
            # Forward substitution undoes the whitening.
            for c in range(a):
                v -= whitening[k, a, c] * left[c]
            left[a] = v / whitening[k, a, a]
        for a in range(3):
            left[a] += measurements[k, a]
            for c in range(f):
                left[a] += measurements[k, 3 + a * f + c] * at[c]
            for c in range(slips):
                left[a] += measurements[k, 3 + 3 * f + a * slips + c] * states[k + 1, slot + c]
        # Only the pose: a sensor's drifting zero, further on in the state, moves by its own step.
        compose_scalar(states[k], left, states[k + 1])


def minimise(
    problem: Problem,
    settings: Settings,
    states: Floats,
    u: Floats,
    robust: bool,
    prior: CalibrationPrior | None = None,
    landmarks: Floats | None = None,
) -> tuple[Point, int, bool]:
    """Run Gauss–Newton with Levenberg–Marquardt damping where a plain step does not help.

    Begins at `states` (K, B), `u` (G,) and `landmarks` (L, 2), else the problem's own. Returns the
    minimum, how many steps were tried, and whether it was reached.
    """
    marks = problem.landmarks if landmarks is None else landmarks
    prior = CalibrationPrior.of(problem) if prior is None else prior

    def wheel_table(at: Floats, states: Floats) -> FactorTable:
        table = problem.wheel_table(at, whitening, states)
        return table if robust else without_loss(table)

    whitening: Floats | None = None
    wheels = wheel_table(u, states)
    tables = tuple(
        predicting(t if robust else without_loss(t), wheels, states, u) for t in problem.tables
    )
    # The weights of one run stay those of its first linearisation: costs must be comparable.
    whitening = wheels.sqrt_information
    point = _evaluate(prior, states, u, marks, tables, wheels)
    damping = 0.0
    # A network's poses hang together so stiffly that damping hardly lets them move: shorten.
    parts = SHORTER if any(t.links for t in tables) else (1.0,)
    for iteration in range(1, settings.max_iterations + 1):
        step = step_of(linear_system(prior, point), damping, solver=settings.solver)
        trial = None
        for part in parts:
            if step is None or part * np.abs(step.calibration_step).max(initial=0.0) >= 2.0:
                continue
            tried = _shortened(step, part) if part < 1.0 else step
            at = point.u + tried.calibration_step
            # Of the states only slips matter here, and these are simply added up.
            table = wheel_table(at, point.states + tried.step)
            marks = point.landmarks + tried.landmark_step
            for move in (roll_out, retract):
                trial = _evaluate(prior, move(point, tried, table), at, marks, tables, table)
                if trial.cost < point.cost:
                    break
            if trial is not None and (
                trial.cost < point.cost or trial.cost - point.cost < ROUNDING
            ):
                break
        # A damped step may be small for that alone.
        if damping == 0.0 and trial is not None and 0.0 <= trial.cost - point.cost < ROUNDING:
            return point, iteration, True
        if trial is None or not np.isfinite(trial.cost) or trial.cost > point.cost * (1 + 1e-12):
            damping = max(damping * 10.0, FIRST_DAMPING)
            if damping > LARGEST_DAMPING:
                return point, iteration, False
            continue
        drop = point.cost - trial.cost
        point = trial
        damping = 0.0 if damping <= FIRST_DAMPING else damping / 10.0
        if drop <= settings.tolerance * max(point.cost, 1e-9) or drop < ROUNDING:
            return point, iteration, True
    return point, settings.max_iterations, False
