"""Where a problem is put together: calibration blocks, state columns, landmarks and tables."""

from __future__ import annotations

import numpy as np

from fgloc.core.measurements import Floats, Stamps
from fgloc.core.robot import Robot
from fgloc.factors.tables import FactorTable, Kind
from fgloc.smoothing.problem import diagonal
from fgloc.smoothing.sensors import Columns


class Builder(Columns):
    """Collects calibration blocks, state columns and tables while a problem is built."""

    def __init__(self, keyframes_ns: Stamps, robot: Robot, rounding: Floats) -> None:
        super().__init__(robot)
        self.keyframes_ns = keyframes_ns
        # (3,) sigma of a keyframe's pose, as the counts tell it: x, y, heading in body axes.
        self.rounding = rounding
        self.tables: list[FactorTable] = []
        self.counts: dict[str, tuple[int, int]] = {}
        self.zeros: list[tuple[int, float]] = []
        self.marks: dict[int, int] = {}

    def zero(self, sensor: str, first: float, sigma: float, walk: Floats) -> int:
        """Return a new state column for a drifting zero; `walk` (K-1,) are its step sigmas."""
        column = self.slot()
        self.zeros.append((column, first))
        k = walk.size
        empty = slice(0, 0)
        self.tables.append(
            FactorTable(
                Kind.ZERO_WALK,
                sensor,
                np.arange(k, dtype=np.int64),
                np.zeros((k, 1)),
                diagonal(walk[:, None]),
                empty,
                slot=column,
            )
        )
        self.tables.append(
            FactorTable(
                Kind.ZERO_PRIOR,
                sensor,
                np.zeros(1, dtype=np.int64),
                np.array([[first]]),
                diagonal(np.array([[sigma]])),
                empty,
                slot=column,
            )
        )
        return column

    def mark_numbers(self, identities: Stamps) -> Stamps:
        """Return the (N,) places of landmarks in the problem, given what the sensors call them."""
        for name in np.unique(identities).tolist():
            self.marks.setdefault(name, len(self.marks))
        return np.array([self.marks[name] for name in identities.tolist()], dtype=np.int64)

    def seconds(self) -> Floats:
        """Return (K-1,) durations between keyframes [s]."""
        return np.diff(self.keyframes_ns) * 1e-9
