"""Semi-real drives: a recording with a camera and a gyro synthesised from its recorded truth.

No recording of wheels and truth has a tracking camera or a gyro as well. So these two are made from
the truth, with error models of the parts that seed D's robot carried; wheels and truth stay as
they were recorded. Everything drawn comes from the seed:

- camera, like an Intel RealSense T265: poses at 30 Hz in a frame of its own; its place on the robot
  is off by N(0, 2 cm) along each axis and its heading there by N(0, 2°), the same for all drives of
  a robot with the same seed (it is mounted once); its scale by N(0, 1 %), for each drive anew; its
  position walks by 3 mm/√m and its heading by 0.15°/√m.
- gyro, like an MPU6050: yaw rate at 100 Hz with white noise of 0.005 °/s/√Hz, a constant bias of
  0.5 °/s whose sign is drawn for each drive, and a walk of the bias of 0.002 °/s/√s.

Estimators are told these sigmas (0.5 °/s for the bias: what a fixed size with either sign has), the
nominal place, and never what was drawn. What was drawn is in `Drive.true_calibration`.

A sensor cannot be better than the truth that it is made of. Where smoothing leaves more noise than
`NOISY`, estimators are told of it as well, and so is the user.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.measurements import CameraPoses, Sensor, YawRate
from fgloc.datasets.simulator.models import CameraModel, GyroModel
from fgloc.datasets.simulator.recorded_course import RecordedCourse, record
from fgloc.datasets.simulator.sensors import measure_camera, measure_gyro
from fgloc.datasets.simulator.streams import generator
from fgloc.errors import FglocError

DEGREE = math.pi / 180.0

T265 = CameraModel(
    on=True,
    rate=30.0,
    x=0.15,
    mount_sigma=0.02,
    yaw_sigma=2.0 * DEGREE,
    scale_sigma=0.01,
    position_walk=0.003,
    heading_walk=0.15 * DEGREE,
    position_sigma=0.0,
    heading_sigma=0.0,
)
"""The camera, nominally 15 cm ahead of the robot's centre and looking forward."""
MPU6050 = GyroModel(
    on=True,
    rate=100.0,
    density=0.005 * DEGREE,
    bias_sigma=0.5 * DEGREE,
    bias_walk=0.002 * DEGREE,
)
"""The gyro."""
NOISY = 3e-4
"""Noise of the smoothed truth [m, rad] from which on it is part of what sensors state: about what
gyro and camera wander in some seconds anyway."""
STEADY_S = 0.1
"""Time over which a gyro that differences a noisy heading is stated as uncertain as that [s]."""
LABEL = "semi-real"
"""What such drives are called wherever they are shown."""


@dataclass(frozen=True)
class SemiRealSpec:
    """What is synthesised, and from which seed."""

    seed: int = 0
    """Seed of everything drawn, not negative."""
    camera: CameraModel = field(default_factory=lambda: T265)
    """The camera; its rate, place and errors."""
    gyro: GyroModel = field(default_factory=lambda: MPU6050)
    """The gyro."""

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise FglocError(f"seed={self.seed}: a seed must not be negative")


def parse(query: str) -> SemiRealSpec:
    """Return the spec of "seed=3&camera=on&gyro=off", or of "" with seed 0.

    Raises FglocError for an unknown key or value, with what there is.
    """
    spec = SemiRealSpec()
    for item in query.split("&") if query else []:
        key, _, value = item.partition("=")
        if key == "seed" and value.isdecimal():
            spec = replace(spec, seed=int(value))
        elif key in ("camera", "gyro") and value in ("on", "off"):
            model = replace(getattr(spec, key), on=value == "on")
            spec = replace(spec, **{key: model})
        else:
            raise FglocError(
                f"semi: {item!r} is not known; write seed=N, camera=on|off or gyro=on|off, "
                "e.g. semi:vitko-swerve:1?seed=3&gyro=off"
            )
    return spec


