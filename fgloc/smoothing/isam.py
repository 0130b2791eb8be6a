"""Incremental fixed-lag smoothing with iSAM2: the newest states at a bounded cost, for ever."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from threading import RLock

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.errors import FglocError
from fgloc.factors.gtsam_factors import LANDMARK, Bundle, Row
from fgloc.smoothing.isam_rebuild import Snapshot, rebuild
from fgloc.smoothing.isam_settings import IncrementalSettings
from fgloc.smoothing.isam_solver import ENDLESS, Solver
from fgloc.smoothing.isam_upkeep import Upkeep
from fgloc.smoothing.isam_window import (
    STIFF,
    Frame,
    Landmark,
    Segment,
    Window,
    bundled,
    frame_key,
    landmark_key,
    segment_key,
)


class IncrementalGraph:
    """A sliding window of keyframes, calibration segments and landmarks, solved by iSAM2.

    States (B,) are [x, y, theta, sensor zeros] in map axes, SI units; calibration (G,) in solver
    variables; landmarks (2,) as their kernel means them. Use: `start`, then for each keyframe
    `add` (and `add_rows` for what comes late, `add_landmark` for what is seen first) and
    `update`; then read. An exception inside GTSAM never gets out: the graph is built anew from
    the window's own copy and counted in `rebuilds`; what is read is always finite. One lock
    serialises all calls, since GTSAM calls Python in the middle of its updates.

    The work of an update and the memory depend on the window, not on the length of the drive
    (with `lag_s` None on both). The window may be up to one update longer than the lag.
    """

    def __init__(
        self, width: int, walk: Floats, settings: IncrementalSettings | None = None
    ) -> None:
        """Prepare for states of `width` B ≥ 3 and a calibration of walk.size = G ≥ 0 variables.

        `walk` (G,) are standard deviations of the calibration's random walk per root second; 0 for
        a constant.
        """
        if width < 3 or not np.all(walk >= 0.0):
            raise FglocError("a keyframe needs three columns and a calibration walk no sign")
        self.settings = IncrementalSettings() if settings is None else settings
        self.updates = 0
        """Updates so far."""
        self.rebuilds = 0
        """How often iSAM2 failed and was built anew."""
        self.restarts = 0
        """How many of those had to give up part of the window."""
        self.dropped: Counter[str] = Counter()
        """Measurements given up in a rebuild, by sensor."""
        self.last_fault = ""
        """What the last failure said."""
        self.archive: dict[int, tuple[Floats, Floats]] = {}
        """Landmarks that left the window: value (2,) and covariance (2, 2) by id."""
        self._announced: dict[int, tuple[Floats, Floats | None]] = {}
        self._width, self._walk = width, walk
        self._lag = ENDLESS if self.settings.lag_s is None else self.settings.lag_s
        self._lock = RLock()
        self._solver = Solver(self.settings)
        self._window = Window()
        self._upkeep = Upkeep(self.settings)
        self._origin = 0.0
        self._first = 0
        self._snapshot: Snapshot | None = None

    # -- input ---------------------------------------------------------------------------------

    def start(
        self,
        stamp_s: float,
        keyframe: int,
        state: Floats,
        rows: Sequence[Row],
        calibration: Floats | None = None,
        calibration_covariance: Floats | None = None,
    ) -> None:
        """Add the first keyframe with its (B,) state and the rows that determine it.

        `calibration` (G,), zeros if not given, is the first guess and the mean of the prior with
        `calibration_covariance` (G, G); a row of kind STATE_PRIOR may hold the prior instead.
        """
        with self._lock:
            if self._window.frames:
                raise FglocError("the incremental graph was started twice")
            window = self._window
            window.oldest = window.newest = self._first = keyframe
            rows = self._checked(state, rows, keyframe)
            self._origin = stamp_s
            if self._walk.size:
                guess = np.zeros(self._walk.size) if calibration is None else calibration
                window.segments[0] = Segment(0.0, 0.0, guess, calibration_covariance)
                self._solver.insert(segment_key(0), guess, 0.0)
                if calibration_covariance is not None:
                    self._solver.add_prior(segment_key(0), guess, calibration_covariance)
            window.frames[keyframe] = Frame(0.0, 0, state.copy())
            self._solver.insert(frame_key(keyframe), state, 0.0)
            self._enqueue(rows)

    def add(self, stamp_s: float, keyframe: int, state: Floats, rows: Sequence[Row]) -> None:
        """Add the next keyframe with a (B,) guess of its state and the rows that lead to it.

        Rows of older keyframes in the window may be among them. Raises `FglocError`, before
        anything is changed, for a stamp that is not later, an index that is not the next one, a
        row outside the window, for numbers that are not finite and for a keyframe without rows.
        """
        with self._lock:
            window, stamp = self._window, stamp_s - self._origin
            if not window.frames:
                raise FglocError("start the incremental graph before adding to it")
            if keyframe != window.newest + 1:
                raise FglocError(f"keyframe {keyframe} does not follow {window.newest}")
            if not stamp > window.frames[window.newest].stamp:
                raise FglocError(f"keyframe {keyframe} is not later than the one before")
            rows = self._checked(state, rows, keyframe)
            number = (keyframe - self._first) // self.settings.segment_keyframes
            if self._walk.size:
                self._extend_calibration(number, stamp)
            window.frames[keyframe] = Frame(stamp, number, state.copy())
            window.newest = keyframe
            self._solver.insert(frame_key(keyframe), state, stamp)
            self._enqueue(rows)

    def add_rows(self, rows: Sequence[Row]) -> list[Row]:
        """Add rows at keyframes already there; return those whose keyframes have left the window.

        Raises `FglocError` for a row beyond the newest keyframe or not finite.
        """
        with self._lock:
            late = [r for r in rows if int(r.table.first[r.index]) < self._window.oldest]
            here = [r for r in rows if int(r.table.first[r.index]) >= self._window.oldest]
            self._enqueue(self._checked(None, here))
            return late

    def add_landmark(self, landmark: int, guess: Floats, covariance: Floats | None = None) -> None:
        """Announce a new landmark with a guess (2,) and, if it is to have one, a prior (2, 2).

        It becomes a variable with the first row that sees it; without a prior the rows up to the
        next `update` must determine it. A landmark in the archive needs no announcement: it comes
        back by being seen.
        """
        with self._lock:
            if self.has_landmark(landmark):
                raise FglocError(f"landmark {landmark} is there already")
            if not np.isfinite(guess).all():
                raise FglocError(f"landmark {landmark} has a guess that is not finite")
            self._announced[landmark] = guess, covariance

    # -- solving -------------------------------------------------------------------------------

    def update(self) -> None:
        """Solve with everything added since the last update. Never raises what GTSAM raises."""
        with self._lock:
            window, solver = self._window, self._solver
            if not solver.pending:
                return
            self.updates += 1
            fresh = [b for b in solver.queued if b is not None and b.index < 0]
            horizon = window.frames[window.newest].stamp - self._lag
            try:
                forget = self._upkeep.forgets(self.updates, window)
                if forget:
                    self._archive_before(horizon)
                look = self._upkeep.relinearisation(self.updates, forget, solver, window)
                solver.update(*look, forget)
                if forget:
                    window.forget_before(horizon)
                self._upkeep.settle(solver, window)
                self._upkeep.reweigh(solver, window)
                self._take_snapshot()
            except Exception as fault:  # GTSAM raises RuntimeError, IndexError, ValueError, ...
                self._recover(fault, fresh)

    def _recover(self, fault: Exception, fresh: Sequence[Bundle]) -> None:
        """Replace the corrupt solver."""
        self.rebuilds += 1
        said = " ".join(str(fault).split())
        self.last_fault = f"{type(fault).__name__}: {said[:200]}"
        result = rebuild(self._solver, self._window, self.settings, self._snapshot, fresh)
        self._solver = result.solver
        self.dropped.update(result.dropped)
        if result.restarted:
            self.restarts += 1
            self._snapshot = None

    def _take_snapshot(self) -> None:
        """Keep the newest state and its covariance now and then."""
        k = self._window.newest
        if self._snapshot is not None:
            if k - self._snapshot.keyframe < self.settings.snapshot_keyframes:
                return
        elif k == self._first:
            return
        self._snapshot = Snapshot.take(self._solver, self._window)

    # -- output --------------------------------------------------------------------------------

    @property
    def oldest(self) -> int:
        """Return the oldest keyframe that is still a variable."""
        return self._window.oldest

    @property
    def newest(self) -> int:
        """Return the newest keyframe."""
        return self._window.newest

    def state(self, keyframe: int) -> Floats:
        """Return the (B,) state of a keyframe in the window."""
        self._require(keyframe)
        return self._read(frame_key(keyframe))

    def states(self, first: int) -> Floats:
        """Return the states (N, B) of all keyframes from `first` to the newest."""
        self._require(first)
        with self._lock:
            return np.array([self.state(k) for k in range(first, self._window.newest + 1)])

    def covariance(self, keyframe: int) -> Floats:
        """Return the (B, B) marginal covariance of a keyframe, in map axes."""
        self._require(keyframe)
        return self._read(frame_key(keyframe), covariance=True)

    def calibration(self) -> Floats:
        """Return the (G,) calibration of the newest segment."""
        if not self._walk.size:
            return np.zeros(0)
        return self._read(self._window.segment_of(self._window.newest))

    def calibration_covariance(self) -> Floats:
        """Return the (G, G) marginal covariance of the newest segment's calibration."""
        if not self._walk.size:
            return np.zeros((0, 0))
        return self._read(self._window.segment_of(self._window.newest), covariance=True)

    def has_landmark(self, landmark: int) -> bool:
        """Return whether a landmark is in the window, in the archive or announced."""
        known = (self._window.landmarks, self.archive, self._announced)
        return any(landmark in where for where in known)

    def landmark(self, landmark: int) -> tuple[Floats, Floats]:
        """Return a landmark's value (2,) and covariance (2, 2), from the window or the archive."""
        with self._lock:
            if landmark in self._window.landmarks:
                key = landmark_key(landmark)
                return self._read(key), self._read(key, covariance=True)
            if landmark in self.archive:
                return self.archive[landmark]
        raise FglocError(f"landmark {landmark} is not known")

    def _read(self, key: int, covariance: bool = False) -> Floats:
        """Return an estimate or covariance; a solver that fails in this is replaced first."""
        with self._lock:
            for _ in range(2):
                try:
                    solver = self._solver
                    return solver.covariance(key) if covariance else solver.value(key)
                except Exception as fault:  # a read may eliminate, and fail like an update
                    if not solver.knows(key):
                        raise FglocError("read after update, not before it") from fault
                    self._recover(fault, ())
        raise FglocError(f"the incremental solver has no estimate: {self.last_fault}")

    # -- parts ---------------------------------------------------------------------------------

    def _require(self, keyframe: int) -> None:
        window = self._window
        if not window.oldest <= keyframe <= window.newest or not window.frames:
            raise FglocError(
                f"keyframe {keyframe} is not in the window {window.oldest} to {window.newest}"
            )

    def _checked(
        self, state: Floats | None, rows: Sequence[Row], newest: int | None = None
    ) -> list[Row]:
        """Return the rows; raises `FglocError` for what the graph cannot take."""
        if state is not None and (state.shape != (self._width,) or not np.isfinite(state).all()):
            raise FglocError(f"a keyframe's guess must be {self._width} finite numbers")
        if state is not None and not any(row.keyframe == newest for row in rows):
            raise FglocError(f"keyframe {newest} has no measurement that ties it to anything")
        for row in rows:
            self._window.check(row, self._window.newest if newest is None else newest)
            if row.landmark >= 0 and not self.has_landmark(row.landmark):
                raise FglocError(f"{row.table.sensor}: landmark {row.landmark} is not known")
        return list(rows)

    def _extend_calibration(self, number: int, stamp: float) -> None:
        """Let the calibration live up to `stamp`, in a new segment if it is time for one."""
        segments = self._window.segments
        if number not in segments:
            before = segments[number - 1]
            known = self._solver.knows(segment_key(number - 1))
            guess = self._read(segment_key(number - 1)) if known else before.guess
            sigma = np.maximum(self._walk * np.sqrt(stamp - before.begin), STIFF)
            segments[number] = Segment(stamp, stamp, guess, walk=sigma)
            # The one before goes with its last keyframe.
            self._solver.insert(segment_key(number), guess, stamp)
            self._solver.add_walk(segment_key(number - 1), segment_key(number), sigma)
        segments[number].stamp = stamp
        self._solver.stamp(segment_key(number), stamp)

    def _enqueue(self, rows: Sequence[Row]) -> None:
        """Queue rows, bundled, with the landmarks that come back for them."""
        for bundle in bundled(rows):
            seen_at = self._window.frames[bundle.last].stamp
            for i in bundle.landmarks:
                mark = self._window.landmarks.get(i)
                if mark is None:
                    self._enter(i, seen_at)
                elif mark.stamp < seen_at:
                    mark.stamp = seen_at
                    self._solver.stamp(landmark_key(i), seen_at)
            self._window.attach(bundle)
            self._solver.add(bundle)

    def _enter(self, landmark: int, stamp: float) -> None:
        """Queue an announced or archived landmark as a variable."""
        if landmark in self._announced:
            guess, prior = self._announced.pop(landmark)
        else:
            guess, known = self.archive.pop(landmark)
            prior = known * self.settings.reentry_inflation
        self._window.landmarks[landmark] = Landmark(stamp, stamp, guess, prior)
        key = landmark_key(landmark)
        self._solver.insert(key, guess, stamp)
        if prior is not None:
            self._solver.add_prior(key, guess, prior)

    def _archive_before(self, stamp: float) -> None:
        """Keep value and covariance of the landmarks that the next update will forget."""
        for i, mark in self._window.landmarks.items():
            if mark.stamp < stamp and self._solver.knows(landmark_key(i)):
                key = landmark_key(i)
                covariance = self._solver.covariance(key)[:LANDMARK, :LANDMARK]
                self.archive[i] = self._solver.value(key), covariance
