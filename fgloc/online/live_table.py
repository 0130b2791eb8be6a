"""Factors of one sensor in a sliding window: added at any keyframe, dropped with the oldest."""

from __future__ import annotations

import numpy as np

from fgloc.core.measurements import Floats, Stamps
from fgloc.factors.robust import PLAIN, Loss
from fgloc.factors.tables import LANDMARK, PAIRWISE, FactorTable, Kind
from fgloc.online.growing import GrowingArray


class LiveTable:
    """A FactorTable that grows; `first` are keyframe numbers since the start of the drive."""

    def __init__(
        self,
        kind: Kind,
        sensor: str,
        sizes: tuple[int, int],
        calibration: slice,
        loss: Loss = PLAIN,
        slot: int = -1,
        places: GrowingArray | None = None,
        parameters: int = 0,
    ) -> None:
        """`sizes` are those of a measurement row and of the residual.

        For kinds that see landmarks: `places` of all landmarks in the border, by number, and the
        `parameters` of the calibration before them.
        """
        measurement, dimension = sizes
        self.dimension = dimension
        self.kind = kind
        self.sensor = sensor
        self.calibration = calibration
        self.loss = loss
        self.slot = slot
        self.pairwise = kind in PAIRWISE
        self.sees_landmarks = kind in LANDMARK
        self._places = places
        self._parameters = parameters
        self.first = GrowingArray((), np.int64)
        # Number of the landmark that each row sees, -1 where the kind sees none.
        self.second = GrowingArray((), np.int64)
        self.measurements = GrowingArray((measurement,))
        self.sqrt_information = GrowingArray((dimension, dimension))
        self.added = 0
        # How many rows had been added before each one: the newest can be taken back.
        self.serial = GrowingArray((), np.int64)
        # Whether a new row that surprises is worth nothing, whatever the loss says.
        self.strict = False
        # Robust weight of each row; infinite until the row has been judged.
        self.weight = GrowingArray(())

    def add(
        self,
        first: int,
        measurement: Floats,
        sqrt_information: Floats,
        weight: float = np.inf,
        second: int = -1,
    ) -> None:
        """Add a factor; usually the newest, but any place will do. Not judged yet by default."""
        self.added += 1
        first_rows = self.first.view
        n = first_rows.size
        at = n
        if n and first < first_rows[-1]:
            at = int(np.searchsorted(first_rows, first, side="right"))
        self.first.insert(at, first)
        self.second.insert(at, second)
        self.serial.insert(at, self.added)
        self.measurements.insert(at, measurement)
        self.sqrt_information.insert(at, sqrt_information)
        self.weight.insert(at, weight)

    def has(self, number: int) -> bool:
        """Return True if there is a factor whose first keyframe is `number`."""
        first = self.first.view
        at = int(np.searchsorted(first, number))
        return at < first.size and first[at] == number

    def rows(self, begin: int, end: int) -> slice:
        """Return the live rows that lie within keyframes begin ≤ k < end."""
        first = self.first.view
        last = end - 1 if self.pairwise else end
        low = int(np.searchsorted(first, begin))
        return slice(low, max(int(np.searchsorted(first, last)), low))

    def view(self, rows: slice, begin: int) -> FactorTable:
        """Return live rows as a table, its keyframes numbered from `begin`.

        The arrays are views: they hold until the next change.
        """
        return FactorTable(
            self.kind,
            self.sensor,
            self.first.view[rows] - begin,
            self.measurements.view[rows],
            self.sqrt_information.view[rows],
            self.calibration,
            self.loss,
            self.slot,
            None if self._places is None else self._places.view[self.second.view[rows]],
        )

    def border_columns(self, rows: slice) -> Stamps:
        """Return the columns (M, 2) of the border that live rows' landmarks have."""
        assert self._places is not None
        place = self._places.view[self.second.view[rows]]
        return np.asarray(self._parameters + 2 * place[:, None] + np.arange(2))

    def drop(self, before: int) -> Floats:
        """Forget the factors whose first keyframe is older than `before`; return their weights."""
        count = int(np.searchsorted(self.first.view, before))
        weights = self.weight.view[:count].copy()
        for column in self._columns:
            column.drop(count)
        return weights

    def forget(self, since: int) -> int:
        """Forget the factors whose first keyframe is `since` or later; return how many they were.

        Not for kinds that see landmarks.
        """
        count = int(np.searchsorted(self.first.view, since))
        lost = len(self.first) - count
        for column in self._columns:
            column.replace(column.view[:count].copy())
        return lost

    def take_back(self, since: int = 0) -> int:
        """Forget the rows added after the first `since` ever; return how many they were."""
        rows = np.flatnonzero(self.serial.view > since)
        for column in self._columns:
            column.replace(np.delete(column.view, rows, axis=0))
        return int(rows.size)

    @property
    def _columns(self) -> tuple[GrowingArray, ...]:
        """Return all columns."""
        return (
            self.first,
            self.second,
            self.serial,
            self.measurements,
            self.sqrt_information,
            self.weight,
        )
