"""Smoothing a window: forward at every update, the whole window now and then.

The graph of the window is a chain of keyframes with one calibration vector, so that eliminating it
from the oldest keyframe on is a square-root information filter: what is carried to a keyframe is
the joint prior of its state and the calibration by everything older. New measurements at the
newest keyframe need one step of that filter; late ones a few; and once a second the whole window
is linearised anew at its smoothed states, robust weights included.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fgloc.core.consistency import gate_threshold
from fgloc.core.geometry import compose
from fgloc.core.measurements import Floats
from fgloc.errors import FglocError
from fgloc.factors.tables import FactorTable, Kind, Linearised, linearise
from fgloc.online.live_table import LiveTable
from fgloc.online.settings import OnlineSettings
from fgloc.online.window import Window
from fgloc.smoothing.arrow import Elimination, eliminate, stack
from fgloc.smoothing.minimise import CalibrationPrior, Point, minimise

BENT = 0.3
"""A step that turns a keyframe by more [rad] is beyond its linearisation."""
FAR = 0.5
"""So is one that changes a calibration variable (log-ratio or half tracks) by more."""


PASSES = 3
"""The whole window is linearised so often at most."""
SETTLED = 0.3
"""A change of a robust weight that is worth another pass."""

Judging = tuple[Floats, Floats, dict[int, float]]
"""Joint covariance of state and calibration, that of the last displacement, gates by dimension."""


class SolverError(FglocError):
    """The window does not determine its keyframes, whatever is tried."""


@dataclass(frozen=True)
class Posterior:
    """What is known at a keyframe from everything up to now."""

    number: int
    """Keyframe."""
    calibration: Floats
    """(G,) calibration in solver variables."""
    root: Floats
    """(B+G, B+G) square-root information of state (body axes) and calibration."""
    covariance: Floats
    """(B+G, B+G) their joint covariance."""


@dataclass(frozen=True)
class Judged:
    """The innovations of one table's new measurements."""

    table: LiveTable
    """Where they are."""
    nis: Floats
    """(M,) normalised innovations squared."""


