"""From readings to factors: each sensor's stream makes the rows that batch would make.

A continuous sensor is interpolated to the keyframes, so its row for a keyframe comes with the
first reading behind it. A late reading is put where it belongs, and the keyframes beside it are
looked at again. Scalar code: a call costs microseconds.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_left, bisect_right
from collections.abc import Callable
from typing import Any

import numpy as np

from fgloc.core.geometry import between, interpolate, wrap_scalar
from fgloc.core.measurements import CameraPoses, Floats, Yaw, YawRate
from fgloc.factors.robust import Loss
from fgloc.factors.tables import Kind
from fgloc.online.layout import Place
from fgloc.online.window import Window
from fgloc.smoothing.keyframes import MAX_GAP_S
from fgloc.smoothing.sensors import camera_sigma, gyro_sigma, yaw_sigma

GAP_NS = int(MAX_GAP_S * 1e9)
Touch = Callable[[int], None]
"""Told the last keyframe that every added row belongs to."""


class Stream(ABC):
    """Readings of one sensor, sorted by stamp, as far back as the window reaches."""

    def __init__(self, sensor: str, window: Window, touch: Touch) -> None:
        self.sensor = sensor
        self.window = window
        self.touch = touch
        self.stamps: list[int] = []
        self.values: list[Any] = []

    def push(self, stamp_ns: int, value: Any) -> bool:
        """Take a reading in any order; False for a second one with the same stamp."""
        at = bisect_left(self.stamps, stamp_ns)
        if at < len(self.stamps) and self.stamps[at] == stamp_ns:
            return False
        self.stamps.insert(at, stamp_ns)
        self.values.insert(at, value)
        last = min(at + 1, len(self.stamps) - 1)
        self.look(self.stamps[max(at - 1, 0)], self.stamps[last])
        return True

    def keyframe_added(self, number: int) -> None:
        """Make what can be made at the newest keyframe from readings that came before it."""
        stamp = self.window.stamp(number)
        if self.stamps and self.stamps[-1] >= stamp:
            self.look(stamp, stamp)

    @abstractmethod
    def look(self, begin_ns: int, end_ns: int) -> None:
        """Make the rows that readings between two stamps allow."""

    def prune(self, before_ns: int) -> None:
        """Forget readings that no keyframe of the window needs any more."""
        at = bisect_right(self.stamps, before_ns) - 1
        if at > 0:
            del self.stamps[:at], self.values[:at]

    def forget(self, since_ns: int) -> None:
        """Forget readings from a stamp on."""
        at = bisect_left(self.stamps, since_ns)
        del self.stamps[at:], self.values[at:]

    def numbers(self, begin_ns: int, end_ns: int) -> range:
        """Return the numbers of the live keyframes with begin ≤ stamp ≤ end."""
        w = self.window
        low = w.number_at(begin_ns - 1) + 1
        return range(max(low, w.base), w.number_at(end_ns) + 1)

    def bracket(self, stamp_ns: int) -> tuple[int, float] | None:
        """Return the reading before a stamp and the fraction to the next; None if too far off."""
        at = bisect_right(self.stamps, stamp_ns) - 1
        if at < 0:
            return None
        if self.stamps[at] == stamp_ns:
            return at, 0.0
        if at + 1 == len(self.stamps):
            return None
        gap = self.stamps[at + 1] - self.stamps[at]
        return (at, (stamp_ns - self.stamps[at]) / gap) if gap <= GAP_NS else None


class YawStream(Stream):
    """Absolute headings: one row a keyframe, its zero measured from the first one."""

    def __init__(
        self, sensor: Yaw, place: Place, loss: Loss, window: Window, touch: Touch, epoch_ns: int
    ) -> None:
        super().__init__(sensor.sensor, window, touch)
        self.epoch_ns = epoch_ns
        self.zero = float("nan")
        self.last_used = -1
        self.root = np.array([[1.0 / yaw_sigma(sensor, window.rounding)]])
        self.table = window.table(Kind.YAW, sensor.sensor, (2, 1), place.block, loss, place.slot)

    def look(self, begin_ns: int, end_ns: int) -> None:
        """Make the rows of keyframes between two stamps, each reading used once at most."""
        for number in self.numbers(begin_ns, end_ns):
            stamp = self.window.stamp(number)
            found = self.bracket(stamp)
            if found is None or self.table.has(number):
                continue
            at, fraction = found
            nearest = self.stamps[at + (fraction > 0.5)]
            if nearest == self.last_used:
                continue
            reading = self.values[at]
            if fraction > 0.0:
                reading += fraction * wrap_scalar(self.values[at + 1] - reading)
            if np.isnan(self.zero):
                self.zero = wrap_scalar(reading - self.window.state(number)[2])
            seconds = (stamp - self.epoch_ns) * 1e-9
            self.table.add(number, np.array([reading - self.zero, seconds]), self.root)
            self.last_used = nearest
            self.touch(number)


class GyroStream(Stream):
    """Yaw rates: one row an interval between keyframes, integrated by the trapezoidal rule."""

    def __init__(
        self, sensor: YawRate, place: Place, loss: Loss, window: Window, touch: Touch
    ) -> None:
        super().__init__(sensor.sensor, window, touch)
        self.noise = sensor
        self.table = window.table(
            Kind.YAW_RATE, sensor.sensor, (2, 1), place.block, loss, place.slot
        )

    def look(self, begin_ns: int, end_ns: int) -> None:
        """Make the rows of intervals that end between two stamps or hold the first of them."""
        w = self.window
        for number in range(max(w.number_at(begin_ns), w.base), w.number_at(end_ns)):
            if self.table.has(number):
                continue
            first, second = w.stamp(number), w.stamp(number + 1)
            angle = self.turned(first, second)
            if angle is None:
                continue
            seconds = (second - first) * 1e-9
            sigma = gyro_sigma(self.noise, np.array([seconds]), self.window.rounding)
            root = 1.0 / sigma[:, None]
            self.table.add(number, np.array([angle, seconds]), root)
            self.touch(number + 1)

    def keyframe_added(self, number: int) -> None:
        """Look at the interval that ends at the newest keyframe."""
        if number > self.window.base and self.stamps:
            stamp = self.window.stamp(number)
            if self.stamps[-1] >= stamp:
                self.look(self.window.stamp(number - 1), stamp)

    def turned(self, first: int, second: int) -> float | None:
        """Return the angle turned between two stamps, None if a part of it is not known."""
        begin, end = self.bracket(first), self.bracket(second)
        if begin is None or end is None:
            return None
        stamp, rate = first, self._rate(begin)
        total = 0.0
        for at in range(begin[0] + 1, end[0] + 1):
            if self.stamps[at] - stamp > GAP_NS:
                return None
            total += 0.5 * (rate + self.values[at]) * (self.stamps[at] - stamp)
            stamp, rate = self.stamps[at], self.values[at]
        return 1e-9 * float(total + 0.5 * (rate + self._rate(end)) * (second - stamp))

    def _rate(self, place: tuple[int, float]) -> float:
        """Return the rate at a place between two readings."""
        at, fraction = place
        if fraction == 0.0:
            return float(self.values[at])
        return float(self.values[at] + fraction * (self.values[at + 1] - self.values[at]))


class CameraStream(Stream):
    """Camera odometry: one relative motion an interval between keyframes."""

    def __init__(
        self, sensor: CameraPoses, place: Place, loss: Loss, window: Window, touch: Touch
    ) -> None:
        super().__init__(sensor.sensor, window, touch)
        self.noise = sensor
        self.table = window.table(Kind.CAMERA, sensor.sensor, (9, 3), place.block, loss)

    def look(self, begin_ns: int, end_ns: int) -> None:
        """Make the rows of intervals with an end between two stamps."""
        w = self.window
        begin = max(w.number_at(begin_ns) - 1, w.base)
        for number in range(begin, min(w.number_at(end_ns) + 1, w.newest)):
            if self.table.has(number):
                continue
            first, second = self._pose(w.stamp(number)), self._pose(w.stamp(number + 1))
            if first is None or second is None:
                continue
            motion = between(first, second)
            sigma = camera_sigma(self.noise, motion[None], w.rounding)[0]
            row = np.concatenate([motion, self.noise.mount, w.predicted(number)])
            self.table.add(number, row, np.diag(1.0 / sigma))
            self.touch(number + 1)

    def _pose(self, stamp_ns: int) -> Floats | None:
        """Return the camera's pose at a stamp, interpolated on SE(2)."""
        found = self.bracket(stamp_ns)
        if found is None:
            return None
        at, fraction = found
        pose: Floats = self.values[at]
        if fraction == 0.0:
            return pose
        return interpolate(pose, self.values[at + 1], np.array(fraction))
