"""The streams of a drive as the messages that a robot_localization-like filter takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.geometry import between, chain, compose, inverse, log, wrap
from fgloc.core.measurements import (
    Acceleration,
    CameraPoses,
    Floats,
    PoseFixes,
    PositionFixes,
    Sensor,
    Stamps,
    WheelIncrements,
    Yaw,
    YawRate,
)
from fgloc.core.preintegration import preintegrate, rounding_sigma, split_at
from fgloc.filters.rl_kernel import AX, RATE, VX, VY, YAW, X, Y
from fgloc.io.ekf_config import PLANAR, EkfConfig, EkfInput

Stream = Sensor | WheelIncrements
ACCELERATION_SIGMA = 0.1
"""Sigma of an accelerometer [m/s²]; streams do not state theirs."""
POSE = (X, Y, YAW)
POSE_NAMES = tuple(PLANAR[state] for state in POSE)
TWIST = (VX, VY, RATE)

HELD: Mapping[str, tuple[str, ...]] = {
    "WheelIncrements": ("x", "y", "yaw", "vx", "vy", "vyaw"),
    "twist": ("vx", "vy", "vyaw"),
    "CameraPoses": ("x", "y", "yaw"),
    "PoseFixes": ("x", "y", "yaw"),
    "PositionFixes": ("x", "y"),
    "Yaw": ("yaw",),
    "YawRate": ("vyaw",),
    "Acceleration": ("ax",),
}
"""What each kind of stream holds of the planar states; the wheels as a twist have no pose."""


@dataclass(frozen=True)
class Messages:
    """Measurements of the same states by one stream, in the frame of the start."""

    input: EkfInput
    """For which input they are."""
    sensor: str
    """Name of the stream."""
    stamps_ns: Stamps
    """(M,) stamps."""
    states: tuple[int, ...]
    """The d states they hold."""
    values: Floats
    """(M, d) measured states."""
    noises: Floats
    """(M, d, d) their covariances."""
    threshold: float
    """Mahalanobis distance from which on they are rejected."""
    lever: Floats = field(default_factory=lambda: np.zeros(2))
    """(2,) lever arm of a position [m], body axes."""
    absolute: bool = False
    """Positions in the map; differential and relative ones are not."""


@dataclass(frozen=True)
class Binding:
    """Which streams an input reads."""

    input: EkfInput
    """The input."""
    streams: tuple[Stream, ...]
    """What it reads; an IMU is up to three streams."""

    def __str__(self) -> str:
        who = f"{self.input.name} ({self.input.topic})" if self.input.topic else self.input.name
        if not self.streams:
            return f"{who} has no stream on this drive"
        mode = " differential" * self.input.differential + " relative" * self.input.relative
        held = {s.sensor: self.held(s) for s in self.streams}
        # Modes are of poses; a gyro and an accelerometer have none.
        modes = {n: mode if any(f in POSE_NAMES for f in what) else "" for n, what in held.items()}
        read = [f"{n}:{modes[n]} {', '.join(what)}" for n, what in held.items() if what]
        there = {flag for what in held.values() for flag in what}
        missing = [flag for flag in self.input.flags if flag not in there]
        parts = [f"reads {'; '.join(read)}"] if read else ["reads nothing"]
        if missing:
            parts.append(f"{' + '.join(held)} has no {', '.join(missing)}")
        return f"{who} {'; '.join(parts)}"

    def held(self, stream: Stream) -> tuple[str, ...]:
        """Return which of the flags of the input a stream can serve."""
        kinds = HELD["twist"] if self.input.kind == "twist" else HELD[type(stream).__name__]
        return tuple(flag for flag in self.input.flags if flag in kinds)


def bind(config: EkfConfig, drive: Drive) -> tuple[Binding, ...]:
    """Return which streams each input reads: by kind and order, none twice.

    odom0 is the wheels, further ones the camera, pose fixes and position fixes that no pose input
    reads; poses are those streams; a twist is the wheels; an IMU is one yaw, one gyro and one
    accelerometer. Where the topic has the name of a stream in it, that one goes first.
    """
    free: list[Stream] = [
        s for s in drive.sensors if isinstance(s, CameraPoses | PoseFixes | PositionFixes)
    ]
    imu: list[Stream] = [s for s in drive.sensors if isinstance(s, Yaw | YawRate | Acceleration)]
    wheels: list[Stream] = [drive.wheels]
    found: dict[str, tuple[Stream, ...]] = {}
    # Poses choose before odometries do: these have the wheels.
    for one in sorted(config.inputs, key=lambda i: ("pose", "imu", "odom", "twist").index(i.kind)):
        if one.kind == "imu":
            kinds = (Yaw, YawRate, Acceleration)
            chosen = [_choose([s for s in imu if isinstance(s, k)], imu, one) for k in kinds]
        elif one.kind == "twist":
            chosen = [drive.wheels]
        elif one.kind == "odom" and wheels:
            chosen = [_choose(wheels, wheels, one)]
        else:
            chosen = [_choose(free, free, one)]
        found[one.name] = tuple(s for s in chosen if s is not None)
    return tuple(Binding(one, found[one.name]) for one in config.inputs)


def _choose(fitting: Sequence[Stream], pool: list[Stream], one: EkfInput) -> Stream | None:
    """Return the stream named in the topic, else the first; take it out of the pool."""
    named = [s for s in fitting if s.sensor in one.topic]
    chosen = next(iter([*named, *fitting]), None)
    if chosen is not None:
        pool[:] = [s for s in pool if s is not chosen]
    return chosen


def messages_of(binding: Binding, drive: Drive, start: Floats) -> list[Messages]:
    """Return all measurements that an input makes of its streams, within the drive.

    `start` (3,) is the first pose of the base in the map; measurements are relative to it. In the
    order of robot_localization: the pose of a message before its twist before its acceleration.
    """
    one = binding.input
    out: list[Messages] = []
    for whole in binding.streams:
        if isinstance(whole, WheelIncrements):
            out += _wheels(one, drive)
            continue
        stream = _within(whole, drive.wheels.stamps_ns)
        if not stream.stamps_ns.size:
            continue
        if isinstance(stream, YawRate):
            out += _gyro(one, stream)
        elif isinstance(stream, Acceleration):
            variance = np.full((stream.stamps_ns.size, 1, 1), ACCELERATION_SIGMA**2)
            values, limit = stream.forward[:, None], one.acceleration_threshold
            out += _asked(one, stream.sensor, stream.stamps_ns, (AX,), values, variance, limit)
        elif isinstance(stream, Yaw):
            # Its zero is arbitrary: the first reading is the heading of the start.
            values = (stream.yaw - stream.yaw[0])[:, None]
            noises = np.full((values.size, 1, 1), stream.sigma**2)
            out += _poses(one, stream.sensor, stream.stamps_ns, (YAW,), values, noises)
        elif isinstance(stream, CameraPoses):
            out += _camera(one, stream)
        elif isinstance(stream, PoseFixes | PositionFixes):
            out += _fixes(one, stream, start)
    return out


def _within(stream: Sensor, wheels: Stamps) -> Sensor:
    """Return a stream's readings between the first and the last wheel stamp."""
    inside = (stream.stamps_ns >= wheels[0]) & (stream.stamps_ns <= wheels[-1])
    arrays = {
        name: value[inside]
        for name, value in vars(stream).items()
        if isinstance(value, np.ndarray) and value.shape[:1] == inside.shape
    }
    return replace(stream, **arrays)


