"""An array whose rows are appended at one end and dropped at the other."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


class GrowingArray:
    """Rows contiguous in memory, so that a window of them is a view. Amortised O(1) an append."""

    def __init__(self, shape: tuple[int, ...], dtype: Any = np.float64, capacity: int = 64) -> None:
        self._rows = np.zeros((capacity, *shape), dtype)
        self._begin = 0
        self._end = 0

    def __len__(self) -> int:
        return self._end - self._begin

    @property
    def view(self) -> npt.NDArray[Any]:
        """Return the (N, ...) live rows; the view holds until the next append or insert."""
        return self._rows[self._begin : self._end]

    def append(self, row: Any) -> None:
        """Add a row behind the last one."""
        if self._end == self._rows.shape[0]:
            self._make_room()
        self._rows[self._end] = row
        self._end += 1

    def insert(self, position: int, row: Any) -> None:
        """Add a row before the live row `position`. O(rows behind it)."""
        if position == len(self):
            self.append(row)
            return
        if self._end == self._rows.shape[0]:
            self._make_room()
        at = self._begin + position
        self._rows[at + 1 : self._end + 1] = self._rows[at : self._end].copy()
        self._rows[at] = row
        self._end += 1

    def drop(self, count: int) -> None:
        """Forget the first `count` rows. O(1)."""
        self._begin += count

    def replace(self, rows: npt.NDArray[Any]) -> None:
        """Hold copies of `rows` (N, ...) and nothing else."""
        self._begin, self._end = 0, rows.shape[0]
        if self._rows.shape[0] < self._end:
            self._rows = np.zeros((2 * self._end, *self._rows.shape[1:]), self._rows.dtype)
        self._rows[: self._end] = rows

    def __getstate__(self) -> dict[str, Any]:
        """Return what a checkpoint needs: the live rows, not the room around them."""
        return {"rows": self.view, "capacity": self._rows.shape[0]}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Hold the rows of a checkpoint."""
        rows = state["rows"]
        self._rows = np.zeros((state["capacity"], *rows.shape[1:]), rows.dtype)
        self._begin, self._end = 0, rows.shape[0]
        self._rows[: self._end] = rows

    def _make_room(self) -> None:
        """Move the live rows to the front, into a larger array where they fill more than half."""
        live = self.view.copy()
        if live.shape[0] > self._rows.shape[0] // 2:
            self._rows = np.zeros((2 * self._rows.shape[0], *self._rows.shape[1:]), live.dtype)
        self._rows[: live.shape[0]] = live
        self._begin, self._end = 0, live.shape[0]
