"""Segments of a simulated drive beside the walls that its lidar saw."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgloc.core.consistency import each_squared_normalised
from fgloc.core.geometry import compose, interpolate, wrap
from fgloc.core.measurements import Floats, Scans
from fgloc.datasets.registry import load_drive
from fgloc.datasets.simulator.worlds import load_world
from fgloc.lidar.lines import extract
from fgloc.lidar.motion import scan_motion
from fgloc.lidar.scan import cloud
from fgloc.lidar.segments import Segments

SCANS = slice(0, 400)


def squared_errors(segments: Segments, lidar: Floats, walls: Floats) -> Floats:
    """Return (M,) NEES of each segment against the wall (W, 4) that suits it best.

    `lidar` (N, 3) are the true poses of the lidar at the scans, in the axes of the walls.
    """
    at = lidar[segments.scan]
    c, s = np.cos(at[:, 2]), np.sin(at[:, 2])
    x, y = segments.middle.T
    middle = np.stack([at[:, 0] + c * x - s * y, at[:, 1] + s * x + c * y], axis=1)
    normal = wrap(segments.normal + at[:, 2])
    best = np.full(segments.scan.size, np.inf)
    for x1, y1, x2, y2 in walls:
        length = np.hypot(x2 - x1, y2 - y1)
        tx, ty = (x2 - x1) / length, (y2 - y1) / length
        off = middle - np.array([x1, y1])
        across, along = ty * off[:, 0] - tx * off[:, 1], tx * off[:, 0] + ty * off[:, 1]
        # Both sides of a wall are seen; its normal is on the side of the lidar.
        for side, angle in ((1.0, np.arctan2(-tx, ty)), (-1.0, np.arctan2(tx, -ty))):
            error = np.stack([wrap(normal - angle), side * across], axis=1)
            squared = each_squared_normalised(error, segments.covariance)
            squared[(along < -0.2) | (along > length + 0.2)] = np.inf
            best = np.minimum(best, squared)
    return best


def test_a_drive_through_a_room() -> None:
    drive = load_drive("sim:seed-b-room")
    (scans,) = drive.each(Scans)
    scans = replace(scans, stamps_ns=scans.stamps_ns[SCANS], ranges=scans.ranges[SCANS])
    assert drive.truth is not None
    assert drive.true_calibration is not None
    truth = drive.truth.trajectory
    k = np.searchsorted(truth.stamps_ns, scans.stamps_ns, side="right") - 1
    k = np.clip(k, 0, len(truth) - 2)
    share = (scans.stamps_ns - truth.stamps_ns[k]) / (truth.stamps_ns[k + 1] - truth.stamps_ns[k])
    base = interpolate(truth.poses[k], truth.poses[k + 1], share)
    mount = [drive.true_calibration[f"lidar_{axis}"] for axis in ("x", "y", "yaw")]
    lidar = compose(base, np.broadcast_to(np.array(mount), base.shape))
    walls = load_world("seed-b-room").walls
    found = extract(cloud(scans, scan_motion(drive.wheels, drive.robot, scans)), scans)
    squared = squared_errors(found, lidar, walls)
    # Each segment is of some wall, and their errors are as stated: 2, or a little less, since the
    # default allows for walls that are not plane.
    assert found.scan.size > 4 * len(scans.ranges)
    assert (squared < 25.0).mean() > 0.99
    assert 1.2 < squared[squared < 25.0].mean() < 2.3
    # The same with the motion of the turns left in.
    bent = squared_errors(extract(cloud(scans), scans), lidar, walls)
    assert bent[np.isfinite(bent)].mean() > 5.0
