"""What is tuned about each baseline: its noise parameters, their ranges, how it is built.

A method's parameters are those of the sensors on the drives at hand: the noise of a camera that no
drive has would only use up the budget. The smoothers have none here. They run with the noise that
the drives state.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from fgloc.core.drive import Drive
from fgloc.core.measurements import (
    CameraPoses,
    PoseFixes,
    PositionFixes,
    Sensor,
    Yaw,
    YawRate,
)
from fgloc.errors import FglocError
from fgloc.estimator import Estimator, Result
from fgloc.experiments.tuning import Tunable
from fgloc.experiments.tuning_search import Bounds, Values
from fgloc.filters.model3 import Model3, Model3Settings
from fgloc.filters.pose_ekf import PoseEkf
from fgloc.filters.pose_ekf_settings import PoseEkfSettings
from fgloc.filters.rl_ekf import RlEkf, default_config
from fgloc.io.ekf_config import PROCESS_NOISE, diagonal

VARIANCE = 1000.0
"""A variance is searched from a thousandth to the thousandfold of its default."""
SIGMA = 30.0
"""A standard deviation, or a factor on one, likewise: some thirty times less or more."""

Kinds = tuple[type[Sensor], ...]
FIXES: Kinds = (PositionFixes, PoseFixes)


@dataclass(frozen=True)
class Noise:
    """One noise parameter of a method."""

    bounds: Bounds
    """Where it is searched."""
    kinds: Kinds = ()
    """It matters where a drive has a stream of one of these; always where none is named."""


def around(default: float, factor: float) -> Bounds:
    """Return the range from a default divided by a factor to the default times it."""
    return Bounds(default / factor, default * factor, default)


MODEL3 = {
    name: Noise(around(getattr(Model3Settings(), name), VARIANCE))
    for name in ("heading_variance", "track_variance", "yaw_variance")
}
"""Q and R of Model 3. The process noise of x and y stays: no reading tells of the position, so it
changes the covariance and never the estimate."""

POSE_EKF = {
    name: Noise(around(getattr(PoseEkfSettings(), name), SIGMA), kinds)
    for name, kinds in {
        "process_noise": (),
        "calibration": (),
        "horizon_s": (),
        "camera_position": (CameraPoses,),
        "camera_heading": (CameraPoses,),
        "camera_growth": (CameraPoses,),
        "yaw": (Yaw,),
        "yaw_drift": (Yaw,),
        "gyro": (YawRate,),
        "fix": FIXES,
    }.items()
}
"""All factors of the pose EKF on noise, and for how long it takes lasting errors to last. Gates are
no noise, and stay."""

RL_EKF = {
    "position_variance": Noise(around(PROCESS_NOISE[0], VARIANCE)),
    "heading_variance": Noise(around(PROCESS_NOISE[2], VARIANCE)),
    "velocity_variance": Noise(around(PROCESS_NOISE[3], VARIANCE)),
    "rate_variance": Noise(around(PROCESS_NOISE[5], VARIANCE)),
    "acceleration_variance": Noise(around(PROCESS_NOISE[6], VARIANCE)),
    "camera_position": Noise(around(1.0, SIGMA), (CameraPoses,)),
    "camera_heading": Noise(around(1.0, SIGMA), (CameraPoses,)),
    "yaw": Noise(around(1.0, SIGMA), (Yaw,)),
    "gyro": Noise(around(1.0, SIGMA), (YawRate,)),
    "fix": Noise(around(1.0, SIGMA), FIXES),
}
"""Process noise a second of the robot_localization-like filter, and factors on the sigmas that the
drive's sensors state: that filter takes a measurement's covariance from its message. The wheels'
sigmas stay: to multiply all noise by one number changes nothing."""


@dataclass(frozen=True)
class TunedRlEkf:
    """The robot_localization-like filter in its default configuration with other noise."""

    values: Values
    """Some of the parameters of `RL_EKF`; the others stay."""

    @property
    def method(self) -> str:
        """Return the method id."""
        return "rl-ekf"

    def estimate(self, drive: Drive) -> Result:
        """Return what the filter makes of the drive; raises FglocError as it does."""
        used = {name: n.bounds.default for name, n in RL_EKF.items()} | dict(self.values)
        position, heading, speed, rate, force = (
            used[f"{what}_variance"]
            for what in ("position", "heading", "velocity", "rate", "acceleration")
        )
        noise = diagonal((position, position, heading, speed, speed, rate, force, force))
        factors = {name: f for name, f in used.items() if not name.endswith("_variance")}
        config = replace(default_config(drive), process_noise=noise)
        return RlEkf(config).estimate(with_noise(drive, factors))


def with_noise(drive: Drive, factors: Mapping[str, float]) -> Drive:
    """Return the drive with the sigmas that it states multiplied, by kind of measurement.

    "wheels" (all of the robot's wheel noise), "camera_position", "camera_heading" (of one pose),
    "yaw", "gyro", "fix"; 1 where a kind is not named.
    """
    f = dict.fromkeys(("wheels", "camera_position", "camera_heading", "yaw", "gyro", "fix"), 1.0)
    f |= factors

    def scaled(sensor: Sensor) -> Sensor:
        if isinstance(sensor, Yaw):
            return replace(sensor, sigma=f["yaw"] * sensor.sigma)
        if isinstance(sensor, YawRate):
            density, bias = f["gyro"] * sensor.density, f["gyro"] * sensor.bias_sigma
            return replace(sensor, density=density, bias_sigma=bias)
        if isinstance(sensor, CameraPoses):
            return replace(
                sensor,
                position_sigma=f["camera_position"] * sensor.position_sigma,
                heading_sigma=f["camera_heading"] * sensor.heading_sigma,
            )
        if isinstance(sensor, PositionFixes | PoseFixes):
            return replace(sensor, sigma=f["fix"] * sensor.sigma)
        return sensor

    noise = drive.robot.noise
    wheels = {name: f["wheels"] * value for name, value in vars(noise).items()}
    robot = replace(drive.robot, noise=replace(noise, **wheels))
    return replace(drive, robot=robot, sensors=tuple(map(scaled, drive.sensors)))


def build_model3(values: Values) -> Estimator:
    """Return Model 3 with these variances."""
    named: dict[str, Any] = dict(values)
    return Model3(Model3Settings(**named))


def build_pose_ekf(values: Values) -> Estimator:
    """Return the pose EKF with these factors."""
    named: dict[str, Any] = dict(values)
    return PoseEkf(PoseEkfSettings(**named))


def build_rl_ekf(values: Values) -> Estimator:
    """Return the robot_localization-like filter with this noise."""
    return TunedRlEkf(values)


TUNABLE = {
    "model3": (MODEL3, build_model3),
    "pose-ekf": (POSE_EKF, build_pose_ekf),
    "rl-ekf": (RL_EKF, build_rl_ekf),
}
"""Noise parameters and builder by method id."""


def tunable(method: str, drives: Sequence[Drive]) -> Tunable:
    """Return what is tuned about a method on these drives.

    Raises FglocError for a method without noise parameters.
    """
    if method not in TUNABLE:
        raise FglocError(f"{method} cannot be tuned; choose from {', '.join(TUNABLE)}")
    parameters, build = TUNABLE[method]
    there = {type(sensor) for drive in drives for sensor in drive.sensors}
    chosen = {
        name: noise.bounds
        for name, noise in parameters.items()
        if not noise.kinds or there.intersection(noise.kinds)
    }
    return Tunable(method, chosen, build)
