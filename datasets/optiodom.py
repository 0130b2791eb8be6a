"""The optiodom recordings: four small robots under a motion-capture system.

Source: https://github.com/sousarbarb/optiodom (MIT). A run is
`data/<robot>/<path>/<set>/<set>_run-<NN>.csv` without header: t [s], x [m], y [m], heading [rad]
and one encoder column a wheel, counted since the row before; the set's `_metadata.csv` holds the
nominal geometry. Robots: diff, omni3, omni4 (mecanum), tricyc.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fgloc.core.bases import differential, mecanum, omni3, tricycle
from fgloc.core.drive import Drive, Reference
from fgloc.core.kinematics import WheeledBase
from fgloc.core.measurements import Floats, WheelIncrements
from fgloc.core.robot import Robot
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.intervals import usable_increments
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

NAME = "optiodom"
ENCODERS = {"diff": 2, "omni3": 3, "omni4": 4, "tricyc": 2}
"""Encoder columns of each robot; the tricycle's second one is its steering angle [rad]."""
OMNI4_COUNTS = 11520
"""The mecanum robot's revolutions are whole multiples of 1/11520."""


@dataclass(frozen=True)
class Geometry:
    """What a set's metadata file says of the robot."""

    robot: str
    """diff, omni3, omni4 or tricyc."""
    counts: float
    """Encoder counts per wheel revolution."""
    lengths: tuple[float, ...]
    """Base lengths [m]: track, base radius, (length, width) or wheelbase."""
    diameters: tuple[float, ...]
    """Wheel diameters [m]."""


def runs(folder: Path) -> list[str]:
    """Return the runs `<robot>/<path>/<set>/<NN>` that are there, sorted."""
    found = []
    for file in (folder / "data").glob("*/*/*/*_run-*.csv"):
        match = re.fullmatch(r"(.+)_run-(\d+)\.csv", file.name)
        robot, path, recording = file.parts[-4:-1]
        if match and match.group(1) == recording and robot in ENCODERS:
            found.append(f"{robot}/{path}/{recording}/{match.group(2)}")
    return sorted(found)


def load(folder: Path, run: str, name: str) -> Drive:
    """Return one run. Raises FglocError naming file and line for what cannot be understood."""
    robot, path, recording, number = run.split("/")
    directory = folder / "data" / robot / path / recording
    geometry = read_metadata(directory / f"{recording}_metadata.csv")
    if geometry.robot != robot:
        raise FglocError(
            f"type is {geometry.robot}, the folder says {robot}; download the set again",
            file=directory / f"{recording}_metadata.csv",
        )
    file = directory / f"{recording}_run-{number}.csv"
    rejected: Counter[str] = Counter()
    lines = read_lines(file)
    body, numbers = numbered(lines, rejected)
    width = 4 + ENCODERS[robot]
    table = parse_rows(body, numbers, file, widths=(width,), rejected=rejected).columns(width)
    table = table[finite_rows(table[:, :1], rejected, f"stamp {NOT_A_NUMBER}")]
    stamps = seconds_to_ns(table[:, 0])
    base, angles, steering = _wheels(geometry, table[:, 4:])
    columns = angles if steering is None else np.concatenate([angles, steering], axis=1)
    boundaries, increments, stretch = usable_increments(stamps, columns, rejected)
    if boundaries.size < 2:
        raise FglocError("fewer than two usable rows; download the file again", file=file)
    count = angles.shape[1]
    wheels = WheelIncrements(
        "wheels",
        boundaries,
        increments[:, :count],
        base.driven_names,
        # Stretching is for what was counted; an angle that was read is undone from it.
        steering=None if steering is None else increments[:, count:] / stretch[:, None],
        resolution=2.0 * math.pi / _steps(geometry),
    )
    poses = table[:, 1:4]
    known = finite_rows(poses, rejected, f"truth {NOT_A_NUMBER}")
    known[known] = forward_stamps(stamps[known], Counter())
    poses = np.column_stack([poses[known, :2], np.unwrap(poses[known, 2])])
    truth = Reference(Trajectory(stamps[known], poses), "optitrack", (1e-3, 1e-3, 0.02))
    return Drive(
        name,
        Robot.typical(f"optiodom {robot}", base),
        wheels,
        truth=truth if known.any() else None,
        motion=f"{robot}/{path}",
        rejected=dict(rejected),
        notes=_notes(robot),
    )


