"""The sliding window: keyframes, wheel increments between them, factors, and the prior before it.

Keyframes are numbered from the start of the drive. The window is the one truth of the online
engine: every solver is fed from it, and can be rebuilt from it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from fgloc.core.measurements import Floats, Stamps
from fgloc.core.preintegration import SplitIncrements, rounding_sigma
from fgloc.factors.robust import Loss
from fgloc.factors.slip import slip_effect
from fgloc.factors.tables import LANDMARK, FactorTable, Kind
from fgloc.online.growing import GrowingArray
from fgloc.online.landmarks import Landmarks, wider
from fgloc.online.layout import Layout
from fgloc.online.live_table import LiveTable
from fgloc.smoothing.problem import HIDDEN, Problem, predicted_displacement

WHEELS = "wheels"
"""Name under which the wheels' factors are counted."""
GUESSED = 0.03
"""Sigma of a slip that is taken to go on as it was."""
REINTEGRATE = 0.01
"""Change of a calibration variable beyond which the wheels are integrated again."""


class Window:
    """Keyframes of the last seconds with everything that was measured there."""

    def __init__(self, layout: Layout, wheel_loss: Loss, resolution: float) -> None:
        self.layout = layout
        self.resolution = resolution
        # (3,) how far rounded counts put a keyframe from where the base is, in body axes.
        self.rounding = rounding_sigma(layout.robot, resolution)
        driven = len(layout.robot.base.driven)
        n = layout.size
        self.base = 0
        self.stamps_ns = GrowingArray((), np.int64)
        self.states = GrowingArray((layout.width,))
        self._bounds = GrowingArray((), np.int64)
        self._angles = GrowingArray((driven,))
        self._steering = GrowingArray((driven,))
        self._seconds = GrowingArray(())
        # Slips of the wheels in the interval that ends at each keyframe, and what is known of them.
        self.slips = GrowingArray((driven,))
        self.slip_sigmas = GrowingArray((driven,))
        # What may have moved the robot besides its wheels in that interval: sigmas [m, m, rad].
        self.jolts = GrowingArray((3,))
        self.jolted = -1
        self.slipping = np.zeros(driven)
        self.slipped = -1
        # Stamps, slips and sigmas of the intervals with slip that have left the window.
        self.slip_history: list[tuple[int, int, Floats, Floats]] = []
        self._pieces = 0
        self._dropped = 0
        self.landmarks = Landmarks(layout.width, n - layout.width)
        self.tables: dict[tuple[str, Kind], LiveTable] = {}
        f = len(layout.free)
        self.wheels = self.table(Kind.WHEEL, WHEELS, (3 + 3 * f, 3), slice(0, f), wheel_loss)
        # The calibration at which the wheels' displacements were integrated last.
        self._reference = np.zeros(n - layout.width)
        # The newest calibration: what the wheels predict for other sensors is taken there.
        self.latest = np.zeros(n - layout.width)
        self.prior: FactorTable | None = None
        # What elimination carried to each keyframe (square-root information of its state and the
        # border by everything older), and where it was linearised.
        self.carry = GrowingArray((n, n + 1))
        self.linear_states = GrowingArray((layout.width,))
        self.linear_border = GrowingArray((n - layout.width,))

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
            marks = self.landmarks
            places = marks.places if kind in LANDMARK else None
            self.tables[key] = LiveTable(
                kind, sensor, sizes, calibration, loss, slot, places, marks.parameters
            )
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
        self.slips.append(self.slipping)
        self.slip_sigmas.append(np.where(self.slipping == 0.0, 0.0, GUESSED))
        self.jolts.append(0.0)
        if self.slipping.any():
            self.slipped = self.newest
        self.carry.append(0.0)
        self.linear_states.append(state)
        self.linear_border.append(0.0)
        return self.newest

    def close_interval(self, calibration: Floats) -> None:
        """Make the wheels' factor between the two newest keyframes."""
        self.latest = calibration.copy()
        table = self._wheel_table(self.newest - 1, calibration)
        self.wheels.add(
            self.newest - 1, table.measurements[0], table.sqrt_information[0], weight=1.0
        )

    def _wheel_table(self, begin: int, calibration: Floats) -> FactorTable:
        """Return the wheels' factors from keyframe `begin` on, as uncertain as their slips."""
        table = self.problem(begin, self.newest + 1, ()).wheel_table(calibration)
        if self.jolted > begin:
            jolts = self.jolts.view[begin - self.base + 1 :]
            k = np.flatnonzero(jolts.any(axis=1))
            spread = jolts[k][:, :, None] * np.eye(3)
            table.sqrt_information[k] = _spread(table.sqrt_information[k], spread)
        sigma = self.slip_sigmas.view[begin - self.base + 1 :]
        k = np.flatnonzero(sigma.any(axis=1)) if self.slipped > begin else np.zeros(0, np.int64)
        if not k.size:
            return table
        raw, slips = (
            self._raw_split(begin, self.newest + 1),
            self.slips.view[begin - self.base + 1 :],
        )
        _, effect = slip_effect(raw, self.layout.robot, self.layout.values(calibration), slips)
        spread = effect[k] * sigma[k][:, None, :]
        table.sqrt_information[k] = _spread(table.sqrt_information[k], spread)
        return table

    def jolt(self, begin: int, sigma: Floats, calibration: Floats) -> None:
        """Allow for `sigma` (3,) [m, m, rad] of motion in each interval since keyframe `begin`.

        That the wheels know nothing of: the robot was lifted, pushed, or its wheels hung in the
        air. Their factors are believed anew.
        """
        self.jolts.view[begin - self.base + 1 :] = sigma
        self.jolted = self.newest
        rows = self.wheels.rows(begin, self.newest + 1)
        table = self._wheel_table(begin, calibration)
        self.wheels.sqrt_information.view[rows] = table.sqrt_information
        self.wheels.weight.view[rows] = 1.0

    def set_slips(self, begin: int, slips: Floats, sigmas: Floats, calibration: Floats) -> None:
        """Take (N, D) slips and their sigmas for the N intervals from keyframe `begin` on.

        The last of them goes on until it is set anew. Wheel factors are integrated again and
        believed anew.
        """
        row = begin - self.base
        self.slips.view[row + 1 :] = slips
        self.slip_sigmas.view[row + 1 :] = sigmas
        self.slipping = slips[-1].copy()
        slipped = np.flatnonzero(self.slips.view.any(axis=1))
        self.slipped = self.base + int(slipped[-1]) if slipped.size else -1
        rows = self.wheels.rows(begin, self.newest + 1)
        table = self._wheel_table(begin, calibration)
        self.wheels.measurements.view[rows] = table.measurements
        self.wheels.sqrt_information.view[rows] = table.sqrt_information
        self.wheels.weight.view[rows] = 1.0

    def integrate_again(self, calibration: Floats) -> None:
        """Integrate all wheel increments anew if the calibration has moved too far for first order.

        The factors hold displacement and derivative; what is left out grows with the square of
        the change: a hundredth of a percent of the way at REINTEGRATE.
        """
        if np.abs(calibration - self._reference).max(initial=0.0) < REINTEGRATE:
            return
        self._reference = calibration.copy()
        if len(self.wheels.first):
            table = self._wheel_table(self.base, calibration)
            self.wheels.measurements.view[:] = table.measurements
            self.wheels.sqrt_information.view[:] = table.sqrt_information
            moved = predicted_displacement(table, calibration)
            for live in self.tables.values():
                if live.kind == Kind.CAMERA:
                    live.measurements.view[:, 6:9] = moved[live.first.view - self.base]

    def predicted(self, number: int) -> Floats:
        """Return the (3,) displacement from keyframe `number` to the next that wheels predict."""
        rows = self.wheels.rows(number, number + 2)
        table = self.wheels.view(rows, number)
        moved: Floats = predicted_displacement(table, self.latest)[0]
        return moved

    def slips_until(self, count: int) -> list[tuple[int, int, Floats, Floats]]:
        """Return begin, end [ns], slips and sigmas (D,) of the first `count` intervals that have
        any."""
        if self.slipped < self.base:
            return []
        rows = 1 + np.flatnonzero(self.slips.view[1 : count + 1].any(axis=1))
        stamps = self.stamps_ns.view
        return [
            (
                int(stamps[k - 1]),
                int(stamps[k]),
                self.slips.view[k].copy(),
                self.slip_sigmas.view[k].copy(),
            )
            for k in rows
        ]

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
        """Return the increments between keyframes begin ≤ k < end, less what the wheels slipped.

        With `end` two beyond the newest keyframe the open interval after it closes the list.
        """
        split = self._raw_split(begin, end)
        if self.slipped <= begin and not self.slipping.any():
            return split
        row = begin - self.base + 1
        slips = np.append(self.slips.view[row:], self.slipping[None], axis=0)
        gripping = 1.0 - slips[: split.bounds.size - 1]
        angles = split.angles * np.repeat(gripping, np.diff(split.bounds), axis=0)
        return replace(split, angles=angles)

    def _raw_split(self, begin: int, end: int) -> SplitIncrements:
        """Return the increments between keyframes as the wheels turned; see `split`."""
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

    def problem(
        self, begin: int, end: int, tables: tuple[FactorTable, ...], as_turned: bool = False
    ) -> Problem:
        """Return the graph of keyframes begin ≤ k < end with the given factors.

        `as_turned`: with the wheels as they turned, slip included.
        """
        low, high = begin - self.base, end - self.base
        unknown = np.full(high - low - 1, np.nan)
        return Problem(
            keyframes_ns=self.stamps_ns.view[low:high],
            robot=self.layout.robot,
            split=self._raw_split(begin, end) if as_turned else self.split(begin, end),
            free=self.layout.free,
            parameters=self.layout.parameters,
            tables=tables,
            states=self.states.view[low:high],
            counts={},
            wheel_loss=self.wheels.loss,
            turn=unknown,
            turn_spread=np.zeros((unknown.size, 2)),
        )

    def widen(self, guesses: Floats, root: Floats) -> None:
        """Give the border more columns, of which `root` (m, m) is known about `guesses` (m,)."""
        assert self.prior is not None
        self.prior = wider(self.prior, self.layout.width, guesses, root)
        self.landmarks.aside.widen(guesses)
        old, at = self.carry.view, self.linear_border.view
        k, n, m = old.shape[0], old.shape[1], guesses.size
        carry, border = np.zeros((k, n + m, n + m + 1)), np.zeros((k, at.shape[1] + m))
        carry[:, :n, :n], carry[:, :n, -1] = old[:, :, :n], old[:, :, n]
        carry[:, n:, n:-1] = root
        border[:, : at.shape[1]], border[:, at.shape[1] :] = at, guesses
        self._carry(carry, border)

    def rearrange(self, columns: int) -> None:
        """Give the border another number of columns; nothing is carried to any keyframe."""
        k, n = len(self.stamps_ns), self.layout.width + columns
        self._carry(np.zeros((k, n, n + 1)), np.zeros((k, columns)))

    def _carry(self, carry: Floats, border: Floats) -> None:
        """Hold what is carried, and where the border was linearised, in other sizes."""
        room = 2 * carry.shape[0] + 16
        self.carry = GrowingArray(carry.shape[1:], capacity=room)
        self.carry.replace(carry)
        self.linear_border = GrowingArray(border.shape[1:], capacity=room)
        self.linear_border.replace(border)

    def factors(self, begin: int, tables: Iterable[LiveTable]) -> list[FactorTable]:
        """Return the factors of live tables from keyframe `begin` on.

        But for the wheels', and for those that see landmarks.
        """
        found = []
        for live in tables:
            rows = live.rows(begin, self.newest + 1)
            if rows.start < rows.stop and live is not self.wheels and not live.sees_landmarks:
                found.append(live.view(rows, begin))
        return found

    def wheel_factors(self) -> FactorTable:
        """Return the wheels' factors between all keyframes, as integrated last."""
        return self.wheels.view(self.wheels.rows(self.base, self.newest + 1), self.base)

    def drop(self, before: int) -> dict[str, Floats]:
        """Forget keyframes older than `before`; return the last weights of what was dropped.

        By sensor, the wheels' under their own name.
        """
        count = before - self.base
        weights: dict[str, Floats] = {}
        pieces = int(self._bounds.view[count]) - self._dropped
        self.slip_history += self.slips_until(count)
        for column in (
            self.stamps_ns,
            self.states,
            self.slips,
            self.slip_sigmas,
            self.jolts,
            self._bounds,
            self.carry,
            self.linear_states,
            self.linear_border,
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


def _spread(root: Floats, spread: Floats) -> Floats:
    """Return square-root information (K, 3, 3) of what has an error spread (K, 3, m) more."""
    covariance = np.linalg.inv(root.swapaxes(1, 2) @ root)
    wider = np.linalg.cholesky(covariance + spread @ spread.swapaxes(1, 2))
    return np.asarray(np.linalg.inv(wider))
