"""The poses that an engine emitted, and a file to which they are appended."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from fgloc.core.measurements import Stamps
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError
from fgloc.online.engine import OnlineEngine

RECORD = np.dtype([("stamp_ns", "<i8"), ("pose", "<f8", (3,)), ("covariance", "<f8", (3, 3))])
"""One pose in the file: 104 bytes; metres, radians, map axes."""


class Track:
    """One pose and covariance a wheel stamp, as they were emitted."""

    def __init__(self, stamps_ns: Stamps) -> None:
        """Prepare for the wheel stamps (N,) of a drive."""
        self._rows = np.zeros(stamps_ns.size, RECORD)
        self._rows["stamp_ns"] = stamps_ns
        self.count = 0

    def emit(self, engine: OnlineEngine) -> None:
        """Take the engine's pose of now for the next stamp."""
        row = self._rows[self.count]
        row["pose"] = engine.propagation.state[:3]
        row["covariance"] = engine.propagation.covariance()
        self.count += 1

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
