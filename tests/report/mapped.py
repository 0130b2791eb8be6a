"""A robot in a square room, for the tests of maps: everything about it is known by hand."""

from __future__ import annotations

import numpy as np

from fgloc.core import bases
from fgloc.core.drive import Drive, Reference
from fgloc.core.geometry import compose
from fgloc.core.measurements import (
    Floats,
    LandmarkSightings,
    Scans,
    Sensor,
    Stamps,
    Survey,
    WheelIncrements,
)
from fgloc.core.robot import Robot
from fgloc.core.trajectory import Trajectory
from fgloc.estimator import Result
from fgloc.lidar.segments import Segments
from fgloc.lidar.walls import Map, Marks, Walls

HALF = 3.0
"""The room reaches from -3 to 3 m in x and y."""
BEAMS = 360
PERIOD = 0.1 / BEAMS
"""Ten turns a second."""
MOUNT = (0.1, -0.05, 0.3)
"""Where the lidar sits."""


def poses_at(seconds: Floats) -> Floats:
    """Poses of a robot that drives at 0.4 m/s on a circle of 1 m, from (1, 0) on: a constant twist.

    Ends of the circle's parts are known in closed form: x = cos 0.4 t, y = sin 0.4 t.
    """
    angle = 0.4 * seconds
    return np.stack([np.cos(angle), np.sin(angle), angle + np.pi / 2], axis=-1)


def to_walls(lidar: Floats, directions: Floats) -> Floats:
    """Ranges from poses (..., 3) along directions in lidar axes to the room's walls.

    Along (c, s) from (x, y) the walls x = ±3 are reached after (±3 - x) / c, those in y alike.
    """
    c, s = np.cos(lidar[..., 2] + directions), np.sin(lidar[..., 2] + directions)
    x, y = lidar[..., 0], lidar[..., 1]
    with np.errstate(divide="ignore"):
        to_x = (np.where(c > 0, HALF, -HALF) - x) / c
        to_y = (np.where(s > 0, HALF, -HALF) - y) / s
    return np.minimum(to_x, to_y)


def room_scans(scans: int = 20, *, period: float = PERIOD) -> Scans:
    """Scans of the room as a lidar takes them that turns while the robot drives; no noise."""
    stamps = np.arange(scans, dtype=np.int64) * 200_000_000
    beams = np.arange(BEAMS)
    lidar = compose(poses_at(stamps[:, None] * 1e-9 + period * beams), np.array(MOUNT))
    directions = -np.pi + 2.0 * np.pi * beams / BEAMS
    ranges = to_walls(lidar, directions)
    return Scans("lidar", stamps, ranges, -np.pi, 2.0 * np.pi / BEAMS, period, MOUNT, max_range=8.0)


def trajectory(end_s: float = 4.0) -> Trajectory:
    """The robot's path, a pose every 50 ms, with covariance."""
    stamps: Stamps = np.arange(0, round(end_s * 1e9) + 1, 50_000_000, dtype=np.int64)
    covariances = np.tile(np.diag([1e-4, 4e-4, 1e-4]), (stamps.size, 1, 1))
    return Trajectory(stamps, poses_at(stamps * 1e-9), covariances)


def room_walls() -> Walls:
    """The room's walls x = 3, y = 3, x = -3, y = -3, seen from inside, anchored in their middle."""
    normal = np.array([np.pi, -np.pi / 2, 0.0, np.pi / 2])
    anchor = np.array([[HALF, 0.0], [0.0, HALF], [-HALF, 0.0], [0.0, -HALF]])
    covariance = np.tile(np.diag([0.01**2, 0.02**2]), (4, 1, 1))
    reach = np.tile([-HALF, HALF], (4, 1))
    return Walls(normal, np.zeros(4), anchor, reach, covariance, np.array([20, 19, 18, 17]))


def room_segments() -> Segments:
    """One piece of wall in the first scan, 1 m long, straight ahead of the lidar, 2 m away."""
    return Segments(
        np.array([0]),
        np.array([np.pi]),
        np.array([[2.0, 0.0]]),
        np.array([[-0.5, 0.5]]),
        np.tile(np.eye(2) * 1e-4, (1, 1, 1)),
        np.array([30]),
    )


def marks() -> Marks:
    """Two landmarks; what is uncertain of the second is not known."""
    covariance = np.stack([np.diag([0.04, 0.01]), np.full((2, 2), np.nan)])
    return Marks(
        np.array([6, 14]), np.array([[1.0, 2.0], [-1.5, 0.5]]), covariance, np.array([9, 1])
    )


def drive(*sensors: Sensor, truth: bool = True) -> Drive:
    """A drive of four seconds with the sensors given; its truth is the path itself.

    On the circle the wheels, 0.5 m apart, roll at 0.4 ∓ 0.4 · 0.25 m/s: 3 and 5 rad/s.
    """
    path = trajectory()
    base = bases.differential(0.1, 0.1, 0.5)
    turned = np.tile([0.15, 0.25], (len(path) - 1, 1))
    wheels = WheelIncrements("wheels", path.stamps_ns, turned, ("left", "right"))
    reference = Reference(Trajectory(path.stamps_ns, path.poses)) if truth else None
    return Drive("a/room:1", Robot("robot", base), wheels, sensors, reference)


def sightings(*, surveyed: bool = True) -> LandmarkSightings:
    """A sighting of landmark 6, surveyed 10 cm from where `marks` has it."""
    survey = Survey(np.array([6]), np.array([[1.1, 2.0]]), np.full((1, 2), 0.01))
    return LandmarkSightings(
        "camera",
        np.array([0], dtype=np.int64),
        np.array([6]),
        np.array([2.0]),
        np.array([0.0]),
        survey=survey if surveyed else None,
    )


def result(found: Map | None = None, method: str = "batch") -> Result:
    """What a method found that made no mistake."""
    return Result(method, "a/room:1", trajectory(), ("wheels", "lidar"), map=found)


def room_map() -> Map:
    """Walls, marks, and one segment that was seen of the second wall (y = 3)."""
    return Map(room_walls(), room_segments(), np.array([1]), marks())
