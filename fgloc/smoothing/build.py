"""From a drive to its graph: one table a sensor, calibration blocks, drifting zeros."""

from __future__ import annotations

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.geometry import between
from fgloc.core.kinematics import Parameter
from fgloc.core.measurements import (
    CameraPoses,
    Floats,
    PoseFixes,
    PositionFixes,
    Stamps,
    Yaw,
    YawRate,
)
from fgloc.core.preintegration import preintegrate, rounding_sigma, split_at
from fgloc.core.robot import Robot
from fgloc.core.start import trim_to_truth
from fgloc.factors.robust import PLAIN, Loss
from fgloc.factors.tables import FactorTable, Kind
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
from fgloc.smoothing.settings import Settings

KNOWN = 1e-6
"""Sigma [m, rad] that stands for "known exactly" where a block has some free components."""
FREE_HEADING = np.pi
"""Prior sigma of an unknown heading [rad]."""


def mount_parameters(
    name: str, nominal: tuple[float, ...], sigma: tuple[float, ...]
) -> list[Parameter]:
    """Return `<name>_x`, `_y` and, for a pose, `_yaw`: where a sensor sits on the robot."""
    labels = (("_x", "m"), ("_y", "m"), ("_yaw", "rad"))
    return [
        Parameter(name + suffix, value, max(s, KNOWN), unit)
        for (suffix, unit), value, s in zip(labels, nominal, sigma, strict=False)
    ]


class _Builder:
    """Collects calibration blocks, state columns and tables while a problem is built."""

    def __init__(self, keyframes_ns: Stamps, robot: Robot, rounding: Floats) -> None:
        self.keyframes_ns = keyframes_ns
        # (3,) sigma of a keyframe's pose, as the counts tell it: x, y, heading in body axes.
        self.rounding = rounding
        base = robot.base.parameters
        self.free = tuple(k for k, p in enumerate(base) if p.prior_sigma > 0.0)
        self.parameters: list[Parameter] = [base[k] for k in self.free]
        self.width = 3
        self.tables: list[FactorTable] = []
        self.counts: dict[str, tuple[int, int]] = {}
        self.zeros: list[tuple[int, float]] = []
        self._blocks: dict[str, slice] = {}

    def block(self, name: str, parameters: list[Parameter]) -> slice:
        """Return the columns of a sensor's calibration block, made on first use."""
        if name not in self._blocks:
            begin = len(self.parameters)
            self.parameters += parameters
            self._blocks[name] = slice(begin, begin + len(parameters))
        return self._blocks[name]

    def mount(self, name: str, nominal: tuple[float, ...], sigma: tuple[float, ...]) -> slice:
        """Return the columns of a mounting block, or an empty slice where it is known exactly."""
        if not any(s > 0.0 for s in sigma):
            return slice(0, 0)
        return self.block(f"{name} mount", mount_parameters(name, nominal, sigma))

    def slot(self, sensor: str, first: float, sigma: float, walk: Floats) -> int:
        """Return a new state column for a drifting zero; `walk` (K-1,) are its step sigmas."""
        column = self.width
        self.width += 1
        self.zeros.append((column, first))
        k = walk.size
        empty = slice(0, 0)
        self.tables.append(
            FactorTable(
                Kind.ZERO_WALK,
                sensor,
                np.arange(k, dtype=np.int64),
                np.zeros((k, 1)),
                diagonal(walk[:, None]),
                empty,
                slot=column,
            )
        )
        self.tables.append(
            FactorTable(
                Kind.ZERO_PRIOR,
                sensor,
                np.zeros(1, dtype=np.int64),
                np.array([[first]]),
                diagonal(np.array([[sigma]])),
                empty,
                slot=column,
            )
        )
        return column

    def rounded(self, sigma: Floats) -> Floats:
        """Return the sigmas (M, 2 or 3) of fixes of a pose that rounded counts tell."""
        # Fixes have map axes; the larger of the body's is at most a millimetre too cautious.
        along = float(self.rounding[:2].max())
        own = np.array([along, along, self.rounding[2]])[: sigma.shape[1]]
        return np.asarray(np.hypot(sigma, own))

    def seconds(self) -> Floats:
        """Return (K-1,) durations between keyframes [s]."""
        return np.diff(self.keyframes_ns) * 1e-9


def _add_yaw(b: _Builder, sensor: Yaw, start: float, loss: Loss) -> None:
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
    slot, variables = -1, []
    if sensor.drift_sigma > 0.0:
        walk = sensor.drift_sigma * np.sqrt(b.seconds())
        slot = b.slot(sensor.sensor, zero, FREE_HEADING, walk)
    else:
        variables.append(Parameter(f"{sensor.sensor}_zero", zero, FREE_HEADING, "rad"))
        reading = reading - zero
    if sensor.drift_rate_sigma > 0.0:
        rate = Parameter(f"{sensor.sensor}_drift", 0.0, sensor.drift_rate_sigma, "rad/s")
        variables.append(rate)
    seconds = (b.keyframes_ns - b.keyframes_ns[0]) * 1e-9
    b.tables.append(
        FactorTable(
            Kind.YAW,
            sensor.sensor,
            first,
            np.ascontiguousarray(np.stack([reading, seconds], axis=1)[first]),
            diagonal(np.full((first.size, 1), np.hypot(sensor.sigma, b.rounding[2]))),
            b.block(sensor.sensor, variables) if variables else slice(0, 0),
            loss,
            slot,
        )
    )


