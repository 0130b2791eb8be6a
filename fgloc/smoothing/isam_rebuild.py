"""What the incremental smoother does when iSAM2 fails: a new one from the window's own copy.

After an exception iSAM2 holds factors and variables of the update that failed and answers with
wrong values. Four attempts, each giving up more than the one before:

1. everything: the window's bundles at the points where they were linearised, and the linear
   factors that are left of keyframes before the window;
2. the same without the measurements of the update that failed, but for wheel odometry;
3. from the last snapshot on: its state and covariance as a prior, and the bundles since;
4. the newest keyframe alone, at the guess it came with (dead reckoning), with a covariance
   inflated for what happened since the snapshot.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.errors import FglocError
from fgloc.factors.gtsam_factors import Bundle
from fgloc.factors.tables import Kind
from fgloc.smoothing.isam_settings import IncrementalSettings
from fgloc.smoothing.isam_solver import Solver
from fgloc.smoothing.isam_window import Window, frame_key, landmark_key, segment_key

INFLATION = 2.0
"""Factor on the snapshot's covariances: how state and calibration hang together is not kept, and
twice the blocks of a covariance is never less than all of it."""
DRIFT = 0.1
"""Standard deviation of dead reckoning since the snapshot, per metre and per radian."""
UNKNOWN = np.array([1.0, 1.0, 0.5])
"""Standard deviations [m, m, rad] where not even a snapshot exists."""


@dataclass(frozen=True)
class Snapshot:
    """A keyframe's estimate at a time when the solver was healthy."""

    keyframe: int
    """Its index."""
    state: Floats
    """(B,)."""
    covariance: Floats
    """(B, B) in map axes."""
    calibration: Floats
    """(G,) of its segment."""
    calibration_covariance: Floats
    """(G, G)."""

    @staticmethod
    def take(solver: Solver, window: Window) -> Snapshot:
        """Return the newest keyframe's estimate. The newest are cheap: they are at the root."""
        k = window.newest
        key = frame_key(k)
        u, sigma = np.zeros(0), np.zeros((0, 0))
        if window.segments:
            segment = window.segment_of(k)
            u, sigma = solver.value(segment), solver.covariance(segment)
        return Snapshot(k, solver.value(key), solver.covariance(key), u, sigma)


@dataclass
class Rebuilt:
    """A healthy solver, and what it cost."""

    solver: Solver
    """It holds exactly what the window holds."""
    dropped: Counter[str] = field(default_factory=Counter)
    """Measurements given up, by sensor."""
    restarted: bool = False
    """Whether older keyframes were given up."""


def rebuild(
    failed: Solver,
    window: Window,
    settings: IncrementalSettings,
    snapshot: Snapshot | None,
    fresh: Sequence[Bundle],
) -> Rebuilt:
    """Return a new solver for the window, which is cut down to what the solver holds.

    `fresh` are the bundles that the failed update brought. O(window); it happens seldom.
    """
    recovery = _Recovery(failed, window, settings, snapshot, fresh)
    attempts: tuple[Callable[[], Solver], ...] = (
        recovery.everything,
        recovery.without_fresh,
        recovery.since_snapshot,
        recovery.newest_alone,
    )
    for attempt in attempts:
        try:
            solver = attempt()
            solver.value(frame_key(window.newest))
        except Exception:  # whatever it was, the next attempt asks for less
            continue
        return Rebuilt(solver, recovery.dropped, recovery.restarted)
    raise FglocError("the incremental solver cannot start anew: the newest guess is not usable")


