"""Scans in map axes: every beam where the robot was when it was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fgloc.core.drive import Drive
from fgloc.core.evaluation import interpolate_trajectory, map_mount
from fgloc.core.geometry import between, compose, exp, log
from fgloc.core.measurements import Floats, Scans, Stamps
from fgloc.core.trajectory import Trajectory
from fgloc.estimator import Result, calibrated_mount
from fgloc.lidar.scan import cloud

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class PlacedScans:
    """The scans of one lidar in map axes, those that the trajectory says where to put."""

    sensor: str
    """Name of the lidar's stream."""
    scan: Stamps
    """(S,) index of each scan in its stream."""
    stamps_ns: Stamps
    """(S,) stamp of its first beam."""
    poses: Floats
    """(S, 3) lidar's pose in the map at that stamp [m, m, rad]."""
    origins: Floats
    """(S, B, 2) where the lidar was at each beam [m]."""
    points: Floats
    """(S, B, 2) where each beam ended [m]; arbitrary where not `valid`."""
    valid: Mask
    """(S, B) whether the beam returned from within the lidar's limits."""
    left_out: int
    """How many scans lie outside the trajectory or in a gap of it."""

    @property
    def returned(self) -> Floats:
        """Return (K, 2) the points of all beams that returned, in their order in time [m]."""
        return np.asarray(self.points[self.valid])


def place_scans(scans: Scans, trajectory: Trajectory, mount: tuple[float, ...]) -> PlacedScans:
    """Return scans in map axes, the robot's motion during each of them undone.

    `trajectory` holds poses of base_link in the map, `mount` is the lidar's pose on it. A scan
    lies where the trajectory, interpolated along arcs, was at its first beam; its other beams
    follow along the arc from there to the pose one scan later. Scans that do not lie wholly
    inside the trajectory, or lie in a gap of more than 0.5 s, are left out and counted.
    O(N·B + N log T).
    """
    x, y, yaw = mount
    path = map_mount(trajectory, (x, y, yaw))
    beams = scans.ranges.shape[1]
    begin = scans.stamps_ns
    end = begin + round(beams * scans.beam_period * 1e9)
    poses, known = interpolate_trajectory(path, begin)
    later, known_later = interpolate_trajectory(path, end)
    chosen = np.flatnonzero(known & known_later)
    poses, later = poses[chosen], later[chosen]
    motion = log(between(poses, later))
    own = replace(scans, stamps_ns=begin[chosen], ranges=scans.ranges[chosen])
    seen = cloud(own, motion)
    c, s = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
    along, across = seen.points[..., 0], seen.points[..., 1]
    points = np.stack([c * along - s * across, s * along + c * across], axis=-1)
    points += poses[:, None, :2]
    share = np.arange(beams) / max(beams, 1)
    origins = compose(poses[:, None], exp(motion[:, None] * share[:, None]))[..., :2]
    return PlacedScans(
        scans.sensor,
        chosen.astype(np.int64),
        begin[chosen],
        poses,
        np.ascontiguousarray(origins),
        points,
        seen.valid,
        int(begin.size - chosen.size),
    )


def placed_scans(result: Result, drive: Drive) -> tuple[PlacedScans, ...]:
    """Return the scans of each of the drive's lidars in map axes, mounted as calibrated."""
    return tuple(
        place_scans(scans, result.trajectory, calibrated_mount(result.calibration, scans))
        for scans in drive.each(Scans)
    )


def all_points(placed: Sequence[PlacedScans]) -> Floats:
    """Return (K, 2) the points of all beams that returned, lidar by lidar [m]."""
    return np.concatenate([np.zeros((0, 2)), *(p.returned for p in placed)])
