"""The optimiser's loop: linearise tables, take a step, keep it only if it lowers the cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fgloc.core.geometry import between, chain, compose
from fgloc.core.measurements import Floats
from fgloc.errors import FglocError
from fgloc.factors.tables import FactorTable, Kind, Linearised, linearise
from fgloc.smoothing.arrow import ArrowSolution, NormalEquations, accumulate, solve
from fgloc.smoothing.elimination import solve_with_gtsam
from fgloc.smoothing.initial import dead_reckon
from fgloc.smoothing.problem import FIXES, Problem, without_loss
from fgloc.smoothing.settings import Settings

FIRST_DAMPING = 1e-4
LARGEST_DAMPING = 1e8
BENT = 0.3
"""Heading sigma [rad] up to which a dead-reckoned path is close to its linearisation."""
ROUGH = 1e-2
"""Relative decrease at which a window of the sweep is good enough to go on."""
BEYOND = 6.0
"""A calibration that many prior sigmas away means that the sweep lost its way."""
LOOK = 3000
"""How many keyframes a window of the sweep may add at most."""
OVERLAP = 4
"""How many fixes of the last window the next one sees again."""


@dataclass(frozen=True)
class Solution:
    """Where the optimiser stopped."""

    states: Floats
    """(K, B) keyframe states: x, y, theta and drifting sensor zeros."""
    u: Floats
    """(G,) calibration in solver variables."""
    tables: tuple[FactorTable, ...]
    """All factor tables, the wheels' first, as linearised last."""
    linear: tuple[Linearised, ...]
    """Their whitened residuals and Jacobians at the solution."""
    weights: tuple[Floats, ...]
    """Robust weights (M,) of every factor at the solution."""
    cost: float
    """Half the sum of squared whitened residuals, robust losses and priors applied."""
    iterations: int
    """Steps tried."""
    converged: bool
    """False if the iteration limit or the damping limit was reached."""
    covariance: Floats | None = None
    """(K, B, B) marginal covariances in keyframe axes."""
    calibration_covariance: Floats | None = None
    """(G, G) covariance of u."""


@dataclass(frozen=True)
class _Point:
    """One linearisation: a state with its cost."""

    states: Floats
    u: Floats
    tables: tuple[FactorTable, ...]
    linear: tuple[Linearised, ...]
    weights: tuple[Floats, ...]
    cost: float


@dataclass(frozen=True)
class CalibrationPrior:
    """A Gaussian prior on the calibration, in solver variables."""

    mean: Floats
    """(G,)."""
    information: Floats
    """(G, G)."""

    @staticmethod
    def of(problem: Problem) -> CalibrationPrior:
        """Return the prior of a problem: solver variables are zero at nominal."""
        return CalibrationPrior(np.zeros(len(problem.parameters)), problem.prior_information)


def _evaluate(
    prior: CalibrationPrior,
    states: Floats,
    u: Floats,
    tables: Sequence[FactorTable],
    wheels: FactorTable,
) -> _Point:
    """Linearise all tables at a state and sum up the cost."""
    everything = (wheels, *tables)
    linear = tuple(linearise(t, states, u) for t in everything)
    weights = []
    off = u - prior.mean
    cost = 0.5 * float(off @ prior.information @ off)
    for table, rows in zip(everything, linear, strict=True):
        squared = np.einsum("md,md->m", rows.residual, rows.residual)
        cost += float(np.sum(table.loss.cost(squared)))
        weights.append(table.loss.weight(squared))
    return _Point(states, u, everything, linear, tuple(weights), cost)


def normal_equations(prior: CalibrationPrior, point: _Point | Solution) -> NormalEquations:
    """Return the weighted normal equations at a linearisation, priors included."""
    keyframes, width = point.states.shape
    system = NormalEquations.zeros(keyframes, width, point.u.size)
    for table, rows, weight in zip(point.tables, point.linear, point.weights, strict=True):
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
    system.corner[:] += prior.information
    system.gradient_corner[:] += prior.information @ (point.u - prior.mean)
    return system


def _step(
    prior: CalibrationPrior, point: _Point, damping: float, solver: str
) -> ArrowSolution | None:
    """Solve for one step with the chosen linear solver."""
    if solver == "arrow":
        return solve(normal_equations(prior, point), damping)
    root = np.sqrt(np.diag(prior.information))
    extra = None
    if damping > 0.0:
        system = normal_equations(prior, point)
        lead = np.einsum("kaa->ka", system.diagonal).ravel()
        extra = np.sqrt(damping * np.concatenate([lead, np.diag(system.corner)]))
    linear = list(zip(point.tables, point.linear, point.weights, strict=True))
    offset = root * (point.u - prior.mean)
    return solve_with_gtsam(linear, *point.states.shape, (root, offset), extra)


