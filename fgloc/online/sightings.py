"""Sightings of point landmarks in the online engine: range and bearing to marks in the window."""

from __future__ import annotations

import numpy as np

from fgloc.core.geometry import compose
from fgloc.core.measurements import Floats, LandmarkSightings
from fgloc.factors.robust import Loss
from fgloc.factors.tables import Kind
from fgloc.online.fixes import Fix
from fgloc.online.layout import Place
from fgloc.online.live_table import LiveTable
from fgloc.online.spots import LATE, MapHost

UNKNOWN_M = 1e3
"""Sigma of where a mark is before it is seen [m]."""


class MarkTable:
    """The marks that one sensor sees, and its sightings of them."""

    def __init__(self, sensor: LandmarkSightings, place: Place, loss: Loss, host: MapHost) -> None:
        self._host = host
        self.delay_ns = 0
        self.sensor = sensor.sensor
        self.mount = np.array(sensor.mount)
        window = host.window
        sigma = np.array([sensor.range_sigma, sensor.bearing_sigma])
        # Rounded counts: along the way the range suffers, across it and in heading the bearing.
        own = np.array([float(window.rounding[:2].max()), float(window.rounding[2])])
        self._root = np.diag(1.0 / np.hypot(sigma, own))
        self._survey = sensor.survey
        self.table: LiveTable = window.table(
            Kind.RANGE_BEARING, sensor.sensor, (5, 2), place.block, loss
        )
        # Number of the landmark by the identity that the sensor gives.
        self.numbers: dict[int, int] = {}
        self.sightings: dict[int, int] = {}
        self._seen: dict[tuple[int, int], tuple[float, float]] = {}

    def first(self, fix: Fix) -> bool:
        """Note that a sighting came; False if the same one came before."""
        mark, distance, bearing = fix.values.tolist()
        key = (fix.stamp_ns, int(mark))
        if self._seen.get(key) == (distance, bearing):
            return False
        self._seen[key] = (distance, bearing)
        return True

    def due(self, state: Floats) -> bool:
        """Return True: every sighting tells something."""
        return True

    def pending(self) -> list[str]:
        """Return nothing: a reading becomes a factor at once, or never."""
        return []

    def prune(self, before_ns: int) -> None:
        """Forget what the window has left behind."""
        self._seen = {key: value for key, value in self._seen.items() if key[0] >= before_ns}

    def add(self, number: int, fix: Fix, moved: Floats | None) -> None:
        """Add the factor of a sighting at a keyframe, or `moved` (3,) away from it."""
        host = self._host
        mark = int(fix.values[0])
        if mark < 0:
            host.reject(self.sensor, "the sensor does not know which landmark it is")
            return
        mount = self.mount if moved is None else compose(moved, self.mount)
        landmark = self.numbers.get(mark)
        fresh = landmark is None
        if landmark is None:
            landmark = self._meet(mark, compose(host.window.state(number)[:3], mount), fix)
        elif not host.window.landmarks.in_use(landmark):
            host.recall([landmark])
            if number < host.window.base:
                host.reject(self.sensor, LATE)
                return
        row = np.concatenate([fix.values[1:], mount])
        # What is seen for the first time, and nowhere surveyed, surprises nobody.
        weight = 1.0 if fresh and not self._surveyed(mark) else np.inf
        self.table.add(number, row, self._root, weight, landmark)
        self.sightings[landmark] = self.sightings.get(landmark, 0) + 1
        host.touch(number)

    def _surveyed(self, mark: int) -> bool:
        """Return True if somebody measured where a mark is."""
        return self._survey is not None and bool((self._survey.landmark == mark).any())

    def _meet(self, mark: int, sensor_pose: Floats, fix: Fix) -> int:
        """Take a new mark into use, seen from a sensor's pose (3,) in the map."""
        if self._survey is not None and self._surveyed(mark):
            k = int(np.flatnonzero(self._survey.landmark == mark)[0])
            guess, sigma = self._survey.positions[k], self._survey.sigma[k]
        else:
            distance, bearing = fix.values[1:]
            toward = sensor_pose[2] + bearing
            away = distance * np.array([np.cos(toward), np.sin(toward)])
            guess, sigma = sensor_pose[:2] + away, np.full(2, UNKNOWN_M)
        landmark = self._host.enter(guess, np.diag(1.0 / sigma))[0]
        self.numbers[mark] = landmark
        return landmark
