"""People who walk about in a simulated world: what moves while a map takes it for walls."""

from __future__ import annotations

import numpy as np

from fgloc.core.measurements import Floats, Stamps
from fgloc.datasets.simulator.worlds import World

RADIUS_M = 0.2
"""How wide a person is at the height of a lidar, half of it [m]."""
SLOW_M_S, FAST_M_S = 0.5, 1.4
"""People walk with a constant speed between these [m/s]."""
ASIDE_M = 0.25
"""How far from the robot's way they walk at most [m]: where that is clear, so is theirs."""


class Walker:
    """A person who walks along the robot's way, either way round."""

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        """Draw speed, direction, start and side of one person in a world."""
        way = world.waypoints
        way = np.concatenate([way, way[:1] if world.closed else way[-2::-1]])
        legs = np.diff(way, axis=0)
        length = np.hypot(legs[:, 0], legs[:, 1])
        self._way = way
        self._at = np.concatenate([[0.0], np.cumsum(length)])
        self._left = np.stack([-legs[:, 1], legs[:, 0]], axis=1) / length[:, None]
        self._speed = rng.uniform(SLOW_M_S, FAST_M_S) * (1.0 if rng.random() < 0.5 else -1.0)
        self._start = rng.uniform(0.0, self._at[-1])
        self._aside = rng.uniform(-ASIDE_M, ASIDE_M)

    def positions(self, stamps: Stamps) -> Floats:
        """Return (N, 2) where the person is at the stamps [ns]. Corners are cut sharply."""
        way = np.mod(self._start + self._speed * stamps * 1e-9, self._at[-1])
        leg = np.minimum(np.searchsorted(self._at, way, side="right") - 1, len(self._left) - 1)
        passed = (way - self._at[leg]) / (self._at[leg + 1] - self._at[leg])
        on = self._way[leg] + passed[:, None] * (self._way[leg + 1] - self._way[leg])
        return np.asarray(on + self._aside * self._left[leg])