def _add_yaw_rate(b: _Builder, sensor: YawRate, loss: Loss) -> None:
    """Add one factor a keyframe interval; the gyro's bias is a drifting or constant variable."""
    angle, valid = turned_angle(sensor, b.keyframes_ns)
    first = np.flatnonzero(valid)
    b.counts[sensor.sensor] = (first.size, valid.size - first.size)
    if not first.size:
        return
    seconds = b.seconds()
    slot, block = -1, slice(0, 0)
    white = np.hypot(sensor.density * np.sqrt(seconds), np.sqrt(2.0) * b.rounding[2])
    sigma = max(sensor.bias_sigma, KNOWN)
    if sensor.bias_walk > 0.0:
        slot = b.slot(sensor.sensor, 0.0, sigma, sensor.bias_walk * np.sqrt(seconds))
    else:
        parameter = Parameter(f"{sensor.sensor}_bias", 0.0, sigma, "rad/s")
        block = b.block(sensor.sensor, [parameter])
    b.tables.append(
        FactorTable(
            Kind.YAW_RATE,
            sensor.sensor,
            first.astype(np.int64),
            np.stack([angle, seconds], axis=1)[first],
            diagonal(white[first, None]),
            block,
            loss,
            slot,
        )
    )


def _add_camera(b: _Builder, sensor: CameraPoses, loss: Loss) -> None:
    """Add one relative-motion factor a keyframe interval, with mounting and scale as variables."""
    poses, valid = camera_at(sensor, b.keyframes_ns)
    first = np.flatnonzero(valid[1:] & valid[:-1])
    b.counts[sensor.sensor] = (first.size, valid.size - 1 - first.size)
    if not first.size:
        return
    motion = between(poses[first], poses[first + 1])
    path = np.hypot(motion[:, 0], motion[:, 1])
    sigma = np.empty((first.size, 3))
    sigma[:, :2] = np.sqrt(sensor.position_walk**2 * path + sensor.position_sigma**2)[:, None]
    sigma[:, 2] = np.sqrt(sensor.heading_walk**2 * path + sensor.heading_sigma**2)
    sigma = np.hypot(sigma, np.sqrt(2.0) * b.rounding)
    name = sensor.sensor
    parameters = mount_parameters(name, sensor.mount, sensor.mount_sigma)
    parameters.append(Parameter(f"{name}_scale", 1.0, max(sensor.scale_sigma, KNOWN), "1"))
    nominal = np.broadcast_to(np.array(sensor.mount), (first.size, 3))
    b.tables.append(
        FactorTable(
            Kind.CAMERA,
            name,
            first.astype(np.int64),
            np.concatenate([motion, nominal], axis=1),
            diagonal(sigma),
            b.block(name, parameters),
            loss,
        )
    )


def _add_fixes(b: _Builder, sensor: PositionFixes | PoseFixes, loss: Loss) -> None:
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
            diagonal(b.rounded(sensor.sigma[valid])),
            b.mount(sensor.mount_name or sensor.sensor, sensor.mount, sensor.mount_sigma),
            loss,
        )
    )


def _add_start(b: _Builder, drive: Drive, start: Floats, sigma: Floats) -> None:
    """Tie the first keyframe to where the drive starts, through the reference's mounting."""
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    block = slice(0, 0)
    if drive.truth is not None:
        mount = drive.truth.mount
        block = b.mount(drive.truth.sensor, mount, drive.truth.mount_sigma)
        sigma = b.rounded(sigma[None])[0]
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


def build_problem(drive: Drive, settings: Settings) -> Problem:
    """Build the graph of a drive: O(N) numpy, no loop over measurements.

    Raises FglocError where the drive's wheels and truth do not overlap in time.
    """
    drive = trim_to_truth(drive)
    keyframes = choose_keyframes(drive, settings.keyframe_period_s)
    split = split_at(drive.wheels, keyframes)
    rounding = rounding_sigma(drive.robot, drive.wheels.resolution)
    builder = _Builder(keyframes, drive.robot, rounding)
    guess = first_guess(drive, keyframes, preintegrate(split, drive.robot))
    robust = settings.robust
    _add_start(builder, drive, guess.start, guess.start_sigma)
    for yaw in drive.each(Yaw):
        _add_yaw(builder, yaw, float(guess.poses[0, 2]), settings.yaw_loss if robust else PLAIN)
    for gyro in drive.each(YawRate):
        _add_yaw_rate(builder, gyro, settings.yaw_loss if robust else PLAIN)
    for camera in drive.each(CameraPoses):
        _add_camera(builder, camera, settings.camera_loss if robust else PLAIN)
    for fixes in absolute_fixes(drive):
        _add_fixes(builder, fixes, settings.fix_loss if robust else PLAIN)
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
        notes=(*guess.notes, *remarks(drive, builder.counts)),
    )
