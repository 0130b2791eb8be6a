"""The online engine: packets in, poses out.

Every wheel packet moves the estimate on; a keyframe is made when one is due, or where a fix
arrived; every stream then makes the factors that it can. Where new factors came, the window is
smoothed from the oldest of them on (usually the newest keyframe), once a second as a whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fgloc.core.drive import Reference
from fgloc.core.geometry import compose
from fgloc.core.measurements import Floats, LandmarkSightings, Scans, Sensor
from fgloc.core.robot import Robot
from fgloc.errors import FglocError
from fgloc.factors.robust import PLAIN
from fgloc.factors.tables import Kind
from fgloc.online.alarm import Alarm, Pause
from fgloc.online.clock import Clock
from fgloc.online.fixes import Fix, FixTable
from fgloc.online.incremental import IncrementalSmoother
from fgloc.online.layout import Layout, make_layout
from fgloc.online.opening import loss_of, open_stream, open_table, open_zero
from fgloc.online.plausible import reading_fault, sigma_fault, size_of, wheels_fault
from fgloc.online.priors import after_move, first_prior
from fgloc.online.propagate import Propagation
from fgloc.online.settings import OnlineSettings
from fgloc.online.slip import SlipWatch
from fgloc.online.smoother import WindowSmoother
from fgloc.online.spots import BROKE, Spots, empty_sigma
from fgloc.online.streams import Stream
from fgloc.online.tally import Tally
from fgloc.online.trust import Trust, Verdict
from fgloc.online.window import Window
from fgloc.smoothing.initial import ORIGIN_SIGMA
from fgloc.smoothing.problem import HIDDEN
from fgloc.smoothing.sensors import fix_sigma


@dataclass(frozen=True)
class Start:
    """Where a drive starts."""

    pose: Floats
    """(3,) measured pose of the reference at the first stamp, map axes [m, m, rad]."""
    sigma: Floats
    """(3,) its standard deviations."""
    base: Floats
    """(3,) pose of the robot's base that follows with the nominal mounting."""
    mount: Floats
    """(3,) nominal pose of the reference on the robot."""


START = "start"
"""Name of the factor that says where the drive starts."""
FUTURE_NS = 30_000_000_000
"""A stamp this far ahead of the wheels' is wrong."""
BROKEN = (FglocError, ArithmeticError, ValueError, RuntimeError)
"""What a solver may raise over numbers it cannot digest (numpy's and GTSAM's errors are these)."""
SPARSE = 5.0
"""With a lidar keyframes are so many times rarer: its scans make those that are needed."""
CONTRADICTED = "found to contradict the others"
"""Why factors were taken out of the window."""
ASIDE = 1000
"""Readings that are put aside at most while the clock is in doubt."""


