"""UTIAS MRCLAM: iRobot Creates that see barcodes on cylinders and on each other, under Vicon.

Source: K. Leung, Y. Halpern, T. Barfoot, H. Liu, "The UTIAS multi-robot cooperative localization
and mapping dataset", IJRR 30 (2011); http://asrl.utias.utoronto.ca/datasets/mrclam/. A run `6/1` is
`MRCLAM_Dataset6/Robot1_{Odometry,Measurement,Groundtruth}.dat`, blank-separated with `#` comments,
beside `Barcodes.dat` (subject, barcode) and `Landmark_Groundtruth.dat` (subject, x, y, sigmas).
Measurements name what they saw by barcode; subjects 1-5 are the robots, 6-20 the landmarks.

The odometry is what the robots were told to do, `t v w`: it holds until the next line. Against the
Vicon poses of robots 1 and 2 of data set 6 it comes 0.2 s too early, and a robot that turns while
it drives is slower than told: with 0.4 rad/s by 0.44 of its speed, with 0.12 rad/s by 0.15.

What is published as the range is a depth: the distance along the camera's axis, times 1.03 on robot
1 and 1.05 on robot 2. Taken for a distance it is off by up to 10 % at the edge of the picture, the
same for as long as a mark stays there; as a depth by 1 % from picture to picture. Pictures are
stamped 40 ms after they were taken.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from fgloc.core.bases import body_odometry
from fgloc.core.drive import Drive, Reference
from fgloc.core.kinematics import Parameter, Wheel, WheeledBase, X
from fgloc.core.measurements import Floats, LandmarkSightings, Survey, WheelIncrements
from fgloc.core.robot import Robot, WheelNoise
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.text import (
    NOT_A_NUMBER,
    Integers,
    count,
    countable_seconds,
    finite_rows,
    forward_stamps,
    parse_rows,
    read_lines,
    seconds_to_ns,
    steady_stamps,
)
from fgloc.datasets.text import numbered as all_numbered
from fgloc.errors import FglocError

NAME = "utias-mrclam"
ROBOTS = 5
"""Subjects up to this number are robots."""
DELAY_NS = 200_000_000
"""How long after it was told to a robot moves [ns]."""
SCALE_PRIOR = 0.05
"""Relative prior sigma of the speed."""
TURN_PRIOR = 0.1
"""Relative prior sigma of the yaw rate."""
TURN_LOSS_S, TURN_LOSS_PRIOR_S = 1.1, 0.3
"""Share of the speed that is lost in a turn, for its yaw rate, and prior sigma [1 per rad/s]."""
NOISE = WheelNoise(rolling=0.03, lateral=0.01, turning=0.1, veering=0.05, standing=1e-3)
"""What the motion differs from the commands by, beyond scale and delay: the residuals of robots 1
and 2 over one and five seconds."""
LATE_NS = 40_000_000
"""How long after it was taken a picture is stamped [ns]."""
DEPTH_SCALE = 1.04
"""What a depth is published as, over what it is: the middle of the two robots'."""
MOUNT_SIGMA = (0.05, 0.02, 0.02)
"""The camera is said to be in the robot's middle; looser, for what is wrong with its depths [m, m,
rad]: a scale that is 1 % off is 4 cm at the usual distance."""
RANGE_SIGMA_M, BEARING_SIGMA_RAD = 0.06, 0.02
"""Noise of a sighting [m], [rad]: 1 % of 1 to 7 m and as much for the scale, 0.01 to 0.02 rad, and
a half of both is the same for seconds."""
WIDEST_RAD = 1.2
"""No camera sees a mark further aside [rad]; depth and distance part there."""
SURVEY_FLOOR_M = 1e-3
"""Landmarks are not known better [m]: the stated sigmas are those of a mean, down to 0.04 mm."""


def runs(folder: Path) -> list[str]:
    """Return the runs `DATASET/ROBOT` that are there, in order of their numbers."""
    found = []
    for file in folder.glob("MRCLAM_Dataset*/Robot*_Odometry.dat"):
        numbers = re.fullmatch(
            r"MRCLAM_Dataset(\d+)/Robot(\d+)_Odometry",
            str(file.relative_to(folder).with_suffix("").as_posix()),
        )
        if numbers:
            found.append((int(numbers[1]), int(numbers[2])))
    return [f"{dataset}/{robot}" for dataset, robot in sorted(found)]


def base() -> WheeledBase:
    """Return the body odometry of a robot that loses speed in turns.

    A fourth pseudo-wheel `bend` adds up speed times yaw rate, whichever way [m/s]; `turn_loss` [s]
    times that is lost of the way forward.
    """
    plain = body_odometry()
    scale, turn = plain.parameters
    loss = Parameter("turn_loss", TURN_LOSS_S, TURN_LOSS_PRIOR_S, "s", scale=TURN_LOSS_S)
    bend = Wheel("bend", -TURN_LOSS_S, 0.0, kind="linear")
    *driven, side = plain.wheels
    return replace(
        plain,
        wheels=(*driven, bend, side),
        parameters=(
            replace(scale, prior_sigma=SCALE_PRIOR),
            replace(turn, prior_sigma=TURN_PRIOR),
            loss,
        ),
        links=(*plain.links, ("turn_loss", "bend", X, -1.0)),
    )


