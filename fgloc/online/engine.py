"""The online engine: packets in, poses out.

Every wheel packet moves the estimate on; a keyframe is made when one is due, or where a fix
arrived; every stream then makes the factors that it can. Where new factors came, the window is
smoothed from the oldest of them on (usually the newest keyframe), once a second as a whole.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from fgloc.core.drive import Reference
from fgloc.core.measurements import (
    CameraPoses,
    Floats,
    PoseFixes,
    PositionFixes,
    Sensor,
    Yaw,
    YawRate,
)
from fgloc.core.preintegration import Integrator
from fgloc.core.robot import Robot
from fgloc.factors.robust import PLAIN, Loss
from fgloc.factors.tables import Kind
from fgloc.online.fixes import Fix, FixTable
from fgloc.online.layout import Layout, make_layout
from fgloc.online.propagate import Propagation
from fgloc.online.settings import OnlineSettings
from fgloc.online.smoother import WindowSmoother, first_prior
from fgloc.online.streams import CameraStream, GyroStream, Stream, YawStream
from fgloc.online.trust import Trust, Verdict
from fgloc.online.window import Window
from fgloc.smoothing.build import FREE_HEADING, KNOWN


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


DOWN_WEIGHTED = 0.25
"""A factor whose robust weight is below this counts as down-weighted."""


@dataclass
class Tally:
    """What became of one sensor's measurements."""

    accepted: int = 0
    """Factors with (nearly) full weight."""
    down_weighted: int = 0
    """Factors with a weight below 0.25."""
    rejected: dict[str, int] = field(default_factory=dict)
    """Measurements that did not become factors, by reason."""

    def reject(self, reason: str) -> None:
        """Count one more."""
        self.rejected[reason] = self.rejected.get(reason, 0) + 1


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
        self.window = Window(self.layout, self._loss(settings.wheel_loss), resolution)
        self.propagation = Propagation(self.layout, resolution)
        self.smoother = WindowSmoother(self.window, settings)
        self.trust = Trust(self.smoother)
        self.left_out: dict[str, str] = {}
        self.sensors = tuple(sensors)
        self.streams: dict[str, Stream] = {}
        self.fix_tables: dict[str, FixTable] = {}
        self.tally: dict[str, Tally] = {"wheels": Tally(), **{s.sensor: Tally() for s in sensors}}
        self.walks: dict[str, float] = {}
        self.waiting: list[Fix] = []
        self.now_ns = 0
        self.dirty: int | None = None
        self._resolution = resolution

    def _loss(self, loss: Loss) -> Loss:
        """Return a sensor's loss, or none where nothing is to be robust."""
        return loss if self.settings.robust else PLAIN

    def begin(self, stamp_ns: int, start: Start) -> None:
        """Make the first keyframe."""
        layout, window = self.layout, self.window
        state = np.zeros(layout.width)
        state[:3] = start.base
        self.now_ns = stamp_ns
        window.add_keyframe(stamp_ns, state)
        window.prior = first_prior(window, state, np.zeros((layout.width, layout.width)))
        known = window.table(
            Kind.POSE_FIX, "start", (6, 3), layout.places["start"].block, PLAIN
        )
        row = np.concatenate([start.pose, start.mount])
        known.add(0, row, np.diag(1.0 / start.sigma), weight=1.0)
        for sensor in self.sensors:
            self._open(sensor, stamp_ns)
        self.smoother.begin()
        self._restart()

    def _open(self, sensor: Sensor, stamp_ns: int) -> None:
        """Make the stream of one sensor, and the model of its drifting zero."""
        place = self.layout.places.get(sensor.sensor)
        if place is None:
            return  # a kind of sensor that this engine does not use
        settings, window = self.settings, self.window
        if isinstance(sensor, Yaw):
            loss = self._loss(settings.yaw_loss)
            self.streams[sensor.sensor] = YawStream(
                sensor, place, loss, window, self._touch, stamp_ns
            )
            self._open_zero(sensor.sensor, place.slot, FREE_HEADING, sensor.drift_sigma)
        elif isinstance(sensor, YawRate):
            loss = self._loss(settings.yaw_loss)
            self.streams[sensor.sensor] = GyroStream(sensor, place, loss, window, self._touch)
            sigma = max(sensor.bias_sigma, KNOWN)
            self._open_zero(sensor.sensor, place.slot, sigma, sensor.bias_walk)
        elif isinstance(sensor, CameraPoses):
            loss = self._loss(settings.camera_loss)
            self.streams[sensor.sensor] = CameraStream(sensor, place, loss, window, self._touch)
        elif isinstance(sensor, PositionFixes | PoseFixes):
            loss = self._loss(settings.fix_loss)
            self.fix_tables[sensor.sensor] = FixTable(sensor, place, loss, window)

    def _open_zero(self, sensor: str, slot: int, sigma: float, walk: float) -> None:
        """Give a drifting zero its prior and its random walk."""
        if slot < 0:
            return
        empty = slice(0, 0)
        prior = self.window.table(Kind.ZERO_PRIOR, sensor, (1, 1), empty, PLAIN, slot)
        prior.add(0, np.zeros(1), np.array([[1.0 / sigma]]), weight=1.0)
        self.window.table(Kind.ZERO_WALK, sensor, (1, 1), empty, PLAIN, slot)
        self.walks[sensor] = walk

    def _touch(self, number: int) -> None:
        """Note that a keyframe has a new factor."""
        self.dirty = number if self.dirty is None else min(self.dirty, number)

    def reading(self, sensor: str, stamp_ns: int, values: Floats, sigma: Floats | None) -> None:
        """Take a measurement of any sensor but the wheels, in any order of time.

        What cannot be used is counted with its reason, and never raises.
        """
        tally = self.tally[sensor]
        if sensor in self.left_out:
            tally.reject("contradicts the others")
        elif not np.isfinite(values).all():
            tally.reject("not finite")
        elif stamp_ns < self.window.stamp(self.window.base):
            tally.reject("older than the window")
        elif sensor in self.streams:
            value = float(values[0]) if values.size == 1 else values
            if not self.streams[sensor].push(stamp_ns, value):
                tally.reject("a second one with the same stamp")
        elif sensor in self.fix_tables:
            if sigma is None or not (np.isfinite(sigma).all() and (sigma > 0.0).all()):
                tally.reject("its sigma is zero, negative or not finite")
            else:
                self._fix(Fix(stamp_ns, sensor, values, sigma))
        else:
            tally.reject("not used by this engine")

    def _fix(self, fix: Fix) -> None:
        """Put a fix where it belongs, or let it wait for the wheels."""
        window = self.window
        if fix.stamp_ns > self.now_ns:
            insort(self.waiting, fix, key=lambda f: f.stamp_ns)
            return
        number = window.number_at(fix.stamp_ns)
        if fix.stamp_ns == self.now_ns and window.stamp(number) != self.now_ns:
            number = self._keyframe()
        moved = None
        if window.stamp(number) != fix.stamp_ns:
            moved = self._moved(number, fix.stamp_ns)
        self.fix_tables[fix.sensor].add(number, fix, moved)
        self._touch(number)

    def _moved(self, number: int, stamp_ns: int) -> Floats:
        """Return where the wheels had brought the robot at a stamp, seen from a keyframe before."""
        integrator = Integrator(self.layout.robot, self._resolution)
        integrator.restart(self.layout.values(self.smoother.calibration))
        left = (stamp_ns - self.window.stamp(number)) * 1e-9
        pieces = self.window.split(number, number + 2)
        for angles, steering, seconds in zip(
            pieces.angles, pieces.steering, pieces.seconds, strict=True
        ):
            part = min(1.0, left / seconds)
            integrator.add(angles * part, steering, seconds * part)
            left -= seconds
            if left <= 0.0:
                break
        return integrator.displacement

    def wheels(
        self, stamp_ns: int, angles: Floats, steering: Floats | None = None
    ) -> bool:
        """Take the wheels' rotation (D,) [rad] since the last packet, and its end.

        Returns False if the packet could not be used (counted with its reason).
        """
        tally = self.tally["wheels"]
        if not np.isfinite(angles).all() or (
            steering is not None and not np.isfinite(steering).all()
        ):
            tally.reject("not finite")
            return False
        if stamp_ns <= self.now_ns:
            tally.reject("time goes back")
            return False
        steer = np.zeros_like(angles) if steering is None else steering
        whole = stamp_ns - self.now_ns
        while self.waiting and self.waiting[0].stamp_ns <= stamp_ns:
            fix = self.waiting.pop(0)
            self._advance(angles, steer, fix.stamp_ns, whole)
            number = self.window.newest
            if self.window.stamp(number) != fix.stamp_ns:
                number = self._keyframe()
            self.fix_tables[fix.sensor].add(number, fix)
            self._touch(number)
        self._advance(angles, steer, stamp_ns, whole)
        if self._due():
            self._keyframe()
        if self.dirty is not None or self.smoother.unsolved >= self.settings.relinearise_every:
            self.update()
        return True

    def _advance(self, angles: Floats, steering: Floats, stamp_ns: int, whole: int) -> None:
        """Move on to a stamp within a packet of `whole` nanoseconds."""
        if stamp_ns <= self.now_ns:
            return
        part = (stamp_ns - self.now_ns) / whole
        seconds = (stamp_ns - self.now_ns) * 1e-9
        self.window.add_piece(angles * part, steering, seconds)
        self.propagation.add(angles * part, steering, seconds)
        self.now_ns = stamp_ns

    def _due(self) -> bool:
        """Return True if it is time for a keyframe."""
        s, window = self.settings, self.window
        last = window.newest
        # 5 % slack keeps a jittering sensor of the same rate from alternating between one and two.
        if self.now_ns - window.stamp(last) >= 0.95e9 * s.keyframe_period_s:
            return True
        before, now = window.state(last), self.propagation.state
        way = float(np.hypot(now[0] - before[0], now[1] - before[1]))
        return way >= s.keyframe_distance_m or abs(now[2] - before[2]) >= s.keyframe_turn

    def _keyframe(self) -> int:
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
        """Smooth with everything that came since the last time."""
        joint = self.propagation.joint()
        moved = self.propagation.displacement_covariance
        dropped = self.smoother.update(self.dirty, joint, moved)
        self.dirty = None
        verdict = self.trust.look() if self.smoother.smoothed_whole else None
        if verdict is not None:
            self._leave_out(verdict)
        self._restart()
        for sensor, weights in dropped.items():
            if sensor in self.tally:
                low = int(np.count_nonzero(weights < DOWN_WEIGHTED))
                self.tally[sensor].down_weighted += low
                self.tally[sensor].accepted += weights.size - low
        if dropped:
            oldest = self.window.stamp(self.window.base)
            for stream in self.streams.values():
                stream.prune(oldest)

    def _leave_out(self, verdict: Verdict) -> None:
        """Do without a sensor from now on."""
        self.streams.pop(verdict.sensor)
        self.left_out[verdict.sensor] = verdict.reason

    def _restart(self) -> None:
        """Let dead reckoning go on from the keyframe solved last."""
        posterior, window = self.smoother.posterior, self.window
        self.propagation.restart(posterior, window.state(posterior.number))
        open_pieces = window.split(posterior.number, window.newest + 2)
        for angles, steering, seconds in zip(
            open_pieces.angles, open_pieces.steering, open_pieces.seconds, strict=True
        ):
            self.propagation.add(angles, steering, float(seconds))
