"""The Jackal recording of the jackass calibrator: one drive of a skid-steer robot with 3-D lidar.

Source: https://github.com/LeoBrizi/jackass-calibrator. Run 0 has `t vR vL imu_yaw x y th` on
every line, run 1 (an earlier export of the same drive) lacks the yaw; wheel rates in rad/s at
50 Hz. Lines where a lidar pose was available add `lidar_x lidar_y lidar_th t_lidar`. The x y th
columns are the exporter's own guess and are not read.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from fgloc.core.bases import skid_steer
from fgloc.core.drive import Drive, Reference
from fgloc.core.measurements import Sensor, WheelIncrements, Yaw
from fgloc.core.robot import Robot
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.intervals import trapezoid
from fgloc.datasets.text import (
    NOT_A_NUMBER,
    finite_rows,
    forward_stamps,
    numbered,
    parse_rows,
    read_lines,
    seconds_to_ns,
)
from fgloc.errors import FglocError

NAME = "jackal-jackass"
FILES = {
    "0": "calib_dump_imu_associations.txt",
    "1": "calib_dump_associations_2f5e880.txt",
}
RADIUS = 0.098
"""Nominal wheel radius [m]."""
TRACK = 0.3756
"""Nominal distance between left and right wheels [m]; the effective track is larger."""


def runs(folder: Path) -> list[str]:
    """Return the runs that are there."""
    return [run for run, file in FILES.items() if (folder / file).is_file()]


def load(folder: Path, run: str, name: str) -> Drive:
    """Return one run; wheel rates are integrated between stamps by the trapezoid rule.

    Raises FglocError naming file and line for what cannot be understood.
    """
    file = folder / FILES[run]
    has_yaw = run == "0"
    short = 7 if has_yaw else 6
    rejected: Counter[str] = Counter()
    body, numbers = numbered(read_lines(file), rejected)
    rows = parse_rows(
        body, numbers, file, widths=(short, short + 4), separator=None, rejected=rejected
    )
    table = rows.columns(short)
    wanted = table[:, : short - 3]
    table = table[finite_rows(wanted, rejected)]
    stamps = seconds_to_ns(table[:, 0])
    keep = forward_stamps(stamps, rejected)
    stamps, table = stamps[keep], table[keep]
    if stamps.size < 2:
        raise FglocError("fewer than two usable lines; download the file again", file=file)
    rates = table[:, [2, 1]]
    wheels = WheelIncrements("wheels", stamps, trapezoid(stamps, rates), ("left", "right"))
    sensors: tuple[Sensor, ...] = ()
    notes = ["Wheel rates are integrated between stamps by the trapezoid rule."]
    if has_yaw:
        sensors = (Yaw("yaw", stamps, table[:, 3], sigma=0.02, drift_sigma=0.005),)
        notes.append("The IMU's yaw is unreliable on this drive.")
    wide = rows.widths == short + 4
    lidar = rows.columns(short + 4, wide)[:, short:]
    lidar = lidar[finite_rows(lidar, rejected, f"truth {NOT_A_NUMBER}")]
    lidar_stamps = seconds_to_ns(lidar[:, 3])
    later = forward_stamps(lidar_stamps, rejected, "truth ")
    poses = np.column_stack([lidar[later, :2], np.unwrap(lidar[later, 2])])
    truth = Reference(
        Trajectory(lidar_stamps[later], poses),
        "lidar",
        (0.01, 0.01, 0.005),
        mount_sigma=(0.2, 0.2, 0.2),
    )
    return Drive(
        name,
        Robot.typical("Clearpath Jackal", skid_steer(("left",), ("right",), RADIUS, TRACK)),
        wheels,
        sensors,
        truth=truth if later.any() else None,
        rejected=dict(rejected),
        notes=(*notes, "The truth is the lidar's pose; where the lidar sits is not known."),
    )
