"""Frozen descriptions of the simulated sensors: rate, noise, quantisation, drift and dropout."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class EncoderModel:
    """Wheel encoders."""

    ticks: int = -1
    """Counts per wheel revolution; 0 continuous, -1 as the robot has."""
    noise: float = 0.0
    """Half-width of uniform noise added to every increment [counts] (the seed: 0.5)."""
    dropout: float = 0.0
    """Probability that a packet is lost; the counts go on, the interval becomes longer."""


@dataclass(frozen=True)
class YawModel:
    """Absolute heading of an IMU, wrapped to ±π as IMUs report it."""

    on: bool = True
    """Whether the sensor is there."""
    rate: float = 50.0
    """Samples per second [Hz]."""
    sigma: float = 0.002
    """White noise of one reading before quantisation [rad]."""
    resolution: float = 0.01
    """Quantisation step [rad]; 0 for none."""
    drift: float = 0.01 / 7.0
    """Constant drift of the zero [rad/s]; the Jaguar's IMU steps 0.01 rad every 7 s at rest."""
    walk: float = 0.0005
    """Random walk of the zero [rad/sqrt(s)]."""
    zero: float = 0.0
    """Reading for heading 0 at the start [rad]."""
    dropout: float = 0.0
    """Probability that a sample is lost."""


@dataclass(frozen=True)
class GyroModel:
    """Yaw-rate gyro."""

    on: bool = False
    """Whether the sensor is there."""
    rate: float = 50.0
    """Samples per second [Hz]."""
    density: float = 0.0005
    """White noise density [rad/s/sqrt(Hz)]."""
    bias_sigma: float = 0.01
    """The constant bias is drawn with this sigma [rad/s]."""
    bias_walk: float = 0.0001
    """Random walk of the bias [rad/s/sqrt(s)]."""
    resolution: float = 0.0
    """Quantisation step [rad/s]; 0 for none."""
    dropout: float = 0.0
    """Probability that a sample is lost."""


@dataclass(frozen=True)
class AccelerometerModel:
    """Accelerometer along body x."""

    on: bool = False
    """Whether the sensor is there."""
    rate: float = 50.0
    """Samples per second [Hz]."""
    sigma: float = 0.05
    """White noise of one sample [m/s²]."""
    bias_sigma: float = 0.02
    """The constant bias is drawn with this sigma [m/s²]."""
    resolution: float = 9.81 / 255.0
    """Quantisation step [m/s²]: 255 counts are about 1 g on the Jaguar; 0 for none."""
    dropout: float = 0.0
    """Probability that a sample is lost."""


@dataclass(frozen=True)
class CameraModel:
    """Visual-inertial odometry of the T265 kind, in a frame that starts at the camera's pose."""

    on: bool = False
    """Whether the sensor is there."""
    rate: float = 30.0
    """Poses per second [Hz]."""
    x: float = 0.2
    """Nominal position on the robot, forward [m]."""
    y: float = 0.0
    """Nominal position on the robot, left [m]."""
    yaw: float = 0.0
    """Nominal heading on the robot [rad]."""
    mount_sigma: float = 0.02
    """The true position on the robot differs by this sigma, x and y [m]."""
    yaw_sigma: float = 0.035
    """The true heading on the robot differs by this sigma [rad]."""
    scale_sigma: float = 0.01
    """The scale error is drawn with this sigma."""
    position_walk: float = 0.005
    """Random walk of the position over distance [m/sqrt(m)]."""
    heading_walk: float = 0.003
    """Random walk of the heading over distance [rad/sqrt(m)]."""
    position_sigma: float = 0.001
    """White noise of one position [m]."""
    heading_sigma: float = 0.001
    """White noise of one heading [rad]."""
    dropout: float = 0.0
    """Probability that a pose is lost."""


@dataclass(frozen=True)
class FixModel:
    """Absolute position fixes of a GPS antenna or a total station's prism."""

    every: float = 0.0
    """Time between fixes [s]; 0 for no fixes. The first comes after this time."""
    sigma: float = 0.05
    """White noise along map x and y [m]."""
    x: float = 0.0
    """Nominal antenna position on the robot, forward [m]."""
    y: float = 0.0
    """Nominal antenna position on the robot, left [m]."""
    mount_sigma: float = 0.0
    """The true antenna position differs by this sigma [m]; 0 means known exactly."""
    dropout: float = 0.0
    """Probability that a fix is lost."""


@dataclass(frozen=True)
class LidarModel:
    """A turning lidar of the RPLIDAR kind; only in drives that have a world."""

    kind: str = "off"
    """a1 (0.15-8 m, 1 %), a2 (0.2-12 m, 0.75 %) or off."""
    rate: float = 10.0
    """Turns per second [Hz]."""
    beams: int = 400
    """Beams a turn."""
    share: float = -1.0
    """White noise of a range as a share of it; -1 as the device has."""
    range_sigma: float = 0.003
    """White noise of a range that does not grow with it [m]."""
    angle_sigma: float = 0.0026
    """White noise of a beam's direction [rad]."""
    dropout: float = 0.02
    """Probability that a beam does not return."""
    x: float = 0.15
    """Nominal position on the robot, forward [m]."""
    y: float = 0.0
    """Nominal position on the robot, left [m]."""
    yaw: float = 0.0
    """Nominal heading on the robot [rad]."""
    mount_sigma: float = 0.005
    """The true position on the robot differs by this sigma, x and y [m]."""
    yaw_sigma: float = 0.003
    """The true heading on the robot differs by this sigma [rad]."""
