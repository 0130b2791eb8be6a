"""Segments that belong to no known wall, until one was seen often enough to be a wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.core.geometry import compose, wrap_scalar
from fgloc.core.measurements import Floats
from fgloc.online.window import Window

SIGHTINGS = 3
"""A wall is one that was seen so often."""
LENGTH_M = 0.5
"""And of which so much was seen at once [m]."""
PATIENCE_NS = 6_000_000_000
"""Seen no more for so long [ns], it was something else."""
MOST = 60
"""Walls to be that are remembered at most; the oldest go first."""
SLACK = np.array([0.01, 0.02])
"""What pose to pose adds to the noise of direction [rad] and offset [m] within seconds."""
APART_M = 0.3
"""Sightings of one wall overlap, or are no further apart along it [m]."""
ALIKE = 13.8
"""Normalised square of the difference of two sightings of one wall (two numbers, 0.1 %)."""


@dataclass
class Sighting:
    """A segment at a keyframe."""

    number: int
    """Keyframe."""
    stamp_ns: int
    """When it was seen."""
    row: Floats
    """(8,) measurement row of the wall kernel, without anchor."""
    reach: Floats
    """(2,) how far it reaches along its tangent [m]."""
    noise: Floats
    """(2, 2) covariance of direction and offset."""
    key: tuple[int, int]
    """Scan and segment, to count it."""

    def line(self, window: Window) -> tuple[float, Floats]:
        """Return direction of the normal and middle (2,) in the map, where the window has it."""
        pose = compose(window.state(self.number)[:3], self.row[5:8])
        middle = compose(pose, np.array([self.row[1], self.row[2], self.row[0]]))
        return float(middle[2]), middle[:2]


class Tentative:
    """Walls that were not seen often enough yet."""

    def __init__(self) -> None:
        self.walls: list[list[Sighting]] = []

    def add(self, one: Sighting, window: Window) -> list[Sighting] | None:
        """Take a segment; return all sightings of its wall if they are enough by now.

        O(MOST).
        """
        angle, middle = one.line(window)
        found = next((s for s in self.walls if _alike(one, angle, middle, s[-1], window)), None)
        if found is None:
            self.walls.append([one])
            return None
        found.append(one)
        longest = max(s.reach[1] - s.reach[0] for s in found)
        if len(found) < SIGHTINGS or longest < LENGTH_M:
            return None
        self.walls.remove(found)
        return found

    def prune(self, window: Window, now_ns: int) -> int:
        """Give up what was not seen again; return how many segments that were."""
        lost = 0
        kept = []
        for wall in self.walls[-MOST:]:
            live = [s for s in wall if s.number >= window.base]
            lost += len(wall) - len(live)
            if live and now_ns - live[-1].stamp_ns < PATIENCE_NS:
                kept.append(live)
            else:
                lost += len(live)
        lost += sum(len(wall) for wall in self.walls[:-MOST])
        self.walls = kept
        return lost


def _alike(one: Sighting, angle: float, middle: Floats, other: Sighting, window: Window) -> bool:
    """Return True if two segments show the same wall; the first in the map as given."""
    if other.number < window.base or other.key[0] == one.key[0]:
        return False
    there, foot = other.line(window)
    turn = wrap_scalar(angle - there)
    if abs(turn) > 0.5:
        return False
    normal, tangent = (
        np.array([np.cos(there), np.sin(there)]),
        np.array([-np.sin(there), np.cos(there)]),
    )
    away = middle - foot
    along, offset = float(tangent @ away), float(normal @ away)
    if along + one.reach[0] > other.reach[1] + APART_M:
        return False
    if along + one.reach[1] < other.reach[0] - APART_M:
        return False
    # The offset where the other one's middle is not its own: its direction swings it.
    noise = one.noise + other.noise + np.diag(SLACK**2)
    noise = noise.copy()
    noise[1, 1] += along**2 * other.noise[0, 0]
    r = np.array([turn, offset])
    return float(r @ np.linalg.solve(noise, r)) < ALIKE
