"""Wheel slip in a drive: whether to look for it, the graph with a slip a wheel, what was found.

Most drives need none of it: robust losses give up the odd interval. Where the wheels contradict
each other (four encoders on two sides), or the other sensors for longer, giving up is too little:
what the other wheels tell is lost with it, and a wheel that slips for seconds pulls on track and
yaw. Then every driven wheel gets a slip in every interval, sparse in time and between wheels
(`fgloc.factors.slip`), and the better explanation is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fgloc.core.measurements import Floats
from fgloc.estimator import SLIPPING, WheelSlip
from fgloc.factors.robust import PLAIN
from fgloc.factors.slip import SlipModel, likely_side, redundancy_table, slip_tables
from fgloc.factors.tables import FactorTable, Kind, linearise
from fgloc.smoothing.minimise import CalibrationPrior, Point, minimise
from fgloc.smoothing.optimise import Solution, finish
from fgloc.smoothing.problem import FIXES, Problem
from fgloc.smoothing.settings import Settings
from fgloc.smoothing.slip_report import runs, wheel_slips

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


@dataclass(frozen=True)
class Explanation:
    """A drive explained by wheels that slip."""

    problem: Problem
    """The graph with slips."""
    point: Point
    """Its minimum."""
    converged: bool
    """Whether the minimum was reached."""

    @property
    def slipping(self) -> npt.NDArray[np.bool_]:
        """Return (K-1, W): in which interval which driven wheel slips."""
        return where_slipping(self.problem, self.point)


def look_for_slip(
    problem: Problem, solution: Solution, settings: Settings
) -> tuple[Problem, Solution]:
    """Return problem and solution with slips where those explain a drive far better.

    Costs nothing but a look at residuals where nothing is suspect, else about two more solutions
    of a graph with one more unknown a wheel and keyframe. O(K).
    """
    model, plain = settings.slip, solution.point
    if model is None or not settings.robust:
        return problem, solution
    slipping = replace(with_slips(problem, model), landmarks=plain.landmarks)
    if not _suspect(slipping, solution):
        return problem, solution
    # A slip that bent the calibration is better sought from where it was not bent yet.
    starts = ((plain.states, plain.u), (problem.states, np.zeros_like(plain.u)))
    found, count = explain(slipping, plain, settings, starts)
    iterations = solution.iterations + count
    if found is None or float(np.mean(found.slipping.any(axis=1))) > SELDOM:
        return problem, replace(solution, iterations=iterations)
    stopped = "the cost falls no further" if found.converged else "no step lowers the cost"
    return slipping, finish(slipping, settings, found.point, iterations, found.converged, stopped)


def explain(
    slipping: Problem,
    plain: Point,
    settings: Settings,
    starts: Sequence[tuple[Floats, Floats]],
    prior: CalibrationPrior | None = None,
    gain: float = GAIN,
) -> tuple[Explanation | None, int]:
    """Return the slips that explain a graph `with_slips` far better than `plain`, or None.

    `plain` is its solution without slips, `starts` are states (K, B) without slips and calibrations
    (G,) to look from, `prior` replaces the calibration's, `gain` is what each stretch of slip must
    save. Returns the iterations too.
    """
    width = plain.states.shape[1]
    none = np.zeros((plain.states.shape[0], slipping.states.shape[1] - width))
    before = _without_slips(slipping, plain)
    best, iterations = None, 0
    for states, u in starts:
        point, count = _first_look(slipping, settings, np.hstack([states, none]), u, prior)
        iterations += count
        if best is None or point.cost < best.cost:
            best = point
    # Without one stretch that counts, the gain is noise that was soaked up everywhere.
    if best is None or best.cost > before - gain or not where_slipping(slipping, best).any():
        return None, iterations
    point, count, converged = minimise(
        slipping, settings, best.states, best.u, True, prior, best.landmarks
    )
    found = Explanation(slipping, point, converged)
    stretches = sum(len(runs(column)) for column in found.slipping.T)
    believed = stretches > 0 and point.cost < before - gain * stretches
    return found if believed else None, iterations + count


def with_slips(problem: Problem, model: SlipModel) -> Problem:
    """Return the problem with a slip for every driven wheel in every interval. O(K)."""
    base, slot = problem.robot.base, problem.states.shape[1]
    wheels = len(base.driven)
    seconds = np.diff(problem.keyframes_ns) * 1e-9
    side = likely_side(base, problem.split, model)
    tables = [_wider(t, slot, wheels) if t.kind == Kind.STATE_PRIOR else t for t in problem.tables]
    tables += slip_tables(model, side, seconds, slot, wheels)
    contradiction = redundancy_table(
        problem.split, problem.robot, problem.free, slot, problem.wheel_loss
    )
    if contradiction is not None:
        tables.append(contradiction)
    states = np.hstack([problem.states, np.zeros((problem.states.shape[0], wheels))])
    return replace(problem, tables=tuple(tables), states=states, slip_slot=slot)


def _wider(prior: FactorTable, slot: int, wheels: int) -> FactorTable:
    """Return a joint prior of state and calibration that says nothing of slips at `slot`."""
    n = prior.dimension
    kept = np.r_[0:slot, slot + wheels : n + wheels]
    root = np.zeros((prior.first.size, n + wheels, n + wheels))
    root[:, kept[:, None], kept] = prior.sqrt_information
    rows = np.zeros((prior.first.size, 2 * (n + wheels)))
    rows[:, kept], rows[:, n + wheels + kept] = prior.measurements[:, :n], prior.measurements[:, n:]
    return replace(prior, measurements=rows, sqrt_information=root)


def slips_of(problem: Problem, solution: Solution) -> tuple[WheelSlip, ...]:
    """Return when which wheel slipped by 5 % or more, in order of time; empty without slips."""
    if problem.slip_slot < 0:
        return ()
    names = problem.robot.base.driven_names
    columns = slice(problem.slip_slot, problem.slip_slot + len(names))
    slips = problem.slips(solution.point.states)
    sigmas = np.full(slips.shape, np.nan)
    if solution.covariance is not None:
        sigmas = np.sqrt(np.diagonal(solution.covariance, axis1=1, axis2=2)[1:, columns])
    slipping = where_slipping(problem, solution.point)
    return wheel_slips(names, problem.keyframes_ns, slips, sigmas, slipping)


def seen_by_others(problem: Problem) -> bool:
    """Return True if camera or fixes saw the motion as well."""
    return any(t.kind in (Kind.CAMERA, *FIXES) and t.sensor != "start" for t in problem.tables)


def where_slipping(problem: Problem, point: Point) -> npt.NDArray[np.bool_]:
    """Return (K-1, W): in which interval which driven wheel turns and slips."""
    slips = problem.slips(point.states)
    rolled = np.add.reduceat(problem.split.angles, problem.split.bounds[:-1], axis=0)
    return np.asarray((np.abs(slips) > SLIPPING) & (rolled != 0.0))


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


def _without_slips(slipping: Problem, point: Point) -> float:
    """Return what the drive costs without slips, the wheels' own contradictions included."""
    table = _contradiction(slipping)
    if table is None:
        return point.cost
    own = linearise(table, np.zeros_like(slipping.states), point.u)
    return point.cost + float(np.sum(table.loss.cost(own.squared)))


def _first_look(
    problem: Problem,
    settings: Settings,
    states: Floats,
    u: Floats,
    prior: CalibrationPrior | None,
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
        point, count, _ = minimise(
            stage, rough, point.states, point.u, True, prior, point.landmarks
        )
        iterations += count
    return point, iterations