def _steps(geometry: Geometry) -> float:
    """Return the steps of a wheel revolution that the encoder tells apart.

    A set recorded in revolutions states one count a revolution, which is its unit and not its
    resolution.
    """
    return OMNI4_COUNTS if geometry.counts == 1.0 else geometry.counts


def read_metadata(file: Path) -> Geometry:
    """Return a set's nominal geometry. Raises FglocError for a missing key or a wrong number."""
    lines = read_lines(file)
    rows = {}
    for number, line in enumerate((*lines.text, lines.rest), start=1):
        key, *fields = line.split(",")
        rows[key.strip()] = (number, [f.strip() for f in fields if f.strip()])

    def values(key: str) -> tuple[float, ...]:
        number, fields = rows.get(key, (0, []))
        try:
            found = tuple(float(f) for f in fields)
        except ValueError:
            raise FglocError(f"{key}: {fields} are not numbers", file=file, line=number) from None
        if not found or not all(v > 0.0 and math.isfinite(v) for v in found):
            raise FglocError(
                f"{key} is missing or not positive; download the file again", file=file
            )
        return found

    robot = (rows.get("type", (0, []))[1] or [""])[0]
    if robot not in ENCODERS:
        raise FglocError(
            f"type is {robot!r}, known are {', '.join(ENCODERS)}; download the file again",
            file=file,
        )
    diameters, lengths = values("Di"), values("Li")
    wheels = 1 if robot == "tricyc" else ENCODERS[robot]
    if len(diameters) != wheels or len(lengths) != (2 if robot == "omni4" else 1):
        raise FglocError(f"{robot} needs {wheels} diameters Di and its lengths Li", file=file)
    return Geometry(robot, values("ngear")[0] * values("encRes")[0], lengths, diameters)


def _wheels(geometry: Geometry, encoders: Floats) -> tuple[WheeledBase, Floats, Floats | None]:
    """Return the nominal base, wheel angles (N, W) forward positive [rad] and steering angles.

    Signs and wheel order were checked by regressing the recorded motion on the encoder columns.
    """
    radii = [d / 2.0 for d in geometry.diameters]
    length = geometry.lengths[0]
    angles = encoders * (2.0 * math.pi / geometry.counts)
    if geometry.robot == "diff":
        return differential(radii[1], radii[0], length, order=("right", "left")), angles, None
    if geometry.robot == "omni3":
        # Wheels at front right, front left and back, counted positive when they turn clockwise
        # round the robot; here positive is counter-clockwise.
        places = (-math.pi / 3.0, math.pi / 3.0, math.pi)
        return omni3(radii, length, places), -angles, None
    if geometry.robot == "omni4":
        # Lengths are between wheels; the right wheels are mirror-mounted.
        base = mecanum(radii, length / 2.0, geometry.lengths[1] / 2.0, ("fl", "fr", "rl", "rr"))
        return base, angles * np.array([1.0, -1.0, 1.0, -1.0]), None
    steering = encoders[:, 1:].copy()
    steering[1:] = 0.5 * (encoders[1:, 1:] + encoders[:-1, 1:])
    return tricycle(radii[0], length), angles[:, :1], steering


def _notes(robot: str) -> tuple[str, ...]:
    """Return what a user should know about this robot's recordings."""
    notes = ["The first row's increment is not motion and is left out."]
    if robot == "tricyc":
        notes.append("Clocks of odometry and truth were aligned by hand and drift by 1-2 %.")
        notes.append("The mean of two consecutive steering readings is used for an interval.")
    notes.append("The truth's heading jumps by 1-3 degrees between frames in places.")
    return tuple(notes)
