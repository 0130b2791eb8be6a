"""Fixes in the online engine: at a keyframe of their own, or carried to the one before."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

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
    """One fix that waits for the wheels to reach its stamp."""

    stamp_ns: int
    """When."""
    sensor: str
    """Which stream."""
    values: Floats
    """(2,) or (3,) position or pose in the map frame."""
    sigma: Floats
    """Their standard deviations."""


class FixTable:
    """Rows of one stream of fixes."""

    def __init__(
        self, sensor: PositionFixes | PoseFixes, place: Place, loss: Loss, window: Window
    ) -> None:
        d = len(sensor.mount)
        kind = Kind.POSE_FIX if d == 3 else Kind.POSITION_FIX
        self.dimension = d
        self.rounding = window.rounding
        self.mount = np.zeros(3)
        self.mount[:d] = sensor.mount
        self.table: LiveTable = window.table(kind, sensor.sensor, (2 * d, d), place.block, loss)
        # Stamps of the fixes that came, as far back as the window reaches.
        self.stamps: list[int] = []

    def first_at(self, stamp_ns: int) -> bool:
        """Note that a fix came; False if one of the same stamp came before. O(log N), usually."""
        at = bisect_left(self.stamps, stamp_ns)
        if at < len(self.stamps) and self.stamps[at] == stamp_ns:
            return False
        self.stamps.insert(at, stamp_ns)
        return True

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