class WindowSmoother:
    """Keeps a window solved."""

    def __init__(self, window: Window, settings: OnlineSettings) -> None:
        self._window = window
        self._settings = settings
        self._gates = {d: gate_threshold(settings.gate_probability, d) for d in (1, 2, 3)}
        self._since_whole = 0
        self.calibration = np.zeros(len(window.layout.parameters))
        self.posterior: Posterior | None = None
        self.repairs = 0
        self.nis: dict[str, list[float]] = {}

    @property
    def unsolved(self) -> int:
        """Return how many keyframes were made since the last step."""
        solved = -1 if self.posterior is None else self.posterior.number
        return self._window.newest - solved

    def begin(self) -> None:
        """Solve the first keyframe."""
        self._whole(None)

    def update(self, dirty: int | None, joint: Floats, moved: Floats) -> dict[str, Floats]:
        """Smooth from the oldest keyframe with a new factor, `dirty`, on.

        `joint` (B+G, B+G) is the predicted covariance of the newest state and the calibration,
        `moved` (3, 3) that of the wheels' displacement since the last step; what new measurements
        are worth is judged by them. Returns the last weights of all factors that left the window,
        by sensor.
        """
        window, solved = self._window, self.posterior
        assert solved is not None
        self._since_whole += window.newest - solved.number
        judging = (joint, moved, self._gates)
        if self._since_whole < self._settings.relinearise_every and dirty is not None:
            forward = dirty > solved.number
            begin = solved.number if forward else max(dirty - 1, window.base)
            prior = posterior_prior(window, solved) if forward else carried_prior(window, begin)
            if prior is not None:
                step = self._step(begin, prior, forward, judging)
                if step is not None and trusted(step):
                    self._accept(step)
                    return {}
        self._since_whole = 0
        self._whole(judging)
        return self._slide()

    def _step(
        self, begin: int, prior: FactorTable, forward: bool, judging: Judging | None
    ) -> Pass | None:
        """Take one step and note what the new measurements' innovations were."""
        step, judged = run_pass(self._window, begin, prior, self.calibration, forward, judging)
        for one in judged:
            count = self.nis.setdefault(one.table.sensor, [0.0, 0.0])
            count[0] += float(one.nis.sum())
            count[1] += one.nis.size * one.table.sqrt_information.view.shape[1]
        return step

    def _accept(self, step: Pass) -> None:
        """Make a step's result the window's."""
        self.posterior = accept(self._window, step)
        self.calibration = step.calibration

    def _whole(self, judging: Judging | None) -> None:
        """Linearise the whole window anew, twice where the weights change much."""
        window = self._window
        assert window.prior is not None
        for _ in range(PASSES):
            step = self._step(window.base, window.prior, False, judging)
            if step is None or not trusted(step):
                self._repair()
                step = self._step(window.base, window.prior, False, judging)
            if step is None:
                raise SolverError
            self._accept(step)
            if reweight(window, step) < SETTLED:
                break

    def _repair(self) -> None:
        """Look for the window's minimum with damped steps: the plain ones led too far."""
        window = self._window
        assert window.prior is not None
        self.repairs += 1
        end = window.newest + 1
        tables = [window.prior]
        for live in window.tables.values():
            rows = live.rows(window.base, end)
            if rows.start < rows.stop:
                tables.append(live.view(rows, window.base))
        problem = window.problem(window.base, end, tuple(tables))
        g = self.calibration.size
        free = CalibrationPrior(np.zeros(g), np.zeros((g, g)))
        best: Point | None = None
        for plain_first in (False, True):
            states, u = problem.states.copy(), self.calibration
            if plain_first:
                point, _, _ = minimise(problem, self._settings, states, u, False, free)
                states, u = point.states, point.u
            point, _, _ = minimise(problem, self._settings, states, u, True, free)
            if best is None or point.cost < best.cost:
                best = point
        assert best is not None
        window.states.view[:] = best.states
        self.calibration = best.u
        window.wheel_weight.view[:-1] = best.weights[0]
        for live in window.tables.values():
            for table, weights in zip(best.tables, best.weights, strict=True):
                if (table.sensor, table.kind) == (live.sensor, live.kind):
                    live.weight.view[live.rows(window.base, end)] = weights

    def _slide(self) -> dict[str, Floats]:
        """Sum up keyframes older than the lag in a prior; return their factors' last weights."""
        window, lag = self._window, self._settings.lag_s
        if not np.isfinite(lag):
            return {}
        oldest = window.number_at(window.stamp(window.newest) - int(lag * 1e9))
        if oldest <= window.base:
            return {}
        prior = carried_prior(window, oldest)
        if prior is None:
            return {}
        seconds = (window.stamp(oldest) - window.stamp(window.base)) * 1e-9
        window.prior = self._loosened(prior, seconds)
        return window.drop(oldest)

    def _loosened(self, prior: FactorTable, seconds: float) -> FactorTable:
        """Let the robot's own parameters walk for some time.

        With u' = u + walk, u is eliminated from the rows of the prior and of the walk; on rows,
        not on covariances, which would lose digits.
        """
        layout = self._window.layout
        walk = self._settings.calibration_walk * np.sqrt(seconds)
        if not walk > 0.0:
            return prior
        free = len(layout.free)
        n, b = layout.size, layout.width
        sigma = np.array([p.solver_sigma for p in layout.parameters[:free]])
        root = prior.sqrt_information[0]
        own = slice(b, b + free)
        rows = np.zeros((free + n, free + n))
        rows[:free, :free] = np.diag(1.0 / (walk * sigma))
        rows[:free, free + b : free + b + free] = -rows[:free, :free]
        rows[free:, :free] = root[:, own]
        rows[free:, free:] = root
        rows[free:, free + b : free + b + free] = 0.0
        triangle = np.linalg.qr(rows, mode="r")[free:, free:]
        return replace(prior, sqrt_information=np.ascontiguousarray(triangle)[None])


