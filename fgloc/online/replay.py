"""A recorded drive as the packets that a robot would have sent, in order of arrival."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.measurements import (
    CameraPoses,
    Floats,
    LandmarkSightings,
    PoseFixes,
    PositionFixes,
    Scans,
    Sensor,
    Yaw,
    YawRate,
)
from fgloc.online.scans import turn_ns

CHUNK = 8192
"""Packets that are turned into Python numbers at a time."""


@dataclass(frozen=True)
class Packet:
    """One measurement as it arrives."""

    stamp_ns: int
    """When it was measured."""
    sensor: str
    """Name of the stream; "" for the wheels."""
    values: Floats
    """Wheel angles (D,), or the reading."""
    extra: Floats | None = None
    """Steering angles (D,) of the wheels, sigmas of a fix."""


def _columns(sensor: Sensor) -> tuple[Floats, Floats | None] | None:
    """Return the readings (N, d) of a stream and their sigmas; None for kinds not used online."""
    if isinstance(sensor, Yaw):
        return sensor.yaw[:, None], None
    if isinstance(sensor, YawRate):
        return sensor.rate[:, None], None
    if isinstance(sensor, CameraPoses):
        return sensor.poses, None
    if isinstance(sensor, PositionFixes):
        return sensor.positions, sensor.sigma
    if isinstance(sensor, PoseFixes):
        return sensor.poses, sensor.sigma
    if isinstance(sensor, LandmarkSightings):
        return np.column_stack([sensor.landmark, sensor.range_m, sensor.bearing]), None
    if isinstance(sensor, Scans):
        return sensor.ranges, None
    return None


def packets(drive: Drive, skip: int = 0) -> Iterator[Packet]:
    """Yield a drive's measurements in order of arrival, the wheels' last among equal ones.

    That is by stamp, but for scans: they arrive when they are complete.

    What lies before the first wheel stamp is left out: the drive has not begun. So are the first
    `skip` packets, which an engine that was restored has had.
    """
    wheels = drive.wheels
    streams: list[tuple[str, Floats, Floats | None]] = []
    stamps, source, index = [wheels.stamps_ns[1:]], [np.zeros(wheels.angles.shape[0], np.int64)], []
    index.append(np.arange(wheels.angles.shape[0]))
    delays = [np.zeros(wheels.angles.shape[0], np.int64)]
    for sensor in drive.sensors:
        columns = _columns(sensor)
        if columns is None:
            continue
        streams.append((sensor.sensor, *columns))
        keep = np.flatnonzero(sensor.stamps_ns >= wheels.stamps_ns[0])
        stamps.append(sensor.stamps_ns[keep])
        delays.append(np.full(keep.size, turn_ns(sensor) if isinstance(sensor, Scans) else 0))
        source.append(np.full(keep.size, len(streams)))
        index.append(keep)
    when, who, where = np.concatenate(stamps), np.concatenate(source), np.concatenate(index)
    order = np.lexsort((np.where(who == 0, len(streams) + 1, who), when + np.concatenate(delays)))
    order = order[skip:]
    # Python numbers for some thousand packets at a time: for a whole day they would fill memory.
    for part in range(0, order.size, CHUNK):
        some = order[part : part + CHUNK]
        for stamp, stream, k in zip(
            when[some].tolist(), who[some].tolist(), where[some].tolist(), strict=True
        ):
            if stream == 0:
                steering = None if wheels.steering is None else wheels.steering[k]
                yield Packet(stamp, "", wheels.angles[k], steering)
            else:
                name, values, sigma = streams[stream - 1]
                yield Packet(stamp, name, values[k], None if sigma is None else sigma[k])
