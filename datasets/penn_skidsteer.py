"""A four-wheel skid-steer robot indoors: `Encoders<NN>.mat` and `imu<NN>.mat` of a course.

Source: https://github.com/zweedao/Robot-Mapping (data of Penn's ESE 650, the robot's description
in its docs folder). MATLAB 5 files. `Encoders` is a struct: `counts` (4, N), what the wheels FR,
FL, RR, RL counted since the request before, forward positive, 360 a turn, wheels of 0.254 m;
`ts` (1, N) seconds since 1970, about 40 Hz. The IMU file has `ts` (1, M) and `vals` (6, M):
accelerations [g] along x, y, z, then rates [rad/s] about them, x forward, z up, about 100 Hz.

The gyro is late: in the three runs that were looked at, wheels and gyro turn together best when
0.17, 0.16 and 0.18 s are taken from the IMU's stamps. Its readings are smooth, so they are
filtered, and every filter delays. The delay is part of this reader.
"""

from __future__ import annotations

import io
import math
import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fgloc.core.bases import skid_steer
from fgloc.core.drive import Drive
from fgloc.core.measurements import Acceleration, Floats, Sensor, Stamps, WheelIncrements, YawRate
from fgloc.core.robot import Robot
from fgloc.datasets.intervals import usable_increments
from fgloc.datasets.text import (
    count,
    countable_seconds,
    finite_rows,
    forward_stamps,
    read_bytes,
    seconds_to_ns,
)
from fgloc.errors import FglocError

NAME = "penn-skidsteer"
COUNTS = 360
"""Counts a turn."""
RADIUS = 0.127
"""Nominal wheel radius [m]."""
TRACK = 0.3937
"""Middle of the left to middle of the right tyres [m], between the inner and outer distances of
the robot's drawing, 0.31115 and 0.47625 m; the effective track is larger."""
TRACK_PRIOR = 0.7
"""Relative prior sigma of the effective track: from half to over three times the geometric one."""
WHEELS = ("fr", "fl", "rr", "rl")
"""Order of the rows of counts."""
FASTEST_M_S = 5.0
"""No wheel of this robot turns faster at its rim [m/s]."""
SHORTEST_S = 0.025
"""Time between requests [s]; a late one holds the counts of a longer time than its stamps say."""
DELAY_S = 0.17
"""How late the IMU's readings are stamped [s]."""
G = 9.80665
"""Unit of the accelerations [m/s²]."""
DENSITY = 1e-3
"""Noise density of the gyro on a driving robot [rad/s/sqrt(Hz)]."""
BIAS_SIGMA = 0.005
"""Prior of the gyro's bias [rad/s]."""
BIAS_WALK = 1e-4
"""Its walk [rad/s/sqrt(s)]."""

Array = npt.NDArray[Any]


def runs(folder: Path) -> list[str]:
    """Return the runs of which both files are there, in numerical order."""
    found = (re.fullmatch(r"Encoders(\d+)\.mat", f.name) for f in folder.glob("Encoders*.mat"))
    numbers = sorted((m.group(1) for m in found if m), key=int)
    return [n for n in numbers if (folder / f"imu{n}.mat").is_file()]


def load(folder: Path, run: str, name: str) -> Drive:
    """Return one run. Raises FglocError naming the file and the variable that is wrong."""
    rejected: Counter[str] = Counter()
    file = folder / f"Encoders{run}.mat"
    stamps, counts = _encoders(file, rejected)
    # What is left out has been counted.
    boundaries, increments, _ = usable_increments(
        stamps, counts * (2.0 * math.pi / COUNTS), Counter()
    )
    if boundaries.size < 2:
        raise FglocError("fewer than two usable samples; download the file again", file=file)
    wheels = WheelIncrements(
        "wheels", boundaries, increments, WHEELS, resolution=2.0 * math.pi / COUNTS
    )
    imu_stamps, rate, forward = _imu(folder / f"imu{run}.mat", rejected)
    sensors: tuple[Sensor, ...] = (
        YawRate("gyro", imu_stamps, rate, DENSITY, BIAS_SIGMA, BIAS_WALK),
        Acceleration("acc", imu_stamps, forward),
    )
    base = skid_steer(
        ("fl", "rl"), ("fr", "rr"), RADIUS, TRACK, track_prior=TRACK_PRIOR, order=WHEELS
    )
    return Drive(
        name,
        Robot.typical("Penn skid-steer", base),
        wheels,
        sensors,
        rejected=dict(rejected),
        notes=(f"The IMU's stamps are taken to be {DELAY_S} s late.",),
    )


