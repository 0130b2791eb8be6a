"""What a lidar sees along a drive, before any graph: straight walls, and how scans lie together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.geometry import compose
from fgloc.core.measurements import Floats, Scans, Stamps
from fgloc.core.preintegration import preintegrate, split_at
from fgloc.lidar.chain import Chain, match_chain
from fgloc.lidar.closures import Closures, find_closures
from fgloc.lidar.lines import extract
from fgloc.lidar.motion import scan_motion
from fgloc.lidar.scan import cloud
from fgloc.lidar.segments import Segments
from fgloc.lidar.surfaces import surfaces
from fgloc.smoothing.initial import dead_reckon

STEP_M, STEP_RAD, STEP_S = 0.15, 0.1, 1.0
"""A scan is used when the robot moved or turned so far since the last one, or so much later."""


@dataclass(frozen=True)
class Front:
    """What the scans of one lidar tell of themselves."""

    scans: Scans
    """The scans that are used."""
    numbers: Stamps
    """(N,) which of the drive's scans they are."""
    left_out: int
    """How many were not: too near to the one before, a repetition of it, or outside the drive."""
    segments: Segments
    """Straight walls in them."""
    chain: Chain
    """Displacements from scan to scan."""
    closures: Closures
    """Places that the robot came back to."""


def look_around(drive: Drive) -> Front | None:
    """Return what the drive's first lidar sees; None without one, or with fewer than two scans.

    About 10 ms a used scan, most of it for matching.
    """
    lidars = drive.each(Scans)
    if not lidars:
        return None
    every = lidars[0]
    first, last = drive.wheels.stamps_ns[[0, -1]]
    # Noise makes every scan another one: a lidar that hangs sends its last one again, and would
    # have it that the robot stands.
    fresh = np.append(True, np.any(every.ranges[1:] != every.ranges[:-1], axis=1))
    inside = np.flatnonzero(fresh & (every.stamps_ns >= first) & (every.stamps_ns <= last))
    if inside.size < 2:
        return None
    scans = _some(every, inside)
    pre = preintegrate(split_at(drive.wheels, scans.stamps_ns), drive.robot)
    steps = pre.displacement
    used = _spread(scans.stamps_ns, np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2]))
    path = dead_reckon(steps, np.full(steps.shape[0], np.nan))[used]
    scans = _some(scans, used)
    points = cloud(scans, scan_motion(drive.wheels, drive.robot, scans))
    segments = extract(points, scans)
    surface = surfaces(points.points, points.valid, scans)
    matched = match_chain(surface, compose(path, np.array(scans.mount)))
    closures = find_closures(surface, matched.relative, matched.covariance)
    left_out = every.stamps_ns.size - used.size
    return Front(scans, inside[used], left_out, segments, matched, closures)


def _spread(stamps: Stamps, moved: Floats, turned: Floats) -> Stamps:
    """Return the indices of scans that are far enough from the one used before."""
    keep, way, turn = [0], 0.0, 0.0
    since = int(stamps[0])
    rows = zip(moved.tolist(), turned.tolist(), stamps[1:].tolist(), strict=True)
    for k, (step, angle, stamp) in enumerate(rows, 1):
        way, turn = way + step, turn + angle
        if way >= STEP_M or turn >= STEP_RAD or stamp - since >= STEP_S * 1e9:
            keep.append(k)
            way, turn, since = 0.0, 0.0, stamp
    return np.array(keep, dtype=np.int64)


def _some(scans: Scans, which: Stamps) -> Scans:
    """Return some of the scans."""
    return replace(scans, stamps_ns=scans.stamps_ns[which], ranges=scans.ranges[which])
