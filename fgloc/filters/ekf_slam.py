"""EKF-SLAM: pose and landmarks in one state. The baseline of seeds B and C."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.start import start_pose, trim_to_truth
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError
from fgloc.estimator import Result, SensorCount
from fgloc.filters.ekf_slam_events import merge
from fgloc.filters.ekf_slam_map import map_notes, map_of
from fgloc.filters.ekf_slam_run import Run
from fgloc.filters.ekf_slam_settings import EkfSlamSettings
from fgloc.filters.model1 import trim_note
from fgloc.filters.pose_ekf import FARTHEST, ORIGIN_SIGMA


@dataclass(frozen=True)
class EkfSlam:
    """Extended Kalman filter of the pose and of every landmark that was seen often enough.

    Wheel odometry of any base predicts, with the covariance of the robot's wheel noise; range and
    bearing of one landmark after the other correct. A wall is the foot of the perpendicular from
    the map's origin, as in seed C: degenerate where it passes through the origin, and the way along
    a wall seems to be seen where it is not. Association is by the nearest landmark. Nothing of the
    robot is estimated. Source: seeds B and C; docs/filters.md says what they leave open.
    """

    settings: EkfSlamSettings = field(default_factory=EkfSlamSettings)
    """Noise, gates, sightings, lives, extractor."""

    @property
    def method(self) -> str:
        """Return the method id."""
        return "ekf-slam"

    def estimate(self, drive: Drive) -> Result:
        """Return the pose at every wheel stamp as it was known then, and the map at the end.

        A scan counts when its last beam has returned. The residuals of the result are innovations.
        O(E n²) for E sightings and n states. Raises FglocError if the drive has neither scans nor
        landmark sightings, wheels and truth do not overlap, the wheels do not determine the
        motion, or numbers are so large that nothing can be computed from them.
        """
        trimmed = trim_to_truth(drive)
        wheels = trimmed.wheels
        sigma = np.full(3, ORIGIN_SIGMA) if drive.truth is None else np.array(drive.truth.sigma)
        run = Run(merge(trimmed, self.settings), self.settings, start_pose(trimmed), sigma)
        run.filter()
        if not (np.abs(run.poses) < FARTHEST).all() or not np.isfinite(run.covariances).all():
            raise FglocError(
                f"{drive.name} cannot be filtered: a measurement or a sigma is off by orders of "
                "magnitude; look for leaps in the data and for sigmas near zero"
            )
        found = map_of(run)
        left_out = drive.wheels.stamps_ns.size - wheels.stamps_ns.size
        counts = {wheels.sensor: SensorCount(wheels.angles.shape[0], rejected=left_out)}
        counts |= run.counts()
        return Result(
            self.method,
            drive.name,
            Trajectory(wheels.stamps_ns, run.poses, run.covariances),
            tuple(name for name, count in counts.items() if count.accepted > 0),
            residuals=run.innovations(),
            counts=counts,
            notes=(*map_notes(run, found.walls), *trim_note(left_out)),
            map=found,
        )
