"""A drive's measurements merged by time, as the pose EKF's loop takes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.geometry import between, compose, inverse
from fgloc.core.kinematics import prior_correlation
from fgloc.core.measurements import (
    CameraPoses,
    Floats,
    PoseFixes,
    PositionFixes,
    Sensor,
    Stamps,
    Yaw,
    YawRate,
)
from fgloc.core.preintegration import preintegrate, rounding_sigma, split_at
from fgloc.core.robot import Robot
from fgloc.filters.causal_gyro import turned_so_far
from fgloc.filters.pose_ekf_kernel import CAMERA, POSE, POSITION, YAW, Codes
from fgloc.filters.pose_ekf_settings import PoseEkfSettings


@dataclass(frozen=True)
class Stream:
    """One sensor that corrects the state, its readings ready for the filter."""

    sensor: Sensor
    """Where it comes from."""
    kind: int
    """CAMERA, POSE, POSITION or YAW."""
    stamps_ns: Stamps
    """(M,) stamps inside the drive."""
    values: Floats
    """(M, 3) readings, in the first columns; CAMERA: pose of the base since the first reading."""
    noises: Floats
    """(M, 3, 3) covariances; CAMERA: in the axes of the base at the first reading."""
    lever: Floats
    """(3,) nominal mounting: x, y [m], yaw [rad]."""
    gate: float
    """Largest squared Mahalanobis distance that is believed."""
    zero_walk: float = 0.0
    """YAW: variance [rad²/s] by which its zero wanders."""


@dataclass(frozen=True)
class Events:
    """All measurements of a drive in the order of time."""

    cuts_ns: Stamps
    """(C,) moments at which something is measured or emitted, all wheel stamps among them."""
    steps: Floats
    """(C-1, 3) relative poses between cuts by the wheels."""
    step_covariances: Floats
    """(C-1, 3, 3) their covariances, in the axes of the earlier cut."""
    emit: Codes
    """(C,) number of the wheel stamp, -1 at cuts that are none."""
    first: Codes
    """(C+1,) the first event at each cut; the last entry is E."""
    streams: tuple[Stream, ...]
    """What is measured, in the drive's order."""
    stream_of: Codes
    """(E,) index into `streams`."""
    reading_of: Codes
    """(E,) index into the stream's readings."""
    gyros: tuple[YawRate, ...]
    """Gyros, in the drive's order."""
    turns: Floats
    """(G, C-1) angle turned between cuts by each gyro [rad]."""
    turn_variances: Floats
    """(G, C-1) its variance [rad²]; 0 where the gyro was silent."""
    rounding: Floats
    """(3,) sigma of a pose that rounded encoder counts tell, in body axes [m, m, rad]."""


def merge(drive: Drive, settings: PoseEkfSettings) -> Events:
    """Return the measurements inside the drive (cut to its truth already), merged by time.

    Raises FglocError if the wheels do not determine the motion. O((N + M) log (N + M)).
    """
    wheels = drive.wheels.stamps_ns
    rounding = rounding_sigma(drive.robot, drive.wheels.resolution)
    prepared = (_stream(s, wheels, settings, rounding) for s in drive.sensors)
    streams = tuple(s for s in prepared if s is not None)
    cuts = np.unique(np.concatenate([wheels, *(s.stamps_ns for s in streams)]))
    moved = preintegrate(split_at(drive.wheels, cuts), drive.robot)
    seconds = np.diff(cuts) * 1e-9
    covariance = moved.covariance + _miscalibration(drive.robot, moved.jacobian, seconds, settings)
    emit = np.full(cuts.size, -1, dtype=np.int64)
    emit[np.searchsorted(cuts, wheels)] = np.arange(wheels.size)
    sizes = [s.stamps_ns.size for s in streams]
    stream_of = np.repeat(np.arange(len(streams)), sizes).astype(np.int64)
    reading_of = np.concatenate([np.zeros(0, np.int64), *(np.arange(n) for n in sizes)])
    at = np.concatenate([np.zeros(0, np.int64), *(s.stamps_ns for s in streams)])
    order = np.argsort(at, kind="stable")
    gyros = drive.each(YawRate)
    turns = np.zeros((len(gyros), seconds.size))
    variances = np.zeros((len(gyros), seconds.size))
    for k, gyro in enumerate(gyros):
        turns[k], heard = turned_so_far(gyro, cuts)
        density = gyro.density**2 + gyro.bias_sigma**2 * settings.horizon_s
        variances[k] = np.where(heard, settings.gyro**2 * density * seconds, 0.0)
    return Events(
        cuts_ns=cuts,
        steps=moved.displacement,
        step_covariances=settings.process_noise**2 * covariance,
        emit=emit,
        first=np.searchsorted(at[order], np.append(cuts, cuts[-1] + 1)).astype(np.int64),
        streams=streams,
        stream_of=stream_of[order],
        reading_of=reading_of[order],
        gyros=gyros,
        turns=turns,
        turn_variances=variances,
        rounding=rounding,
    )


