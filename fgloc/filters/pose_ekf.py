"""The pose EKF: wheels predict, camera, yaw, gyro and fixes correct. The baseline of seed D."""

from __future__ import annotations

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.start import start_pose, trim_to_truth
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError
from fgloc.estimator import Result, SensorCount
from fgloc.filters.model1 import trim_note
from fgloc.filters.pose_ekf_events import merge
from fgloc.filters.pose_ekf_run import Run
from fgloc.filters.pose_ekf_settings import PoseEkfSettings

ORIGIN_SIGMA = 1e-4
"""Sigma [m, rad] of a start that defines the map frame itself."""
FARTHEST = 1e9
"""No robot gets as far as this [m, rad]; beyond it doubles no longer know millimetres."""


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

        Runs on wheels alone. The residuals of the result are innovations: reading minus what was
        expected before it. Raises FglocError if wheels and truth do not overlap, the wheels do
        not determine the motion, or numbers are so large that nothing can be computed from them.
        """
        trimmed = trim_to_truth(drive)
        wheels = trimmed.wheels
        sigma = np.full(3, ORIGIN_SIGMA) if drive.truth is None else np.array(drive.truth.sigma)
        run = Run(merge(trimmed, self.settings), self.settings, start_pose(trimmed), sigma)
        notes = run.filter() if drive.truth is not None else run.filter_from_nowhere()
        if not (np.abs(run.poses) < FARTHEST).all() or not np.isfinite(run.covariances).all():
            raise FglocError(
                f"{drive.name} cannot be filtered: a measurement or a sigma is off by orders of "
                "magnitude; look for leaps in the data and for sigmas near zero"
            )
        left_out = drive.wheels.stamps_ns.size - wheels.stamps_ns.size
        counts = {wheels.sensor: SensorCount(wheels.angles.shape[0], rejected=left_out)}
        counts |= run.counts(drive)
        return Result(
            self.method,
            drive.name,
            Trajectory(wheels.stamps_ns, run.poses, run.covariances),
            tuple(name for name, count in counts.items() if count.accepted > 0),
            residuals=run.innovations(),
            counts=counts,
            notes=(*notes, *run.notes(), *trim_note(left_out)),
        )
