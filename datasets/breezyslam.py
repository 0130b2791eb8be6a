"""The MinesRover recordings of BreezySLAM: a differential robot with a Hokuyo URG-04LX laser.

Source: https://github.com/simondlevy/BreezySLAM, `examples/exp1.dat`, `exp2.dat`, recorded at the
École des Mines de Paris for CoreSLAM (Steux and El Hamzaoui, ICARCV 2010). A line, 10 Hz, holds a
stamp [us], a number that is not explained, the left and the right encoder count, 20 more numbers
that are not explained, and 683 ranges [mm] from right to left. `examples/mines.py` states wheel
radius 77 mm, 2 x 165 mm between the wheels, 2000 counts a turn, the laser 145 mm before the axle,
and that the robot hides the first and last 70 ranges; it leaves the last one out as the line's end.
"""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path

import numpy as np

from fgloc.core.bases import differential
from fgloc.core.drive import Drive
from fgloc.core.measurements import Scans, WheelIncrements
from fgloc.core.robot import Robot
from fgloc.datasets.text import (
    NOT_A_NUMBER,
    count,
    finite_rows,
    forward_stamps,
    numbered,
    parse_rows,
    read_lines,
)
from fgloc.errors import FglocError

NAME = "breezyslam"
FIRST_RANGE, BEAMS = 24, 683
"""Column of the first range, and how many there are."""
RADIUS_M, TRACK_M, COUNTS = 0.077, 0.33, 2000
"""Wheel radius and distance between the wheels [m]; encoder counts a turn."""
OFFSET_M = 0.145
"""The laser before the axle [m]."""
HIDDEN = 70
"""Ranges at either end that show the robot itself."""
STEPS = 1024
"""Steps of a turn of the URG-04LX, of which the 683 about its front are used."""
TURN_S = 0.1
"""Duration of its turn [s]."""
MIN_RANGE_M, MAX_RANGE_M = 0.06, 4.0
"""What it measures [m]; below 20 mm stand error numbers."""
RANGE_SIGMA_M, RANGE_SHARE = 0.01, 0.01
"""Stated accuracy: 10 mm up to 1 m, 1 % beyond."""


def runs(folder: Path) -> list[str]:
    """Return the runs that are there, `exp1`, `exp2`."""
    return sorted(p.stem for p in folder.glob("exp[0-9]*.dat"))


def load(folder: Path, run: str, name: str) -> Drive:
    """Return one run. Raises FglocError naming file and line for what cannot be understood.

    When in a turn a line was stamped is not stated: it is taken for the first beam's time.
    """
    file = folder / f"{run}.dat"
    rejected: Counter[str] = Counter()
    body, numbers = numbered(read_lines(file), rejected)
    width = FIRST_RANGE + BEAMS
    table = parse_rows(
        body, numbers, file, widths=(width,), separator=None, rejected=rejected
    ).columns(width)
    stamped = np.isfinite(table[:, 0]) & (np.abs(table[:, 0]) < 9e15)
    count(rejected, f"stamp {NOT_A_NUMBER}", int((~stamped).sum()))
    table = table[stamped]
    stamps = table[:, 0].astype(np.int64) * 1000
    later = forward_stamps(stamps, rejected)
    stamps, table = stamps[later], table[later]
    # Counts are of the whole drive: where one is missing, the next tells of both intervals.
    good = finite_rows(table[:, 2:4], rejected, f"wheels {NOT_A_NUMBER}")
    boundaries = stamps[good]
    angles = np.diff(table[good, 2:4], axis=0) * (2.0 * math.pi / COUNTS)
    if boundaries.size < 2:
        raise FglocError("fewer than two usable lines; download the file again", file=file)
    ranges = table[:, FIRST_RANGE:] * 1e-3
    ranges[:, :HIDDEN] = 0.0
    ranges[:, -HIDDEN:] = 0.0
    seen = np.isfinite(ranges) & (ranges >= MIN_RANGE_M) & (ranges < MAX_RANGE_M)
    step = 2.0 * math.pi / STEPS
    base = differential(RADIUS_M, RADIUS_M, TRACK_M)
    return Drive(
        name,
        Robot.typical("MinesRover", base),
        WheelIncrements(
            "wheels", boundaries, angles, ("left", "right"), resolution=2.0 * math.pi / COUNTS
        ),
        (
            Scans(
                "lidar",
                stamps,
                np.where(seen, ranges, 0.0),
                -0.5 * (BEAMS - 1) * step,
                step,
                TURN_S / STEPS,
                mount=(OFFSET_M, 0.0, 0.0),
                mount_sigma=(0.02, 0.02, 0.03),
                range_sigma=RANGE_SIGMA_M,
                range_sigma_share=RANGE_SHARE,
                bearing_sigma=0.25 * step,
                min_range=MIN_RANGE_M,
                max_range=MAX_RANGE_M,
            ),
        ),
        rejected=dict(rejected),
        notes=("There is no truth.",),
    )