def _miscalibration(
    robot: Robot, jacobian: Floats, seconds: Floats, settings: PoseEkfSettings
) -> Floats:
    """Return what wrong radii, track and the like add to the covariance of every step (M, 3, 3).

    J Σ Jᵀ is right for one step, but the next is wrong the same way, so that errors and not
    variances add up: white noise of horizon / duration times as much does so over the horizon.
    """
    parameters = robot.base.parameters
    sigma = np.array([p.prior_sigma for p in parameters])
    prior = settings.calibration**2 * prior_correlation(parameters) * np.outer(sigma, sigma)
    longer = np.maximum(settings.horizon_s / seconds, 1.0)
    once = np.einsum("mip,pq,mjq->mij", jacobian, prior, jacobian, optimize=True)
    return np.asarray(longer[:, None, None] * once)


def _stream(
    sensor: Sensor, wheels: Stamps, settings: PoseEkfSettings, rounding: Floats
) -> Stream | None:
    """Return a sensor's readings between the first and the last wheel stamp; None for others."""
    inside = (sensor.stamps_ns >= wheels[0]) & (sensor.stamps_ns <= wheels[-1])
    stamps = sensor.stamps_ns[inside]
    values, noises = np.zeros((stamps.size, 3)), np.zeros((stamps.size, 3, 3))
    # The larger of the body's two axes; fixes have map axes.
    along, turn = float(rounding[:2].max()), float(rounding[2])
    if isinstance(sensor, Yaw):
        values[:, 0] = sensor.yaw[inside]
        noises[:, 0, 0] = (settings.yaw * sensor.sigma) ** 2 + turn**2
        walk = sensor.drift_sigma**2 + sensor.drift_rate_sigma**2 * settings.horizon_s
        lever, gate, walk = np.zeros(3), settings.yaw_gate, settings.yaw_drift**2 * walk
        return Stream(sensor, YAW, stamps, values, noises, lever, gate**2, walk)
    if isinstance(sensor, CameraPoses):
        if stamps.size:
            values, noises = _camera(sensor, stamps, sensor.poses[inside], settings)
        noises += np.diag([along**2, along**2, turn**2])
        gate = settings.camera_gate**2
        return Stream(sensor, CAMERA, stamps, values, noises, np.zeros(3), gate)
    if isinstance(sensor, PositionFixes | PoseFixes):
        pose = isinstance(sensor, PoseFixes)
        d = 3 if pose else 2
        read = sensor.poses if isinstance(sensor, PoseFixes) else sensor.positions
        values[:, :d] = read[inside]
        spread = np.array(sensor.mount_sigma)
        # The lever arm's error turns with the robot; the larger one stands for both axes.
        spread[:2] = spread[:2].max()
        variance = (settings.fix * sensor.sigma[inside]) ** 2 + spread**2
        variance += np.array([along, along, turn])[:d] ** 2
        for a in range(d):
            noises[:, a, a] = variance[:, a]
        lever = np.zeros(3)
        lever[:d] = sensor.mount
        gate = settings.fix_gate**2
        return Stream(sensor, POSE if pose else POSITION, stamps, values, noises, lever, gate)
    return None


def _camera(
    sensor: CameraPoses, stamps: Stamps, poses: Floats, settings: PoseEkfSettings
) -> tuple[Floats, Floats]:
    """Return the base's poses (M, 3) since the camera's first, by the nominal mount, and their R.

    `stamps` (M,) and `poses` (M, 3) are those inside the drive, at least one. What is uncertain of
    a camera pose: its white noise, its random walk since the beginning, and what mounting and scale
    may be off by, to first order. With the camera's displacement D = (d, δ) since its first pose
    and the mount (m, ψ), the base has moved by m + R(ψ) d − R(δ) m. Walk, mounting and scale are
    wrong the same way in one pose after the other, while the filter takes poses to be independent;
    so these parts count horizon / period times.
    """
    mount = np.array(sensor.mount)
    moved = between(poses[0], poses)
    base = compose(compose(mount, moved), inverse(mount))
    seen = compose(np.array([0.0, 0.0, mount[2]]), moved)[:, :2]
    path = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    period = float(np.median(np.diff(stamps))) * 1e-9 if stamps.size > 1 else settings.horizon_s
    growth = settings.camera_growth**2 * max(settings.horizon_s / period, 1.0)
    c, s = np.cos(moved[:, 2]), np.sin(moved[:, 2])
    # d base / d (m_x, m_y, psi, scale), rows x and y.
    jacobian = np.empty((path.size, 2, 4))
    jacobian[:, 0] = np.stack([1.0 - c, s, -seen[:, 1], seen[:, 0]], axis=1)
    jacobian[:, 1] = np.stack([-s, 1.0 - c, seen[:, 0], seen[:, 1]], axis=1)
    spread = np.array([*sensor.mount_sigma, sensor.scale_sigma]) ** 2
    noises = np.zeros((path.size, 3, 3))
    noises[:, :2, :2] = growth * np.einsum("mik,k,mjk->mij", jacobian, spread, jacobian)
    position = sensor.position_sigma**2 + growth * sensor.position_walk**2 * path
    heading = sensor.heading_sigma**2 + growth * sensor.heading_walk**2 * path
    noises[:, 0, 0] += position
    noises[:, 1, 1] += position
    noises[:, :2, :2] *= settings.camera_position**2
    noises[:, 2, 2] = settings.camera_heading**2 * heading
    return base, noises
