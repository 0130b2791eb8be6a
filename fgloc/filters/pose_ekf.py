"""The pose EKF: wheels predict, camera, yaw, gyro and fixes correct. The baseline of seed D."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.measurements import Floats
from fgloc.core.start import start_pose, trim_to_truth
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError
from fgloc.estimator import Result, SensorCount, SensorResiduals
from fgloc.filters.model1 import trim_note
from fgloc.filters.pose_ekf_events import Events, merge
from fgloc.filters.pose_ekf_kernel import (
    ACCEPTED,
    CAMERA,
    POSE,
    POSITION,
    RECOVERED,
    REFERENCE,
    REJECTED,
    YAW,
    run_filter,
)
from fgloc.filters.pose_ekf_settings import PoseEkfSettings

ORIGIN_SIGMA = 1e-4
"""Sigma [m, rad] of a start that defines the map frame itself."""
COMPONENTS = {
    CAMERA: ("x [m]", "y [m]", "heading [rad]"),
    POSE: ("x [m]", "y [m]", "heading [rad]"),
    POSITION: ("x [m]", "y [m]"),
    YAW: ("heading [rad]",),
}
"""What the numbers of an innovation are, by kind of event."""


class PoseEkf:
    """Extended Kalman filter of x, y, heading and the zero of every yaw sensor.

    Wheel odometry of any base predicts, with the covariance of the robot's wheel noise; camera
    poses, yaw, the angle turned by a gyro, position and pose fixes correct, in the order of time.
    Nothing of the robot is estimated: no radii or track, no gyro bias, no mounting. Source: seed D,
    chapter 4 (eqs 4.1-4.8); what it leaves open is said in docs/ekf.md.
    """

    def __init__(self, settings: PoseEkfSettings | None = None) -> None:
        self.settings = settings if settings is not None else PoseEkfSettings()

    @property
    def method(self) -> str:
        """Return the method id."""
        return "pose-ekf"

    def estimate(self, drive: Drive) -> Result:
        """Return the pose at every wheel stamp as it was known then, with its covariance.

        Runs on wheels alone. Raises FglocError if wheels and truth do not overlap, the wheels do
        not determine the motion, or numbers are so large that nothing can be computed from them.
        """
        trimmed = trim_to_truth(drive)
        wheels = trimmed.wheels
        events = merge(trimmed, self.settings)
        start = start_pose(trimmed)
        sigma = np.full(3, ORIGIN_SIGMA) if drive.truth is None else np.array(drive.truth.sigma)
        run = _Run(events, self.settings, start, sigma)
        if not (np.isfinite(run.poses).all() and np.isfinite(run.covariances).all()):
            raise FglocError(
                f"{drive.name} cannot be filtered: a measurement or a sigma is off by orders of "
                "magnitude; look for leaps in the data and for sigmas near zero"
            )
        left_out = drive.wheels.stamps_ns.size - wheels.stamps_ns.size
        counts = {wheels.sensor: SensorCount(wheels.angles.shape[0], rejected=left_out)}
        counts |= run.counts(drive)
        used = tuple(name for name, count in counts.items() if count.accepted > 0)
        return Result(
            self.method,
            drive.name,
            Trajectory(wheels.stamps_ns, run.poses, run.covariances),
            used,
            residuals=run.innovations(),
            counts=counts,
            notes=(*run.notes(), *trim_note(left_out)),
        )


class _Run:
    """One pass of the filter over a drive, and what it says of the sensors."""

    def __init__(
        self, events: Events, settings: PoseEkfSettings, start: Floats, sigma: Floats
    ) -> None:
        self.events = events
        streams = events.streams
        readings = np.concatenate([[0], np.cumsum([s.stamps_ns.size for s in streams])])
        # Streams one after the other, then in the order of time.
        order = (readings[events.stream_of] + events.reading_of).astype(np.int64)
        kinds = np.array([s.kind for s in streams], dtype=np.int64)
        yaws = [k for k, s in enumerate(streams) if s.kind == YAW]
        zero_of = np.full(len(streams), -1, dtype=np.int64)
        zero_of[yaws] = 3 + np.arange(len(yaws))
        n, e, wheels = 3 + len(yaws), order.size, int(events.emit.max()) + 1
        x, p = np.zeros(n), np.zeros((n, n))
        x[:3] = start
        p[np.arange(3), np.arange(3)] = sigma**2
        self.poses, self.covariances = np.zeros((wheels, 3)), np.zeros((wheels, 3, 3))
        self._status = np.full(e, REJECTED, dtype=np.int64)
        self._innovations, self._whitened = np.zeros((e, 3)), np.zeros((e, 3))
        self._turn_status = np.full(events.turns.shape, REJECTED, dtype=np.int64)
        self._turn_innovations = np.zeros((*events.turns.shape, 2))
        run_filter(
            events.cuts_ns,
            events.steps,
            events.step_covariances,
            events.emit,
            events.first,
            kinds[events.stream_of],
            events.stream_of,
            _joined([s.values for s in streams], (3,))[order],
            _joined([s.noises for s in streams], (3, 3))[order],
            _joined([s.lever[None] for s in streams], (3,)),
            np.array([s.gate for s in streams], dtype=np.float64),
            zero_of,
            np.array([streams[k].zero_walk for k in yaws], dtype=np.float64),
            events.turns,
            events.turn_variances,
            np.full(len(events.gyros), settings.gyro_gate**2),
            events.rounding,
            np.array(
                [settings.patience_count, min(settings.patience_s * 1e9, 2.0**62)], dtype=np.int64
            ),
            x,
            p,
            self.poses,
            self.covariances,
            self._status,
            self._innovations,
            self._whitened,
            self._turn_status,
            self._turn_innovations,
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
            again = int(np.count_nonzero(self._status[self.events.stream_of == k] == RECOVERED))
            if again:
                notes.append(
                    f"{stream.sensor.sensor} was rejected for so long that it was believed again "
                    f"{again} time{'s' if again > 1 else ''}"
                )
        return tuple(notes)


def _joined(arrays: list[Floats], shape: tuple[int, ...]) -> Floats:
    """Return arrays (M, *shape) one after the other; (0, *shape) of none."""
    return np.concatenate([np.zeros((0, *shape)), *arrays])
