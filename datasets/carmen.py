"""Drives in CARMEN logs and gfs files: an odometry of the body and a planar laser.

There are gfs files where a reading's stamp is that of the ODOM line before it while its pose is
that of the line after it. All that is known then is that the scan lies between those two: it is
taken to lie midway, and the wheels' noise covers what that may be wrong. Where stamp and pose
belong together, the scans' poses are odometry like any other.
"""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path

import numpy as np

from fgloc.core.bases import body_odometry
from fgloc.core.drive import Drive, Reference
from fgloc.core.geometry import between, log, wrap
from fgloc.core.measurements import Floats, Scans, WheelIncrements
from fgloc.core.robot import Robot, WheelNoise, typical_noise
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.carmen_lines import Log, Poses, Readings, read_log
from fgloc.datasets.text import Integers, Mask, count, forward_stamps
from fgloc.errors import FglocError

FIRST_BEAM_RAD = -0.5 * math.pi
"""Where the lasers in such logs (SICK LMS) begin; they see half a turn [rad]."""
MAX_RANGE_M = 80.0
"""Such a laser answers 81.91 m where nothing returned [m]."""
RANGE_SIGMA_M = 0.015
"""Noise of a SICK LMS range [m]: 5 mm stated, and readings are whole centimetres or worse."""
BEARING_SIGMA_RAD = 0.002
"""Noise of a beam's direction [rad]; a beam is some 10 mrad wide."""
SAME = 1.5e-3
"""Poses that differ by less are the same one, printed with three digits [m, rad]."""
RIGID_M = 0.01
"""A laser whose place on the robot varies by more is written down at its corrected pose [m]."""
TRUTH_SIGMA = (0.05, 0.05, 0.01)
"""Noise of a corrected pose, those of a grid of 5 cm [m, m, rad]."""
UNTIMED = WheelNoise(rolling=0.07, lateral=0.04, turning=0.1, veering=0.04)
"""Odometry between scans whose stamps are known to a tenth of a second: at 1 m/s and 1 rad/s most
of it is that. From the residuals of 405 steps of csail against its published poses."""


def load(path: Path, name: str) -> Drive:
    """Return the drive in a CARMEN log or a gfs. O(characters).

    A gfs has a truth where `<its stem>.log` beside it holds corrected poses of the same scans, a
    CARMEN log where its lasers' poses are no fixed place on the robot. Raises FglocError naming
    file and line for what cannot be understood, and for a log whose stamps have too few digits to
    tell when anything happened.
    """
    rejected: Counter[str] = Counter()
    notes: list[str] = []
    found = read_log(path, rejected)
    mount, truth = (0.0, 0.0, 0.0), None
    if found.gfs:
        truth = _companion(path.with_suffix(".log"), found.readings, path)
    else:
        mount, truth = _mount(found.readings)
    readings, echoed, kept = _timed(found, rejected, notes)
    odometry = _merged(found.odometry, readings.at.select(~echoed))
    if odometry.stamps.size < 2:
        raise FglocError("fewer than two usable poses of the odometry", file=path)
    base = body_odometry()
    noise = UNTIMED if echoed.any() else typical_noise(base.kind)
    steps = between(odometry.poses[:-1], odometry.poses[1:])
    steps[:, 2] = wrap(steps[:, 2])
    return Drive(
        name,
        Robot("robot with odometry", base, noise),
        WheelIncrements("wheels", odometry.stamps, log(steps), base.driven_names),
        (_scans(readings, mount),),
        truth=None if truth is None else _reference(readings, truth[kept]),
        rejected=dict(rejected),
        notes=tuple(notes),
    )


def _companion(path: Path, readings: Readings, gfs: Path) -> Floats | None:
    """Return the corrected poses (N, 3) of a gfs's scans, from the log beside it; None without one.

    Raises FglocError for a log of other scans.
    """
    if not path.is_file() or path == gfs:
        return None
    # Its stamps are printed with six digits and tell nothing: scans are paired by their order.
    known = read_log(path, Counter(), timed=False).readings
    by_line = dict(zip(_keys(known), known.laser, strict=True))
    found = [by_line.get(key) for key in _keys(readings)]
    missing = next((k for k, pose in enumerate(found) if pose is None), None)
    if missing is not None:
        raise FglocError(
            f"the scan on line {readings.at.lines[missing]} of {gfs.name} is not here; is this log "
            "of another drive, or cut off? move it elsewhere to do without its corrected poses",
            file=path,
        )
    return np.array(found, dtype=np.float64)