def retract(point: _Point, step: ArrowSolution, _: FactorTable) -> Floats:
    """Return states ⊕ step: poses composed in the body frame, sensor zeros added."""
    moved = point.states + step.step
    moved[:, :3] = compose(point.states[:, :3], step.step[:, :3])
    return moved


def roll_out(point: _Point, step: ArrowSolution, wheels: FactorTable) -> Floats:
    """Return the states that a step means in terms of motion: dead reckoning plus its errors.

    The linear step predicts what is left of each wheel residual. Driving the chain again from
    its new first pose, with the wheels' displacements at the new calibration and those residuals,
    keeps long arcs arcs: moving the poses one by one would tear them, and the damping needed to
    prevent that would take a hundred iterations. (The forward pass of iterative LQR.)
    """
    rows = point.linear[0]
    first, second = step.step[:-1], step.step[1:]
    left = rows.residual + np.einsum("kab,kb->ka", rows.by_first, first)
    left += np.einsum("kab,kb->ka", rows.by_second, second)
    left += rows.by_calibration @ step.calibration_step[point.tables[0].calibration]
    unwhitened = np.linalg.solve(point.tables[0].sqrt_information, left[:, :, None])[:, :, 0]
    free = wheels.calibration.stop
    jacobian = wheels.measurements[:, 3:].reshape(-1, 3, free)
    at = point.u[:free] + step.calibration_step[:free]
    displacement = wheels.measurements[:, :3] + jacobian @ at + unwhitened
    moved = point.states + step.step
    start = compose(point.states[0, :3], step.step[0, :3])
    moved[:, :3] = chain(displacement, start)
    return moved


def _minimise(
    problem: Problem,
    settings: Settings,
    states: Floats,
    u: Floats,
    robust: bool,
    prior: CalibrationPrior | None = None,
) -> tuple[_Point, int, bool]:
    """Run Gauss–Newton with Levenberg–Marquardt damping where a plain step does not help."""
    prior = CalibrationPrior.of(problem) if prior is None else prior
    tables = problem.tables if robust else tuple(without_loss(t) for t in problem.tables)

    def wheel_table(at: Floats) -> FactorTable:
        table = problem.wheel_table(at, whitening)
        return table if robust else without_loss(table)

    whitening: Floats | None = None
    wheels = wheel_table(u)
    # The weights of one run stay those of its first linearisation: costs must be comparable.
    whitening = wheels.sqrt_information
    point = _evaluate(prior, states, u, tables, wheels)
    damping = 0.0
    for iteration in range(1, settings.max_iterations + 1):
        step = _step(prior, point, damping, settings.solver)
        trial = None
        if step is not None and np.abs(step.calibration_step).max(initial=0.0) < 2.0:
            at = point.u + step.calibration_step
            table = wheel_table(at)
            for move in (roll_out, retract):
                trial = _evaluate(prior, move(point, step, table), at, tables, table)
                if trial.cost < point.cost:
                    break
        if trial is None or not np.isfinite(trial.cost) or trial.cost > point.cost * (1 + 1e-12):
            damping = max(damping * 10.0, FIRST_DAMPING)
            if damping > LARGEST_DAMPING:
                return point, iteration, False
            continue
        drop = point.cost - trial.cost
        point = trial
        damping = 0.0 if damping <= FIRST_DAMPING else damping / 10.0
        if drop <= settings.tolerance * max(point.cost, 1e-9) or drop < 1e-9:
            return point, iteration, True
    return point, settings.max_iterations, False


def reach(problem: Problem, u: Floats, sigma: Floats, heading: float) -> int:
    """Return the number of keyframes over which dead reckoning keeps its heading.

    `sigma` (G, G) is the covariance of the calibration u, `heading` the heading variance at the
    first keyframe. The limit is where the predicted heading sigma exceeds BENT: there the path
    bends away from its linearisation. Where a yaw sensor or gyro gives the rotation nothing
    grows. O(K).
    """
    wheels = problem.wheel_table(u)
    free = wheels.calibration.stop
    unknown = np.isnan(problem.turn)
    by_calibration = np.cumsum(wheels.measurements[:, 3 + 2 * free :] * unknown[:, None], axis=0)
    covariance = np.linalg.inv(wheels.sqrt_information)
    noise = np.cumsum(np.einsum("kb,kb->k", covariance[:, 2], covariance[:, 2]) * unknown)
    spread = np.einsum("kp,pq,kq->k", by_calibration, sigma[:free, :free], by_calibration)
    lost = np.flatnonzero(heading + noise + spread > BENT**2)
    return int(lost[0]) if lost.size else problem.states.shape[0]


