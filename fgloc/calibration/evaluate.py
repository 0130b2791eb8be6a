"""What a calibration is worth: wheel odometry alone, open loop, with and without it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from fgloc.calibration.result import CalibrationReport, DriveError
from fgloc.core.drive import Drive, Reference
from fgloc.core.evaluation import Evaluation, evaluate
from fgloc.core.geometry import EXACT, integrate
from fgloc.core.robot import Robot
from fgloc.core.start import start_pose, trim_to_truth
from fgloc.core.totals import Totals, totals
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError
from fgloc.estimator import Mount, calibrated_mount


def open_loop_trajectory(
    drive: Drive, robot: Robot, mount: Mount | None = None, offset_s: float = 0.0
) -> Trajectory:
    """Return where a robot's wheels alone put its base, from the drive's true start on. O(N).

    `mount` is where the reference sits on the base (None: as recorded); the true start is mapped
    through it. What the wheels tell of a time t is stamped t - `offset_s`, by the reference's
    clock. Raises FglocError if wheels and truth do not overlap.
    """
    if drive.truth is not None and mount is not None:
        drive = replace(drive, truth=replace(drive.truth, mount=mount))
    drive = trim_to_truth(drive)
    wheels = drive.wheels
    moved = robot.base.displacements(wheels.angles, wheels.steering)
    stamps = wheels.stamps_ns - round(offset_s * 1e9)
    return Trajectory(stamps, integrate(moved, start_pose(drive), EXACT))


@dataclass(frozen=True)
class OpenLoop:
    """Where wheels alone put the base on a drive, and what their errors are taken against."""

    trajectory: Trajectory
    """Poses of the base."""
    truth: Reference
    """The drive's truth."""
    mount: Mount
    """Where its reference sits on the base."""

    @property
    def errors(self) -> Evaluation:
        """Return the errors against the truth."""
        return evaluate(self.trajectory, self.truth, self.mount)


def before_and_after(drive: Drive, report: CalibrationReport) -> Mapping[str, OpenLoop]:
    """Return the open loop of the robot as described ("nominal") and "calibrated". O(N).

    Calibrated are also where the reference sits and by how much the wheels' stamps are late.
    Raises FglocError without a truth, or if it does not overlap the wheels in time.
    """
    truth = drive.truth
    if truth is None:
        raise FglocError(f"{drive.name} has no recorded truth, so nothing can be evaluated on it")
    mount = calibrated_mount(report.parameters, truth)
    after = open_loop_trajectory(drive, report.robot, mount, report.time_offset_s)
    return {
        "nominal": OpenLoop(open_loop_trajectory(drive, report.nominal), truth, truth.mount),
        "calibrated": OpenLoop(after, truth, mount),
    }


def evaluate_drives(
    drives: Sequence[Drive], report: CalibrationReport
) -> tuple[tuple[DriveError, ...], Totals | None, Totals | None]:
    """Return the errors of every drive before and after, and both totals; None without drives."""
    found = []
    for d in drives:
        paths = before_and_after(d, report)
        found.append(
            DriveError(d.name, d.motion, paths["nominal"].errors, paths["calibrated"].errors)
        )
    if not found:
        return (), None, None
    before = totals((e.motion, e.nominal) for e in found)
    after = totals((e.motion, e.value) for e in found)
    return tuple(found), before, after
