"""The lines of CARMEN logs and of the .gfs that gmapping writes, as arrays.

CARMEN (`.log`, `.clf`): `ODOM x y th tv rv accel ipc_stamp host logger_stamp` and
`FLASER n r1 … rn x y th odom_x odom_y odom_th ipc_stamp host logger_stamp`, the first pose being
the laser's, or the corrected one where somebody corrected the log. Stamps [s] are taken from
ipc_stamp, or from logger_stamp where those lack the digits.
gfs: `ODOM x y th stamp` and `LASER_READING n r1 … rn x y th stamp` with a pose of the odometry.
Lines of other kinds are not read.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fgloc.core.measurements import Floats, Stamps
from fgloc.datasets.text import (
    LATEST_S,
    NOT_A_NUMBER,
    Integers,
    Mask,
    Rows,
    countable_seconds,
    finite_rows,
    forward_stamps,
    numbered,
    parse_rows,
    read_lines,
    seconds_to_ns,
)
from fgloc.errors import FglocError

FIRST_WORDS = ("ODOM", "FLASER", "LASER_READING", "ODO_UPDATE", "PARAM", "SYNC", "# CARMEN")
"""What lines of such a log begin with."""
MOST_BEAMS = 100_000
"""No scan has more; a number that large is damage."""


@dataclass(frozen=True)
class Poses:
    """Lines that hold a pose of the odometry, in file order."""

    stamps: Stamps
    """(N,) stamps [ns]."""
    poses: Floats
    """(N, 3) x, y [m], heading [rad] as written."""
    lines: Integers
    """(N,) line numbers."""

    def select(self, which: Integers | Mask) -> Poses:
        """Return some of them, by index or mask."""
        return Poses(self.stamps[which], self.poses[which], self.lines[which])


@dataclass(frozen=True)
class Readings:
    """Lines that hold a scan, in file order."""

    at: Poses
    """Stamps, odometry poses and lines."""
    laser: Floats
    """(N, 3) first pose of the line: the laser's, or the corrected one; a gfs has no other."""
    ranges: Floats
    """(N, B) ranges [m] as written, where nothing returned and what is not a number included."""

    def select(self, which: Integers | Mask) -> Readings:
        """Return some of them, by index or mask."""
        return Readings(self.at.select(which), self.laser[which], self.ranges[which])


@dataclass(frozen=True)
class Log:
    """What is read of a log."""

    odometry: Poses
    """ODOM lines."""
    readings: Readings
    """FLASER or LASER_READING lines."""
    gfs: bool
    """True for gmapping's format."""


def looks_like(line: str) -> bool:
    """Return True for a line of such a log."""
    return line.startswith(tuple(f"{word} " for word in FIRST_WORDS))


