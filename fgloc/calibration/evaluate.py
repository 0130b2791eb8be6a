"""What a calibration is worth: wheel odometry alone, open loop, with and without it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from fgloc.calibration.result import DriveError
from fgloc.core.drive import Drive
from fgloc.core.evaluation import Evaluation, evaluate
from fgloc.core.geometry import EXACT, integrate
from fgloc.core.robot import Robot
from fgloc.core.start import start_pose, trim_to_truth
from fgloc.core.totals import Totals, totals
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError

Mount = tuple[float, float, float]


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


def open_loop_errors(
    drive: Drive, robot: Robot, mount: Mount | None = None, offset_s: float = 0.0
) -> Evaluation:
    """Return the errors of `open_loop_trajectory`. Raises FglocError without a truth."""
    if drive.truth is None:
        raise FglocError(f"{drive.name} has no recorded truth, so nothing can be evaluated on it")
    return evaluate(open_loop_trajectory(drive, robot, mount, offset_s), drive.truth, mount)


def evaluate_drives(
    drives: Sequence[Drive],
    nominal: Robot,
    calibrated: Robot,
    mount: Mount | None,
    offset_s: float = 0.0,
) -> tuple[tuple[DriveError, ...], Totals | None, Totals | None]:
    """Return the errors of every drive before and after, and both totals; None without drives."""
    found = tuple(
        DriveError(
            d.name,
            d.motion,
            open_loop_errors(d, nominal),
            open_loop_errors(d, calibrated, mount, offset_s),
        )
        for d in drives
    )
    if not found:
        return found, None, None
    before = totals((e.motion, e.nominal) for e in found)
    after = totals((e.motion, e.value) for e in found)
    return found, before, after
