"""The sliding window: keyframes, wheel increments between them, factors, and the prior before it.

Keyframes are numbered from the start of the drive. The window is the one truth of the online
engine: every solver is fed from it, and can be rebuilt from it.
"""

from __future__ import annotations

import numpy as np

from fgloc.core.measurements import Floats, Stamps
from fgloc.core.preintegration import SplitIncrements
from fgloc.factors.robust import Loss
from fgloc.factors.tables import FactorTable, Kind
from fgloc.online.growing import GrowingArray
from fgloc.online.layout import Layout
from fgloc.online.live_table import LiveTable
from fgloc.smoothing.problem import Problem

WHEELS = "wheels"
"""Name under which the wheels' factors are counted."""
HIDDEN = (Kind.ZERO_WALK, Kind.ZERO_PRIOR, Kind.STATE_PRIOR)
"""Tables that are a sensor's model, not its measurements."""


class Window:
    """Keyframes of the last seconds with everything that was measured there."""

    def __init__(self, layout: Layout, wheel_loss: Loss, resolution: float) -> None:
        self.layout = layout
        self.wheel_loss = wheel_loss
        self.resolution = resolution
        driven = len(layout.robot.base.driven)
        n = layout.size
        self.base = 0
        self.stamps_ns = GrowingArray((), np.int64)
        self.states = GrowingArray((layout.width,))
        self._bounds = GrowingArray((), np.int64)
        self._angles = GrowingArray((driven,))
        self._steering = GrowingArray((driven,))
        self._seconds = GrowingArray(())
        self._pieces = 0
        self._dropped = 0
        self.tables: dict[tuple[str, Kind], LiveTable] = {}
        self.prior: FactorTable | None = None
        # What elimination carried to each keyframe (square-root information of its state and the
        # calibration by everything older), and where it was linearised.
        self.carry = GrowingArray((n, n + 1))
        # Robust weight of the wheels' factor that begins at each keyframe.
        self.wheel_weight = GrowingArray(())
        self.linear_states = GrowingArray((layout.width,))
        self.linear_calibration = GrowingArray((n - layout.width,))

    @property
    def newest(self) -> int:
        """Return the number of the newest keyframe."""
        return self.base + len(self.stamps_ns) - 1

    def table(
        self,
        kind: Kind,
        sensor: str,
        sizes: tuple[int, int],
        calibration: slice,
        loss: Loss,
        slot: int = -1,
    ) -> LiveTable:
        """Return the live table of a kind and sensor, made on first use."""
        key = (sensor, kind)
        if key not in self.tables:
            self.tables[key] = LiveTable(kind, sensor, sizes, calibration, loss, slot)
        return self.tables[key]

    def add_piece(self, angles: Floats, steering: Floats, seconds: float) -> None:
        """Add wheel increments (D,) behind the newest keyframe."""
        self._angles.append(angles)
        self._steering.append(steering)
        self._seconds.append(seconds)
        self._pieces += 1

    def add_keyframe(self, stamp_ns: int, state: Floats) -> int:
        """Make the end of all increments so far a keyframe; return its number."""
        self.stamps_ns.append(stamp_ns)
        self.states.append(state)
        self._bounds.append(self._pieces)
        self.carry.append(0.0)
        self.wheel_weight.append(1.0)
        self.linear_states.append(state)
        self.linear_calibration.append(0.0)
        return self.newest

    def stamp(self, number: int) -> int:
        """Return the stamp of a live keyframe."""
        return int(self.stamps_ns.view[number - self.base])

    def state(self, number: int) -> Floats:
        """Return the (B,) state of a live keyframe as a view."""
        row: Floats = self.states.view[number - self.base]
        return row

    def number_at(self, stamp_ns: int) -> int:
        """Return the number of the last keyframe not later than a stamp; below base if none."""
        return self.base + int(np.searchsorted(self.stamps_ns.view, stamp_ns, side="right")) - 1

    def split(self, begin: int, end: int) -> SplitIncrements:
        """Return the increments between keyframes begin ≤ k < end; those behind a last one too.

        With `end` beyond the newest keyframe the open interval after it closes the list.
        """
        low, high = begin - self.base, end - self.base
        bounds: Stamps = self._bounds.view[low:high] - self._dropped
        if high > len(self._bounds):
            bounds = np.append(bounds, self._pieces - self._dropped)
        pieces = slice(int(bounds[0]), int(bounds[-1]))
        return SplitIncrements(
            angles=self._angles.view[pieces],
            steering=self._steering.view[pieces],
            seconds=self._seconds.view[pieces],
            bounds=bounds - pieces.start,
            resolution=self.resolution,
        )

    def problem(self, begin: int, end: int, tables: tuple[FactorTable, ...]) -> Problem:
        """Return the graph of keyframes begin ≤ k < end with the given factors."""
        low, high = begin - self.base, end - self.base
        unknown = np.full(high - low - 1, np.nan)
        return Problem(
            keyframes_ns=self.stamps_ns.view[low:high],
            robot=self.layout.robot,
            split=self.split(begin, end),
            free=self.layout.free,
            parameters=self.layout.parameters,
            tables=tables,
            states=self.states.view[low:high],
            counts={},
            wheel_loss=self.wheel_loss,
            turn=unknown,
            turn_spread=np.zeros((unknown.size, 2)),
        )

    def drop(self, before: int) -> dict[str, Floats]:
        """Forget keyframes older than `before`; return the last weights of what was dropped.

        By sensor, the wheels' under their own name.
        """
        count = before - self.base
        weights = {WHEELS: self.wheel_weight.view[:count].copy()}
        pieces = int(self._bounds.view[count]) - self._dropped
        for column in (
            self.stamps_ns,
            self.states,
            self._bounds,
            self.carry,
            self.wheel_weight,
            self.linear_states,
            self.linear_calibration,
        ):
            column.drop(count)
        for increments in (self._angles, self._steering, self._seconds):
            increments.drop(pieces)
        self._dropped += pieces
        self.base = before
        for table in self.tables.values():
            gone = table.drop(before)
            if table.kind not in HIDDEN:
                weights[table.sensor] = gone
        return weights
