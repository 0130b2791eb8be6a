"""A simulated RPLIDAR: a turning beam that measures while the robot moves.

Slamtec's A1 and A2 turn clockwise, some 400 beams a turn at 10 turns a second. The scan begins
behind the robot, so that the seam is not where it drives. Beams are stamped one after the other,
and each is cast from where the lidar is at its own time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fgloc.core import geometry
from fgloc.core.measurements import Floats, Scans
from fgloc.datasets.simulator.course import Course
from fgloc.datasets.simulator.models import LidarModel
from fgloc.datasets.simulator.people import RADIUS_M, Walker
from fgloc.datasets.simulator.rays import cast, cut_by_discs
from fgloc.datasets.simulator.sensors import cut_normal
from fgloc.datasets.simulator.streams import generator
from fgloc.datasets.simulator.worlds import World
from fgloc.errors import FglocError

SCANS_AT_ONCE = 500
"""So many scans are made in one go; it bounds the memory, and the drive does not depend on it."""


@dataclass(frozen=True)
class Device:
    """What a model of lidar can do."""

    min_range: float
    """Shortest range [m]."""
    max_range: float
    """Longest range [m]."""
    share: float
    """Noise of a range as a share of it."""


DEVICES = {"a1": Device(0.15, 8.0, 0.01), "a2": Device(0.2, 12.0, 0.0075)}
"""By the name in `lidar=…`; the share is 0.75-1 % in the data sheets."""


def device(name: str) -> Device:
    """Return a device by name; FglocError for an unknown one."""
    if name not in DEVICES:
        raise FglocError(f"lidar={name}: there is no such lidar; use {', '.join(DEVICES)} or off")
    return DEVICES[name]


def measure_scans(
    course: Course, world: World, model: LidarModel, people: int, seed: int
) -> tuple[Scans, dict[str, float]]:
    """Return the scans of a drive and the lidar's true place by parameter name.

    Only whole turns are recorded. Each range is off by the device's share of it and by
    `range_sigma`, each beam's direction by `angle_sigma`; a range outside the device's limits, and
    a share `dropout` of the others, is no return (0). O(beams · walls in reach).
    """
    kind = device(model.kind)
    rng = generator(seed, "lidar")
    spread = np.array([model.mount_sigma, model.mount_sigma, model.yaw_sigma])
    nominal = (model.x, model.y, model.yaw)
    mount = np.array(nominal) + spread * cut_normal(rng, 3)
    # A beam's period is a whole number of nanoseconds, so that stamps are exact.
    period = round(1e9 / (model.rate * model.beams))
    count = course.duration_ns // (period * model.beams)
    stamps = np.arange(count, dtype=np.int64) * (period * model.beams)
    increment = -2.0 * math.pi / model.beams
    share = model.share if model.share >= 0.0 else kind.share
    walker_rng = generator(seed, "people")
    walkers = [Walker(world, walker_rng) for _ in range(people)]
    ranges = np.zeros((count, model.beams))
    for first in range(0, count, SCANS_AT_ONCE):
        part = stamps[first : first + SCANS_AT_ONCE]
        at = (part[:, None] + np.arange(model.beams) * period).ravel()
        lidar = geometry.compose(course.poses_at(at), mount)
        nominal_angle = math.pi + increment * np.arange(model.beams)
        direction = lidar[:, 2] + np.tile(nominal_angle, part.size)
        direction += model.angle_sigma * rng.standard_normal(at.size)
        origin = np.ascontiguousarray(lidar[:, :2])
        found = cast(origin, direction, model.beams, world.walls, kind.max_range)
        for walker in walkers:
            cut_by_discs(origin, direction, walker.positions(at), RADIUS_M, found)
        found = _noisy(found, share, model, rng)
        seen = (found >= kind.min_range) & (found <= kind.max_range)
        seen &= rng.random(at.size) >= model.dropout
        ranges[first : first + part.size] = np.where(seen, found, 0.0).reshape(part.size, -1)
    scans = Scans(
        "lidar",
        stamps,
        ranges,
        math.pi,
        increment,
        period * 1e-9,
        nominal,
        (model.mount_sigma, model.mount_sigma, model.yaw_sigma),
        model.range_sigma,
        share,
        model.angle_sigma,
        kind.min_range,
        kind.max_range,
    )
    names = ("lidar_x", "lidar_y", "lidar_yaw")
    return scans, {n: float(v) for n, v in zip(names, mount, strict=True)}


def _noisy(ranges: Floats, share: float, model: LidarModel, rng: np.random.Generator) -> Floats:
    """Return ranges (M,) with noise; infinite ones stay so."""
    sigma = np.hypot(model.range_sigma, share * np.where(np.isfinite(ranges), ranges, 0.0))
    return np.asarray(ranges + sigma * rng.standard_normal(ranges.size))