def _asked(
    one: EkfInput,
    sensor: str,
    stamps: Stamps,
    states: tuple[int, ...],
    values: Floats,
    noises: Floats,
    threshold: float,
    lever: Floats | None = None,
) -> list[Messages]:
    """Return the measurements cut down to the states that the input asks for; none if none."""
    kept = [k for k, state in enumerate(states) if PLANAR[state] in one.flags]
    if not kept or not stamps.size:
        return []
    return [
        Messages(
            one,
            sensor,
            stamps,
            tuple(states[k] for k in kept),
            np.ascontiguousarray(values[:, kept]),
            np.ascontiguousarray(noises[:, kept][:, :, kept]),
            threshold,
            np.zeros(2) if lever is None else lever,
        )
    ]


def _wheels(one: EkfInput, drive: Drive) -> list[Messages]:
    """Return wheel odometry as ROS drivers publish it: integrated pose and twist at every packet.

    The twist is the displacement of the last interval over its duration, with its covariance and
    the rounding of the counts. The pose is given the constant covariance with which differencing
    it gives its steps their weight back.
    """
    wheels = drive.wheels
    moved = preintegrate(split_at(wheels, wheels.stamps_ns), drive.robot)
    seconds = np.diff(wheels.stamps_ns) * 1e-9
    rounding = np.diag(rounding_sigma(drive.robot, wheels.resolution) ** 2)
    covariance = moved.covariance + 2.0 * rounding
    stamps = wheels.stamps_ns[1:]
    twist = log(moved.displacement) / seconds[:, None]
    noises = covariance / (seconds**2)[:, None, None]
    limit = one.twist_threshold
    twists = _asked(one, wheels.sensor, stamps, TWIST, twist, noises, limit)
    poses = chain(moved.displacement, np.zeros(3))[1:]
    typical = covariance.mean(axis=0) / (2.0 * float(np.median(seconds)) ** 3)
    constant = np.broadcast_to(typical, covariance.shape)
    if one.kind == "twist":
        return twists
    return [*_poses(one, wheels.sensor, stamps, POSE, poses, constant), *twists]


