"""One pass of EKF-SLAM over a drive: its arrays, which grow with the map, and what became of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from fgloc.core.measurements import Floats, LandmarkSightings
from fgloc.errors import FglocError
from fgloc.estimator import SensorCount, SensorResiduals
from fgloc.filters.ekf_slam_events import Events
from fgloc.filters.ekf_slam_kernel import run_slam
from fgloc.filters.ekf_slam_settings import EkfSlamSettings
from fgloc.filters.ekf_slam_steps import known
from fgloc.filters.ekf_slam_tables import (
    BORN,
    CANDIDATES,
    COLUMNS,
    FIELD,
    FIELD_LEFT,
    FIELD_RIGHT,
    IDENTITY,
    LANDMARKS,
    LAST,
    LIVES,
    NUMBER,
    NUMBERS,
    PLACE_X,
    PLACE_Y,
    REJECTED,
    SHAPE,
    STREAM,
    TALLY,
    TOLD,
    USED,
    Codes,
)

T = TypeVar("T", bound=np.generic)

ROOM = 32
"""Landmarks for which there is room at first."""


class Run:
    """The filter's arrays: made from a drive's events, filled by `filter`."""

    def __init__(
        self, events: Events, settings: EkfSlamSettings, start: Floats, sigma: Floats
    ) -> None:
        """`start` (3,) is the first pose, `sigma` (3,) its standard deviations [m, m, rad]."""
        self.events = events
        self._settings = settings
        streams = events.streams
        begins = np.concatenate([[0], np.cumsum([s.identities.size for s in streams])])
        # Streams one after the other, then in the order of time.
        order = (begins[events.stream_of] + events.reading_of).astype(np.int64)
        self._values = np.concatenate([s.values for s in streams])[order]
        self._identities = np.concatenate([s.identities for s in streams])[order]
        self._kinds = np.array([s.kind for s in streams], dtype=np.int64)
        e, wheels = order.size, int(events.emit.max()) + 1
        self.poses, self.covariances = np.zeros((wheels, 3)), np.zeros((wheels, 3, 3))
        self.status = np.full(e, REJECTED, dtype=np.int64)
        self.numbers = np.full(e, -1, dtype=np.int64)
        self._innovations, self._whitened = np.zeros((e, 2)), np.zeros((e, 2))
        self.tally = np.zeros(TALLY, dtype=np.int64)
        self._field = np.zeros((len(streams), FIELD))
        self._field[:, FIELD_RIGHT], self._field[:, FIELD_LEFT] = np.inf, -np.inf
        self.codes = np.zeros((ROOM, COLUMNS), dtype=np.int64)
        self.shapes = np.zeros((ROOM, SHAPE))
        self._waiting = np.zeros((ROOM, COLUMNS), dtype=np.int64)
        self._waiting_shapes = np.zeros((ROOM, SHAPE))
        self._waiting_places = np.zeros((ROOM, 2))
        self.x, self.p = np.zeros(3 + 2 * ROOM), np.zeros((3 + 2 * ROOM, 3 + 2 * ROOM))
        self.x[:3] = start
        self.p[np.arange(3), np.arange(3)] = sigma**2
        for k, stream in enumerate(streams):
            if isinstance(stream.sensor, LandmarkSightings):
                self._survey(k, stream.sensor)

    def filter(self) -> None:
        """Filter the whole drive. Raises FglocError where numbers are no longer finite."""
        events, settings = self.events, self._settings
        limits = (settings.sightings, settings.lives, settings.forget_unseen, settings.patience)
        cut = 0
        while cut < events.cuts_ns.size:
            cut = run_slam(
                cut,
                events.steps,
                events.step_covariances,
                events.emit,
                events.first_group,
                events.group_stream,
                events.group_first,
                events.group_row,
                events.group_turn,
                self._values,
                self._identities,
                self._kinds,
                np.array([s.row for s in events.streams]),
                events.ranges,
                np.array(limits, dtype=np.int64),
                np.array([settings.gate_m, settings.identity_gate]),
                self.x,
                self.p,
                self.codes,
                self.shapes,
                self._waiting,
                self._waiting_shapes,
                self._waiting_places,
                np.zeros((2, self.x.size)),
                self._field,
                self.tally,
                self.poses,
                self.covariances,
                self.status,
                self.numbers,
                self._innovations,
                self._whitened,
            )
            if cut < 0:
                seconds = (events.cuts_ns[-1 - cut] - events.cuts_ns[0]) * 1e-9
                raise FglocError(
                    f"the state is no longer finite {seconds:.1f} s after the start: a "
                    "measurement or a sigma is off by orders of magnitude"
                )
            if cut < events.cuts_ns.size:
                self._grow(cut)

    def counts(self) -> Mapping[str, SensorCount]:
        """Return how many sightings (lidar: pieces of wall) of each sensor were used."""
        found = {}
        for k, stream in enumerate(self.events.streams):
            status = self.status[self.events.stream_of == k]
            used = int(np.count_nonzero((status == USED) | (status == BORN)))
            rejected = status.size - used + stream.left_out
            found[stream.sensor.sensor] = SensorCount(used, rejected=rejected)
        return found

    def innovations(self) -> tuple[SensorResiduals, ...]:
        """Return each sensor's innovations: reading minus prediction, before the correction."""
        out = []
        at = self.events.cuts_ns[self._cut_of()]
        for k, stream in enumerate(self.events.streams):
            mine = (self.events.stream_of == k) & (
                (self.status == USED) | ((self.status == REJECTED) & (self.numbers >= 0))
            )
            if mine.any():
                out.append(
                    SensorResiduals(
                        stream.sensor.sensor,
                        ("range [m]", "bearing [rad]"),
                        at[mine],
                        self._innovations[mine],
                        self._whitened[mine],
                        (self.status[mine] == USED).astype(np.float64),
                    )
                )
        return tuple(out)

    def waiting_sightings(self) -> int:
        """Return how many sightings told of landmarks that were not used yet or never."""
        return int(np.count_nonzero(self.status == TOLD))

    def _cut_of(self) -> Codes:
        """Return (E,) the cut of every sighting."""
        sizes = np.diff(self.events.group_first)
        cuts = np.repeat(np.arange(self.events.cuts_ns.size), np.diff(self.events.first_group))
        return np.asarray(np.repeat(cuts, sizes))

    def _survey(self, stream: int, sensor: LandmarkSightings) -> None:
        """Put the landmarks that somebody measured into the state."""
        survey = sensor.survey
        if survey is None:
            return
        while self.tally[LANDMARKS] + survey.landmark.size > self.codes.shape[0]:
            self._double()
        for identity, place, sigma in zip(
            survey.landmark, survey.positions, survey.sigma, strict=True
        ):
            k = int(self.tally[LANDMARKS])
            known(self.x, self.p, 3 + 2 * k, *place, *(sigma**2))
            self.codes[k, NUMBER] = self.tally[NUMBERS]
            self.codes[k, STREAM], self.codes[k, IDENTITY] = stream, identity
            self.codes[k, LIVES], self.codes[k, LAST] = -1, -1
            self.shapes[k, [PLACE_X, PLACE_Y]] = place
            self.tally[LANDMARKS] += 1
            self.tally[NUMBERS] += 1

    def _grow(self, cut: int) -> None:
        """Make room for what is seen at a cut."""
        events = self.events
        groups = events.first_group[cut : cut + 2]
        new = int(events.group_first[groups[1]] - events.group_first[groups[0]])
        while self.tally[LANDMARKS] + new > self.codes.shape[0]:
            self._double()
        while self.tally[CANDIDATES] + new > self._waiting.shape[0]:
            self._waiting = _doubled(self._waiting)
            self._waiting_shapes = _doubled(self._waiting_shapes)
            self._waiting_places = _doubled(self._waiting_places)

    def _double(self) -> None:
        """Make room for twice as many landmarks in the state."""
        self.codes, self.shapes = _doubled(self.codes), _doubled(self.shapes)
        n = self.x.size
        x, p = np.zeros(2 * n - 3), np.zeros((2 * n - 3, 2 * n - 3))
        x[:n], p[:n, :n] = self.x, self.p
        self.x, self.p = x, p


def _doubled(table: npt.NDArray[T]) -> npt.NDArray[T]:
    """Return a table with twice the rows, the new ones zero."""
    return np.concatenate([table, np.zeros_like(table)])