def _keys(readings: Readings) -> list[tuple[bytes, int]]:
    """Return what tells scans apart: their readings, and how often those occurred before."""
    seen: Counter[bytes] = Counter()
    keys = []
    for row in readings.ranges:
        content = row.tobytes()
        keys.append((content, seen[content]))
        seen[content] += 1
    return keys


def _mount(readings: Readings) -> tuple[tuple[float, float, float], Floats | None]:
    """Return where a CARMEN log's laser is on the robot, and its corrected poses if they are that.

    The first pose of a line is the laser's: at a fixed place beside the odometry's, unless somebody
    corrected it.
    """
    place = between(readings.at.poses, readings.laser)
    middle = np.median(place, axis=0)
    if float(np.abs(place[:, :2] - middle[:2]).max(initial=0.0)) > RIGID_M:
        return (0.0, 0.0, 0.0), readings.laser
    return (float(middle[0]), float(middle[1]), float(middle[2])), None


def _timed(found: Log, rejected: Counter[str], notes: list[str]) -> tuple[Readings, Mask, Integers]:
    """Return scans with stamps that are theirs, which of them are estimated, and their indices.

    A scan that repeats the stamp of the odometry line before it, but not its pose, lies between
    that line and the next: midway, or at even distances if there are several.
    """
    readings, odometry = found.readings, found.odometry
    before = np.searchsorted(odometry.lines, readings.at.lines) - 1
    if not odometry.lines.size:
        return readings, np.zeros(before.size, np.bool_), np.arange(before.size)
    last = odometry.lines.size - 1
    at = np.clip(before, 0, last)
    apart = readings.at.poses - odometry.poses[at]
    apart[:, 2] = wrap(apart[:, 2])
    echoed = (before >= 0) & (readings.at.stamps == odometry.stamps[at])
    echoed &= np.abs(apart).max(axis=1) > SAME
    lost = echoed & (before == last)
    count(rejected, "scan after the last odometry line", int(lost.sum()))
    kept = np.flatnonzero(~lost)
    readings, echoed, at = readings.select(kept), echoed[kept], at[kept]
    which = at[echoed]
    _, first, several = np.unique(which, return_index=True, return_counts=True)
    place = np.arange(which.size) - np.repeat(first, several) + 1
    gap = odometry.stamps[which + 1] - odometry.stamps[which]
    stamps = readings.at.stamps.copy()
    stamps[echoed] += gap * place // (np.repeat(several, several) + 1)
    if which.size:
        notes.append(
            "Scans have the stamp of the odometry line before them and the pose of the line after; "
            f"they are taken to lie midway, which may be wrong by {0.5e-9 * gap.max():.2f} s."
        )
    timed = Readings(
        Poses(stamps, readings.at.poses, readings.at.lines), readings.laser, readings.ranges
    )
    later = forward_stamps(stamps, rejected, "scan ")
    return timed.select(later), echoed[later], kept[later]


def _merged(odometry: Poses, more: Poses) -> Poses:
    """Return all poses of the odometry in order of time; of equal stamps the odometry's own."""
    stamps = np.concatenate([odometry.stamps, more.stamps])
    order = np.argsort(stamps, kind="stable")
    order = order[np.diff(stamps[order], prepend=stamps[order[:1]] - 1) > 0]
    poses = np.concatenate([odometry.poses, more.poses])
    lines = np.concatenate([odometry.lines, more.lines])
    return Poses(stamps[order], poses[order], lines[order])


def _scans(readings: Readings, mount: tuple[float, float, float]) -> Scans:
    """Return the laser's stream; what is no number or too far is no return."""
    seen = np.isfinite(readings.ranges) & (readings.ranges > 0.0)
    seen &= readings.ranges < MAX_RANGE_M
    beams = readings.ranges.shape[1]
    # 181 and 361 readings include both ends of the half turn, 180 and 360 do not.
    return Scans(
        "lidar",
        readings.at.stamps,
        np.where(seen, readings.ranges, 0.0),
        FIRST_BEAM_RAD,
        math.pi / max(beams - beams % 2, 1),
        mount=mount,
        range_sigma=RANGE_SIGMA_M,
        bearing_sigma=BEARING_SIGMA_RAD,
        max_range=MAX_RANGE_M,
    )


def _reference(readings: Readings, poses: Floats) -> Reference:
    """Return the corrected poses of the scans as a truth."""
    poses = np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])])
    return Reference(Trajectory(readings.at.stamps, poses), "corrected", TRUTH_SIGMA)
