"""Wheel slip in a drive: whether to look for it, the graph with a slip a wheel, what was found.

Most drives need none of it: robust losses give up the odd interval. Where the wheels contradict
each other (four encoders on two sides), or the other sensors for longer, giving up is too little:
what the other wheels tell is lost with it, and a wheel that slips for seconds pulls on track and
yaw. Then every driven wheel gets a slip in every interval, sparse in time and between wheels
(`fgloc.factors.slip`), and the better explanation is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from fgloc.core.measurements import Floats
from fgloc.estimator import WheelSlip
from fgloc.factors.robust import PLAIN
from fgloc.factors.slip import SlipModel, likely_side, redundancy_table, slip_tables
from fgloc.factors.tables import FactorTable, Kind, linearise
from fgloc.smoothing.minimise import CalibrationPrior, Point, minimise
from fgloc.smoothing.optimise import Solution, finish
from fgloc.smoothing.problem import FIXES, Problem
from fgloc.smoothing.settings import Settings

TELLING = (Kind.YAW, Kind.YAW_RATE, Kind.CAMERA)
"""Sensors that see the motion of every interval; sparse fixes cannot tell when a wheel slipped."""
SUSPECT = 4.0
"""Whitened residual of the wheels, among each other or against the rest, that calls for a look."""
STRETCHED = 3.0
"""Prior sigmas of the robot's calibration at which slip is a likelier explanation."""
GAIN = 10.0
"""What each stretch of slip must save in cost: more than noise makes it save by chance."""
HELD = 0.01
"""Part of its prior within which the calibration is held while slips are sought."""
ROUGH = 1e-3
"""Relative decrease of the cost at which a first look is over."""
FEW = 15
"""Linearisations of each of its stages at most."""
SELDOM = 0.4
"""Part of a drive up to which wheels may slip; beyond it, rather a sensor is wrong."""
MOST = 6
"""So many stretches of slip are named in a note."""
SLIPPING = 0.05
"""Slip from which on a wheel is said to slip."""


def look_for_slip(
    problem: Problem, solution: Solution, settings: Settings
) -> tuple[Problem, Solution]:
    """Return problem and solution with slips where those explain a drive far better.

    Costs nothing but a look at residuals where nothing is suspect, else about two more solutions
    of a graph with one more unknown a wheel and keyframe. O(K).
    """
    model = settings.slip
    if model is None or not settings.robust:
        return problem, solution
    slipping = with_slips(problem, model)
    if not _suspect(slipping, solution):
        return problem, solution
    none = slipping.states[:, problem.states.shape[1] :]
    states = np.hstack([solution.point.states, none])
    before = _without_slips(slipping, solution.point, states)
    best, iterations = _first_look(slipping, settings, states, solution.point.u)
    # A slip that bent the calibration is better sought from where it was not bent yet.
    nominal = np.hstack([problem.states, none])
    other, count = _first_look(slipping, settings, nominal, np.zeros_like(best.u))
    iterations += count + solution.iterations
    best = min(best, other, key=lambda point: point.cost)
    # Without one stretch that counts, the gain is noise that was soaked up everywhere.
    if best.cost < before - GAIN and _slipping(slipping, best).any():
        point, count, converged = minimise(slipping, settings, best.states, best.u, True)
        iterations += count
        slips = _slipping(slipping, point)
        stretches = sum(len(_runs(column)) for column in slips.T)
        seldom = float(np.mean(slips.any(axis=1))) <= SELDOM
        if seldom and stretches and point.cost < before - GAIN * stretches:
            stopped = "the cost falls no further" if converged else "no step lowers the cost"
            found = finish(slipping, settings, point, iterations, converged, stopped)
            return slipping, found
    return problem, replace(solution, iterations=iterations)


def with_slips(problem: Problem, model: SlipModel) -> Problem:
    """Return the problem with a slip for every driven wheel in every interval. O(K)."""
    base, slot = problem.robot.base, problem.states.shape[1]
    wheels = len(base.driven)
    seconds = np.diff(problem.keyframes_ns) * 1e-9
    side = likely_side(base, problem.split, model)
    tables = [*problem.tables, *slip_tables(model, side, seconds, slot, wheels)]
    contradiction = redundancy_table(
        problem.split, problem.robot, problem.free, slot, problem.wheel_loss
    )
    if contradiction is not None:
        tables.append(contradiction)
    states = np.hstack([problem.states, np.zeros((problem.states.shape[0], wheels))])
    return replace(problem, tables=tuple(tables), states=states, slip_slot=slot)


