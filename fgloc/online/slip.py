"""Wheels that slip, found while driving: a look at the last seconds when the wheels are suspect.

A wheel that slips is taken to go on slipping as it does until the others contradict that: its
increments are shortened before they move the pose, so what is emitted is right from the first
packet after a slip was found. The look itself is that of batch (`fgloc.smoothing.slip`), over a
few seconds, with everything older summed up in a prior.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.factors.slip import redundancy_table, redundant
from fgloc.factors.tables import Kind, linearise
from fgloc.online.priors import carried_prior, without_landmarks
from fgloc.online.settings import OnlineSettings
from fgloc.online.smoother import WindowSmoother
from fgloc.online.window import GUESSED
from fgloc.smoothing.minimise import CalibrationPrior, linear_system, minimise
from fgloc.smoothing.network import step_of
from fgloc.smoothing.slip import (
    GAIN,
    SELDOM,
    STRETCHED,
    SUSPECT,
    Explanation,
    explain,
    with_slips,
)
from fgloc.smoothing.trust import STRAINED, pulled

LOOK_NS = 3_000_000_000
"""A look goes back by so much [ns], and as far before a slip that has not ended."""
LONGEST_NS = 15_000_000_000
"""But never by more [ns]."""
ROUGH = 1e-3
"""Relative decrease of the cost at which a search is over."""
STEPS = 10
"""Steps of the graph without slips that a look is compared with, at most."""
PATIENCE = 5
"""Keyframes between two looks in vain, at most."""
FIRST_S = 10.0
"""Slip in the first seconds of a drive is no reason to stop looking for it [s]."""
CHANGED = 0.01
"""A change of a slip by less is not worth integrating the wheels again."""


class SlipWatch:
    """Watches a window for wheels that contradict each other or the other sensors."""

    def __init__(self, smoother: WindowSmoother, settings: OnlineSettings) -> None:
        self._smoother = smoother
        self._settings = settings
        base = smoother.window.layout.robot.base
        # Two wheels and a yaw sensor cannot tell who lies; wheels in excess or a camera can.
        self._conditions = redundant(base)
        self._seen = smoother.window.newest
        self._wait = 0
        self._pause = 1
        self._slipping_s = 0.0
        self._driven_s = 0.0

    def look(self) -> int | None:
        """Return the oldest keyframe whose slip has changed, None if there is none.

        Costs a linearised row a keyframe where nothing is suspect, else some ten milliseconds; the
        more looks were in vain, the rarer they become.
        """
        window = self._smoother.window
        new, self._seen = range(max(self._seen, window.base) + 1, window.newest + 1), window.newest
        self._count(new)
        self._wait -= len(new)
        if not new or self._settings.slip is None or not self._able:
            return None
        begin = self._begin(window.newest)
        # Now and then a slip that goes on, or just ended, is looked at again: its size is known
        # the better the longer it lasts. And a slip bends the calibration as far as it goes before
        # a residual shows it.
        whole = self._smoother.smoothed_whole
        wanted = whole and (window.slipped > begin or self._bent)
        if not wanted and (self._wait > 0 or not self._suspect(new.start - 1)):
            return None
        found = self._explain(begin)
        self._pause = 1 if found is not None else min(2 * self._pause, PATIENCE)
        self._wait = self._pause
        return self._take(begin, found)

    @property
    def _able(self) -> bool:
        """Return True if somebody else than the wheels in question can tell, and may be heard."""
        window = self._smoother.window
        camera = any(t.kind == Kind.CAMERA and len(t.first) for t in window.tables.values())
        often = self._slipping_s > SELDOM * self._driven_s and self._driven_s > FIRST_S
        return (
            (len(self._conditions) > 0 or camera)
            and not often
            and self._smoother.strain() < STRAINED
        )

    @property
    def _bent(self) -> bool:
        """Return True if a parameter is far from nominal, observed or not."""
        layout = self._smoother.window.layout
        parameters = layout.parameters[: len(layout.free)]
        return pulled(parameters, self._smoother.calibration, None) > STRETCHED

    def _count(self, new: range) -> None:
        """Add up how long wheels turned, and slipped."""
        window = self._smoother.window
        for number in new:
            seconds = (window.stamp(number) - window.stamp(number - 1)) * 1e-9
            self._driven_s += seconds
            if window.slips.view[number - window.base].any():
                self._slipping_s += seconds

    def _begin(self, newest: int) -> int:
        """Return the keyframe from which on to look."""
        window = self._smoother.window
        now = window.stamp(newest)
        begin = max(window.number_at(now - LOOK_NS), window.base)
        slips = window.slips.view
        # Not from the middle of a slip: how it began tells which wheel it was.
        while (
            begin > window.base
            and slips[begin - window.base].any()
            and now - window.stamp(begin) < LONGEST_NS
        ):
            begin = max(window.number_at(window.stamp(begin) - LOOK_NS // 3), window.base)
        return begin

    def _suspect(self, begin: int) -> bool:
        """Return True if the wheels of the newest intervals contradict each other or the rest."""
        window = self._smoother.window
        states = window.states.view[begin - window.base :]
        rows = window.wheels.rows(begin, window.newest + 1)
        tables = [window.wheels.view(rows, begin)]
        own = redundancy_table(
            window.split(begin, window.newest + 1),
            window.layout.robot,
            window.layout.free,
            window.layout.width,
            window.wheels.loss,
            self._conditions,
        )
        if own is not None:
            tables.append(own)
        still = np.hstack([states, np.zeros((states.shape[0], window.slipping.size))])
        return any(
            float(linearise(t, still, self._smoother.calibration).squared.max()) > SUSPECT**2
            for t in tables
        )

    def _explain(self, begin: int) -> Explanation | None:
        """Return the slips since keyframe `begin`, if there are any."""
        window, model = self._smoother.window, self._settings.slip
        prior = carried_prior(window, begin)
        if prior is None or model is None:
            return None
        layout = window.layout
        # What the landmarks tell of the last seconds is left out: of the time before it is in.
        prior = without_landmarks(prior, layout.width, len(layout.parameters))
        tables = (prior, *window.factors(begin, window.tables.values()))
        problem = window.problem(begin, window.newest + 1, tables, as_turned=True)
        g = self._smoother.calibration.size
        free = CalibrationPrior.flat(g)
        few = replace(self._settings, max_iterations=STEPS, tolerance=ROUGH)
        plain, _, _ = minimise(
            problem, few, problem.states.copy(), self._smoother.calibration, True, free
        )
        # From where the slip did not bend the calibration yet, as well.
        b = window.layout.width
        at_begin = prior.measurements[0, b : b + g] + prior.measurements[0, b + g + b :]
        starts = ((plain.states, plain.u), (plain.states, at_begin))
        # What was believed once need not be proved again.
        gain = 0.0 if window.slips.view[begin - window.base + 1 :].any() else GAIN
        found, _ = explain(with_slips(problem, model), plain, few, starts, free, gain)
        return found

    def _take(self, begin: int, found: Explanation | None) -> int | None:
        """Give the window the slips that were found; return the oldest keyframe that changed."""
        window = self._smoother.window
        before = window.slips.view[begin - window.base + 1 :]
        slips, sigmas = np.zeros_like(before), np.zeros_like(before)
        if found is not None:
            mask = found.slipping
            slips[mask] = found.problem.slips(found.point.states)[mask]
            sigmas[mask] = self._sigmas(found)[mask]
        if np.abs(slips - before).max(initial=0.0) < CHANGED:
            return None
        if found is not None:
            window.states.view[begin - window.base :] = found.point.states[
                :, : found.problem.slip_slot
            ]
        window.set_slips(begin, slips, sigmas, self._smoother.calibration)
        return begin + 1

    def _sigmas(self, found: Explanation) -> Floats:
        """Return the (K-1, W) posterior standard deviations of the slips."""
        free = CalibrationPrior.flat(found.point.u.size)
        solved = step_of(linear_system(free, found.point), with_covariance=True)
        slot, wheels = found.problem.slip_slot, self._smoother.window.slipping.size
        if solved is None or solved.covariance is None:
            return np.full((found.point.states.shape[0] - 1, wheels), GUESSED)
        variance = np.diagonal(solved.covariance, axis1=1, axis2=2)[1:, slot : slot + wheels]
        return np.asarray(np.sqrt(variance))
