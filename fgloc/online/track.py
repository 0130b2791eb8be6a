"""The poses that an engine emitted, and a file to which they are appended."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fgloc.core.kinematics import Parameter
from fgloc.core.measurements import Stamps
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError
from fgloc.estimator import TURNING, TurningHistory
from fgloc.online.engine import OnlineEngine

RECORD = np.dtype(
    [
        ("stamp_ns", "<i8"),
        ("pose", "<f8", (3,)),
        ("covariance", "<f8", (3, 3)),
        ("turning", "<f8", (2,)),
    ]
)
"""One pose in the file: 120 bytes; metres, radians, map axes; effective track and its sigma."""


class Track:
    """One pose and covariance a wheel stamp, as they were emitted."""

    def __init__(self, stamps_ns: Stamps, parameters: Sequence[Parameter] = ()) -> None:
        """Prepare for the wheel stamps (N,) of a drive and an engine's calibration variables."""
        self._parameters = tuple(parameters)
        names = [p.name for p in parameters]
        found = [names.index(n) for n in TURNING if n in names]
        self._column = found[0] if found else -1
        self._rows = np.zeros(stamps_ns.size, RECORD)
        self._rows["stamp_ns"] = stamps_ns
        self.count = 0

    def emit(self, engine: OnlineEngine) -> None:
        """Take the engine's pose of now for the next stamp."""
        row = self._rows[self.count]
        row["pose"] = engine.propagation.state[:3]
        row["covariance"] = engine.propagation.covariance()
        row["turning"] = self._turning(engine)
        self.count += 1

    def _turning(self, engine: OnlineEngine) -> tuple[float, float]:
        """Return effective track and sigma as they are known now; NaN without one. O(1)."""
        parameters = engine.layout.parameters
        if self._column < 0:
            return np.nan, np.nan
        known, k = engine.smoother.posterior, self._column
        p, u, b = parameters[k], float(known.border[k]), engine.layout.width
        return p.to_value(u), float(np.sqrt(known.covariance[b + k, b + k])) * p.derivative(u)

    def history(self) -> TurningHistory | None:
        """Return the effective track over time; None for a robot that calibrates none."""
        if self._column < 0:
            return None
        p, rows = self._parameters[self._column], self._rows
        return TurningHistory(
            p.name,
            p.unit,
            p.nominal,
            rows["stamp_ns"].astype(np.int64),
            rows["turning"][:, 0].copy(),
            rows["turning"][:, 1].copy(),
        )

    def trajectory(self) -> Trajectory:
        """Return all poses."""
        rows = self._rows
        return Trajectory(
            rows["stamp_ns"].astype(np.int64), rows["pose"].copy(), rows["covariance"].copy()
        )

    def append_to(self, path: Path, written: int) -> None:
        """Write the poses behind the first `written` to the end of a file, flushed to disk."""
        with open(path, "ab") as file:
            file.write(self._rows[written : self.count].tobytes())
            file.flush()
            os.fsync(file.fileno())

    def take_from(self, path: Path, count: int) -> None:
        """Begin with the first `count` poses of a file, and cut off what is behind them there.

        Raises FglocError if they are not there, or are those of other stamps.
        """
        try:
            rows = np.fromfile(path, RECORD, count)
        except FileNotFoundError:
            rows = np.zeros(0, RECORD)
        expected = self._rows["stamp_ns"][:count]
        if rows.size != count or not np.array_equal(rows["stamp_ns"], expected):
            raise FglocError(
                f"does not hold the {count} poses that belong to the state beside it; "
                "start the drive again",
                file=path,
            )
        os.truncate(path, count * RECORD.itemsize)
        self._rows[:count] = rows
        self.count = count