def prior_table(mean_state: Floats, calibration: Floats, root: Floats) -> FactorTable:
    """Return the joint prior of a window's first keyframe and the calibration."""
    return FactorTable(
        Kind.STATE_PRIOR,
        "prior",
        np.zeros(1, np.int64),
        np.concatenate([mean_state, calibration])[None],
        np.ascontiguousarray(root)[None],
        slice(0, calibration.size),
    )


@dataclass(frozen=True)
class Pass:
    """One Gauss–Newton step over the keyframes from `begin` to the newest."""

    begin: int
    """First keyframe."""
    states: Floats
    """(K, B) states after the step."""
    calibration: Floats
    """(G,) calibration after the step."""
    elimination: Elimination
    """Carries and triangular rows, linearised at the states before the step."""
    tables: tuple[FactorTable, ...]
    """Factors, the wheels' first, then the prior."""
    live: tuple[LiveTable, ...]
    """Where tables[2:] come from."""
    squared: tuple[Floats, ...]
    """(M,) squared whitened residuals of `tables` that the step predicts."""
    turned: float
    """Largest change of a heading [rad]."""


def posterior_prior(window: Window, posterior: Posterior) -> FactorTable:
    """Return everything known at the posterior's keyframe as a prior on it."""
    state = window.states.view[posterior.number - window.base]
    return prior_table(state, posterior.calibration, posterior.root)


def carried_prior(window: Window, number: int) -> FactorTable | None:
    """Return what older keyframes tell of one as a prior; None where it cannot be told.

    The carried rows say S·step = right side at the point of linearisation; the mean that makes
    the residual vanish is that point moved by S⁻¹ right side.
    """
    if number == window.base:
        return window.prior
    row = number - window.base
    carry = window.carry.view[row]
    n = carry.shape[0]
    b = window.layout.width
    try:
        step = np.linalg.solve(carry[:, :n], carry[:, n])
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(step).all():
        return None
    mean = window.linear_states.view[row] + step[:b]
    mean[:3] = compose(window.linear_states.view[row][:3], step[:3])
    return prior_table(mean, window.linear_calibration.view[row] + step[b:], carry[:, :n].copy())


def judge(
    live: LiveTable,
    rows: slice,
    linear: Linearised,
    joint: Floats,
    moved: Floats,
    gate: float,
) -> Judged | None:
    """Give the new rows of a table their first weights, by what was expected of them.

    The innovation's covariance is that of the measurement plus that of the prediction: `joint`
    (B+G, B+G) of the newest state and the calibration for factors of one keyframe, `moved` (3, 3)
    of the wheels' last displacement for factors between two. A normalised innovation squared
    beyond `gate` is weighted as the loss would weight a residual of that size; a large residual
    that the prediction's own uncertainty explains is not.
    """
    weight = live.weight.view[rows]
    new = np.flatnonzero(np.isinf(weight))
    if new.size == 0:
        return None
    b = linear.by_first.shape[2]
    sides = joint if not live.pairwise else joint.copy()
    if live.pairwise:
        sides[:b, :] = 0.0
        sides[:, :b] = 0.0
        sides[:3, :3] = moved
    by_state = linear.by_second if live.pairwise else linear.by_first
    columns = [*range(b), *range(b + live.calibration.start, b + live.calibration.stop)]
    nis = np.empty(new.size)
    within = sides[np.ix_(columns, columns)]
    for at, k in enumerate(new):
        jacobian = np.concatenate([by_state[k], linear.by_calibration[k]], axis=1)
        innovation = np.eye(jacobian.shape[0]) + jacobian @ within @ jacobian.T
        r = linear.residual[k]
        nis[at] = float(r @ np.linalg.solve(innovation, r))
    weight[new] = np.where(nis > gate, live.loss.weight(nis), 1.0)
    return Judged(live, nis)