def with_semi_real(drive: Drive, spec: SemiRealSpec, name: str | None = None) -> Drive:
    """Return the drive with a camera and a gyro synthesised from its recorded truth.

    `name` is the id of the new drive, the old one's if None. The streams are called "camera" and
    "gyro", or "semi_camera" and "semi_gyro" where the recording has such names. Where the place of
    the reference on the robot is uncertain, so is the camera's, by as much more. Deterministic.
    Raises FglocError as `record` does, or if nothing is switched on. O(duration).
    """
    if not (spec.camera.on or spec.gyro.on):
        raise FglocError(f"{drive.name}: camera and gyro are both off, nothing is semi-real")
    recorded = record(drive)
    taken = {s.sensor for s in drive.sensors}
    truth: dict[str, float] = {}
    sensors: list[Sensor] = []
    if spec.camera.on:
        sensors.append(_camera(drive, recorded, spec, taken, truth))
    if spec.gyro.on:
        sensors.append(_gyro(drive, recorded, spec, taken, truth))
    sensors = [_as_noisy(s, recorded.noise) for s in sensors]
    made = " and ".join(s.sensor for s in sensors)
    note = (
        f"{LABEL}: {made} synthesised from the recorded truth, seed {spec.seed}; "
        "wheels and truth as recorded."
    )
    notes = [note]
    if max(recorded.noise) > NOISY:
        millis = [1e3 * sigma for sigma in recorded.noise]
        notes.append(
            f"{LABEL}: the truth is noisy, {max(millis[:2]):.2g} mm and {millis[2]:.2g} mrad are "
            f"left when it is smoothed; {made} state this noise beside their own, but share it, "
            "which no estimator expects: compare with care."
        )
    return replace(
        drive,
        name=drive.name if name is None else name,
        sensors=(*drive.sensors, *sensors),
        notes=(*drive.notes, *notes),
        true_calibration={**(drive.true_calibration or {}), **truth},
    )


def _as_noisy(sensor: Sensor, noise: tuple[float, float, float]) -> Sensor:
    """Return the sensor with the noise of the truth that it was made of as part of its own."""
    if max(noise) <= NOISY:
        return sensor
    if isinstance(sensor, CameraPoses):
        return replace(
            sensor,
            position_sigma=math.hypot(sensor.position_sigma, *noise[:2]),
            heading_sigma=math.hypot(sensor.heading_sigma, noise[2]),
        )
    assert isinstance(sensor, YawRate)
    # The angle between two times is off by the noise at both of them.
    return replace(sensor, density=math.hypot(sensor.density, noise[2] * math.sqrt(2.0 / STEADY_S)))


def _name(kind: str, taken: set[str]) -> str:
    """Return what a stream is called beside those that the recording has."""
    return f"semi_{kind}" if kind in taken else kind


def _camera(
    drive: Drive,
    recorded: RecordedCourse,
    spec: SemiRealSpec,
    taken: set[str],
    truth: dict[str, float],
) -> Sensor:
    """Return the camera's poses, and add its true place and scale to `truth`."""
    assert drive.truth is not None
    off = np.empty(4)
    off[:3] = generator(spec.seed, "mount", drive.robot.name).standard_normal(3)
    rng = generator(spec.seed, "camera", drive.name)
    off[3] = rng.standard_normal()
    camera, found = measure_camera(recorded.course, spec.camera, rng, off)
    name = _name("camera", taken)
    truth |= {key.replace("camera", name, 1): value for key, value in found.items()}
    known = recorded.known(camera.stamps_ns)
    spread = np.hypot(camera.mount_sigma, drive.truth.mount_sigma).tolist()
    return replace(
        camera,
        sensor=name,
        stamps_ns=camera.stamps_ns[known] + recorded.begin_ns,
        poses=camera.poses[known],
        mount_sigma=(spread[0], spread[1], spread[2]),
    )


def _gyro(
    drive: Drive,
    recorded: RecordedCourse,
    spec: SemiRealSpec,
    taken: set[str],
    truth: dict[str, float],
) -> Sensor:
    """Return the gyro's rates, and add its true constant bias to `truth`."""
    rng = generator(spec.seed, "gyro", drive.name)
    bias = spec.gyro.bias_sigma * float(rng.choice((-1.0, 1.0)))
    gyro = measure_gyro(recorded.course, spec.gyro, rng, bias)
    name = _name("gyro", taken)
    truth[f"{name}_bias"] = bias
    known = recorded.known(gyro.stamps_ns)
    return replace(
        gyro,
        sensor=name,
        stamps_ns=gyro.stamps_ns[known] + recorded.begin_ns,
        rate=gyro.rate[known],
    )
