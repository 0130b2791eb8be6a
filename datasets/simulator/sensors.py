"""Simulated sensors: a function each, from the true course and a model to measurements.

Every sensor has its own rate, noise, quantisation, drift and dropout, and draws from a generator
of its own, so that switching one on or changing it leaves the others' samples as they were.
"""

from __future__ import annotations

import numpy as np

from fgloc.core import geometry
from fgloc.core.measurements import (
    Acceleration,
    CameraPoses,
    Floats,
    PositionFixes,
    Sensor,
    Stamps,
    WheelIncrements,
    Yaw,
    YawRate,
)
from fgloc.datasets.simulator.course import Course
from fgloc.datasets.simulator.faults import keep
from fgloc.datasets.simulator.models import (
    AccelerometerModel,
    CameraModel,
    EncoderModel,
    FixModel,
    GyroModel,
    YawModel,
)
from fgloc.datasets.simulator.spec import SimSpec
from fgloc.datasets.simulator.streams import generator

DRIFT_RATE_SIGMA = 0.002
"""What estimators are told of a yaw sensor that drifts: the sigma of its constant rate [rad/s]."""
CUT = 2.5
"""Nothing that is drawn from a prior lies further than this many sigmas from its nominal."""
FLOOR = 1e-6
"""What a perfect sensor states as its noise [its unit]: zero would be infinite weight."""


def cut_normal(rng: np.random.Generator, size: int) -> Floats:
    """Return `size` standard normal draws, drawn again until none lies beyond `CUT`."""
    drawn = rng.standard_normal(size)
    while bool(np.any(far := np.abs(drawn) > CUT)):
        drawn[far] = rng.standard_normal(int(far.sum()))
    return drawn


def _walk(stamps: Stamps, sigma: float, rng: np.random.Generator) -> Floats:
    """Return a random walk (N,) over time that starts at 0; sigma per sqrt(s)."""
    steps = rng.standard_normal(stamps.size)
    steps[1:] *= np.sqrt(np.diff(stamps) * 1e-9)
    steps[0] = 0.0
    return sigma * np.cumsum(steps)


def _quantised(values: Floats, step: float) -> Floats:
    """Return the values rounded to multiples of `step`; 0 leaves them as they are."""
    return values if step <= 0.0 else np.round(values / step) * step


def _around(course: Course, stamps: Stamps, rate: float) -> tuple[Stamps, Stamps]:
    """Return begin and end of the sample period around each stamp, cut to the drive."""
    half = round(0.5e9 / rate)
    return np.maximum(stamps - half, 0), np.minimum(stamps + half, course.duration_ns)


def measure_wheels(
    course: Course,
    angles: Floats,
    steering: Floats | None,
    names: tuple[str, ...],
    rate: float,
    model: EncoderModel,
    rng: np.random.Generator,
) -> WheelIncrements:
    """Return encoder increments at `rate` [Hz] from wheel angles per step (M, W).

    Counts are cumulative and then differenced, so quantisation never accumulates and a lost
    packet only makes its interval longer. Steering is the mean over the interval.
    """
    stamps = course.stamps(rate)
    stamps = stamps[keep(stamps.size, model.dropout, rng)]
    resolution = 2.0 * np.pi / model.ticks if model.ticks > 0 else 0.0
    turned = _cumulative(course, angles, stamps)
    if resolution > 0.0:
        phase = rng.random(len(names))
        turned = np.floor(turned / resolution + phase) * resolution
    increments = np.diff(turned, axis=0)
    if model.noise > 0.0:
        increments += resolution * rng.uniform(-model.noise, model.noise, increments.shape)
    mean = None
    if steering is not None:
        steps = np.diff(stamps)[:, None] / course.step_ns
        mean = np.diff(_cumulative(course, steering, stamps), axis=0) / steps
    return WheelIncrements("wheels", stamps, increments, names, mean, resolution)


def _cumulative(course: Course, steps: Floats, stamps: Stamps) -> Floats:
    """Return the sum of per-step values (M, W) up to each stamp, linear within a step (N, W)."""
    grid = course.boundaries_ns.astype(np.float64)
    total = np.vstack([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])
    at = stamps.astype(np.float64)
    return np.stack([np.interp(at, grid, column) for column in total.T], axis=1)


def measure_yaw(course: Course, model: YawModel, rng: np.random.Generator) -> Yaw:
    """Return the IMU's heading: truth, zero, drift, walk and white noise; wrapped, quantised."""
    stamps = course.stamps(model.rate)
    stamps = stamps[keep(stamps.size, model.dropout, rng)]
    heading = course.poses_at(stamps)[:, 2] + model.zero + model.drift * stamps * 1e-9
    heading += _walk(stamps, model.walk, rng)
    heading += model.sigma * rng.standard_normal(stamps.size)
    yaw = _quantised(geometry.wrap(heading), model.resolution)
    sigma = float(np.hypot(model.sigma, model.resolution / np.sqrt(12.0)))
    # Estimators are told how large a drift may be, not how large it is.
    drift = DRIFT_RATE_SIGMA if model.drift else 0.0
    return Yaw("yaw", stamps, yaw, max(sigma, 1e-3), model.walk, model.resolution, drift)