def run_pass(
    window: Window,
    begin: int,
    prior: FactorTable,
    calibration: Floats,
    after_begin: bool,
    judging: Judging | None,
) -> tuple[Pass | None, list[Judged]]:
    """Linearise the keyframes from `begin` on at their states and take one step.

    `after_begin`: factors of keyframe `begin` alone are in the prior already. `judging` holds the
    joint covariance, that of the last displacement, and the gates by residual dimension.
    None if the system is indeterminate or its solution not finite. O(K) with a compiled core.
    """
    end = window.newest + 1
    states = window.states.view[begin - window.base :]
    tables: list[FactorTable] = []
    live: list[LiveTable] = []
    slices: list[slice] = []
    for table in window.tables.values():
        low = begin + 1 if after_begin and not table.pairwise else begin
        rows = table.rows(low, end)
        if rows.start < rows.stop:
            tables.append(table.view(rows, begin))
            live.append(table)
            slices.append(rows)
    problem = window.problem(begin, end, ())
    wheels = problem.wheel_table(calibration)
    everything = (wheels, prior, *tables)
    linear = [linearise(t, states, calibration) for t in everything]
    judged: list[Judged] = []
    weights = [window.wheel_weight.view[begin - window.base : -1], np.ones(1)]
    for table, rows, lin in zip(live, slices, linear[2:], strict=True):
        if judging is not None:
            joint, moved, gates = judging
            found = judge(table, rows, lin, joint, moved, gates[lin.residual.shape[1]])
            if found is not None:
                judged.append(found)
        weight = table.weight.view[rows]
        weights.append(np.where(np.isinf(weight), 1.0, weight))
    width = window.layout.width
    no_rows = np.zeros((0, calibration.size + 1))
    system = stack(
        list(zip(everything, linear, weights, strict=True)), states.shape[0], width, no_rows
    )
    elimination = eliminate(system)
    if elimination is None:
        return None, judged
    step, u = elimination.step, elimination.calibration_step
    moved_states = states + step
    moved_states[:, :3] = compose(states[:, :3], step[:, :3])
    squared = tuple(
        _predicted(t, lin, step, u) for t, lin in zip(everything, linear, strict=True)
    )
    return (
        Pass(
            begin,
            moved_states,
            calibration + u,
            elimination,
            everything,
            tuple(live),
            squared,
            float(np.abs(step[:, 2]).max()),
        ),
        judged,
    )


def _predicted(table: FactorTable, linear: Linearised, step: Floats, u: Floats) -> Floats:
    """Return the (M,) squared whitened residuals after a step, to first order."""
    r = linear.residual + np.einsum("kab,kb->ka", linear.by_first, step[table.first])
    if table.pairwise:
        r += np.einsum("kab,kb->ka", linear.by_second, step[table.first + 1])
    r += linear.by_calibration @ u[table.calibration]
    return np.asarray(np.einsum("ka,ka->k", r, r))


def trusted(step: Pass) -> bool:
    """Return True if a step stays where its linearisation holds."""
    change = np.abs(step.elimination.calibration_step).max(initial=0.0)
    return step.turned < BENT and bool(change < FAR)


def accept(window: Window, step: Pass) -> Posterior:
    """Write a step's states and carries into the window; return what is known at the newest."""
    row = step.begin - window.base
    before = window.states.view[row:].copy()
    window.states.view[row:] = step.states
    e = step.elimination
    window.carry.view[row + 1 :] = e.carries[1:]
    window.linear_states.view[row + 1 :] = before[1:]
    window.linear_calibration.view[row + 1 :] = step.calibration - e.calibration_step
    root = e.newest_root()
    inverse = np.linalg.inv(root)
    return Posterior(window.newest, step.calibration, root, inverse @ inverse.T)


def reweight(window: Window, step: Pass) -> float:
    """Give all factors of a whole-window pass the robust weights of its predicted residuals.

    Returns the largest change of a weight.
    """
    wheels = step.tables[0].loss.weight(step.squared[0])
    old = window.wheel_weight.view[:-1]
    change = float(np.abs(wheels - old).max(initial=0.0))
    window.wheel_weight.view[:-1] = wheels
    for live, table, squared in zip(step.live, step.tables[2:], step.squared[2:], strict=True):
        rows = live.rows(step.begin, window.newest + 1)
        weights = table.loss.weight(squared)
        change = max(change, float(np.abs(weights - live.weight.view[rows]).max(initial=0.0)))
        live.weight.view[rows] = weights
    return change
