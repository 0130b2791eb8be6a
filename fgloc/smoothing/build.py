"""From a drive to its graph: one table a sensor, calibration blocks, drifting zeros."""

from __future__ import annotations

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.geometry import between
from fgloc.core.measurements import (
    CameraPoses,
    Floats,
    LandmarkSightings,
    PoseFixes,
    PositionFixes,
    Scans,
    Yaw,
    YawRate,
)
from fgloc.core.preintegration import preintegrate, rounding_sigma, split_at
from fgloc.core.start import trim_to_truth
from fgloc.factors.robust import PLAIN, Loss
from fgloc.factors.tables import FactorTable, Kind
from fgloc.smoothing.build_landmarks import add_sightings, scene_of
from fgloc.smoothing.builder import Builder
from fgloc.smoothing.front import Front
from fgloc.smoothing.initial import first_guess
from fgloc.smoothing.keyframes import (
    absolute_fixes,
    camera_at,
    choose_keyframes,
    once_each,
    turned_angle,
    yaw_at,
)
from fgloc.smoothing.problem import Problem, diagonal
from fgloc.smoothing.remarks import remarks
from fgloc.smoothing.sensors import (
    FREE_HEADING,
    bias_sigma,
    camera_parameters,
    camera_sigma,
    fix_sigma,
    gyro_parameters,
    gyro_sigma,
    yaw_parameters,
    yaw_sigma,
)
from fgloc.smoothing.settings import Settings


def _add_yaw(b: Builder, sensor: Yaw, start: float, loss: Loss) -> None:
    """Add one factor a keyframe with the sensor's zero as a drifting or constant variable."""
    reading, valid = yaw_at(sensor, b.keyframes_ns)
    first = once_each(sensor, b.keyframes_ns, valid)
    outside = (sensor.stamps_ns < b.keyframes_ns[0]) | (sensor.stamps_ns > b.keyframes_ns[-1])
    b.counts[sensor.sensor] = (
        first.size,
        int(outside.sum()) if first.size else sensor.stamps_ns.size,
    )
    if not first.size:
        return
    zero = float(reading[first[0]] - start)
    slot = -1
    if sensor.drift_sigma > 0.0:
        walk = sensor.drift_sigma * np.sqrt(b.seconds())
        slot = b.zero(sensor.sensor, zero, FREE_HEADING, walk)
    else:
        reading = reading - zero
    seconds = (b.keyframes_ns - b.keyframes_ns[0]) * 1e-9
    b.tables.append(
        FactorTable(
            Kind.YAW,
            sensor.sensor,
            first,
            np.ascontiguousarray(np.stack([reading, seconds], axis=1)[first]),
            diagonal(np.full((first.size, 1), yaw_sigma(sensor, b.rounding))),
            b.block(sensor.sensor, yaw_parameters(sensor, zero)),
            loss,
            slot,
        )
    )


def _add_yaw_rate(b: Builder, sensor: YawRate, loss: Loss) -> None:
    """Add one factor a keyframe interval; the gyro's bias is a drifting or constant variable."""
    angle, valid = turned_angle(sensor, b.keyframes_ns)
    first = np.flatnonzero(valid)
    b.counts[sensor.sensor] = (first.size, valid.size - first.size)
    if not first.size:
        return
    seconds = b.seconds()
    slot = -1
    if sensor.bias_walk > 0.0:
        walk = sensor.bias_walk * np.sqrt(seconds)
        slot = b.zero(sensor.sensor, 0.0, bias_sigma(sensor), walk)
    b.tables.append(
        FactorTable(
            Kind.YAW_RATE,
            sensor.sensor,
            first.astype(np.int64),
            np.stack([angle, seconds], axis=1)[first],
            diagonal(gyro_sigma(sensor, seconds[first], b.rounding)[:, None]),
            b.block(sensor.sensor, gyro_parameters(sensor)),
            loss,
            slot,
        )
    )


def _add_camera(b: Builder, sensor: CameraPoses, predicted: Floats, loss: Loss) -> None:
    """Add one relative-motion factor a keyframe interval, with mounting and scale as variables.

    `predicted` (K-1, 3) are the wheels' displacements.
    """
    poses, valid = camera_at(sensor, b.keyframes_ns)
    first = np.flatnonzero(valid[1:] & valid[:-1])
    b.counts[sensor.sensor] = (first.size, valid.size - 1 - first.size)
    if not first.size:
        return
    motion = between(poses[first], poses[first + 1])
    nominal = np.broadcast_to(np.array(sensor.mount), (first.size, 3))
    b.tables.append(
        FactorTable(
            Kind.CAMERA,
            sensor.sensor,
            first.astype(np.int64),
            np.concatenate([motion, nominal, predicted[first]], axis=1),
            diagonal(camera_sigma(sensor, motion, b.rounding)),
            b.block(sensor.sensor, camera_parameters(sensor)),
            loss,
        )
    )