def measure_gyro(
    course: Course, model: GyroModel, rng: np.random.Generator, bias: float | None = None
) -> YawRate:
    """Return the gyro's yaw rate: truth plus bias, its random walk and white noise.

    The truth is averaged over the sample period around the stamp, as the sensor's filter does.
    `bias` is the constant part [rad/s]; drawn, and within `CUT` sigmas, if None.
    """
    stamps = course.stamps(model.rate)
    stamps = stamps[keep(stamps.size, model.dropout, rng)]
    before, after = _around(course, stamps, model.rate)
    turned = course.poses_at(after)[:, 2] - course.poses_at(before)[:, 2]
    if bias is None:
        bias = model.bias_sigma * float(cut_normal(rng, 1)[0])
    rate = turned / ((after - before) * 1e-9) + bias
    rate += _walk(stamps, model.bias_walk, rng)
    rate += model.density * np.sqrt(model.rate) * rng.standard_normal(stamps.size)
    quantised = _quantised(rate, model.resolution)
    density = max(model.density, FLOOR)
    return YawRate("gyro", stamps, quantised, density, model.bias_sigma, model.bias_walk)


def measure_acceleration(
    course: Course, model: AccelerometerModel, rng: np.random.Generator
) -> Acceleration:
    """Return the acceleration along body x: dv_x/dt − ω v_y plus bias and white noise, quantised.

    dv_x/dt is a difference over the sample period around the stamp.
    """
    stamps = course.stamps(model.rate)
    stamps = stamps[keep(stamps.size, model.dropout, rng)]
    before, after = _around(course, stamps, model.rate)
    change = course.twists_at(after)[:, 0] - course.twists_at(before)[:, 0]
    twist = course.twists_at(stamps)
    forward = change / ((after - before) * 1e-9) - twist[:, 2] * twist[:, 1]
    forward = forward + model.bias_sigma * cut_normal(rng, 1)
    forward += model.sigma * rng.standard_normal(stamps.size)
    return Acceleration("acc", stamps, _quantised(forward, model.resolution))


def measure_camera(
    course: Course, model: CameraModel, rng: np.random.Generator, off: Floats | None = None
) -> tuple[CameraPoses, dict[str, float]]:
    """Return the camera's odometry and its true mount and scale by parameter name.

    Steps between poses are scaled, disturbed in proportion to the square root of the distance,
    and chained; each pose then has white noise of its own. `off` (4,) are the errors of mount
    (x, y, yaw) and scale in sigmas; drawn, and within `CUT`, if None.
    """
    drawn = cut_normal(rng, 4) if off is None else off
    nominal = (model.x, model.y, model.yaw)
    spread = (model.mount_sigma, model.mount_sigma, model.yaw_sigma)
    mount = np.array(nominal) + np.array(spread) * drawn[:3]
    scale = 1.0 + model.scale_sigma * float(drawn[3])
    stamps = course.stamps(model.rate)
    true = geometry.compose(course.poses_at(stamps), mount)
    steps = geometry.between(true[:-1], true[1:])
    root = np.sqrt(np.hypot(steps[:, 0], steps[:, 1]))[:, None]
    walk = np.array([model.position_walk, model.position_walk, model.heading_walk])
    steps[:, :2] *= scale
    steps += walk * root * rng.standard_normal(steps.shape)
    # A chained pose step is not a twist: log makes it one, so that exact chaining applies.
    poses = geometry.integrate(geometry.log(steps), np.zeros(3), geometry.EXACT)
    white = np.array([model.position_sigma, model.position_sigma, model.heading_sigma])
    poses += white * rng.standard_normal(poses.shape)
    kept = keep(stamps.size, model.dropout, rng)
    camera = CameraPoses(
        "camera",
        stamps[kept],
        poses[kept],
        model.position_walk,
        model.heading_walk,
        max(model.position_sigma, FLOOR),
        max(model.heading_sigma, FLOOR),
        nominal,
        spread,
        model.scale_sigma,
    )
    names = ("camera_x", "camera_y", "camera_yaw")
    truth = {n: float(v) for n, v in zip(names, mount, strict=True)}
    return camera, truth | {"camera_scale": scale}


def measure_fixes(
    course: Course, model: FixModel, rng: np.random.Generator
) -> tuple[PositionFixes, dict[str, float]]:
    """Return position fixes and, where drawn, the true antenna position by parameter name."""
    nominal = (model.x, model.y)
    mount = np.array(nominal) + model.mount_sigma * cut_normal(rng, 2)
    stamps = course.stamps(1.0 / model.every)[1:]
    poses = course.poses_at(stamps)
    lever = np.append(mount, 0.0)
    positions = geometry.compose(poses, lever)[:, :2]
    positions = positions + model.sigma * rng.standard_normal(positions.shape)
    kept = rng.random(stamps.size) >= model.dropout
    fixes = PositionFixes(
        "fixes",
        stamps[kept],
        positions[kept],
        np.full((int(kept.sum()), 2), model.sigma),
        nominal,
        (model.mount_sigma, model.mount_sigma),
    )
    if model.mount_sigma > 0.0:
        return fixes, {"fixes_x": float(mount[0]), "fixes_y": float(mount[1])}
    return fixes, {}


def measure_all(course: Course, spec: SimSpec) -> tuple[tuple[Sensor, ...], dict[str, float]]:
    """Return all streams but the wheels that the spec switches on, and their true calibration."""
    sensors: list[Sensor] = []
    truth: dict[str, float] = {}
    if spec.yaw.on:
        sensors.append(measure_yaw(course, spec.yaw, generator(spec.seed, "yaw")))
    if spec.gyro.on:
        sensors.append(measure_gyro(course, spec.gyro, generator(spec.seed, "gyro")))
    if spec.acc.on:
        sensors.append(measure_acceleration(course, spec.acc, generator(spec.seed, "acc")))
    if spec.camera.on:
        camera, mount = measure_camera(course, spec.camera, generator(spec.seed, "camera"))
        sensors.append(camera)
        truth |= mount
    if spec.fix.every > 0.0:
        fixes, mount = measure_fixes(course, spec.fix, generator(spec.seed, "fix"))
        sensors.append(fixes)
        truth |= mount
    return tuple(sensors), truth
