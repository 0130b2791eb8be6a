"""What each kind of sensor adds to the graph: its unknowns and its noise; for both engines."""

from __future__ import annotations

import numpy as np

from fgloc.core.kinematics import Parameter
from fgloc.core.measurements import CameraPoses, Floats, Yaw, YawRate
from fgloc.core.robot import Robot

KNOWN = 1e-6
"""Sigma [m, rad] that stands for "known exactly" where a block has some free components."""
FREE_HEADING = np.pi
"""Prior sigma of an unknown heading [rad]."""


class Columns:
    """Hands out the columns of the calibration vector and of the keyframe state."""

    def __init__(self, robot: Robot) -> None:
        base = robot.base.parameters
        self.free = tuple(k for k, p in enumerate(base) if p.prior_sigma > 0.0)
        self.parameters: list[Parameter] = [base[k] for k in self.free]
        self.width = 3
        self._blocks: dict[str, slice] = {}

    def block(self, name: str, parameters: list[Parameter]) -> slice:
        """Return the columns of a calibration block, made on first use; empty for no parameters."""
        if not parameters:
            return slice(0, 0)
        if name not in self._blocks:
            begin = len(self.parameters)
            self.parameters += parameters
            self._blocks[name] = slice(begin, len(self.parameters))
        return self._blocks[name]

    def mount(self, name: str, nominal: tuple[float, ...], sigma: tuple[float, ...]) -> slice:
        """Return the columns of a mounting block, or an empty slice where it is known exactly."""
        if not any(s > 0.0 for s in sigma):
            return slice(0, 0)
        return self.block(f"{name} mount", mount_parameters(name, nominal, sigma))

    def slot(self) -> int:
        """Return a new state column for a drifting zero."""
        self.width += 1
        return self.width - 1


def mount_parameters(
    name: str, nominal: tuple[float, ...], sigma: tuple[float, ...]
) -> list[Parameter]:
    """Return `<name>_x`, `_y` and, for a pose, `_yaw`: where a sensor sits on the robot."""
    labels = (("_x", "m"), ("_y", "m"), ("_yaw", "rad"))
    return [
        Parameter(name + suffix, value, max(s, KNOWN), unit)
        for (suffix, unit), value, s in zip(labels, nominal, sigma, strict=False)
    ]


def yaw_parameters(sensor: Yaw, zero: float = 0.0) -> list[Parameter]:
    """Return a heading sensor's constant zero, unless that wanders, and its constant drift."""
    parameters = []
    if not sensor.drift_sigma > 0.0:
        parameters.append(Parameter(f"{sensor.sensor}_zero", zero, FREE_HEADING, "rad"))
    if sensor.drift_rate_sigma > 0.0:
        name = f"{sensor.sensor}_drift"
        parameters.append(Parameter(name, 0.0, sensor.drift_rate_sigma, "rad/s"))
    return parameters


def bias_sigma(sensor: YawRate) -> float:
    """Return the prior sigma of a gyro's bias [rad/s]."""
    return max(sensor.bias_sigma, KNOWN)


def gyro_parameters(sensor: YawRate) -> list[Parameter]:
    """Return a gyro's bias, unless that wanders."""
    if sensor.bias_walk > 0.0:
        return []
    return [Parameter(f"{sensor.sensor}_bias", 0.0, bias_sigma(sensor), "rad/s")]


def camera_parameters(sensor: CameraPoses) -> list[Parameter]:
    """Return a camera's mounting and scale."""
    parameters = mount_parameters(sensor.sensor, sensor.mount, sensor.mount_sigma)
    scale = Parameter(f"{sensor.sensor}_scale", 1.0, max(sensor.scale_sigma, KNOWN), "1")
    return [*parameters, scale]


def yaw_sigma(sensor: Yaw, rounding: Floats) -> float:
    """Return the sigma of a heading [rad] at a keyframe that is rounded by `rounding` (3,)."""
    return float(np.hypot(sensor.sigma, rounding[2]))


def gyro_sigma(sensor: YawRate, seconds: Floats, rounding: Floats) -> Floats:
    """Return the sigma (M,) of the angle [rad] that a gyro turned in `seconds` (M,)."""
    white = sensor.density * np.sqrt(seconds)
    return np.asarray(np.hypot(white, np.sqrt(2.0) * rounding[2]))


def camera_sigma(sensor: CameraPoses, motion: Floats, rounding: Floats) -> Floats:
    """Return the sigmas (M, 3) of a camera's motions (M, 3) between two keyframes."""
    path = np.hypot(motion[:, 0], motion[:, 1])
    sigma = np.empty((path.size, 3))
    sigma[:, :2] = np.sqrt(sensor.position_walk**2 * path + sensor.position_sigma**2)[:, None]
    sigma[:, 2] = np.sqrt(sensor.heading_walk**2 * path + sensor.heading_sigma**2)
    return np.asarray(np.hypot(sigma, np.sqrt(2.0) * rounding))


def fix_sigma(sigma: Floats, rounding: Floats) -> Floats:
    """Return the sigmas (..., 2 or 3) of fixes of a pose that rounded counts tell."""
    # Fixes have map axes; the larger of the body's is at most a millimetre too cautious.
    along = float(rounding[:2].max())
    own = np.array([along, along, rounding[2]])[: sigma.shape[-1]]
    return np.asarray(np.hypot(sigma, own))
