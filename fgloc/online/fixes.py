"""Fixes in the online engine: at a keyframe of their own, or carried to the one before."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fgloc.core.geometry import compose
from fgloc.core.measurements import Floats, PoseFixes, PositionFixes
from fgloc.factors.robust import Loss
from fgloc.factors.tables import Kind
from fgloc.online.layout import Place
from fgloc.online.live_table import LiveTable
from fgloc.online.window import Window
from fgloc.smoothing.sensors import fix_sigma


@dataclass(frozen=True)
class Fix:
    """One fix, or another reading that has a keyframe at its stamp."""

    stamp_ns: int
    """When."""
    sensor: str
    """Which stream."""
    values: Floats
    """(2,) or (3,) position or pose in the map frame; (3,) number, range [m] and bearing [rad] of a
    landmark; (N,) ranges of a scan [m]."""
    sigma: Floats
    """Standard deviations of a fix; (0,) where they are the sensor's."""


class FixHost(Protocol):
    """What fixes need of an engine."""

    window: Window

    def touch(self, number: int) -> None:
        """Note that a keyframe has a new factor."""
        ...


class FixTable:
    """Rows of one stream of fixes."""

    def __init__(
        self, sensor: PositionFixes | PoseFixes, place: Place, loss: Loss, host: FixHost
    ) -> None:
        window, self._touch = host.window, host.touch
        d = len(sensor.mount)
        kind = Kind.POSE_FIX if d == 3 else Kind.POSITION_FIX
        self.delay_ns = 0
        self.dimension = d
        self.rounding = window.rounding
        self.mount = np.zeros(3)
        self.mount[:d] = sensor.mount
        self.table: LiveTable = window.table(kind, sensor.sensor, (2 * d, d), place.block, loss)
        # Stamps of the fixes that came, as far back as the window reaches.
        self.stamps: list[int] = []

    def first(self, fix: Fix) -> bool:
        """Note that a fix came; False if one of the same stamp came before. O(log N), usually."""
        stamp_ns = fix.stamp_ns
        at = bisect_left(self.stamps, stamp_ns)
        if at < len(self.stamps) and self.stamps[at] == stamp_ns:
            return False
        self.stamps.insert(at, stamp_ns)
        return True

    def due(self, state: Floats) -> bool:
        """Return True: every fix tells something."""
        return True

    def pending(self) -> list[str]:
        """Return nothing: a reading becomes a factor at once, or never."""
        return []

    def prune(self, before_ns: int) -> None:
        """Forget stamps that the window has left behind."""
        del self.stamps[: bisect_left(self.stamps, before_ns)]

    def add(self, number: int, fix: Fix, moved: Floats | None = None) -> None:
        """Add the row of a fix at a keyframe.

        `moved` (3,) is where the robot was at the fix's stamp, seen from the keyframe: a late fix
        has no keyframe of its own, so the sensor is mounted further off. What calibration adds to
        the mounting is not turned by that short way.
        """
        mount = self.mount if moved is None else compose(moved, self.mount)
        row = np.concatenate([fix.values, mount[: self.dimension]])
        self.table.add(number, row, np.diag(1.0 / fix_sigma(fix.sigma, self.rounding)))
        self._touch(number)
