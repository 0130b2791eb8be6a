"""The optimiser's loop: linearise tables, take a step, keep it only if it lowers the cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fgloc.core.geometry import between, chain, compose
from fgloc.core.measurements import Floats
from fgloc.errors import FglocError
from fgloc.factors.tables import FactorTable, Kind, Linearised, linearise
from fgloc.smoothing.arrow import ArrowSolution, NormalEquations, accumulate, solve
from fgloc.smoothing.elimination import solve_with_gtsam
from fgloc.smoothing.problem import Problem, without_loss
from fgloc.smoothing.settings import Settings

FIRST_DAMPING = 1e-4
LARGEST_DAMPING = 1e8
MISSED = 3.0
"""Root mean square of the normalised fix residuals above which a solution is mistrusted."""


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


def _prior_root(problem: Problem) -> Floats:
    """Return (G,) square-root information of the calibration priors, whose mean is nominal.

    Solver variables are zero at nominal, except those that have no logarithm or shift: a sensor
    block's variable is its offset from nominal, so the mean is zero everywhere.
    """
    return np.array([1.0 / p.solver_sigma for p in problem.parameters])


def _evaluate(
    problem: Problem, states: Floats, u: Floats, tables: Sequence[FactorTable], wheels: FactorTable
) -> _Point:
    """Linearise all tables at a state and sum up the cost."""
    everything = (wheels, *tables)
    linear = tuple(linearise(t, states, u) for t in everything)
    weights = []
    prior = _prior_root(problem) * u
    cost = 0.5 * float(prior @ prior)
    for table, rows in zip(everything, linear, strict=True):
        squared = np.einsum("md,md->m", rows.residual, rows.residual)
        cost += float(np.sum(table.loss.cost(squared)))
        weights.append(table.loss.weight(squared))
    return _Point(states, u, everything, linear, tuple(weights), cost)


def normal_equations(problem: Problem, point: _Point | Solution) -> NormalEquations:
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
    information = _prior_root(problem) ** 2
    index = np.arange(point.u.size)
    system.corner[index, index] += information
    system.gradient_corner[:] += information * point.u
    return system


def _step(
    problem: Problem, point: _Point, damping: float, solver: str
) -> ArrowSolution | None:
    """Solve for one step with the chosen linear solver."""
    if solver == "arrow":
        return solve(normal_equations(problem, point), damping)
    root = _prior_root(problem)
    extra = None
    if damping > 0.0:
        system = normal_equations(problem, point)
        lead = np.einsum("kaa->ka", system.diagonal).ravel()
        extra = np.sqrt(damping * np.concatenate([lead, np.diag(system.corner)]))
    linear = list(zip(point.tables, point.linear, point.weights, strict=True))
    return solve_with_gtsam(linear, *point.states.shape, (root, root * point.u), extra)


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
) -> tuple[_Point, int, bool]:
    """Run Gauss–Newton with Levenberg–Marquardt damping where a plain step does not help."""
    tables = problem.tables if robust else tuple(without_loss(t) for t in problem.tables)

    def wheel_table(at: Floats) -> FactorTable:
        table = problem.wheel_table(at, whitening)
        return table if robust else without_loss(table)

    whitening: Floats | None = None
    wheels = wheel_table(u)
    # The weights of one run stay those of its first linearisation: costs must be comparable.
    whitening = wheels.sqrt_information
    point = _evaluate(problem, states, u, tables, wheels)
    damping = 0.0
    for iteration in range(1, settings.max_iterations + 1):
        step = _step(problem, point, damping, settings.solver)
        trial = None
        if step is not None and np.abs(step.calibration_step).max(initial=0.0) < 2.0:
            at = point.u + step.calibration_step
            table = wheel_table(at)
            for move in (roll_out, retract):
                trial = _evaluate(problem, move(point, step, table), at, tables, table)
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


def _misses_fixes(point: _Point) -> bool:
    """Return True if the fixes, which no correct solution misses by much, are missed by much."""
    rows = [
        linear.residual.ravel()
        for table, linear in zip(point.tables, point.linear, strict=True)
        if table.kind in (Kind.POSITION_FIX, Kind.POSE_FIX)
    ]
    normalised = np.concatenate(rows) if rows else np.zeros(1)
    return float(np.sqrt(np.mean(normalised**2))) > MISSED


def _grow(problem: Problem, settings: Settings) -> tuple[Floats, Floats, int]:
    """Return a first guess (K, B) and (G,) learnt on growing beginnings of the drive.

    Each round doubles the length, so that all rounds together cost about one full solve each.
    """
    fixes = [t.first for t in problem.tables if t.kind in (Kind.POSITION_FIX, Kind.POSE_FIX)]
    stops = np.unique(np.concatenate(fixes)) if fixes else np.zeros(1, np.int64)
    total = problem.states.shape[0]
    length = int(stops[min(2, stops.size - 1)]) + 1
    states, u = problem.states, np.zeros(len(problem.parameters))
    iterations = 0
    while 1 < length < total:
        part = problem.head(length)
        point, count, _ = _minimise(part, settings, states[:length], u, True)
        iterations += count
        u = point.u
        path = problem.reckon(u)
        onward = compose(point.states[-1, :3], between(path[length - 1], path[length:]))
        states = states.copy()
        states[:length] = point.states
        states[length:, :3] = onward
        states[length:, 3:] = point.states[-1, 3:]
        length *= 2
    return states, u, iterations


def optimise(problem: Problem, settings: Settings) -> Solution:
    """Return the best trajectory and calibration of a problem.

    First with plain quadratic costs (one basin), then with the robust losses from there.
    Raises FglocError if the system is indeterminate even with the largest damping. Each
    iteration is O(N): one linearisation, one elimination.
    """
    u = np.zeros(len(problem.parameters))
    point, iterations, converged = _minimise(problem, settings, problem.states, u, False)
    if not converged or _misses_fixes(point):
        # Dead reckoning was off by more than a linearisation can bend: learn the calibration on
        # the beginning, then twice as much, and so on.
        states, warm, more = _grow(problem, settings)
        again = _minimise(problem, settings, states, warm, False)
        iterations += more + again[1]
        if again[0].cost < point.cost:
            point, converged = again[0], again[2]
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
    final = solve(normal_equations(problem, point), 0.0, with_covariance=True)
    if final is None:
        raise FglocError("the smoother's system is indeterminate: a sensor's noise may be wrong")
    return Solution(
        **{
            **{f: getattr(solution, f) for f in Solution.__dataclass_fields__},
            "covariance": final.covariance,
            "calibration_covariance": final.calibration_covariance,
        }
    )
