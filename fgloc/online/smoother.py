"""Smoothing a window: forward at every update, the whole window now and then.

The graph of the window is a chain of keyframes with one calibration vector, so that eliminating it
from the oldest keyframe on is a square-root information filter: what is carried to a keyframe is
the joint prior of its state and the calibration by everything older. New measurements at the
newest keyframe need one step of that filter; late ones a few; and once a second the whole window
is linearised anew at its smoothed states, robust weights included. Landmarks that the window sees
join the calibration in one border; the others are put aside (`fgloc.online.landmarks`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from fgloc.core.consistency import gate_threshold
from fgloc.core.geometry import chain
from fgloc.core.measurements import Floats
from fgloc.errors import FglocError
from fgloc.factors.tables import FactorTable, linearise
from fgloc.online.descent import descend
from fgloc.online.evidence import Evidence, Trial, before, evidence, mean_cost
from fgloc.online.keeper import Keeper
from fgloc.online.landmarks import informed, split
from fgloc.online.passes import (
    Judged,
    Judging,
    Pass,
    accept,
    reweight,
    run_pass,
    trusted,
)
from fgloc.online.priors import (
    Posterior,
    after_walk,
    carried_prior,
    definite,
    posterior_prior,
    prior_table,
)
from fgloc.online.settings import OnlineSettings
from fgloc.online.surface import SurfaceWatch
from fgloc.online.window import Window
from fgloc.smoothing.minimise import CalibrationPrior, Point, minimise
from fgloc.smoothing.problem import FIXES, HIDDEN, Problem
from fgloc.smoothing.sweep import starting_calibrations
from fgloc.smoothing.trust import ARBITERS, STRAINED

PASSES = 3
"""The whole window is linearised so often at most."""
LONGEST = 1000
"""Keyframes that a window may hold until the heading is known well enough to sum it up."""
SURE = 0.1
"""Heading sigma [rad] up to which summing up old keyframes does no harm."""
SELDOM = 30
"""Keyframes of the window for each one between two passes over all of it, at least."""
STEPS = 12
"""Steps that a search for a minimum may take: the robot does not stand still meanwhile."""
ROUGH = 1e-3
"""Relative decrease at which a minimum is found well enough; the next passes go on from there."""
HELD = 6000
"""Keyframes that a window may hold while it is not known where the drive started."""
TURNED = 5e-3
"""A step that turns the window by more [rad] is followed by another where there are landmarks."""
SETTLED = 0.3
"""A change of a robust weight that is worth another pass."""


class SolverError(FglocError):
    """The window does not determine its keyframes, whatever is tried."""


class WindowSmoother:
    """Keeps a window solved."""

    def __init__(self, window: Window, settings: OnlineSettings) -> None:
        self.window = window
        self._settings = settings
        self.gates = {d: gate_threshold(settings.gate_probability, d) for d in (1, 2, 3)}
        self._since_whole = 0
        self.border = np.zeros(len(window.layout.parameters))
        self._posterior: Posterior | None = None
        self.repairs = 0
        self._strain = 0.0
        self.holding = False
        self._fixes = 0
        self._wait = 0
        self._pause = 1
        self.judged: list[Judged] = []
        self._keeper = Keeper(window)
        self._surface = SurfaceWatch(window)
        # Landmarks put aside that the next update takes back into use.
        self.wanted: list[int] = []
        self._anew = False

    @property
    def posterior(self) -> Posterior:
        """Return what is known at the keyframe solved last; there is one after `begin`."""
        assert self._posterior is not None
        return self._posterior

    @property
    def calibration(self) -> Floats:
        """Return the (G,) calibration: the border's first columns."""
        return self.border[: len(self.window.layout.parameters)]

    @property
    def unsolved(self) -> int:
        """Return how many keyframes were made since the last step."""
        return self.window.newest - self.posterior.number

    @property
    def smoothed_whole(self) -> bool:
        """Return True if the last update went over the whole window."""
        return self._since_whole == 0

    def begin(self) -> None:
        """Solve the first keyframe."""
        self._whole(None)

    def start_again(self) -> None:
        """Solve the window from its own factors as if nothing of it were solved.

        Raises SolverError (or LinAlgError) if that cannot be done.
        """
        for live in self.window.tables.values():
            live.weight.view[:] = 1.0
        if not (np.isfinite(self.window.states.view).all() and np.isfinite(self.border).all()):
            raise SolverError("the window holds states that are not finite")
        self._repair()
        self._since_whole = 0
        self._whole(None)

    def abandon(self, stamp_ns: int, state: Floats, joint: Floats) -> dict[str, Floats]:
        """Give up the window: all that is left is a keyframe of now, as dead reckoning has it.

        `state` (B,) and `joint` (B+n, B+n) are those at the stamp, which is the newest one's or
        later. Returns the last weights of all factors that are lost. Never raises. Landmarks are
        put aside: what they have in common with the pose is lost as well.
        """
        window = self.window
        dropped = window.drop(window.add_keyframe(stamp_ns, state))
        joint = self._keeper.abandon(state, self.border, joint)
        self.border = self.calibration.copy()
        root, joint = definite(joint)
        window.prior = prior_table(state, self.border, root)
        self._posterior = Posterior(window.newest, self.border, root, joint.copy())
        self._strain = 0.0
        return dropped

    def update(self, dirty: int | None, joint: Floats, moved: Floats) -> dict[str, Floats]:
        """Smooth from the oldest keyframe with a new factor, `dirty`, on.

        `joint` (B+n, B+n) is the predicted covariance of the newest state and the border, `moved`
        (3, 3) that of the wheels' displacement since the last step; what new measurements are
        worth is judged by them. Returns the last weights of all factors that left the window, by
        sensor.
        """
        window, solved = self.window, self.posterior
        self._since_whole += window.newest - solved.number
        judging = (joint, moved, self.gates)
        # A long window is linearised anew the more seldom, so that the effort stays the same.
        often = max(self._settings.relinearise_every, len(window.stamps_ns) // SELDOM)
        if self._since_whole < often and not (self.wanted or self._anew):
            # Without a new factor the wheels' are all there is to go on by.
            oldest = window.newest if dirty is None else dirty
            forward = oldest > solved.number
            begin = solved.number if forward else max(oldest - 1, window.base)
            prior = posterior_prior(window, solved) if forward else carried_prior(window, begin)
            if prior is not None:
                step = self._step(begin, prior, forward, judging)
                if step is not None and trusted(step):
                    self._accept(step)
                    # What was solved before has turned: with landmarks about, what is carried no
                    # longer fits where they are linearised, and would seem to know more.
                    turned = abs(float(step.elimination.step[0, 2]))
                    self._anew = bool(window.landmarks.used) and turned > TURNED
                    return {}
        self._since_whole, self._anew = 0, False
        idle = [k for k in self._keeper.idle() if k not in self.wanted]
        if idle:
            self.border, joint = self._keeper.put_aside(idle, self.border, joint)
        if self.wanted:
            wanted, self.wanted = self.wanted, []
            self.border = self._keeper.take_back(wanted, self.border)
        step = self._whole((joint, moved, self.gates))
        return self._slide(self._explore() or step)

    def inform(self, residual: Floats, by_border: Floats) -> None:
        """Tell something of landmarks in use; see `informed`. The next update is over all."""
        window = self.window
        assert window.prior is not None
        width = window.layout.width
        window.prior = informed(window.prior, width, self.border, residual, by_border)
        self._anew = True

    def jolt(self, begin: int, sigma: Floats) -> None:
        """Allow for motion that the wheels do not know of; see `Window.jolt`.

        The next update is over all.
        """
        self.window.jolt(begin, sigma, self.calibration)
        self._anew = True

    def enter(self, guesses: Floats, root: Floats) -> list[int]:
        """Take new landmarks into use; see `Keeper.enter`. Returns their numbers."""
        numbers, self.border, self._posterior = self._keeper.enter(
            guesses, root, self.border, self.posterior
        )
        return numbers

    def look_again(self) -> None:
        """Let the next update go over the whole window."""
        self._anew = True

    def strain(self) -> float:
        """Return the mean cost of fixes and cameras in the last pass over the whole window."""
        return self._strain

    def evidence(self) -> Evidence:
        """Return what fixes and cameras say of the window. O(K)."""
        window = self.window
        tables = window.factors(window.base, window.tables.values())
        known = {(t.sensor, t.kind): t.weight.view for t in window.tables.values()}
        states, u = window.states.view, self.calibration
        squared = [linearise(t, states, u).squared for t in tables]
        return evidence(tables, squared, [known[t.sensor, t.kind][: t.first.size] for t in tables])

    def _explore(self) -> Pass | None:
        """Look for a better minimum where the fixes are missed, more seldom the more in vain.

        Returns the last pass over the window, None where there was none.
        """
        fixes = sum(t.added for t in self.window.tables.values() if t.kind in ARBITERS)
        new, self._fixes = fixes > self._fixes, fixes
        if not new or self.strain() < STRAINED:
            return None
        self._wait -= 1
        if self._wait > 0:
            return None
        self._repair()
        step = self._whole(None)
        if self.strain() < STRAINED:
            self._pause = 1
        else:
            self._pause *= 2
        self._wait = self._pause
        return step

    def _step(
        self, begin: int, prior: FactorTable, forward: bool, judging: Judging | None
    ) -> Pass | None:
        """Take one step and note what the new measurements' innovations were."""
        step, judged = run_pass(self.window, begin, prior, self.border, forward, judging)
        self.judged += judged
        return step

    def _accept(self, step: Pass) -> None:
        """Make a step's result the window's."""
        posterior = accept(self.window, step)
        variances = np.diag(posterior.covariance)
        if not (np.isfinite(posterior.covariance).all() and (variances > 0.0).all()):
            raise SolverError("the newest keyframe has no finite covariance")
        self._posterior = posterior
        self.border = step.border

    def _whole(self, judging: Judging | None) -> Pass:
        """Linearise the whole window anew, twice where the weights change much.

        Returns the last step.
        """
        window = self.window
        assert window.prior is not None
        window.integrate_again(self.calibration)
        explore = True
        for _ in range(PASSES):
            step = self._step(window.base, window.prior, False, judging)
            if step is None or not trusted(step):
                self._repair(explore)
                explore = False
                step = self._step(window.base, window.prior, False, judging)
            if step is None:
                raise SolverError("the window does not determine its keyframes")
            self._accept(step)
            # Not the step itself: it is as large as the window, and would be in every checkpoint.
            self._strain = mean_cost(step.tables, step.squared)
            settled = reweight(window, step) < SETTLED
            if settled and not (window.landmarks.used and step.turned > TURNED):
                break
        assert step is not None
        return step

    def _repair(self, explore: bool = True) -> None:
        """Look for the window's minimum with damped steps: the plain ones led too far."""
        assert self.window.prior is not None
        self.repairs += 1
        if self.window.landmarks.used:
            self.border = descend(self.window, self.border)
            self.window.integrate_again(self.calibration)
            return
        window = self.window
        tables = window.factors(window.base, window.tables.values())
        self._move_to(self._minimum(self.window.prior, tables, explore))

    def _minimum(self, prior: FactorTable, factors: Sequence[FactorTable], explore: bool) -> Point:
        """Return the best minimum of the window with these factors and the wheels'.

        `explore`: try other starting points where the first leads to one that misses the fixes.
        """
        window = self.window
        tables = (prior, *factors)
        problem = window.problem(window.base, window.newest + 1, tables)
        free = CalibrationPrior.flat(self.calibration.size)
        best: Point | None = None
        quick = replace(self._settings, max_iterations=STEPS, tolerance=ROUGH)
        for states, u in self._starts(problem, prior, explore):
            plain, _, _ = minimise(problem, quick, states, u, False, free)
            point, _, _ = minimise(problem, quick, plain.states, plain.u, True, free)
            if best is None or point.cost < best.cost:
                best = point
            if mean_cost(point.tables, [rows.squared for rows in point.linear]) < STRAINED:
                break
        assert best is not None
        point, _, _ = minimise(problem, quick, best.states, best.u, True, free)
        return point

    def _starts(
        self, problem: Problem, prior: FactorTable, explore: bool
    ) -> Iterator[tuple[Floats, Floats]]:
        """Yield where to begin: as the window stands, then dead reckoning at several calibrations.

        Where the heading is lost between fixes, which turn it took is ambiguous, and each wrong
        answer a minimum of its own.
        """
        yield problem.states.copy(), self.calibration
        if not explore:
            return
        b, n = self.window.layout.width, self.window.layout.size
        root = prior.sqrt_information[0]
        mean = prior.measurements[0, b:n] + prior.measurements[0, n + b :]
        inverse = np.linalg.pinv(root)
        sigma = (inverse @ inverse.T)[b:, b:]
        for offset in starting_calibrations(problem, mean, sigma):
            states = problem.states.copy()
            states[:, :3] = chain(problem.displacement(offset), states[0, :3])
            yield states, offset

    def _move_to(self, point: Point) -> None:
        """Make a minimum the window's point of linearisation, with its robust weights."""
        window = self.window
        end = window.newest + 1
        window.states.view[:] = point.states
        self.border = point.u
        window.integrate_again(point.u)
        for live in window.tables.values():
            for table, weights in zip(point.tables, point.weights, strict=True):
                if (table.sensor, table.kind) == (live.sensor, live.kind):
                    live.weight.view[live.rows(window.base, end)] = weights

    def solve_without(self, sensor: str | None, prior: FactorTable, since: int = 0) -> Trial:
        """Solve the window from `prior` without what a sensor measured from keyframe `since` on.

        None: with all sensors. The window stays as it is.
        """
        window = self.window
        tables = [
            before(t, since - window.base) if t.sensor == sensor and t.kind not in HIDDEN else t
            for t in window.factors(window.base, window.tables.values())
        ]
        return Trial(self._minimum(prior, [t for t in tables if t.first.size], True))

    def adopt(self, trial: Trial, sensor: str | None, prior: FactorTable, since: int = 0) -> int:
        """Make a trial's solution the window's, and forget the sensor's factors.

        Returns how many they were.
        """
        lost = self.forget(sensor, since)
        self.window.prior = prior
        self._move_to(trial.point)
        self._whole(None)
        return lost

    def forget(self, sensor: str | None, since: int) -> int:
        """Forget a sensor's factors from keyframe `since` on; return how many they were.

        The next update is over all.
        """
        self._anew = True
        tables = self.window.tables.values()
        return sum(t.forget(since) for t in tables if t.sensor == sensor and t.kind not in HIDDEN)

    @property
    def _unsettled(self) -> bool:
        """Return True while the window should not be summed up: its linearisation is poor.

        That is so where fixes are to be had but the heading is not known well yet.
        """
        posterior = self.posterior
        fixed = any(t.kind in FIXES and t.added > 1 for t in self.window.tables.values())
        vague = posterior.covariance[2, 2] > SURE**2
        return fixed and vague and len(self.window.stamps_ns) < LONGEST

    def _slide(self, step: Pass) -> dict[str, Floats]:
        """Sum up keyframes older than the lag in a prior; return their factors' last weights.

        `step` is the last pass over the whole window.
        """
        window, lag = self.window, self._settings.lag_s
        if not np.isfinite(lag):
            return {}
        oldest = window.number_at(window.stamp(window.newest) - int(lag * 1e9))
        if self.holding:
            # Fixes may be far between while the start is unknown; but not for ever.
            full = len(window.stamps_ns) >= HELD
            oldest = min(oldest, window.base + HELD // 2) if full else window.base
        elif self._unsettled:
            return {}
        change = None if window.landmarks.used else self._surface.look(self.calibration)
        if change is not None and change.number > window.base:
            oldest = max(oldest, change.number)
        if oldest <= window.base:
            return {}
        prior = carried_prior(window, oldest)
        if prior is None:
            return {}
        aside = window.landmarks.aside
        if aside.numbers:
            aside.rebase(step.before[0], step.border - step.elimination.calibration_step)
            for k in range(oldest - window.base):
                aside.step(step.elimination.triangular[k], step.before[k + 1])
        window.prior = prior
        seconds = (window.stamp(oldest) - window.stamp(window.base)) * 1e-9
        walk = self._settings.calibration_walk * np.sqrt(seconds)
        free = window.layout.parameters[: len(window.layout.free)]
        if walk > 0.0 and free:
            sigma = walk * np.array([p.solver_sigma for p in free])
            if change is not None:
                sigma = np.hypot(sigma, change.walk)
                self._anew = True
            window.prior, walked = after_walk(prior, window.layout.width, sigma)
            if aside.numbers:
                aside.walk(walked, split(prior, aside.width)[2])
        return window.drop(oldest)