def _encoders(file: Path, rejected: Counter[str]) -> tuple[Stamps, Floats]:
    """Return stamps (N,) and counts (N, 4); those no wheel can reach are counted, and NaN."""
    record = _variable(_mat(file), "Encoders", file)
    names = record.dtype.names or ()
    if record.size != 1 or not {"counts", "ts"} <= set(names):
        raise FglocError("Encoders: must be a struct with counts and ts", file=file)
    first = record.ravel()[0]
    seconds = _numbers(first["ts"], "Encoders.ts", file).ravel()
    counts = _numbers(first["counts"], "Encoders.counts", file)
    if counts.shape != (len(WHEELS), seconds.size):
        raise FglocError(
            f"Encoders.counts: must have shape ({len(WHEELS)}, {seconds.size}) as ts has "
            f"{seconds.size} samples, got {counts.shape}",
            file=file,
        )
    good = finite_rows(seconds[:, None], rejected, "stamp not a number")
    good[good] = countable_seconds(seconds[good], rejected)
    stamps, table = seconds_to_ns(seconds[good]), counts.T[good].copy()
    later = forward_stamps(stamps, rejected)
    stamps, table = stamps[later], table[later]
    finite_rows(table, rejected, "wheels not a number")
    interval = np.maximum(np.diff(stamps, prepend=stamps[:1]) * 1e-9, SHORTEST_S)
    most = FASTEST_M_S * interval * COUNTS / (2.0 * math.pi * RADIUS)
    # A counter that wrapped or was read while it changed; the wheels turned all the same.
    wild = (np.abs(table) > most[:, None]).any(axis=1)
    count(rejected, "implausible encoder count", int(wild.sum()))
    table[wild] = np.nan
    return stamps, table


def _imu(file: Path, rejected: Counter[str]) -> tuple[Stamps, Floats, Floats]:
    """Return stamps (M,), yaw rates [rad/s] and forward accelerations [m/s²]."""
    content = _mat(file)
    seconds = _numbers(_variable(content, "ts", file), "ts", file).ravel()
    values = _numbers(_variable(content, "vals", file), "vals", file)
    if values.shape != (6, seconds.size):
        raise FglocError(
            f"vals: must have shape (6, {seconds.size}) as ts has {seconds.size} samples, got "
            f"{values.shape}",
            file=file,
        )
    good = finite_rows(np.column_stack([seconds, values.T]), rejected, "imu not a number")
    good[good] = countable_seconds(seconds[good], rejected, "imu ")
    stamps, values = seconds_to_ns(seconds[good] - DELAY_S), values[:, good]
    later = forward_stamps(stamps, rejected, "imu ")
    if later.sum() < 2:
        raise FglocError("ts: fewer than two usable samples; download the file again", file=file)
    return stamps[later], values[5, later].copy(), G * values[0, later]


def _mat(file: Path) -> dict[str, Array]:
    """Return the variables of a MATLAB 5 file. Raises FglocError for what is none."""
    from scipy.io import loadmat

    data = read_bytes(file)
    try:
        return dict(loadmat(io.BytesIO(data)))
    # The parser of damaged bytes raises whatever it stumbles over.
    except Exception as error:
        raise FglocError(
            f"cannot be read as a MATLAB 5 file ({error}); download it again", file=file
        ) from None


def _variable(content: dict[str, Array], name: str, file: Path) -> Array:
    """Return a variable; raises FglocError if it is missing."""
    if name not in content:
        there = ", ".join(k for k in content if not k.startswith("__")) or "nothing"
        raise FglocError(
            f"the variable {name} is missing, there is {there}; this is not a {NAME} recording",
            file=file,
        )
    return np.asarray(content[name])


def _numbers(values: Any, name: str, file: Path) -> Floats:
    """Return numbers as floats; raises FglocError for anything else."""
    array = np.asarray(values)
    if array.dtype.kind not in "iuf":
        raise FglocError(f"{name}: must hold numbers; download the file again", file=file)
    return array.astype(np.float64)
