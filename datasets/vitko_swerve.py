"""Recordings of the four-wheel-steer wall climber: `odom_<run>.csv` and `abs_<run>.csv`.

Source: https://github.com/JakVit/4WIS4WID_parameter_calibration. Six reference motions were
recorded five times each; run = 5·(motion - 1) + repetition. Both files are exports of ROS topics
with a `time` column in local wall time to the microsecond, which is the time base used here
(the stamps in the message headers are another clock).
"""

from __future__ import annotations

import math
import re
from collections import Counter
from pathlib import Path

import numpy as np

from fgloc.core.bases import four_wheel_steer
from fgloc.core.drive import Drive, Reference
from fgloc.core.measurements import Floats, Stamps, WheelIncrements
from fgloc.core.robot import Robot
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.text import (
    Integers,
    finite_rows,
    forward_stamps,
    numbered,
    parse_rows,
    read_lines,
    split_fields,
)
from fgloc.errors import FglocError

NAME = "vitko-swerve"
MOTIONS = ("line x", "line y", "circle ccw", "circle cw", "spin ccw", "spin cw")
REPETITIONS = 5
WHEELS = {"1": "FL", "2": "BL", "3": "BR", "4": "FR"}
"""Wheel names in the order of the publication, and the prefix of their joints in the files."""
HALF = 0.1125
"""Nominal distance of every wheel from both axes of the robot [m]."""
RADIUS = 0.0254
"""Nominal wheel radius [m]."""
WITHIN = 0.05
"""How far dimensions may be off, relative to nominal; all values within are alike."""
SKIPPED = 29
"""First samples of the motion capture that the publication leaves out."""
LATE_S = 0.015
"""A frame so much later than usual [s] does not tell when it was taken."""
ROUNDS = 8
"""Rounds of leaving out late frames."""
FRAME = ".header.seq"
"""Column that numbers the frames of the motion capture."""
HOLD_NS = 50_000_000
"""How far the wheel signals are held beyond their ends; beyond that there is no odometry."""


def runs(folder: Path) -> list[str]:
    """Return the runs of which both files are there, in numerical order."""
    found = (re.fullmatch(r"odom_(\d+)\.csv", p.name) for p in folder.glob("odom_*.csv"))
    numbers = sorted(int(m.group(1)) for m in found if m)
    return [str(n) for n in numbers if (folder / f"abs_{n}.csv").is_file()]


def robot() -> Robot:
    """Return the robot at its nominal dimensions.

    The publication looks for all radii and wheel positions within 5 % of nominal: as standard
    deviation of the priors that is 2.9 %.
    """
    positions = ((HALF, HALF), (-HALF, HALF), (-HALF, -HALF), (HALF, -HALF))
    base = four_wheel_steer(
        tuple(WHEELS),
        positions,
        (RADIUS,) * 4,
        position_prior=WITHIN / math.sqrt(3.0) * HALF,
        radius_prior=WITHIN / math.sqrt(3.0),
    )
    return Robot.typical("4WIS4WID wall climber", base)


def load(folder: Path, run: str, name: str) -> Drive:
    """Return one run; wheel rates are interpolated to the motion capture's stamps.

    The increment of an interval is the rate and steering angle at its beginning times its length
    (left rectangle), as in the publication: with Euler steps this gives its total error of 1.2607
    over repetitions 1-3, where the trapezoid gives 1.2567.
    Raises FglocError naming file and line for anything that cannot be understood.
    """
    rejected: Counter[str] = Counter()
    stamps, steering, rates = _read_odometry(folder / f"odom_{run}.csv", rejected)
    truth_stamps, poses, frames = _read_truth(folder / f"abs_{run}.csv", rejected)
    truth_stamps, poses = truth_stamps[SKIPPED:], poses[SKIPPED:]
    taken = None if frames is None else frame_times(truth_stamps, frames[SKIPPED:])
    inside = (truth_stamps >= stamps[0] - HOLD_NS) & (truth_stamps <= stamps[-1] + HOLD_NS)
    boundaries = truth_stamps[inside]
    if boundaries.size < 2:
        raise FglocError(
            "wheels and motion capture have no time in common; download the files again",
            file=folder / f"odom_{run}.csv",
        )
    seconds = np.diff(boundaries)[:, None] * 1e-9
    wheels = WheelIncrements(
        "wheels",
        boundaries,
        _interpolate(boundaries, stamps, rates)[:-1] * seconds,
        tuple(WHEELS),
        steering=_interpolate(boundaries, stamps, steering)[:-1],
    )
    truth = Reference(
        Trajectory(truth_stamps, poses), "optitrack", (2e-4, 2e-4, 2e-3), taken_ns=taken
    )
    motion = (int(run) - 1) // REPETITIONS
    return Drive(
        name,
        robot(),
        wheels,
        truth=truth,
        motion=MOTIONS[motion] if 0 <= motion < len(MOTIONS) else None,
        rejected=dict(rejected),
        notes=(
            f"The first {SKIPPED} motion-capture samples are left out, as in the publication.",
            "Wheel rates and steering angles are interpolated to the motion capture's stamps; "
            "an increment is the rate at the beginning of its interval times its length.",
        ),
    )


def frame_times(stamps: Stamps, frames: Stamps) -> Stamps | None:
    """Return when frames of a steady camera system were taken, up to a constant delay; or None.

    Messages arrive within 10 ms of a steady rate, some up to 0.2 s late; frames numbered (N,) tell
    which. A line through the stamps (N,) by frame, those more than `LATE_S` off left out, is when
    they would have arrived without that. None where frames do not count up or nothing is steady.
    """
    if frames.size < 3 or not bool(np.all(np.diff(frames) > 0)):
        return None
    count = (frames - frames[0]).astype(np.float64)
    late = (stamps - stamps[0]) * 1e-9
    used = np.ones(count.size, dtype=np.bool_)
    line = np.zeros(2)
    for _ in range(ROUNDS):
        line = np.polyfit(count[used], late[used], 1)
        off = late - np.polyval(line, count)
        used = np.abs(off - np.median(off)) < LATE_S
        if used.sum() < 0.5 * count.size:
            return None
    return np.asarray(stamps[0] + np.round(np.polyval(line, count) * 1e9).astype(np.int64))


