"""Whether a robot is where it thinks it is, by what became of the walls that it saw just before."""

from __future__ import annotations

import numpy as np

from fgloc.core.measurements import Stamps
from fgloc.online.window import Window

GONE = 2
"""So many walls vanish at once, while as many segments fit no known wall: that is suspect."""
SCANS = 2
"""So many suspect scans in a row are a reason to look around."""
LONG = 6
"""After so many of them that is how it looks here."""
BLIND = 4
"""So many scans in a row that show no known wall at all mean that the robot is lost."""
WAY_M = 1.5
"""Unless it has gone on so far meanwhile that others are to be seen [m]."""


class Bearings:
    """Watches scan after scan."""

    def __init__(self) -> None:
        self.good = -1
        """Keyframe of the last scan that was not suspect."""
        self.times_lost = 0
        """How often the robot was lost."""
        self.times_found = 0
        """How often it found its place again at once."""
        self._walls: list[int] = []
        self._suspect = 0
        self._none = 0

    @property
    def blind(self) -> bool:
        """Return True if none of the known walls has been seen for long."""
        return self._none >= BLIND

    def doubts(self, chosen: Stamps, number: int, window: Window) -> bool:
        """Take a scan's matches (M,) at a keyframe; return True if it is time to look around."""
        seen = np.unique(chosen[chosen >= 0])
        gone = len(self._walls) - int(np.isin(seen, self._walls).sum())
        strange = int((chosen < 0).sum())
        suspect = gone >= GONE and strange >= GONE and self.good >= window.base
        if suspect:
            way = window.state(number)[:2] - window.state(self.good)[:2]
            suspect = float(np.hypot(way[0], way[1])) < WAY_M
        if not suspect:
            self._begin(seen.tolist(), number)
            return False
        self._suspect += 1
        if self._suspect > LONG:
            self._begin(seen.tolist(), number)
            return False
        self._none = 0 if seen.size else self._none + 1
        return self._suspect >= SCANS

    def settle(self, chosen: Stamps, number: int) -> None:
        """Take what a robot that was lost has matched (M,) once it allowed for that."""
        seen = np.unique(chosen[chosen >= 0]).tolist()
        self.times_lost += 1
        self.times_found += bool(seen)
        self._begin(seen, number)

    def _begin(self, walls: list[int], number: int) -> None:
        """Begin anew with the walls seen at a keyframe."""
        self.good, self._walls = number, walls
        self._suspect = self._none = 0