def _gyro(one: EkfInput, gyro: YawRate) -> list[Messages]:
    """Return the yaw rate of an IMU: white noise at its rate, and the prior of its bias."""
    stamps = gyro.stamps_ns
    period = float(np.median(np.diff(stamps))) * 1e-9 if stamps.size > 1 else 1.0
    variance = gyro.density**2 / period + gyro.bias_sigma**2
    noises = np.full((stamps.size, 1, 1), variance)
    values, limit = gyro.rate[:, None], one.twist_threshold
    return _asked(one, gyro.sensor, stamps, (RATE,), values, noises, limit)


def _camera(one: EkfInput, sensor: CameraPoses) -> list[Messages]:
    """Return the base's poses by the nominal mounting, with the camera's white noise.

    The camera's own frame is laid so that its first pose is that of the start.
    """
    mount = np.array(sensor.mount)
    base = compose(compose(mount, between(sensor.poses[0], sensor.poses)), inverse(mount))
    variance = np.array([sensor.position_sigma, sensor.position_sigma, sensor.heading_sigma]) ** 2
    noises = np.tile(np.diag(variance), (base.shape[0], 1, 1))
    return _poses(one, sensor.sensor, sensor.stamps_ns, POSE, base, noises)


def _fixes(one: EkfInput, sensor: PoseFixes | PositionFixes, start: Floats) -> list[Messages]:
    """Return fixes seen from the start; a position keeps its lever arm, a pose loses it here."""
    c, s = np.cos(start[2]), np.sin(start[2])
    d = sensor.sigma.shape[1]
    back = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])[:d, :d]
    noises = back @ (np.eye(d) * sensor.sigma[:, None, :] ** 2) @ back.T
    states: tuple[int, ...] = POSE[:d]
    if isinstance(sensor, PoseFixes):
        base = compose(sensor.poses, inverse(np.array(sensor.mount)))
        values, lever = between(start, base), np.zeros(2)
    else:
        values = (sensor.positions - start[:2]) @ back.T
        lever = np.array(sensor.mount)
    made = _poses(one, sensor.sensor, sensor.stamps_ns, states, values, noises, lever)
    return [replace(m, absolute=not (one.differential or one.relative)) for m in made]


def _poses(
    one: EkfInput,
    sensor: str,
    stamps: Stamps,
    states: tuple[int, ...],
    values: Floats,
    noises: Floats,
    lever: Floats | None = None,
) -> list[Messages]:
    """Return pose messages, or what differential and relative mode make of them.

    `values` (M, d) and `noises` (M, d, d) are those of `states`; what a message does not hold is 0,
    so that the step between two positions without a heading is taken along the axes of the start.
    """
    columns = [POSE.index(state) for state in states]
    full = np.zeros((stamps.size, 3))
    full[:, columns] = values
    if one.differential:
        seconds = np.diff(stamps) * 1e-9
        steps = between(full[:-1], full[1:])
        steps[:, 2] = wrap(steps[:, 2])
        speed = steps[:, columns] / seconds[:, None]
        # As robot_localization has it: the sum of both covariances times the time between.
        both = (noises[1:] + noises[:-1]) * seconds[:, None, None]
        flags = tuple(PLANAR[TWIST[k]] for k in columns if PLANAR[POSE[k]] in one.flags)
        asked = tuple(TWIST[k] for k in columns)
        turned = EkfInput(one.name, one.topic, flags)
        return _asked(turned, sensor, stamps[1:], asked, speed, both, one.pose_threshold)
    if one.relative:
        values = between(full[0], full)[:, columns]
    return _asked(one, sensor, stamps, states, values, noises, one.pose_threshold, lever)
