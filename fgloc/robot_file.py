"""A robot file applied to a drive: the robot itself, and where its sensors sit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from fgloc.config import RobotFile, SensorTable, apply_robot, load_robot
from fgloc.core.drive import Drive, Reference
from fgloc.core.measurements import (
    CameraPoses,
    LandmarkSightings,
    PoseFixes,
    PositionFixes,
    Scans,
    Sensor,
    Stamps,
)
from fgloc.core.trajectory import Trajectory

MOUNTED = (CameraPoses, PositionFixes, PoseFixes, Scans, LandmarkSightings)
"""Streams of sensors that sit somewhere on the robot."""


def apply_robot_file(drive: Drive, path: str | Path) -> Drive:
    """Return the drive with what the robot file at `path` says of its robot and its sensors.

    A sensor or reference that the drive does not have is left aside with a note: a file that was
    calibrated against motion capture serves a drive without it. Raises FglocError as `load_robot`
    and `apply_robot` do.
    """
    file = load_robot(path)
    drive = replace(drive, robot=apply_robot(drive.robot, file))
    sensors: list[Sensor] = [_placed(s, file) for s in drive.sensors]
    truth, absent = drive.truth, []
    for name, table in file.sensors.items():
        if truth is not None and truth.sensor == name:
            truth = _reference(truth, table)
        elif not any(name in _names(s) for s in sensors):
            absent.append(name)
    notes = drive.notes
    if absent:
        notes = (*notes, f"The robot file also describes {', '.join(absent)}, not in this drive.")
    return replace(drive, sensors=tuple(sensors), truth=truth, notes=notes)


def _names(sensor: Sensor) -> tuple[str, ...]:
    """Return the names under which a file may describe a stream: its own, and its mounting's."""
    mount = getattr(sensor, "mount_name", "")
    return (sensor.sensor, mount) if mount else (sensor.sensor,)


def _placed(sensor: Sensor, file: RobotFile) -> Sensor:
    """Return a stream with the mounting and clock that a file gives it."""
    table = next((file.sensors[n] for n in _names(sensor) if n in file.sensors), None)
    if table is None:
        return sensor
    stamps = _later(sensor.stamps_ns, table)
    changes: dict[str, Any] = {"stamps_ns": stamps}
    if isinstance(sensor, MOUNTED):
        changes |= _mount(table, sensor.mount, sensor.mount_sigma)
    return replace(sensor, **changes)


def _reference(truth: Reference, table: SensorTable) -> Reference:
    """Return a recorded truth with the mounting and clock that a file gives it."""
    known = truth.trajectory
    moved = Trajectory(_later(known.stamps_ns, table), known.poses, known.covariances)
    taken = None if truth.taken_ns is None else _later(truth.taken_ns, table)
    mount = _mount(table, truth.mount, truth.mount_sigma)
    return replace(truth, trajectory=moved, taken_ns=taken, **mount)


def _later(stamps: Stamps, table: SensorTable) -> Stamps:
    """Return stamps that were early, put right."""
    return stamps + round((table.time_offset or 0.0) * 1e9)


def _mount(
    table: SensorTable, mount: tuple[float, ...], sigma: tuple[float, ...]
) -> dict[str, Any]:
    """Return the fields of a mounting, those of a file in place of the recording's."""
    places = (table.x, table.y, table.yaw)[: len(mount)]
    spreads = (table.x_sigma, table.y_sigma, table.yaw_sigma)[: len(mount)]
    return {
        "mount": tuple(v if n is None else n for n, v in zip(places, mount, strict=True)),
        "mount_sigma": tuple(v if n is None else n for n, v in zip(spreads, sigma, strict=True)),
    }