def _interpolate(at: Stamps, stamps: Stamps, values: Floats) -> Floats:
    """Return (M, W) values interpolated linearly at `at`, held at both ends."""
    origin = stamps[0]
    x, known = (at - origin).astype(np.float64), (stamps - origin).astype(np.float64)
    return np.stack([np.interp(x, known, column) for column in values.T], axis=1)


def _fields(
    file: Path, rejected: Counter[str], columns: tuple[str, ...]
) -> tuple[list[list[str]], list[int], Integers, list[str]]:
    """Return all fields of a semicolon file, the indices of the `columns`, the line numbers and
    the names of all columns."""
    lines = read_lines(file)
    header = (lines.text[0] if lines.text else lines.rest).split(";")
    missing = [c for c in columns if c not in header]
    if missing:
        raise FglocError(
            f"the header has no column {missing[0]!r}; this is not a {NAME} recording",
            file=file,
            line=1,
        )
    body, numbers = numbered(lines, rejected, skip=1)
    fields, numbers = split_fields(
        body, numbers, file, widths=(len(header),), separator=";", rejected=rejected
    )
    if len(fields) < 2:
        raise FglocError("no samples in this file; download it again", file=file)
    return fields, [header.index(c) for c in columns], numbers, header


def _wall_time(fields: list[list[str]], column: int, numbers: Integers, file: Path) -> Stamps:
    """Return the local wall times `2024/05/03/12:34:34.842768` as nanoseconds since 1970."""
    texts = [f"{row[column][:10].replace('/', '-')}T{row[column][11:]}" for row in fields]
    try:
        return np.array(texts, dtype="datetime64[ns]").astype(np.int64)
    except ValueError:
        for text, row, line in zip(texts, fields, numbers, strict=True):
            try:
                np.datetime64(text, "ns")
            except ValueError:
                raise FglocError(
                    f"{row[column]!r} is not a time; remove or repair the line",
                    file=file,
                    line=int(line),
                ) from None
        raise


def _joint_order(names: str, suffix: str, file: Path, line: int) -> list[int]:
    """Return where the four joints with this suffix stand, in the order of WHEELS."""
    found = re.findall(r"'([^']*)'", names)
    try:
        return [found.index(f"{prefix}_{suffix}") for prefix in WHEELS.values()]
    except ValueError:
        raise FglocError(
            f"the joint names {names} lack a *_{suffix}; this is not a {NAME} recording",
            file=file,
            line=line,
        ) from None


def _read_odometry(file: Path, rejected: Counter[str]) -> tuple[Stamps, Floats, Floats]:
    """Return stamps (N,), steering angles [rad] and wheel rates [rad/s] (N, 4) as in WHEELS."""
    columns = ("time", ".name", ".position", ".velocity")
    fields, (time, name, position, velocity), numbers, _ = _fields(file, rejected, columns)
    stamps = _wall_time(fields, time, numbers, file)
    names = np.array([row[name] for row in fields])
    both = np.empty((2, stamps.size, len(WHEELS)))
    # The order of the joints is the message's own business: it is looked up wherever it changes.
    for order in np.unique(names):
        rows = np.flatnonzero(names == order)
        line = int(numbers[rows[0]])
        width = order.count("'") // 2
        for k, (column, suffix) in enumerate(((position, "Position"), (velocity, "Wheel"))):
            texts = [fields[r][column].strip("() ") for r in rows]
            table = parse_rows(texts, numbers[rows], file, widths=(width,), rejected=None)
            joints = _joint_order(str(order), suffix, file, line)
            both[k, rows] = table.columns(width)[:, joints]
    good = finite_rows(np.concatenate([both[0], both[1]], axis=1), rejected)
    stamps, both = stamps[good], both[:, good]
    keep = forward_stamps(stamps, rejected)
    if keep.sum() < 2:
        raise FglocError("fewer than two valid wheel samples; download the file again", file=file)
    return stamps[keep], both[0, keep], both[1, keep]


def _read_truth(file: Path, rejected: Counter[str]) -> tuple[Stamps, Floats, Stamps | None]:
    """Return stamps (N,), poses (N, 3) of the motion capture, the heading unwrapped, and (N,) frame
    numbers; None for these where the file does not number its frames."""
    quaternion = tuple(f".pose.orientation.{a}" for a in "xyzw")
    columns = ("time", ".pose.position.x", ".pose.position.y", *quaternion)
    fields, (time, *wanted), numbers, header = _fields(file, rejected, columns)
    wanted += [header.index(FRAME)] if FRAME in header else []
    texts = [";".join([row[c] for c in wanted]) for row in fields]
    table = parse_rows(texts, numbers, file, widths=(len(wanted),), separator=";", rejected=None)
    stamps, values = _wall_time(fields, time, numbers, file), table.columns(len(wanted))
    good = finite_rows(values, rejected)
    stamps, values = stamps[good], values[good]
    keep = forward_stamps(stamps, rejected)
    x, y, qx, qy, qz, qw = values[keep, :6].T
    heading = np.unwrap(np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz)))
    frames = values[keep, 6].astype(np.int64) if len(wanted) > 6 else None
    return stamps[keep], np.stack([x, y, heading], axis=1), frames