def read_log(path: Path, rejected: Counter[str], *, timed: bool = True) -> Log:
    """Return the odometry and the scans of a log, usable lines only; the others are counted.

    Stamps of the odometry increase; those of scans are as they are written, and may repeat. With
    `timed` False stamps are neither looked at nor sound. Raises FglocError naming file and line for
    what cannot be understood, a log without scans, and stamps that have too few digits to tell when
    anything happened. O(characters).
    """
    body, numbers = numbered(read_lines(path), rejected)
    at: dict[str, list[int]] = {}
    for k, line in enumerate(body):
        at.setdefault(line.split(None, 1)[0], []).append(k)
    gfs = "LASER_READING" in at
    laser = "LASER_READING" if gfs else "FLASER"
    if laser not in at:
        raise FglocError("there are no FLASER and no LASER_READING lines to read", file=path)

    def table(kind: str, width: int) -> Rows:
        """Return the numbers of all lines of a kind, without the host's name."""
        which = at.get(kind, [])
        texts = [body[k].partition(" ")[2] for k in which]
        texts = texts if gfs else [_without_host(text) for text in texts]
        ends_file = bool(which) and which[-1] + 1 == len(body)
        return parse_rows(
            texts,
            numbers[which],
            path,
            widths=(width,),
            separator=None,
            rejected=rejected if ends_file else None,
        )

    beams = _beams(body[at[laser][0]], path, int(numbers[at[laser][0]]))
    scans = table(laser, beams + (5 if gfs else 9))
    moves = table("ODOM", 4 if gfs else 8)
    width = beams + (5 if gfs else 9)
    values = scans.columns(width)
    wrong = np.flatnonzero(values[:, 0] != beams)
    if wrong.size:
        raise FglocError(
            f"this scan states {values[wrong[0], 0]:g} readings, those before it {beams}",
            file=path,
            line=int(scans.lines[wrong[0]]),
        )
    odometry_columns = moves.columns(4 if gfs else 8)
    tail = values[:, 1 + beams :]
    if timed:
        stamp = _stamp_column(odometry_columns, tail, moves, scans, gfs, path)
        odometry = Poses(
            seconds_to_ns(_finite(odometry_columns[:, stamp])), odometry_columns[:, :3], moves.lines
        )
        at_scans = seconds_to_ns(_finite(tail[:, stamp]))
    else:
        stamp = -1
        odometry = Poses(np.zeros(moves.lines.size, np.int64), odometry_columns[:, :3], moves.lines)
        at_scans = np.zeros(scans.lines.size, np.int64)
    pose = tail[:, :3] if gfs else tail[:, 3:6]
    readings = Readings(Poses(at_scans, pose, scans.lines), tail[:, :3], values[:, 1 : 1 + beams])
    good = finite_rows(odometry_columns[:, [0, 1, 2, stamp]], rejected, f"odometry {NOT_A_NUMBER}")
    usable = finite_rows(
        tail[:, [*range(3 if gfs else 6), stamp]], rejected, f"scan {NOT_A_NUMBER}"
    )
    if timed:
        good[good] = countable_seconds(odometry_columns[good, stamp], rejected, "odometry ")
        usable[usable] = countable_seconds(tail[usable, stamp], rejected, "scan ")
    odometry, readings = odometry.select(good), readings.select(usable)
    if timed:
        odometry = odometry.select(forward_stamps(odometry.stamps, rejected, "odometry "))
    return Log(odometry, readings, gfs)


def _finite(seconds: Floats) -> Floats:
    """Return times with 0 for what is none; such lines are left out afterwards."""
    return np.where(np.abs(seconds) < LATEST_S, seconds, 0.0)


def _without_host(text: str) -> str:
    """Return the values of a CARMEN line without the name of the host, which comes last but one."""
    parts = text.rsplit(None, 2)
    return f"{parts[0]} {parts[2]}" if len(parts) == 3 else text


def _beams(line: str, path: Path, number: int) -> int:
    """Return the number of readings that a line states; FglocError naming it where it does not."""
    fields = line.split(None, 2)
    if len(fields) < 3 or not fields[1].isdecimal() or not 0 < int(fields[1]) < MOST_BEAMS:
        raise FglocError("a scan must begin with its number of readings", file=path, line=number)
    return int(fields[1])


def _stamp_column(
    odometry: Floats, scans: Floats, moves: Rows, lasers: Rows, gfs: bool, path: Path
) -> int:
    """Return which of the last columns has stamps that tell the time.

    Raises FglocError naming the first line where they repeat, if none has.
    """
    for column in (-1,) if gfs else (-2, -1):
        if not _repeats(odometry[:, column]) and not _repeats(scans[:, column]):
            return column
    rows, values = (moves, odometry) if _repeats(odometry[:, -1]) else (lasers, scans)
    k = int(np.flatnonzero(np.diff(values[:, -1 if gfs else -2]) == 0.0)[0]) + 1
    raise FglocError(
        f"the stamps have too few digits: {values[k, -1 if gfs else -2]:.10g} stands here and on "
        "the line of its kind before; take the log that this one was made from, or its .gfs",
        file=path,
        line=int(rows.lines[k]),
    )


def _repeats(seconds: Floats) -> bool:
    """Return True if most stamps are those of the line before."""
    steps = np.diff(seconds)
    return bool(steps.size) and float(np.mean(steps == 0.0)) > 0.5
