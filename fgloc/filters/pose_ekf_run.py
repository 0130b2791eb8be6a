"""One pass of the pose EKF over a drive, and what it says of the sensors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.geometry import compose, inverse
from fgloc.core.measurements import Floats
from fgloc.estimator import SensorCount, SensorResiduals
from fgloc.filters.pose_ekf_events import Events
from fgloc.filters.pose_ekf_kernel import (
    ACCEPTED,
    CAMERA,
    POSE,
    POSITION,
    RECOVERED,
    REFERENCE,
    REJECTED,
    YAW,
    Codes,
    run_filter,
)
from fgloc.filters.pose_ekf_settings import PoseEkfSettings
from fgloc.smoothing.initial import align, telling

COMPONENTS = {
    CAMERA: ("x [m]", "y [m]", "heading [rad]"),
    POSE: ("x [m]", "y [m]", "heading [rad]"),
    POSITION: ("x [m]", "y [m]"),
    YAW: ("heading [rad]",),
}
"""What the numbers of an innovation are, by kind of event."""
FOREVER_NS = 2**62
"""A patience that never ends [ns]."""


class Run:
    """The filter's arrays: made from a drive's events, filled by `filter`."""

    def __init__(
        self, events: Events, settings: PoseEkfSettings, start: Floats, sigma: Floats
    ) -> None:
        """`start` (3,) is the first pose, `sigma` (3,) its standard deviations [m, m, rad]."""
        self.events = events
        self._settings = settings
        self._start, self._sigma = start, sigma
        streams = events.streams
        readings = np.concatenate([[0], np.cumsum([s.stamps_ns.size for s in streams])])
        # Streams one after the other, then in the order of time.
        order = (readings[events.stream_of] + events.reading_of).astype(np.int64)
        kinds = np.array([s.kind for s in streams], dtype=np.int64)
        self._kinds = kinds[events.stream_of]
        self._values = _joined([s.values for s in streams], (3,))[order]
        self._noises = _joined([s.noises for s in streams], (3, 3))[order]
        self._begins = np.concatenate([np.zeros(0, np.int64), *(s.begins for s in streams)])[order]
        self._levers = _joined([s.lever[None] for s in streams], (3,))
        self._yaws = [k for k, s in enumerate(streams) if s.kind == YAW]
        self._absolute = np.isin(kinds, (POSE, POSITION))
        e, wheels = order.size, int(events.emit.max()) + 1
        self.poses, self.covariances = np.zeros((wheels, 3)), np.zeros((wheels, 3, 3))
        self._status = np.full(e, REJECTED, dtype=np.int64)
        self._innovations, self._whitened = np.zeros((e, 3)), np.zeros((e, 3))
        self._turn_status = np.full(events.turns.shape, REJECTED, dtype=np.int64)
        self._turn_innovations = np.zeros((*events.turns.shape, 2))
        self._begin()

    def filter(self) -> tuple[str, ...]:
        """Filter the whole drive from a known start; return no notes."""
        self._run(0, self.events.cuts_ns.size, fixes=True)
        return ()

    def filter_from_nowhere(self) -> tuple[str, ...]:
        """Filter a drive whose start in the map is not known; return what happened.

        Without fixes the start is the origin. With fixes, poses are relative to the start until
        the first of them tell where the path so far lies in the map; there the state is moved.
        """
        absolute = self._absolute[self.events.stream_of]
        if not absolute.any():
            return self.filter()
        last = self.events.cuts_ns.size
        self._run(0, last, fixes=False)
        found = self._aligned(np.flatnonzero(absolute).astype(np.int64))
        if found is None:
            return (
                "no truth to start from, and the fixes do not tell the heading: they are not used, "
                "poses are relative to the start",
            )
        pose, sigma, event, used = found
        cut = int(np.searchsorted(self.events.first, event, side="right")) - 1
        self._begin()
        self._run(0, cut + 1, fixes=False)
        # What was used to align is used up.
        self._status[absolute & (np.arange(absolute.size) <= event)] = REFERENCE
        self._move(pose, sigma)
        emitted = int(self.events.emit[cut])
        if emitted >= 0:
            self.poses[emitted] = self._x[:3]
            self.covariances[emitted] = self._p[:3, :3]
        self._run(cut + 1, last, fixes=True)
        seconds = (self.events.cuts_ns[cut] - self.events.cuts_ns[0]) * 1e-9
        return (
            f"no truth to start from: poses are relative to the start for {seconds:.1f} s, until "
            f"{used} fix{'es' if used > 1 else ''} told where it is",
        )

    def counts(self, drive: Drive) -> Mapping[str, SensorCount]:
        """Return accepted and rejected readings (gyro: intervals between events) by sensor."""
        found = {}
        for k, stream in enumerate(self.events.streams):
            status = self._status[self.events.stream_of == k]
            accepted = int(np.count_nonzero(status != REJECTED))
            total = stream.sensor.stamps_ns.size
            found[stream.sensor.sensor] = SensorCount(accepted, rejected=total - accepted)
        for gyro, status, variance in zip(
            self.events.gyros, self._turn_status, self.events.turn_variances, strict=True
        ):
            accepted = int(np.count_nonzero(status == ACCEPTED))
            heard = int(np.count_nonzero(variance > 0.0))
            found[gyro.sensor] = SensorCount(accepted, rejected=heard - accepted)
        # In the drive's order.
        return {s.sensor: found[s.sensor] for s in drive.sensors if s.sensor in found}

    def innovations(self) -> tuple[SensorResiduals, ...]:
        """Return each sensor's innovations: reading minus prediction, before the correction."""
        out = []
        for k, stream in enumerate(self.events.streams):
            mine = (self.events.stream_of == k) & (self._status != REFERENCE)
            labels = COMPONENTS[stream.kind]
            at = np.searchsorted(self.events.first, np.flatnonzero(mine), side="right") - 1
            out.append(
                SensorResiduals(
                    stream.sensor.sensor,
                    labels,
                    self.events.cuts_ns[at],
                    self._innovations[mine, : len(labels)],
                    self._whitened[mine, : len(labels)],
                    (self._status[mine] != REJECTED).astype(np.float64),
                )
            )
        for g, gyro in enumerate(self.events.gyros):
            heard = self.events.turn_variances[g] > 0.0
            out.append(
                SensorResiduals(
                    gyro.sensor,
                    ("turn [rad]",),
                    self.events.cuts_ns[1:][heard],
                    self._turn_innovations[g, heard, :1],
                    self._turn_innovations[g, heard, 1:],
                    (self._turn_status[g, heard] == ACCEPTED).astype(np.float64),
                )
            )
        return tuple(r for r in out if r.stamps_ns.size)

    def notes(self) -> tuple[str, ...]:
        """Return what a user should know of this run."""
        notes = [f"{g.sensor}: the bias is not estimated, as in seed D" for g in self.events.gyros]
        for k, stream in enumerate(self.events.streams):
            leaps = int(stream.begins.sum()) - 1
            if leaps > 0:
                notes.append(
                    f"{stream.sensor.sensor} leapt {leaps} time{'s' if leaps > 1 else ''}: its "
                    "frame was aligned anew"
                )
            mine = self._status[self.events.stream_of == k]
            again = int(np.count_nonzero(mine == RECOVERED))
            if again:
                notes.append(
                    f"{stream.sensor.sensor} was rejected for so long that it was believed again "
                    f"{again} time{'s' if again > 1 else ''}"
                )
        return tuple(notes)

    def _begin(self) -> None:
        """Set the state to the start."""
        n = 3 + len(self._yaws)
        self._x, self._p = np.zeros(n), np.zeros((n, n))
        self._x[:3] = self._start
        self._p[np.arange(3), np.arange(3)] = self._sigma**2
        self._anchors = np.zeros((len(self.events.streams), 3))
        self._anchor_covariances = np.zeros((len(self.events.streams), 3, 3))
        self._memory = np.zeros((len(self.events.streams), 2), dtype=np.int64)

    def _run(self, begin: int, end: int, *, fixes: bool) -> None:
        """Filter a part of the cuts, with or without listening to fixes."""
        events, settings, streams = self.events, self._settings, self.events.streams
        zero_of = np.full(len(streams), -1, dtype=np.int64)
        zero_of[self._yaws] = 3 + np.arange(len(self._yaws))
        waiting = min(settings.patience_s * 1e9, float(FOREVER_NS))
        run_filter(
            begin,
            end,
            events.cuts_ns,
            events.steps,
            events.step_covariances,
            events.emit,
            events.first,
            self._kinds,
            events.stream_of,
            self._begins,
            self._values,
            self._noises,
            self._levers,
            np.array([s.gate for s in streams], dtype=np.float64),
            (fixes | ~self._absolute).astype(np.int64),
            zero_of,
            np.array([streams[k].zero_walk for k in self._yaws], dtype=np.float64),
            np.array([s.lasting for s in streams], dtype=np.float64),
            events.turns,
            events.turn_variances,
            np.full(len(events.gyros), settings.gyro_gate**2),
            events.rounding,
            settings.horizon_s,
            np.array([settings.patience_count, int(waiting)], dtype=np.int64),
            self._x,
            self._p,
            self._anchors,
            self._anchor_covariances,
            self._memory,
            self.poses,
            self.covariances,
            self._status,
            self._innovations,
            self._whitened,
            self._turn_status,
            self._turn_innovations,
        )

    def _aligned(self, fixes: Codes) -> tuple[Floats, Floats, int, int] | None:
        """Return where the path by dead reckoning lies in the map, as the first fixes tell.

        `fixes` are the events of position and pose fixes. Pose (3,) of the path's frame in the map,
        sigma of position and heading, the event from which on it is known and how many fixes were
        used; None if they do not tell the heading.
        """
        read, kinds = self._values[fixes], self._kinds[fixes]
        # Where the sensor was expected: reading minus innovation.
        expected = read - self._innovations[fixes]
        sigma = np.sqrt(self._noises[fixes, 0, 0])
        enough = telling(read[:, :2], sigma) if fixes.size > 1 else 0
        poses = np.flatnonzero(kinds == POSE)
        if poses.size and (enough == 0 or poses[0] < enough):
            k = int(poses[0])
            turn = float(np.sqrt(self._noises[fixes[k], 2, 2]))
            pose = compose(read[k], inverse(expected[k]))
            return pose, np.array([sigma[k], turn]), int(fixes[k]), 1
        if enough == 0:
            return None
        pose, extent = align(expected[:enough, :2], read[:enough, :2])
        spread = float(sigma[:enough].max())
        return pose, np.array([spread, spread / extent]), int(fixes[enough - 1]), enough

    def _move(self, pose: Floats, sigma: Floats) -> None:
        """Put the state, known in a frame at `pose` in the map, into the map.

        `sigma` (2,) says how well the pose [m] is known where the robot is now, and its turn [rad].
        """
        self._x[:3] = compose(pose, self._x[:3])
        self._anchors[:] = compose(pose, self._anchors)
        c, s = np.cos(pose[2]), np.sin(pose[2])
        turn = np.eye(self._x.size)
        turn[:2, :2] = [[c, -s], [s, c]]
        self._p[:] = turn @ self._p @ turn.T
        self._anchor_covariances[:] = turn[:3, :3] @ self._anchor_covariances @ turn[:3, :3].T
        # A heading in the map and a yaw's zero are wrong by the same angle, with opposite sign.
        angle = np.zeros(self._x.size)
        angle[2], angle[3:] = 1.0, -1.0
        self._x[3:] -= pose[2]
        self._p += sigma[1] ** 2 * np.outer(angle, angle)
        self._p[0, 0] += sigma[0] ** 2
        self._p[1, 1] += sigma[0] ** 2


def _joined(arrays: list[Floats], shape: tuple[int, ...]) -> Floats:
    """Return arrays (M, *shape) one after the other; (0, *shape) of none."""
    return np.concatenate([np.zeros((0, *shape)), *arrays])
