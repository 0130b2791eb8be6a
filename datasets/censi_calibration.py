"""The Khepera III of Censi et al. 2013: wheel rates and the motion of a laser, matched scans.

Source: https://github.com/AndreaCensi/calibration. A run is `<run>.tuple`: JSON objects one after
another, `T` [s], the mean rates `phi_l` and `phi_r` of both wheels [rad/s] and `sm`, how the laser
moved in its own frame meanwhile by scan matching: x, y [m], turn [rad]. Several recordings follow
each other in a run, and intervals whose scans could not be matched were left out by the publisher:
there are no stamps, so the intervals are strung together as if nothing lay between them. That
loses nothing, since each interval is measured by itself.

The publisher's own answers stand in `<run>_results.json`. Run lmov is the paper's configuration C,
with the laser turned by -1.86 rad; lstraight is A, the laser straight ahead.
"""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from fgloc.core import geometry
from fgloc.core.bases import differential
from fgloc.core.drive import Drive
from fgloc.core.measurements import CameraPoses, Floats, WheelIncrements
from fgloc.core.robot import Robot
from fgloc.datasets.text import (
    TRUNCATED,
    count,
    finite_rows,
    read_lines,
    seconds_to_ns,
)
from fgloc.errors import FglocError

NAME = "censi-calibration"
SENSOR = "laser"
"""Name of the stream of the laser's poses."""
RADIUS = 0.0205
"""Nominal wheel radius [m], half of the diameter in the manual of the Khepera III."""
TRACK = 0.0884
"""Nominal distance between the wheels [m], from the same."""
RANGE_SIGMA = 0.0005
"""White noise of one match along x and y [m]."""
TURN_SIGMA = math.radians(0.1)
"""White noise of one match in heading [rad]."""
HEADING_WALK = 0.02
"""What the errors in heading add up to over the way [rad/sqrt(m)], 250 matches a metre: poses that
are strung together drift, and filters must know it. There is none of the position: estimators take
it by the measured way, and where that is 8 mm, give or take half a millimetre, those that happened
to be measured too short would weigh more, and radii come out 0.5 % too small."""
LONGEST_S = 60.0
"""No interval between two scans takes longer [s]."""


def runs(folder: Path) -> list[str]:
    """Return the runs that are there, sorted; the publisher's thirds of a run as well."""
    return sorted(f.stem for f in folder.glob("*.tuple") if re.fullmatch(r"\w+", f.stem))


def load(folder: Path, run: str, name: str) -> Drive:
    """Return one run. Raises FglocError naming file and line for what cannot be understood."""
    file = folder / f"{run}.tuple"
    rejected: Counter[str] = Counter()
    table = read_tuples(file, rejected)
    seconds, rates, moved = table[:, 0], table[:, 1:3], table[:, 3:]
    # Rounded one by one, so that a stamp is the sum of whole nanoseconds.
    stamps = np.concatenate([[0], np.cumsum(seconds_to_ns(seconds))]).astype(np.int64)
    wheels = WheelIncrements("wheels", stamps, rates * seconds[:, None], ("left", "right"))
    poses = geometry.chain(np.ascontiguousarray(moved), np.zeros(3))
    laser = CameraPoses(
        SENSOR,
        stamps,
        poses,
        position_walk=0.0,
        heading_walk=HEADING_WALK,
        position_sigma=RANGE_SIGMA,
        heading_sigma=TURN_SIGMA,
        mount_sigma=(0.05, 0.05, math.pi),
        scale_sigma=0.0,
    )
    return Drive(
        name,
        Robot.typical("Khepera III", differential(RADIUS, RADIUS, TRACK)),
        wheels,
        (laser,),
        rejected=dict(rejected),
        notes=(
            "Intervals are strung together: where the publisher left one out, time is missing.",
            "Where the laser sits is not known; matches are poses of the laser itself.",
        ),
    )


def read_tuples(file: Path, rejected: Counter[str]) -> Floats:
    """Return (N, 6) T [s], left and right rate [rad/s], the laser's x, y [m] and turn [rad].

    A last object that was cut off, values that are not finite and intervals without a length are
    counted and left out. Raises FglocError naming file and line for anything else.
    """
    lines = read_lines(file)
    rows: list[list[float]] = []
    decoder = json.JSONDecoder()
    last = len(lines.text) + 1 if lines.rest.strip() else len(lines.text)
    for number, text in enumerate((*lines.text, lines.rest), start=1):
        # The publisher joined recordings without an end of line between them.
        at = len(text) - len(text.lstrip())
        while at < len(text):
            try:
                item, at = decoder.raw_decode(text, at)
            except ValueError:
                if number == last and "}" not in text[at:]:
                    count(rejected, TRUNCATED)
                    break
                raise FglocError(
                    "this is not a JSON object; remove or repair the line", file=file, line=number
                ) from None
            rows.append(_row(item, file, number))
            at += len(text[at:]) - len(text[at:].lstrip())
    table = np.array(rows, dtype=np.float64).reshape(-1, 6)
    table = table[finite_rows(table, rejected)]
    usable = (table[:, 0] >= 1e-9) & (table[:, 0] <= LONGEST_S)
    count(rejected, "interval of no possible length", int((~usable).sum()))
    if not usable.any():
        raise FglocError("there is no usable interval in it; download the file again", file=file)
    return np.asarray(table[usable])


def _row(item: Any, file: Path, line: int) -> list[float]:
    """Return the six numbers of an object; raises FglocError for a missing or a wrong field."""
    if not isinstance(item, dict):
        raise FglocError("this is not a JSON object; remove the line", file=file, line=line)
    for key in ("T", "phi_l", "phi_r", "sm"):
        if key not in item:
            raise FglocError(
                f"the field {key!r} is missing; remove or repair the line", file=file, line=line
            )
    moved = item["sm"] if isinstance(item["sm"], list) and len(item["sm"]) == 3 else [None]
    values = [item["T"], item["phi_l"], item["phi_r"], *moved]
    # A truth value is a number to Python.
    if not all(type(v) in (int, float) for v in values):
        raise FglocError(
            "T, phi_l and phi_r must be numbers and sm three of them; remove or repair the line",
            file=file,
            line=line,
        )
    return [float(v) for v in values]