def sweep(problem: Problem, settings: Settings) -> tuple[Floats, Floats, int]:
    """Return a first guess (K, B), (G,) smoothed piece by piece from the start, and iterations.

    Dead reckoning with nominal calibration may be turned by radians after minutes, which no local
    optimiser repairs. Each window reaches as far as the heading can be trusted, begins a few
    fixes earlier than the last one ended, and hands pose and calibration on with twice their
    sigma, since a few fixes are counted twice. All windows together cost about one full solve.
    """
    total = problem.states.shape[0]
    fixes = problem.fix_keyframes()
    prior = CalibrationPrior.of(problem)
    states, u = problem.states.copy(), prior.mean
    begin, done, iterations = 0, 1, 0
    trusted = np.sqrt(np.diag(prior.information))
    settings = replace(settings, solver="arrow", tolerance=ROUGH)
    sigma = np.linalg.inv(prior.information)
    heading = 0.0
    marginals = np.zeros((0, states.shape[1], states.shape[1]))
    offset = 0
    while done < total:
        ahead = fixes[fixes >= done]
        least = int(ahead[0]) + 1 if ahead.size else total
        ahead_of = problem.window(done - 1, min(max(least, done + LOOK), total))
        end = min(max(least, done - 1 + reach(ahead_of, u, sigma, heading)), total)
        window = problem.window(begin, end)
        path = dead_reckon(window.displacement(u), window.turn)
        near = done - 1 - begin
        states[done:end, :3] = compose(
            states[done - 1, :3], between(path[near], path[near + 1 :])
        )
        states[done:end, 3:] = states[done - 1, 3:]
        if begin > 0:
            window = window.with_state_prior(states[begin], 4.0 * marginals[begin - offset])
        # Plain first: a robust loss would rather give up a fix than turn the path towards it.
        point, count, _ = _minimise(window, settings, states[begin:end], u, False, prior)
        point, more, _ = _minimise(window, settings, point.states, point.u, True, prior)
        iterations += count + more
        solution = solve(normal_equations(prior, point), 0.0, with_covariance=True)
        if solution is None or solution.covariance is None:
            break
        if np.abs(point.u * trusted).max(initial=0.0) > BEYOND:
            break  # lost: what follows could only be worse than dead reckoning from here
        states[begin:end], u = point.states, point.u
        marginals, offset = solution.covariance, begin
        sigma = np.asarray(solution.calibration_covariance)
        heading = float(marginals[-1, 2, 2])
        prior = CalibrationPrior(u, np.linalg.inv(4.0 * sigma))
        behind = fixes[fixes < end]
        begin = int(behind[max(behind.size - OVERLAP, 0)]) if behind.size else 0
        begin = max(begin, offset)
        done = end
    return states, u, iterations


def optimise(problem: Problem, settings: Settings) -> Solution:
    """Return the best trajectory and calibration of a problem.

    First with plain quadratic costs (one basin), then with the robust losses from there.
    Raises FglocError if the system is indeterminate even with the largest damping. Each
    iteration is O(N): one linearisation, one elimination.
    """
    states, u = problem.states, np.zeros(len(problem.parameters))
    iterations = 0
    sigma = np.linalg.inv(problem.prior_information)
    if reach(problem, u, sigma, 0.0) < states.shape[0] and problem.fix_keyframes().size > 1:
        states, u, iterations = sweep(problem, settings)
    point, more, converged = _minimise(problem, settings, states, u, False)
    iterations += more
    if settings.robust:
        point, more, converged = _minimise(problem, settings, point.states, point.u, True)
        iterations += more
    solution = Solution(
        point.states,
        point.u,
        point.tables,
        point.linear,
        point.weights,
        point.cost,
        iterations,
        converged,
    )
    if not settings.covariances:
        return solution
    final = solve(
        normal_equations(CalibrationPrior.of(problem), point), 0.0, with_covariance=True
    )
    if final is None:
        raise FglocError("the smoother's system is indeterminate: a sensor's noise may be wrong")
    return replace(
        solution,
        covariance=final.covariance,
        calibration_covariance=final.calibration_covariance,
    )
