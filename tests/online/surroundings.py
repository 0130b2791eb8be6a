"""Drives with something to see: point marks scattered around, and rooms with a lidar."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.geometry import between
from fgloc.core.measurements import Floats, LandmarkSightings, Scans, Survey, WheelIncrements
from fgloc.datasets.simulator import load_sim

RANGE_SIGMA, BEARING_SIGMA = 0.1, 0.02
REACH_M = 4.0


def marks_drive(
    seed: int = 0, seconds: int = 40, marks: int = 20, surveyed: bool = False
) -> tuple[Drive, Floats]:
    """Return a drive that sees marks twice a second up to REACH_M away, and where they are."""
    drive = load_sim(f"random?robot=differential&rate=10&yaw=off&duration={seconds}&seed={seed}")
    assert drive.truth is not None
    truth, rng = drive.truth.trajectory, np.random.default_rng(seed + 100)
    low, high = truth.poses[:, :2].min(axis=0) - 2.0, truth.poses[:, :2].max(axis=0) + 2.0
    points = rng.uniform(low, high, (marks, 2))
    rows = []
    for stamp, pose in list(zip(truth.stamps_ns, truth.poses, strict=True))[::5]:
        seen = between(pose, np.column_stack([points, np.zeros(marks)]))
        away = np.hypot(seen[:, 0], seen[:, 1])
        for k in np.flatnonzero(away < REACH_M):
            noise = rng.normal(size=2) * (RANGE_SIGMA, BEARING_SIGMA)
            bearing = np.arctan2(seen[k, 1], seen[k, 0]) + noise[1]
            rows.append((stamp, k, max(away[k] + noise[0], 0.01), bearing))
    columns = list(zip(*rows, strict=True))
    survey = Survey(np.arange(marks), points, np.full((marks, 2), 0.01)) if surveyed else None
    sightings = LandmarkSightings(
        "marks",
        np.array(columns[0], dtype=np.int64),
        np.array(columns[1], dtype=np.int64),
        np.array(columns[2], dtype=np.float64),
        np.array(columns[3], dtype=np.float64),
        RANGE_SIGMA,
        BEARING_SIGMA,
        survey=survey,
    )
    return replace(drive, sensors=(*drive.sensors, sightings)), points


def room_drive(seconds: float, name: str = "seed-b-room", seed: int = 1) -> Drive:
    """Return the first seconds of a drive in a simulated room."""
    drive = load_sim(f"{name}?seed={seed}")
    end = int(drive.wheels.stamps_ns[0] + seconds * 1e9)
    wheels, keep = drive.wheels, int(np.searchsorted(drive.wheels.stamps_ns, end))
    cut = WheelIncrements(
        wheels.sensor,
        wheels.stamps_ns[: keep + 1],
        wheels.angles[:keep],
        wheels.wheels,
        None if wheels.steering is None else wheels.steering[:keep],
        wheels.resolution,
    )
    sensors = []
    for sensor in drive.sensors:
        if isinstance(sensor, Scans):
            n = int(np.searchsorted(sensor.stamps_ns, end))
            sensor = replace(sensor, stamps_ns=sensor.stamps_ns[:n], ranges=sensor.ranges[:n])
        sensors.append(sensor)
    return replace(drive, wheels=cut, sensors=tuple(sensors))


def with_ranges(drive: Drive, ranges: Floats) -> Drive:
    """Return a drive whose lidar measured something else."""
    others = tuple(s for s in drive.sensors if not isinstance(s, Scans))
    (lidar,) = drive.each(Scans)
    return replace(drive, sensors=(*others, replace(lidar, ranges=ranges)))