class OnlineEngine:
    """Localises one robot from its measurements as they come."""

    def __init__(
        self,
        robot: Robot,
        sensors: Sequence[Sensor],
        reference: Reference | None,
        settings: OnlineSettings,
        resolution: float = 0.0,
    ) -> None:
        """Prepare for a robot with these sensors; of the streams only noise and mounting count."""
        self.settings = settings
        self.layout: Layout = make_layout(robot, sensors, reference)
        self.window = Window(self.layout, loss_of(settings, settings.wheel_loss), resolution)
        self.propagation = Propagation(self.layout)
        chain = settings.engine == "chain"
        make = WindowSmoother if chain else IncrementalSmoother
        self.smoother: WindowSmoother | IncrementalSmoother = make(self.window, settings)
        # Its trials are for chains: with landmarks nobody is doubted as a whole.
        mapping = any(isinstance(s, LandmarkSightings | Scans) for s in sensors)
        able = isinstance(self.smoother, WindowSmoother) and not mapping
        self.trust = Trust(self.map_smoother) if able else None
        self.alarm = Alarm(self.map_smoother) if able else None
        self.pauses: list[Pause] = []
        self.slip: SlipWatch | None = None
        self.clock = Clock()
        self.rebuilds = 0
        self.updates = 0
        self._mark: dict[tuple[str, Kind], int] = {}
        self.left_out: dict[str, str] = {}
        self.remarks: list[str] = []
        self.sensors = tuple(sensors)
        self.streams: dict[str, Stream] = {}
        self.spots = Spots(self)
        self.tally: dict[str, Tally] = {"wheels": Tally(), **{s.sensor: Tally() for s in sensors}}
        self.walks: dict[str, float] = {}
        self._aside: list[tuple[str, int, Floats, Floats | None]] = []
        self._sizes = {s.sensor: size_of(s) for s in sensors}
        self._scans = tuple(s.sensor for s in sensors if isinstance(s, Scans))
        self.held = np.zeros(len(robot.base.driven))
        self.began_ns = self.now_ns = 0
        self.dirty: int | None = None

    def begin(self, stamp_ns: int, start: Start | None) -> None:
        """Make the first keyframe.

        Without a start the wheels' path begins at the origin; the first fixes, where the robot
        has a sensor that gives them, tell where in the map that is.
        """
        layout, window = self.layout, self.window
        state = np.zeros(layout.width)
        if start is not None:
            state[:3] = start.base
        self.clock.admit(stamp_ns)
        self.began_ns = self.now_ns = stamp_ns
        window.add_keyframe(stamp_ns, state)
        window.prior = first_prior(window, state, np.zeros((layout.width, layout.width)))
        known = window.table(Kind.POSE_FIX, START, (6, 3), layout.places[START].block, PLAIN)
        if start is None:
            known.add(0, np.zeros(6), np.eye(3) / ORIGIN_SIGMA, weight=1.0)
        else:
            row = np.concatenate([start.pose, start.mount])
            sigma = fix_sigma(start.sigma, window.rounding)
            known.add(0, row, np.diag(1.0 / sigma), weight=1.0)
        for sensor in self.sensors:
            self._open(sensor, stamp_ns)
        if start is None and self.spots.align():
            self.smoother.holding = True
        self.smoother.begin()
        if isinstance(self.smoother, WindowSmoother) and self.settings.robust:
            self.slip = SlipWatch(self.smoother, self.settings)
        self._restart()

    def _open(self, sensor: Sensor, stamp_ns: int) -> None:
        """Make what takes the readings of one sensor, and the model of its drifting zero."""
        place = self.layout.places.get(sensor.sensor)
        if place is None:
            return  # a kind of sensor that this engine does not use
        stream = open_stream(sensor, place, self, self.settings, stamp_ns)
        if stream is not None:
            self.streams[sensor.sensor] = stream
        walk = open_zero(sensor, place, self.window)
        if walk is not None:
            self.walks[sensor.sensor] = walk
        mapping = isinstance(self.smoother, WindowSmoother)
        table = open_table(sensor, place, self, self.settings, mapping)
        if table is not None:
            self.spots.tables[sensor.sensor] = table

    def touch(self, number: int) -> None:
        """Note that a keyframe has a new factor."""
        self.dirty = number if self.dirty is None else min(self.dirty, number)

    def reject(self, sensor: str, reason: str, count: int = 1) -> None:
        """Count readings that could not be used."""
        self.tally[sensor].reject(reason, count)

    @property
    def map_smoother(self) -> WindowSmoother:
        """Return the solver that keeps the landmarks."""
        assert isinstance(self.smoother, WindowSmoother)
        return self.smoother

    def enter(self, guesses: Floats, root: Floats) -> list[int]:
        """Take new landmarks into use at guesses (2 k,), of which `root` (2 k, 2 k) is known."""
        numbers = self.map_smoother.enter(guesses, root)
        self._restart()
        return numbers

    def recall(self, numbers: list[int]) -> None:
        """Take landmarks that were put aside back into use; the whole window is solved for it."""
        self.map_smoother.wanted = numbers
        self.update()

    def reading(self, sensor: str, stamp_ns: int, values: Floats, sigma: Floats | None) -> None:
        """Take a measurement of any sensor but the wheels, in any order of time.

        What cannot be used is counted with its reason, and never raises. Where the wheels' clock
        may have been set back, readings wait until that is known: they would go where the robot
        was seconds ago.
        """
        if self.clock.doubtful and len(self._aside) < ASIDE:
            self._aside.append((sensor, stamp_ns, values, sigma))
        else:
            self._take(sensor, stamp_ns, values, sigma)

    def _take(self, sensor: str, stamp_ns: int, values: Floats, sigma: Floats | None) -> None:
        """Take a reading whose stamp can be understood."""
        if sensor not in self._sizes:
            self.tally.setdefault("unknown", Tally()).reject("no such sensor")
            return
        tally = self.tally[sensor]
        stamp_ns = self.clock.time(stamp_ns)
        fault = reading_fault(values, self._sizes[sensor], sensor in self._scans)
        if not fault and isinstance(self.spots.tables.get(sensor), FixTable):
            fault = sigma_fault(sigma, self._sizes[sensor])
        if sensor in self.left_out or self._paused(sensor, stamp_ns):
            tally.reject("contradicts the others")
        elif fault:
            tally.reject(fault)
        elif stamp_ns < self.window.stamp(self.window.base):
            tally.reject("older than the window")
        elif stamp_ns > self.now_ns + FUTURE_NS:
            tally.reject("its stamp lies in the future")
        elif sensor in self.streams:
            value = float(values[0]) if values.size == 1 else values
            if not self.streams[sensor].push(stamp_ns, value):
                tally.reject("a second one with the same stamp")
        elif sensor in self.spots.tables:
            table = self.spots.tables[sensor]
            stamp_ns += table.delay_ns
            fix = Fix(stamp_ns, sensor, values, empty_sigma() if sigma is None else sigma)
            if not table.first(fix):
                tally.reject("a second one with the same stamp")
                return
            try:
                self.spots.take(fix)
            except BROKEN:
                self._settle(self._rebuild())
        else:
            tally.reject("not used by this engine")

    def place(self, start: Floats, sigma: Floats) -> None:
        """Move the path so far to where it lies in the map, give or take sigma (3,)."""
        window = self.window
        known = window.tables[START, Kind.POSE_FIX]
        for states in (window.states.view, window.linear_states.view):
            states[:, :3] = compose(start, states[:, :3])
        self.propagation.place(start, sigma)
        self.smoother.holding = False
        assert window.prior is not None
        prior = window.prior
        prior.measurements[0, :3] = compose(start, prior.measurements[0, :3])
        if len(known.first):
            known.measurements.view[0, :3] = start
            known.sqrt_information.view[0] = np.diag(1.0 / sigma)
        else:
            # The start is summed up in the prior by now, with the rest of the path's beginning.
            prior.sqrt_information[0] = after_move(prior.sqrt_information[0], sigma)
        self.smoother.start_again()

    def wheels(self, stamp_ns: int, angles: Floats, steering: Floats | None = None) -> bool:
        """Take the wheels' rotation (D,) [rad] since the last packet, and its end.

        Returns False if the packet could not be used (counted with its reason).
        """
        tally = self.tally["wheels"]
        seconds = (self.clock.time(stamp_ns) - self.now_ns) * 1e-9
        fault = wheels_fault(angles, steering, self.held.size, seconds)
        if fault:
            tally.reject(fault)
            return False
        # A packet that was sent twice turned the wheels but once.
        if self.clock.repeats(stamp_ns, angles.tobytes()):
            tally.reject("a second one with the same stamp")
            return False
        if not self.clock.admit(stamp_ns):
            # The wheels did turn: what they turned is part of the next packet.
            tally.reject("its stamp lies in the past")
            self.held = self.held + angles
            return False
        aside, self._aside = self._aside, []
        for reading in aside:
            self._take(*reading)
        angles, self.held = angles + self.held, np.zeros_like(angles)
        steer = np.zeros_like(angles) if steering is None else steering
        try:
            self._drive(self.clock.time(stamp_ns), angles, steer)
        except BROKEN:
            self._settle(self._rebuild())
        return True

    def _drive(self, stamp_ns: int, angles: Floats, steer: Floats) -> None:
        """Move on to the end of a packet, by way of the fixes that wait for it."""
        whole = stamp_ns - self.now_ns
        while (reached := self.spots.reached(stamp_ns)) is not None:
            self._advance(angles, steer, reached, whole)
            self.spots.release()
        self._advance(angles, steer, stamp_ns, whole)
        if self._due():
            self.keyframe()
        if self.dirty is not None or self.smoother.unsolved >= self.settings.relinearise_every:
            self.update()

    def _advance(self, angles: Floats, steering: Floats, stamp_ns: int, whole: int) -> None:
        """Move on to a stamp within a packet of `whole` nanoseconds."""
        if stamp_ns <= self.now_ns:
            return
        part = (stamp_ns - self.now_ns) / whole
        seconds = (stamp_ns - self.now_ns) * 1e-9
        self.window.add_piece(angles * part, steering, seconds)
        gripping = angles * part * (1.0 - self.window.slipping)
        self.propagation.add(gripping, steering, seconds)
        self.now_ns = stamp_ns

    def _due(self) -> bool:
        """Return True if it is time for a keyframe."""
        s, window = self.settings, self.window
        last = window.newest
        # 5 % slack keeps a jittering sensor of the same rate from alternating between one and two.
        period_s = s.keyframe_period_s * (SPARSE if self._scans else 1.0)
        if self.now_ns - window.stamp(last) >= 0.95e9 * period_s:
            return True
        before, now = window.state(last), self.propagation.state
        way = float(np.hypot(now[0] - before[0], now[1] - before[1]))
        return way >= s.keyframe_distance_m or abs(now[2] - before[2]) >= s.keyframe_turn

    def keyframe(self) -> int:
        """Make a keyframe of now, and the factors that end there."""
        window = self.window
        number = window.add_keyframe(self.now_ns, self.propagation.state)
        window.close_interval(self.smoother.calibration)
        seconds = (self.now_ns - window.stamp(number - 1)) * 1e-9
        for sensor, walk in self.walks.items():
            table = window.tables[sensor, Kind.ZERO_WALK]
            root = np.array([[1.0 / (walk * np.sqrt(seconds))]])
            table.add(number - 1, np.zeros(1), root, weight=1.0)
        for stream in self.streams.values():
            stream.keyframe_added(number)
        return number

    def update(self) -> None:
        """Smooth with everything that came since the last time; never raises.

        Whatever the solver stumbles over, the newest factors are taken back and counted, and the
        window is solved without them.
        """
        self.updates += 1
        try:
            dropped = self._smooth()
        except BROKEN:
            dropped = self._rebuild()
        self._settle(dropped)

    def _settle(self, dropped: dict[str, Floats]) -> None:
        """Go on from a solved window that has lost factors with these weights, by sensor."""
        self.dirty = None
        self._mark = {key: table.added for key, table in self.window.tables.items()}
        self._restart()
        for one in self.smoother.judged:
            tally = self.tally[one.table.sensor]
            tally.nis += float(one.nis.sum())
            tally.components += one.nis.size * one.dimension
        self.smoother.judged.clear()
        for sensor, weights in dropped.items():
            if sensor in self.tally:
                self.tally[sensor].gone(weights)
        if dropped:
            oldest = self.window.stamp(self.window.base)
            for stream in self.streams.values():
                stream.prune(oldest)
            self.spots.prune()

    def _smooth(self) -> dict[str, Floats]:
        """Update the window; return the last weights of the factors that left it."""
        joint = self.propagation.joint()
        moved = self.propagation.displacement_covariance
        dropped = self.smoother.update(self.dirty, joint, moved)
        changed = None if self.slip is None else self.slip.look()
        if changed is not None:
            self._restart()
            for sensor, weights in self.smoother.update(changed, joint, moved).items():
                dropped[sensor] = np.concatenate([dropped.get(sensor, weights[:0]), weights])
        if self.alarm is not None:
            pause = self.alarm.relapse()
            if pause is None and self.alarm.raised():
                pause = self.alarm.look()
            if pause is not None:
                self._do_without(pause)
                for sensor, weights in self.smoother.update(None, joint, moved).items():
                    dropped[sensor] = np.concatenate([dropped.get(sensor, weights[:0]), weights])
        if self.trust is not None and self.smoother.smoothed_whole:
            verdict = self.trust.look()
            if verdict is not None and verdict.lost is None:
                self.remarks.append(verdict.reason)
            elif verdict is not None:
                self._leave_out(verdict)
        return dropped

    def _rebuild(self) -> dict[str, Floats]:
        """Take the newest measurements back and solve the window without them.

        Should that fail as well, dead reckoning goes on from the last pose that was right.
        """
        self.rebuilds += 1
        for key, table in self.window.tables.items():
            if table.kind in HIDDEN or table is self.window.wheels:
                continue
            lost = table.take_back(self._mark.get(key, 0))
            if table.sensor in self.tally:
                self.tally[table.sensor].reject(BROKE, lost)
        try:
            self.smoother.start_again()
            return {}
        except BROKEN:
            state, joint = self.propagation.state, self.propagation.joint()
            return self.smoother.abandon(self.now_ns, state, joint)

    def _do_without(self, pause: Pause) -> None:
        """Do without a sensor for a while."""
        self.pauses.append(pause)
        self.streams[pause.sensor].forget(pause.begin_ns)
        self.tally[pause.sensor].reject(CONTRADICTED, pause.lost)

    def _paused(self, sensor: str, stamp_ns: int) -> bool:
        """Return True while a sensor is not believed."""
        return any(
            p.sensor == sensor
            and p.begin_ns <= stamp_ns
            and (p.until_ns is None or stamp_ns < p.until_ns)
            for p in self.pauses
        )

    def _leave_out(self, verdict: Verdict) -> None:
        """Do without a sensor from now on."""
        self.streams.pop(verdict.sensor)
        self.tally[verdict.sensor].reject(CONTRADICTED, verdict.lost or 0)
        self.left_out[verdict.sensor] = verdict.reason

    def finish(self) -> None:
        """Count what is still in the window, and what never became a factor."""
        for sensor, *_ in self._aside:
            self.tally.get(sensor, Tally()).reject("after the last wheel packet")
        for table in self.window.tables.values():
            if table.kind not in HIDDEN and table.sensor in self.tally:
                self.tally[table.sensor].gone(table.weight.view)
        for sensor, reason in self.spots.left():
            self.tally[sensor].reject(reason)

    def _restart(self) -> None:
        """Let dead reckoning go on from the keyframe solved last."""
        posterior, window = self.smoother.posterior, self.window
        self.propagation.restart(posterior, window.state(posterior.number))
        open_pieces = window.split(posterior.number, window.newest + 2)
        for angles, steering, seconds in zip(
            open_pieces.angles, open_pieces.steering, open_pieces.seconds, strict=True
        ):
            self.propagation.add(angles, steering, float(seconds))