def slip_intervals(problem: Problem, solution: Solution) -> tuple[WheelSlip, ...]:
    """Return when which wheel slipped by 5 % or more, in order of time; empty without slips."""
    if problem.slip_slot < 0:
        return ()
    found = []
    slipping = _slipping(problem, solution.point)
    for column, name in enumerate(problem.robot.base.driven_names):
        k = problem.slip_slot + column
        slips = solution.point.states[1:, k]
        sigma = np.full(slips.size, np.nan)
        if solution.covariance is not None:
            sigma = np.sqrt(solution.covariance[1:, k, k])
        for begin, end in _runs(slipping[:, column]):
            found.append(
                WheelSlip(
                    name,
                    int(problem.keyframes_ns[begin]),
                    int(problem.keyframes_ns[end]),
                    float(slips[begin:end].mean()),
                    float(sigma[begin:end].mean()),
                )
            )
    return tuple(sorted(found, key=lambda s: (s.begin_ns, s.end_ns)))


def _slipping(problem: Problem, point: Point) -> npt.NDArray[np.bool_]:
    """Return (K-1, W): in which interval which driven wheel turns and slips."""
    wheels = len(problem.robot.base.driven)
    slips = point.states[1:, problem.slip_slot :][:, :wheels]
    rolled = np.add.reduceat(problem.split.angles, problem.split.bounds[:-1], axis=0)
    return np.asarray((np.abs(slips) > SLIPPING) & (rolled != 0.0))


def slip_notes(problem: Problem, slips: Sequence[WheelSlip]) -> tuple[str, ...]:
    """Return what a user should know of the slips that were found, and of those that cannot be."""
    if problem.slip_slot < 0:
        return ()
    start = int(problem.keyframes_ns[0])
    told: dict[tuple[float, float], list[str]] = {}
    for s in slips:
        key = (round((s.begin_ns - start) * 1e-9, 1), round((s.end_ns - start) * 1e-9, 1))
        told.setdefault(key, []).append(f"{s.wheel} by {s.slip:.0%}")
    shown = [f"{a} to {b} s: {', '.join(who)}" for (a, b), who in list(told.items())[:MOST]]
    more = f", and {len(told) - MOST} stretches more" if len(told) > MOST else ""
    notes = [f"wheels slip: {'; '.join(shown)}{more}"] if told else []
    if not any(t.kind in (Kind.CAMERA, *FIXES) and t.sensor != "start" for t in problem.tables):
        notes.append(
            "without camera or fixes a slip of all wheels alike cannot be seen, and which side "
            "slips is told only by driven wheels turning too fast and braked ones too slowly"
        )
    return tuple(notes)


def _runs(mask: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return begin and end of each stretch where `mask` is true."""
    edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _contradiction(problem: Problem) -> FactorTable | None:
    """Return the table of the wheels against each other; None where they tell nothing twice."""
    for table in problem.tables:
        if table.kind == Kind.WHEEL_REDUNDANCY:
            return table
    return None


def _suspect(slipping: Problem, solution: Solution) -> bool:
    """Return True if wheels contradict each other, or what sees every interval."""
    table = _contradiction(slipping)
    if table is not None:
        own = linearise(table, slipping.states, solution.point.u)
        if float(own.squared.max(initial=0.0)) > SUSPECT**2:
            return True
    if not any(t.kind in TELLING for t in slipping.tables):
        return False
    pulled = np.abs(solution.point.u) / np.sqrt(np.diag(slipping.prior_covariance))
    if float(pulled[: len(slipping.free)].max(initial=0.0)) > STRETCHED:
        return True
    return float(solution.point.linear[0].squared.max(initial=0.0)) > SUSPECT**2


def _without_slips(slipping: Problem, point: Point, states: Floats) -> float:
    """Return what the drive costs without slips, the wheels' own contradictions included."""
    table = _contradiction(slipping)
    if table is None:
        return point.cost
    own = linearise(table, states, point.u)
    return point.cost + float(np.sum(table.loss.cost(own.squared)))


def _first_look(
    problem: Problem, settings: Settings, states: Floats, u: Floats
) -> tuple[Point, int]:
    """Solve roughly with wheels that are to be believed but for their slips, then robustly.

    Slips come before calibration: a wrong track explains a slip, too, and there is no way back.
    """
    tables = [
        replace(t, loss=PLAIN) if t.kind == Kind.WHEEL_REDUNDANCY else t for t in problem.tables
    ]
    rigid = replace(problem, wheel_loss=PLAIN, tables=tuple(tables))
    held = CalibrationPrior.gaussian(u, HELD**2 * problem.prior_covariance)
    rough = replace(settings, tolerance=ROUGH, max_iterations=FEW)
    point, iterations, _ = minimise(rigid, rough, states, u, True, held)
    for stage in (rigid, problem):
        point, count, _ = minimise(stage, rough, point.states, point.u, True)
        iterations += count
    return point, iterations
