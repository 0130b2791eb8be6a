"""Laser scans in the online engine: segments, the walls that they show, and new walls.

A scan has its keyframe where it ended, since only then is it known as a whole; its segments are in
the lidar's axes at its first beam, whose way to the keyframe is part of the mounting. Not every
scan is used: one more from the same place tells little and costs the same.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgloc.core.geometry import between, compose, inverse, log
from fgloc.core.measurements import Floats, Scans, Stamps
from fgloc.factors.robust import Loss
from fgloc.factors.tables import Kind
from fgloc.lidar.lines import extract
from fgloc.lidar.scan import cloud
from fgloc.lidar.segments import Segments
from fgloc.online.bearings import Bearings
from fgloc.online.duplicates import FLAT, difference, first_pair
from fgloc.online.fixes import Fix
from fgloc.online.known_walls import KnownWalls
from fgloc.online.layout import Place
from fgloc.online.live_table import LiveTable
from fgloc.online.propagate import moved_from
from fgloc.online.spots import LATE, MapHost
from fgloc.online.tentative import Sighting, Tentative
from fgloc.online.wall_matching import SURE, Gates, match, possible
from fgloc.online.wall_pairs import DOUBTFUL, NEAR, NONE

WAY_M, TURN, REST_NS = 0.15, 0.12, 1_000_000_000
"""A scan is used after so much way [m], turn [rad] or time [ns] since the last one."""
UNKNOWN = np.array([10.0, 1e3])
"""Sigma of a wall's direction [rad] and offset [m] before it is seen."""
PROBABILITY = 0.999
"""True matches pass the gates with this probability."""
ESTABLISHED = 6
"""A wall that was not seen so often before it was put aside was none."""
JOLT = np.array([2.0, 2.0, 0.5])
"""How far a robot may have been moved that was lost [m, m, rad]."""
RETRY = 10
"""A robot that is lost looks for the walls that it knew with every so many scans."""
ANYWHERE = np.array([5.0, 5.0, 2.0])
"""The same, where no wall fits near by."""
UNCLEAR = "a piece of wall that may belong to several walls"
ASKEW = "a piece of wall near a known one that it does not fit"
SELDOM = "a piece of wall that was not seen often enough"


