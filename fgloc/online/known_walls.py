"""The walls that a lidar has met: where they were seen, and which of them a scan may show."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fgloc.core.geometry import compose
from fgloc.core.measurements import Floats, Stamps
from fgloc.estimator import DOWN_WEIGHTED
from fgloc.online.growing import GrowingArray
from fgloc.online.wall_matching import Candidates
from fgloc.online.window import Window

VAGUE = np.array([3.0, 100.0])
"""A wall known less well than this in direction [rad] and offset [m] was never really seen."""
REFUTED = 3
"""A wall that so many sightings contradict, and most of them, is not looked for."""


class KnownWalls:
    """What is kept of walls besides their lines, which are landmarks of the window."""

    def __init__(self, window: Window) -> None:
        self._window = window
        self.numbers = GrowingArray((), np.int64)
        """Landmark of each wall."""
        self.anchors = GrowingArray((2,))
        """Anchor of each wall [m]."""
        self.reach = GrowingArray((2,))
        """Where it was seen, along its tangent from the anchor's foot [m]."""
        self.sightings = GrowingArray((), np.int64)
        """How many segments told of it."""
        self.retired: list[int] = []
        """Landmarks of walls that are not looked for: the robot is lost beside them."""
        self._rows: dict[int, int] = {}
        self._marginals: tuple[tuple[int, ...], Floats] | None = None

    def add(self, number: int, anchor: Floats) -> None:
        """Take a landmark as a wall that was seen at its anchor (2,)."""
        self._rows[number] = len(self.numbers)
        self.numbers.append(number)
        self.anchors.append(anchor)
        self.reach.append(0.0)
        self.sightings.append(0)

    def retire(self) -> None:
        """Look for none of the walls known so far, until they are taken back."""
        self.retired = self.numbers.view.tolist()

    def retire_refuted(self, seen: Stamps, weights: Floats) -> None:
        """Look no more for walls whose sightings `seen` (M,) are mostly not believed.

        By their robust weights (M,), infinite where they are not known yet.
        """
        judged = np.isfinite(weights)
        numbers = seen[judged]
        count = np.bincount(numbers, minlength=1)
        low = np.bincount(numbers[weights[judged] < DOWN_WEIGHTED], minlength=count.size)
        for number in np.flatnonzero((low >= REFUTED) & (2 * low > count)).tolist():
            if number in self._rows and number not in self.retired:
                self.retired.append(number)

    def drop(self, number: int) -> None:
        """Do not know a wall any more."""
        k = self._rows[number]
        for column in (self.numbers, self.anchors, self.reach, self.sightings):
            column.replace(np.delete(column.view, k, axis=0))
        self._rows = {int(n): row for row, n in enumerate(self.numbers.view)}

    def join(self, number: int, other: int, line: Floats) -> None:
        """Take the reach and sightings of another wall over, and drop that; `line` (2,) is this."""
        k, j = self._rows[number], self._rows[other]
        tangent = np.array([-np.sin(line[0]), np.cos(line[0])])
        along = float(tangent @ (self.anchors.view[j] - self.anchors.view[k]))
        seen, more = self.reach.view[k], along + self.reach.view[j]
        seen[0], seen[1] = min(seen[0], more[0]), max(seen[1], more[1])
        self.sightings.view[k] += self.sightings.view[j]
        self.drop(other)

    def count(self, number: int) -> int:
        """Return how many segments told of a wall."""
        return int(self.sightings.view[self._rows[number]])

    def anchor(self, number: int) -> Floats:
        """Return the anchor (2,) of a wall."""
        anchor: Floats = self.anchors.view[self._rows[number]]
        return anchor

    def extend(self, number: int, pose: Floats, row: Floats, reach: Floats, line: Floats) -> None:
        """Take note of where a segment shows a wall: `reach` (2,) about its middle.

        `row` (8,) is its measurement, seen from the base's `pose` (3,); `line` (2,) the wall.
        """
        k = self._rows[number]
        middle = compose(compose(pose, row[5:8]), np.array([row[1], row[2], 0.0]))[:2]
        along = float(np.array([-np.sin(line[0]), np.cos(line[0])]) @ (middle - row[3:5]))
        seen = self.reach.view[k]
        seen[0], seen[1] = min(seen[0], along + reach[0]), max(seen[1], along + reach[1])
        self.sightings.view[k] += 1

    def in_use(
        self, border: Floats, joint: Floats, block: slice
    ) -> tuple[Candidates, Stamps, Floats]:
        """Return the walls in use, their landmarks, and the joint covariance that goes with them.

        `joint` (B+n, B+n) is that of the state now and the border; the result's columns are the
        pose, the calibration `block` of the lidar's mounting, and two for each wall.
        """
        marks, b = self._window.landmarks, self._window.layout.width
        places = marks.places.view[self.numbers.view]
        rows = np.flatnonzero((places >= 0) & self._sought())
        columns = marks.parameters + 2 * places[rows][:, None] + np.arange(2)
        sigma = np.sqrt(np.maximum(np.diag(joint)[b + columns], 0.0))
        clear = (sigma < VAGUE).all(axis=1)
        rows, columns = rows[clear], columns[clear]
        own = np.concatenate(
            [[0, 1, 2], np.arange(b + block.start, b + block.stop), b + columns.ravel()]
        ).astype(np.int64)
        walls = Candidates(
            border[columns].reshape(-1, 2), self.anchors.view[rows], self.reach.view[rows]
        )
        return walls, self.numbers.view[rows], np.ascontiguousarray(joint[np.ix_(own, own)])

    def _sought(self) -> npt.NDArray[np.bool_]:
        """Return (W,) which walls are looked for."""
        return ~np.isin(self.numbers.view, self.retired)

    def aside(self, state: Floats, border: Floats) -> tuple[Candidates, Stamps, Floats] | None:
        """Return the walls put aside, their landmarks and marginal covariances (W, 2, 2).

        `state` (B,) is that of the window's first keyframe. None if there are none. O(W·n²) once
        the window has moved, else O(W·n).
        """
        aside = self._window.landmarks.aside
        sought = set(self.numbers.view[self._sought()].tolist())
        mine = [k for k, number in enumerate(aside.numbers) if number in sought]
        if not mine:
            return None
        stand = (self._window.base, *aside.numbers)
        if self._marginals is None or self._marginals[0] != stand:
            prior = self._window.prior
            assert prior is not None
            inverse = np.linalg.inv(prior.sqrt_information[0])
            self._marginals = stand, aside.marginals(inverse @ inverse.T)
        numbers = np.array([aside.numbers[k] for k in mine])
        rows = [self._rows[number] for number in numbers.tolist()]
        lines = aside.values(state, border)[mine]
        walls = Candidates(lines, self.anchors.view[rows], self.reach.view[rows])
        return walls, numbers, self._marginals[1][mine]