def load(folder: Path, run: str, name: str) -> Drive:
    """Return one run. Raises FglocError naming file and line for what cannot be understood.

    Sightings of other robots and of barcodes that nobody has are left out and counted.
    """
    dataset, robot = run.split("/")
    directory = folder / f"MRCLAM_Dataset{dataset}"
    rejected: Counter[str] = Counter()
    file = directory / f"Robot{robot}_Odometry.dat"
    odometry, _ = _table(file, 3, rejected, "odometry ")
    odometry = odometry[countable_seconds(odometry[:, 0], rejected, "odometry ")]
    stamps = seconds_to_ns(odometry[:, 0])
    later = forward_stamps(stamps, rejected, "odometry ")
    stamps, odometry = stamps[later], odometry[later]
    if stamps.size < 2:
        raise FglocError("fewer than two usable lines; download the file again", file=file)
    kinematics = base()
    held = odometry[:-1, 1:] * (np.diff(stamps)[:, None] * 1e-9)
    zero = np.zeros(held.shape[0])
    bend = held[:, 0] * np.abs(odometry[:-1, 2])
    angles = np.stack([held[:, 0], zero, held[:, 1], bend], axis=1)
    return Drive(
        name,
        Robot(f"MRCLAM robot {robot}", kinematics, NOISE),
        WheelIncrements("wheels", stamps + DELAY_NS, angles, kinematics.driven_names),
        (_sightings(directory, robot, rejected),),
        truth=_truth(directory / f"Robot{robot}_Groundtruth.dat", rejected),
        rejected=dict(rejected),
        notes=(
            "The odometry is what the robot was told to do; it is taken to do so 0.2 s later.",
            "Sightings of other robots are left out; ranges are taken for depths along the camera.",
        ),
    )


def _table(file: Path, width: int, rejected: Counter[str], what: str) -> tuple[Floats, Integers]:
    """Return the rows of a file with finite numbers only, and their line numbers."""
    body, numbers = all_numbered(read_lines(file), rejected)
    rows = [k for k, line in enumerate(body) if not line.lstrip().startswith("#")]
    found = parse_rows(
        [body[k] for k in rows],
        numbers[rows],
        file,
        widths=(width,),
        separator=None,
        rejected=rejected,
    )
    table = found.columns(width)
    good = finite_rows(table, rejected, what + NOT_A_NUMBER)
    return table[good], found.lines[good]


def _whole(values: Floats, lines: Integers, file: Path) -> Integers:
    """Return a column of whole numbers; FglocError naming the line of one that is none."""
    odd = np.flatnonzero((values != np.rint(values)) | (np.abs(values) > 1e9))
    if odd.size:
        raise FglocError(
            f"{values[odd[0]]:g} is not a number of a subject or barcode",
            file=file,
            line=int(lines[odd[0]]),
        )
    return values.astype(np.int64)


def _sightings(directory: Path, robot: str, rejected: Counter[str]) -> LandmarkSightings:
    """Return what the robot saw of the landmarks, with their surveyed positions."""
    file = directory / "Barcodes.dat"
    table, lines = _table(file, 2, Counter(), "")
    subjects, barcodes = _whole(table[:, 0], lines, file), _whole(table[:, 1], lines, file)
    if np.unique(barcodes).size != barcodes.size:
        raise FglocError("two subjects have the same barcode; download the file again", file=file)
    subject_of = dict(zip(barcodes.tolist(), subjects.tolist(), strict=True))

    file = directory / "Landmark_Groundtruth.dat"
    table, lines = _table(file, 5, Counter(), "")
    survey = Survey(
        _whole(table[:, 0], lines, file), table[:, 1:3], np.maximum(table[:, 3:5], SURVEY_FLOOR_M)
    )

    file = directory / f"Robot{robot}_Measurement.dat"
    table, lines = _table(file, 4, rejected, "sighting ")
    timely = countable_seconds(table[:, 0], rejected, "sighting ")
    table, lines = table[timely], lines[timely]
    seen = np.array([subject_of.get(b, -1) for b in _whole(table[:, 1], lines, file).tolist()])
    known = np.isin(seen, survey.landmark)
    others = (seen >= 1) & (seen <= ROBOTS)
    count(rejected, "sighting of another robot", int((others & ~known).sum()))
    count(rejected, "sighting of an unknown barcode", int((~others & ~known).sum()))
    near = known & ~(table[:, 2] > 0.0)
    count(rejected, "sighting without a distance", int(near.sum()))
    aside = known & ~near & ~(np.abs(table[:, 3]) < WIDEST_RAD)
    count(rejected, "sighting out of the camera's sight", int(aside.sum()))
    known &= ~near & ~aside
    stamps = seconds_to_ns(table[known, 0]) - LATE_NS
    steady = steady_stamps(stamps, rejected, "sighting ")
    return LandmarkSightings(
        "barcodes",
        stamps[steady],
        seen[known][steady].astype(np.int64),
        (table[known, 2] / (DEPTH_SCALE * np.cos(table[known, 3])))[steady],
        table[known, 3][steady],
        range_sigma=RANGE_SIGMA_M,
        bearing_sigma=BEARING_SIGMA_RAD,
        mount_sigma=MOUNT_SIGMA,
        survey=survey,
    )


def _truth(file: Path, rejected: Counter[str]) -> Reference | None:
    """Return the Vicon poses; None where the file is not there."""
    if not file.is_file():
        return None
    table, _ = _table(file, 4, rejected, "truth ")
    table = table[countable_seconds(table[:, 0], rejected, "truth ")]
    stamps = seconds_to_ns(table[:, 0])
    later = forward_stamps(stamps, rejected, "truth ")
    poses = np.column_stack([table[later, 1:3], np.unwrap(table[later, 3])])
    if not later.any():
        return None
    return Reference(Trajectory(stamps[later], poses), "vicon", (1e-3, 1e-3, 5e-3))