class _Recovery:
    """The attempts of one rebuild; each cuts the window down to what it uses."""

    def __init__(
        self,
        failed: Solver,
        window: Window,
        settings: IncrementalSettings,
        snapshot: Snapshot | None,
        fresh: Sequence[Bundle],
    ) -> None:
        self._failed, self._window, self._settings = failed, window, settings
        self._snapshot, self._fresh = snapshot, set(fresh)
        self.dropped: Counter[str] = Counter()
        self.restarted = False

    def everything(self) -> Solver:
        return self._assemble(self._marginals())

    def without_fresh(self) -> Solver:
        for frame in self._window.frames.values():
            keep = [b for b in frame.bundles if b not in self._fresh]
            fresh = [b for b in frame.bundles if b in self._fresh]
            frame.bundles = keep
            for bundle in fresh:
                wheels = [r for r in bundle.rows if r.table.kind == Kind.WHEEL]
                self._drop(bundle, but=len(wheels) > 0)
                if wheels:
                    self._window.attach(Bundle(wheels))
        return self._assemble(self._marginals())

    def since_snapshot(self) -> Solver:
        window, shot = self._window, self._snapshot
        if shot is None or shot.keyframe not in window.frames or shot.keyframe == window.newest:
            raise FglocError("no snapshot in the window")
        self._cut(shot.keyframe)
        solver = Solver(self._settings)
        solver.add_prior(frame_key(shot.keyframe), shot.state, INFLATION * shot.covariance)
        if window.segments:
            spread = INFLATION * shot.calibration_covariance
            solver.add_prior(window.segment_of(shot.keyframe), shot.calibration, spread)
        return self._assemble((), solver)

    def newest_alone(self) -> Solver:
        window, shot, k = self._window, self._snapshot, self._window.newest
        guess = window.frames[k].guess
        self._cut(k)
        solver = Solver(self._settings)
        u = window.segments[window.frames[k].segment].guess if window.segments else np.zeros(0)
        spread = np.diag(np.append(UNKNOWN, np.ones(guess.size - 3)) ** 2)
        u_spread = np.eye(u.size)
        if shot is not None:
            way = float(np.hypot(*(guess[:2] - shot.state[:2])))
            turn = abs(float(guess[2] - shot.state[2]))
            sigma = np.sqrt(shot.covariance[2, 2]) + DRIFT * turn
            spread = INFLATION * shot.covariance
            spread[:2, :2] += np.eye(2) * way * way * (DRIFT**2 + sigma**2)
            spread[2, 2] += (DRIFT * turn) ** 2
            u, u_spread = shot.calibration, INFLATION * shot.calibration_covariance
        solver.add_prior(frame_key(k), guess, spread)
        if window.segments:
            solver.add_prior(window.segment_of(k), u, u_spread)
        return self._assemble((), solver)

    def _marginals(self) -> list[Any]:
        """Return the linear factors left of older keyframes; raises if they are not whole."""
        marginals, keys = self._failed.marginals(), self._window.keys()
        # An exception in the middle of marginalising may have taken variables out already.
        if not all(self._failed.knows(key) for key in keys - self._failed.queued_keys):
            raise FglocError("variables are missing")
        if not all(key in keys for m in marginals for key in m.keys()):  # noqa: SIM118
            raise FglocError("a marginal belongs to no variable")
        return marginals

    def _cut(self, first: int) -> None:
        """Give up all that is before a keyframe, and all landmarks."""
        window, shot = self._window, self._snapshot
        known = shot.keyframe if shot is not None else -1
        self.restarted = True
        for frame in window.frames.values():
            keep = [b for b in frame.bundles if b.first >= first < b.last and not b.landmarks]
            for bundle in frame.bundles:
                # What the snapshot has taken in is not lost.
                if bundle not in keep and bundle.last > known:
                    self._drop(bundle)
            frame.bundles = keep
        while window.oldest < first:
            window.drop_oldest()
        for s in [s for s in window.segments if s < window.frames[first].segment]:
            del window.segments[s]
        window.landmarks.clear()

    def _drop(self, bundle: Bundle, but: bool = False) -> None:
        """Count the rows of a bundle as given up; `but` for all but wheel odometry."""
        for row in bundle.rows:
            if not (but and row.table.kind == Kind.WHEEL):
                self.dropped[row.table.sensor] += 1

    def _assemble(self, marginals: Sequence[Any], solver: Solver | None = None) -> Solver:
        """Return a solver updated with all that the window holds, and the given factors."""
        window, failed = self._window, self._failed
        solver = Solver(self._settings) if solver is None else solver
        bundles = window.bundles()
        used = {i for b in bundles for i in b.landmarks}
        used |= {i for i, mark in window.landmarks.items() if mark.prior is not None}
        tied = {key for m in marginals for key in m.keys()}  # noqa: SIM118

        def insert(key: int, guess: Floats, stamp: float) -> None:
            value = failed.salvage(key)
            solver.insert(key, guess if value is None else value, stamp)

        for k, frame in window.frames.items():
            if window.oldest == window.newest:
                solver.insert(frame_key(k), frame.guess, frame.stamp)
            else:
                insert(frame_key(k), frame.guess, frame.stamp)
        for s, segment in window.segments.items():
            insert(segment_key(s), segment.guess, segment.stamp)
            if segment.prior is not None:
                solver.add_prior(segment_key(s), segment.guess, segment.prior)
            if segment.walk is not None and s - 1 in window.segments:
                solver.add_walk(segment_key(s - 1), segment_key(s), segment.walk)
        for i in list(window.landmarks):
            mark = window.landmarks[i]
            if i not in used and landmark_key(i) not in tied:
                del window.landmarks[i]
                continue
            insert(landmark_key(i), mark.guess, mark.stamp)
            if mark.prior is not None:
                solver.add_prior(landmark_key(i), mark.guess, mark.prior)
        for factor in marginals:
            solver.add_factor(factor)
        for bundle in bundles:
            solver.add(bundle)
        # What is too old goes with the next update, which archives its landmarks first.
        solver.update(forget=False)
        return solver
