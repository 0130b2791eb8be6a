"""Recordings of a Clearpath Husky on several grounds: `<GROUND>/pro_<NN>.csv` and `imu_<NN>.csv`.

Source: https://github.com/norlab-ulaval/BorealTC (data CC0). The wheel file has the speeds of the
left and the right wheels' rims [m/s], in steps of 1/127 m/s, at 6.5 Hz; the IMU file rates [rad/s]
and accelerations [m/s²] at 100 Hz, x forward, z up. There is no truth: the data set is about
telling grounds apart.

Stamps are row numbers divided by the rates that were aimed at, both from zero, and not times: the
two files of a run end up to 2 % apart, and wheels and gyro turn at times that differ by up to 2 s.
The wheels are therefore laid over the gyro (`fgloc.datasets.clock_alignment`).
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import numpy as np

from fgloc.core.bases import skid_steer
from fgloc.core.drive import Drive
from fgloc.core.measurements import Acceleration, Floats, Sensor, WheelIncrements, YawRate
from fgloc.core.robot import Robot
from fgloc.datasets.clock_alignment import FASTEST, align
from fgloc.datasets.intervals import trapezoid
from fgloc.datasets.text import (
    countable_seconds,
    finite_rows,
    forward_stamps,
    numbered,
    parse_rows,
    read_lines,
    seconds_to_ns,
)
from fgloc.errors import FglocError

NAME = "borealtc-husky"
WHEEL_COLUMNS = ("time", "velL", "velR")
IMU_COLUMNS = ("time", "wz", "ax")
RADIUS = 0.1651
"""Nominal wheel radius [m], of the manufacturer's description."""
TRACK = 0.555
"""Distance between left and right wheels [m], of the same; the effective track is larger."""
DENSITY = 1e-3
"""Noise density of the gyro on a shaking robot [rad/s/sqrt(Hz)]: ten times a datasheet's."""
BIAS_SIGMA = 0.005
"""Prior of the gyro's bias [rad/s]."""
BIAS_WALK = 1e-4
"""Its walk [rad/s/sqrt(s)]."""


def runs(folder: Path) -> list[str]:
    """Return the runs `GROUND/NN` of which both files are there, sorted."""
    found = []
    for file in folder.glob("*/pro_*.csv"):
        match = re.fullmatch(r"pro_(\d+)\.csv", file.name)
        if match and (file.parent / f"imu_{match.group(1)}.csv").is_file():
            found.append(f"{file.parent.name}/{match.group(1)}")
    return sorted(found)


def load(folder: Path, run: str, name: str) -> Drive:
    """Return one run; wheel speeds are integrated between stamps by the trapezoid rule.

    Raises FglocError naming file and line for what cannot be understood.
    """
    ground, _, number = run.partition("/")
    rejected: Counter[str] = Counter()
    speeds = _read(folder / ground / f"pro_{number}.csv", WHEEL_COLUMNS, rejected, "wheels ")
    imu = _read(folder / ground / f"imu_{number}.csv", IMU_COLUMNS, rejected, "imu ")
    span = (imu[-1, 0] - imu[0, 0]) / (speeds[-1, 0] - speeds[0, 0])
    # Both files hold the whole run, so the lengths tell the rates apart; not where one is cut off.
    start = span if abs(span - 1.0) <= FASTEST else 1.0
    clock = align(speeds[:, 0], speeds[:, 2] - speeds[:, 1], imu[:, 0], imu[:, 1], start)
    # No stamp before zero, whichever log began first.
    begin = max(0.0, -(clock.offset_s + clock.rate * float(speeds[0, 0])))
    stamps = seconds_to_ns(begin + clock.offset_s + clock.rate * speeds[:, 0])
    gyro_stamps = seconds_to_ns(begin + imu[:, 0])
    wheels = WheelIncrements(
        "wheels", stamps, trapezoid(stamps, speeds[:, 1:] / RADIUS), ("left", "right")
    )
    sensors: tuple[Sensor, ...] = (
        YawRate("gyro", gyro_stamps, imu[:, 1], DENSITY, BIAS_SIGMA, BIAS_WALK),
        Acceleration("acc", gyro_stamps, imu[:, 2]),
    )
    how = "as the turns fit best" if clock.moved else "so that both files last equally long"
    return Drive(
        name,
        Robot.typical("Clearpath Husky A200", skid_steer(("left",), ("right",), RADIUS, TRACK)),
        wheels,
        sensors,
        motion=ground,
        rejected=dict(rejected),
        notes=(
            "Stamps are row numbers over nominal rates; the wheels' are laid over the gyro's "
            f"{how}: t = {clock.offset_s:+.2f} s + {clock.rate:.4f} t (correlation of turns "
            f"{clock.correlation:.3f}).",
            "Wheel speeds are integrated between stamps by the trapezoid rule.",
        ),
    )


def _read(file: Path, columns: tuple[str, ...], rejected: Counter[str], prefix: str) -> Floats:
    """Return (N, C) wanted columns of a comma file with a header, time first and increasing."""
    lines = read_lines(file)
    header = [h.strip() for h in (lines.text[0] if lines.text else lines.rest).split(",")]
    missing = [c for c in columns if c not in header]
    if missing:
        raise FglocError(
            f"the header has no column {missing[0]!r}; this is not a {NAME} recording",
            file=file,
            line=1,
        )
    body, numbers = numbered(lines, rejected, skip=1)
    rows = parse_rows(body, numbers, file, widths=(len(header),), rejected=rejected)
    table = rows.columns(len(header))[:, [header.index(c) for c in columns]]
    table = table[finite_rows(table, rejected, f"{prefix}not a number")]
    table = table[countable_seconds(table[:, 0], rejected, prefix)]
    table = table[forward_stamps(seconds_to_ns(table[:, 0]), rejected, prefix)]
    if table.shape[0] < 2:
        raise FglocError("fewer than two usable lines; download the file again", file=file)
    return np.asarray(table)