def _add_fixes(b: Builder, sensor: PositionFixes | PoseFixes, loss: Loss) -> None:
    """Add one factor a fix at its own keyframe, with the mounting as a variable where uncertain."""
    pose = isinstance(sensor, PoseFixes)
    values = sensor.poses if isinstance(sensor, PoseFixes) else sensor.positions
    at = np.searchsorted(b.keyframes_ns, sensor.stamps_ns)
    at = np.minimum(at, b.keyframes_ns.size - 1)
    valid = b.keyframes_ns[at] == sensor.stamps_ns
    b.counts[sensor.sensor] = (int(valid.sum()), int((~valid).sum()))
    if not valid.any():
        return
    n = int(valid.sum())
    mount = np.broadcast_to(np.array(sensor.mount), (n, len(sensor.mount)))
    b.tables.append(
        FactorTable(
            Kind.POSE_FIX if pose else Kind.POSITION_FIX,
            sensor.sensor,
            at[valid].astype(np.int64),
            np.concatenate([values[valid], mount], axis=1),
            diagonal(fix_sigma(sensor.sigma[valid], b.rounding)),
            b.mount(sensor.mount_name or sensor.sensor, sensor.mount, sensor.mount_sigma),
            loss,
        )
    )


def _add_start(b: Builder, drive: Drive, start: Floats, sigma: Floats) -> None:
    """Tie the first keyframe to where the drive starts, through the reference's mounting."""
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    block = slice(0, 0)
    if drive.truth is not None:
        mount = drive.truth.mount
        block = b.mount(drive.truth.sensor, mount, drive.truth.mount_sigma)
        sigma = fix_sigma(sigma, b.rounding)
    b.tables.append(
        FactorTable(
            Kind.POSE_FIX,
            "start",
            np.zeros(1, dtype=np.int64),
            np.concatenate([start, mount])[None],
            diagonal(sigma[None]),
            block,
        )
    )


def build_problem(drive: Drive, settings: Settings, front: Front | None = None) -> Problem:
    """Build the graph of a drive: O(N) numpy, no loop over measurements.

    `front` is what its lidar sees; the walls come later (`smoothing.mapping`). Raises FglocError
    where the drive's wheels and truth do not overlap in time.
    """
    drive = trim_to_truth(drive)
    scans = None if front is None else front.scans
    keyframes = choose_keyframes(
        drive, settings.keyframe_period_s, None if scans is None else scans.stamps_ns
    )
    split = split_at(drive.wheels, keyframes)
    rounding = rounding_sigma(drive.robot, drive.wheels.resolution)
    builder = Builder(keyframes, drive.robot, rounding)
    wheels = preintegrate(split, drive.robot)
    guess = first_guess(drive, keyframes, wheels)
    robust = settings.robust
    _add_start(builder, drive, guess.start, guess.start_sigma)
    for yaw in drive.each(Yaw):
        _add_yaw(builder, yaw, float(guess.poses[0, 2]), settings.yaw_loss if robust else PLAIN)
    for gyro in drive.each(YawRate):
        _add_yaw_rate(builder, gyro, settings.yaw_loss if robust else PLAIN)
    for camera in drive.each(CameraPoses):
        loss = settings.camera_loss if robust else PLAIN
        _add_camera(builder, camera, wheels.displacement, loss)
    for fixes in absolute_fixes(drive):
        _add_fixes(builder, fixes, settings.fix_loss if robust else PLAIN)
    for sightings in drive.each(LandmarkSightings):
        add_sightings(builder, sightings, settings.landmark_loss if robust else PLAIN)
    scene = None if front is None else scene_of(builder, front)
    for lidar in drive.each(Scans):
        # What `look_around` made nothing of: a single scan, a second lidar.
        builder.counts.setdefault(lidar.sensor, (0, lidar.stamps_ns.size))
    states = np.zeros((keyframes.size, builder.width))
    states[:, :3] = guess.poses
    for column, first in builder.zeros:
        states[:, column] = first
    return Problem(
        keyframes_ns=keyframes,
        robot=drive.robot,
        split=split,
        free=builder.free,
        parameters=tuple(builder.parameters),
        tables=tuple(builder.tables),
        states=states,
        counts={"wheels": (keyframes.size - 1, 0), **builder.counts},
        wheel_loss=settings.wheel_loss if robust else PLAIN,
        turn=guess.turn,
        turn_spread=guess.turn_spread,
        landmarks=np.zeros((len(builder.marks), 2)),
        scene=scene,
        marks=np.array(list(builder.marks), dtype=np.int64),
        notes=(*guess.notes, *remarks(drive, builder.counts)),
    )