class ScanTable:
    """The walls that one lidar sees, and its sightings of them."""

    def __init__(self, sensor: Scans, place: Place, loss: Loss, host: MapHost) -> None:
        self._host = host
        self.sensor = sensor.sensor
        self._lidar = sensor
        self.mount = np.array(sensor.mount, dtype=np.float64)
        self.delay_ns = turn_ns(sensor)
        window = host.window
        own = np.array([float(window.rounding[2]), float(window.rounding[:2].max())])
        self._rounding = np.diag(own**2)
        self._block = place.block
        self.table: LiveTable = window.table(Kind.WALL, sensor.sensor, (8, 2), place.block, loss)
        self.walls = KnownWalls(window)
        self.tentative = Tentative()
        self.bearings = Bearings()
        self._gates = Gates.of(PROBABILITY)
        self._stamps: list[int] = []
        self._last: tuple[int, Floats] | None = None
        self.way_m, self.turn = WAY_M, TURN
        self._tidied = -1
        self.joined = 0
        self.forgotten = 0
        self.used = 0
        self.unused = 0

    def first(self, fix: Fix) -> bool:
        """Note that a scan came; False if one of the same stamp came before."""
        if fix.stamp_ns in self._stamps:
            return False
        self._stamps.append(fix.stamp_ns)
        return True

    def due(self, state: Floats) -> bool:
        """Return True if the robot has moved, or some time has passed, since the last scan."""
        now = self._host.now_ns
        if self._last is not None:
            stamp, pose = self._last
            moved = between(pose, state[:3])
            way, turn = float(np.hypot(moved[0], moved[1])), abs(float(moved[2]))
            if way < self.way_m and turn < self.turn and now - stamp < REST_NS:
                self.unused += 1
                return False
        self._last = now, state[:3].copy()
        self.used += 1
        return True

    def prune(self, before_ns: int) -> None:
        """Forget what the window has left behind."""
        self._stamps = [stamp for stamp in self._stamps if stamp >= before_ns]
        lost = self.tentative.prune(self._host.window, self._host.now_ns)
        self._host.reject(self.sensor, SELDOM, lost)
        self._forget()

    def _forget(self) -> None:
        """Give up walls that were seen no more soon after they were met: they were none."""
        marks = self._host.window.landmarks
        aside = set(marks.aside.numbers)
        gone = [
            number
            for number, seen in zip(
                self.walls.numbers.view.tolist(), self.walls.sightings.view.tolist(), strict=True
            )
            if seen < ESTABLISHED and number in aside
        ]
        for number in gone:
            self.walls.drop(number)
        if gone:
            marks.aside.forget(gone)
        self.forgotten += len(gone)

    def pending(self) -> list[str]:
        """Return a reason for each segment that still waits for others to make a wall."""
        return [SELDOM] * sum(len(wall) for wall in self.tentative.walls)

    def add(self, number: int, fix: Fix, moved: Floats | None) -> None:
        """Make factors of a scan that ended at a keyframe, or `moved` (3,) away from it."""
        host = self._host
        self._tidy()
        if number < host.window.base:
            host.reject(self.sensor, LATE)
            return
        mount, segments = self._segments(number, fix, moved)
        if segments.scan.size == 0:
            host.reject(self.sensor, "no wall in it")
            return
        rows, noise = self._rows(segments, mount)
        chosen = self._match(number, rows, segments.reach, noise)
        if self.walls.retired and self.used % RETRY == 0:
            chosen = self._find_again(chosen, number, rows, segments.reach, noise)
        if self.bearings.doubts(chosen, number, host.window):
            chosen = self._look_around(chosen, number, rows, segments.reach, noise)
        if number < host.window.base:
            host.reject(self.sensor, LATE, chosen.size)
            return
        for wall in np.unique(chosen[chosen >= 0]).tolist():
            for k in np.flatnonzero(chosen == wall).tolist():
                self._see(number, wall, rows[k], segments.reach[k], noise[k], np.inf)
        host.reject(self.sensor, UNCLEAR, int((chosen == DOUBTFUL).sum()))
        host.reject(self.sensor, ASKEW, int((chosen == NEAR).sum()))
        for k in np.flatnonzero(chosen == NONE).tolist():
            key = (fix.stamp_ns, k)
            one = Sighting(number, fix.stamp_ns, rows[k], segments.reach[k], noise[k], key)
            found = self.tentative.add(one, host.window)
            if found is not None:
                self._meet(found)

    def _tidy(self) -> None:
        """Join walls that turned out to be one, once the window has moved on."""
        host, window = self._host, self._host.window
        if self._tidied == window.base:
            return
        self._tidied = window.base
        self.walls.retire_refuted(self.table.second.view, self.table.weight.view)
        marks, border = window.landmarks, host.map_smoother.border
        walls, numbers, joint = self.walls.in_use(border, self._known(), slice(0, 0))
        pair = first_pair(walls, joint[3:, 3:])
        if pair is None:
            return
        one, other = (int(numbers[k]) for k in pair)
        residual, by_both = difference(walls, *pair)
        by_border = np.zeros((2, border.size))
        by_border[:, marks.columns(one)] = by_both[:, :2] / FLAT[:, None]
        by_border[:, marks.columns(other)] = by_both[:, 2:] / FLAT[:, None]
        host.map_smoother.inform(residual / FLAT, by_border)
        self.walls.join(one, other, border[marks.columns(one)])
        marks.dead.append(other)
        self.joined += 1
        host.update()

    def _segments(self, number: int, fix: Fix, moved: Floats | None) -> tuple[Floats, Segments]:
        """Return where the lidar was at the first beam, seen from the keyframe, and what it saw."""
        window = self._host.window
        here = window.state(number)[:3]
        end = here if moved is None else compose(here, moved)
        begin_ns = fix.stamp_ns - self.delay_ns
        at = max(window.number_at(begin_ns), window.base)
        begin = compose(window.state(at)[:3], moved_from(window, at, begin_ns))
        motion = None
        if self.delay_ns > 0:
            turned = between(compose(begin, self.mount), compose(end, self.mount))
            motion = log(turned)[None]
        ranges = np.nan_to_num(fix.values, nan=0.0, posinf=0.0, neginf=0.0)[None]
        stamp = np.array([begin_ns], dtype=np.int64)
        one = replace(self._lidar, stamps_ns=stamp, ranges=ranges)
        return compose(compose(inverse(here), begin), self.mount), extract(cloud(one, motion), one)

    def _rows(self, segments: Segments, mount: Floats) -> tuple[Floats, Floats]:
        """Return the measurement rows (M, 8) of segments, without anchors, and covariances."""
        rows = np.zeros((segments.scan.size, 8))
        rows[:, 0], rows[:, 1:3], rows[:, 5:8] = segments.normal, segments.middle, mount
        return rows, segments.covariance + self._rounding

    def _look_around(
        self, chosen: Stamps, number: int, rows: Floats, reach: Floats, noise: Floats
    ) -> Stamps:
        """Return the landmark of each segment for a robot that may not be where it thinks it is.

        It is lost if many more segments fit some metres away, or none fit here for long.
        """
        host, window = self._host, self._host.window
        elsewhere = self._match(number, rows, reach, noise, JOLT)
        better = int((elsewhere >= 0).sum()) >= int((chosen >= 0).sum()) + 2
        if not (better or self.bearings.blind):
            return chosen
        waiting = len(self.pending())
        self.tentative = Tentative()
        host.reject(self.sensor, SELDOM, waiting)
        begin = max(self.bearings.good, window.base)
        jolt = JOLT if better else ANYWHERE
        host.map_smoother.jolt(begin, jolt / np.sqrt(max(window.newest - begin, 1)))
        host.update()
        if number >= window.base:
            chosen = self._match(number, rows, reach, noise, lost=True)
            if not (chosen >= 0).any():
                # Else the many walls that may be meant keep it from mapping where it is now.
                self.walls.retire()
                chosen = np.full(chosen.size, NONE, np.int64)
        self.bearings.settle(chosen, number)
        return chosen

    def _find_again(
        self, chosen: Stamps, number: int, rows: Floats, reach: Floats, noise: Floats
    ) -> Stamps:
        """Return the landmark of each segment, for a robot that was lost and may be so no more."""
        retired, self.walls.retired = self.walls.retired, []
        again = self._match(number, rows, reach, noise, lost=True)
        if int(np.isin(again, retired).sum()) >= SURE:
            self.bearings.times_found += 1
            return again
        self.walls.retired = retired
        return chosen

    def _match(
        self,
        number: int,
        rows: Floats,
        reach: Floats,
        noise: Floats,
        jolt: Floats | None = None,
        lost: bool = False,
    ) -> Stamps:
        """Return the landmark of each segment, or why there is none.

        `jolt` (3,) are sigmas by which the robot may be elsewhere, besides what is known.
        """
        host = self._host
        wanted = self._distant(number, rows, reach, noise)
        if wanted:
            host.recall(wanted)
            if number < host.window.base:
                return np.full(rows.shape[0], NONE, np.int64)
        walls, numbers, joint = self.walls.in_use(
            host.map_smoother.border, self._known(), self._block
        )
        if jolt is not None:
            joint[[0, 1, 2], [0, 1, 2]] += jolt**2
        pose, lost = host.window.state(number)[:3], lost or jolt is not None
        chosen, _ = match(
            rows, reach, noise, pose, self._calibration(), joint, walls, self._gates, lost
        )
        return (
            np.where(chosen >= 0, numbers[np.maximum(chosen, 0)], chosen)
            if numbers.size
            else chosen
        )

    def _distant(self, number: int, rows: Floats, reach: Floats, noise: Floats) -> list[int]:
        """Return the walls put aside that a segment may show.

        As if they had nothing in common with the pose: the gates are wider then, so that none is
        missed; whether it is the one is decided once it is in use.
        """
        host = self._host
        known = self.walls.aside(host.window.states.view[0], host.map_smoother.border)
        if known is None:
            return []
        walls, numbers, covariances = known
        pose = host.window.state(number)[:3]
        own = self._own_columns()
        by_pose = self._known()[np.ix_(own, own)]
        found = possible(
            rows, reach, noise, pose, self._calibration(), by_pose, walls, covariances, self._gates
        )
        return [int(k) for k in numbers[found]]

    def _known(self) -> Floats:
        """Return the joint covariance (B+n, B+n) of the state now and the border."""
        return self._host.propagation.joint()

    def _own_columns(self) -> Stamps:
        """Return the columns of pose and mounting in the joint covariance."""
        b = self._host.window.layout.width
        return np.array([0, 1, 2, *range(b + self._block.start, b + self._block.stop)])

    def _calibration(self) -> Floats:
        """Return the mounting's (0 or 3,) calibration."""
        return self._host.map_smoother.border[self._block]

    def _see(
        self, number: int, wall: int, row: Floats, reach: Floats, noise: Floats, weight: float
    ) -> None:
        """Add the factor of a segment that shows a wall."""
        host = self._host
        row = row.copy()
        row[3:5] = self.walls.anchor(wall)
        root = np.linalg.inv(np.linalg.cholesky(noise))
        self.table.add(number, row, root, weight, wall)
        line = host.map_smoother.border[host.window.landmarks.columns(wall)]
        self.walls.extend(wall, host.window.state(number)[:3], row, reach, line)
        host.touch(number)

    def _meet(self, sightings: list[Sighting]) -> None:
        """Take a new wall into use."""
        host, last = self._host, sightings[-1]
        angle, middle = last.line(host.window)
        wall = host.enter(np.array([angle, 0.0]), np.diag(1.0 / UNKNOWN))[0]
        self.walls.add(wall, middle)
        for one in sightings:
            # Its own sightings do not surprise a wall that nobody knew.
            self._see(one.number, wall, one.row, one.reach, one.noise, 1.0)


def turn_ns(scans: Scans) -> int:
    """Return how long a scan takes [ns]."""
    turn: int = round(scans.beam_period * 1e9 * scans.ranges.shape[1])
    return turn
