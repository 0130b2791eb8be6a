"""A robot: its kinematics with priors, and how noisy its wheels are."""

from __future__ import annotations

from dataclasses import dataclass

from fgloc.core.kinematics import WheeledBase


@dataclass(frozen=True)
class WheelNoise:
    """Noise of wheel odometry: white over distance, so it does not depend on the sampling rate."""

    rolling: float = 0.01
    """Slip along the rolling direction: sigma of the travelled distance [m/sqrt(m)]."""
    lateral: float = 0.005
    """Side slip: sigma of the sideways displacement [m/sqrt(m)]."""
    turning: float = 0.02
    """Scrub when turning: sigma of the heading [rad/sqrt(rad)] over the turned angle."""
    standing: float = 1e-4
    """Floor for a standing robot [m/sqrt(s)], so that no interval is certain."""
    standing_turn: float = 5e-4
    """The same floor for the heading [rad/sqrt(s)]."""


@dataclass(frozen=True)
class Robot:
    """What a drive says of its robot before anything is estimated."""

    name: str
    """Name in tables, e.g. "Jaguar 4x4"."""
    base: WheeledBase
    """Wheels and calibration parameters at their nominal values, with priors."""
    noise: WheelNoise = WheelNoise()
    """Noise of the wheel odometry."""
