"""Which columns of state and calibration belong to which sensor, before anything is measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from fgloc.core.drive import Reference
from fgloc.core.kinematics import Parameter
from fgloc.core.measurements import (
    CameraPoses,
    Floats,
    PoseFixes,
    PositionFixes,
    Sensor,
    Yaw,
    YawRate,
)
from fgloc.core.robot import Robot
from fgloc.smoothing.build import FREE_HEADING, KNOWN, mount_parameters


@dataclass(frozen=True)
class Place:
    """Where one sensor's unknowns are."""

    block: slice = field(default_factory=lambda: slice(0, 0))
    """Columns of the calibration vector."""
    slot: int = -1
    """State column of a drifting zero, -1 for none."""


@dataclass(frozen=True)
class Layout:
    """The unknowns of one robot with its sensors."""

    robot: Robot
    """Nominal robot."""
    free: tuple[int, ...]
    """Indices of the robot's parameters that are variables."""
    parameters: tuple[Parameter, ...]
    """All G calibration variables: the robot's free ones, then sensor blocks."""
    places: dict[str, Place]
    """Unknowns by sensor name."""
    width: int
    """B, the width of a keyframe's state."""

    @property
    def size(self) -> int:
        """Return B + G."""
        return self.width + len(self.parameters)

    def values(self, u: Floats) -> Floats:
        """Return the robot's physical parameter values at solver variables u (G,)."""
        values = self.robot.base.nominal()
        for k, index in enumerate(self.free):
            values[index] = self.parameters[k].to_value(float(u[k]))
        return values


class _Columns:
    """Hands out columns."""

    def __init__(self, robot: Robot) -> None:
        base = robot.base.parameters
        self.free = tuple(k for k, p in enumerate(base) if p.prior_sigma > 0.0)
        self.parameters: list[Parameter] = [base[k] for k in self.free]
        self.width = 3
        self.blocks: dict[str, slice] = {}

    def block(self, name: str, parameters: list[Parameter]) -> slice:
        """Return the columns of a block, made on first use."""
        if name not in self.blocks:
            begin = len(self.parameters)
            self.parameters += parameters
            self.blocks[name] = slice(begin, len(self.parameters))
        return self.blocks[name]

    def mount(self, name: str, nominal: tuple[float, ...], sigma: tuple[float, ...]) -> slice:
        """Return the columns of a mounting, an empty slice where it is known exactly."""
        if not any(s > 0.0 for s in sigma):
            return slice(0, 0)
        return self.block(f"{name} mount", mount_parameters(name, nominal, sigma))

    def slot(self) -> int:
        """Return a new state column."""
        self.width += 1
        return self.width - 1


def _yaw(c: _Columns, sensor: Yaw) -> Place:
    """Return the place of a heading's zero and its constant drift."""
    variables, slot = [], -1
    if sensor.drift_sigma > 0.0:
        slot = c.slot()
    else:
        variables.append(Parameter(f"{sensor.sensor}_zero", 0.0, FREE_HEADING, "rad"))
    if sensor.drift_rate_sigma > 0.0:
        variables.append(Parameter(f"{sensor.sensor}_drift", 0.0, sensor.drift_rate_sigma, "rad/s"))
    return Place(c.block(sensor.sensor, variables) if variables else slice(0, 0), slot)


def _gyro(c: _Columns, sensor: YawRate) -> Place:
    """Return the place of a gyro's bias."""
    if sensor.bias_walk > 0.0:
        return Place(slot=c.slot())
    sigma = max(sensor.bias_sigma, KNOWN)
    return Place(c.block(sensor.sensor, [Parameter(f"{sensor.sensor}_bias", 0.0, sigma, "rad/s")]))


def _camera(c: _Columns, sensor: CameraPoses) -> Place:
    """Return the place of a camera's mounting and scale."""
    name = sensor.sensor
    parameters = mount_parameters(name, sensor.mount, sensor.mount_sigma)
    parameters.append(Parameter(f"{name}_scale", 1.0, max(sensor.scale_sigma, KNOWN), "1"))
    return Place(c.block(name, parameters))


def make_layout(robot: Robot, sensors: Sequence[Sensor], reference: Reference | None) -> Layout:
    """Return the unknowns of a robot with these sensors (their data are not looked at).

    `reference` is what the start is measured with; its mounting may be an unknown.
    """
    c = _Columns(robot)
    places: dict[str, Place] = {"start": Place()}
    if reference is not None:
        block = c.mount(reference.sensor, reference.mount, reference.mount_sigma)
        places["start"] = Place(block)
    for sensor in sensors:
        if isinstance(sensor, Yaw):
            places[sensor.sensor] = _yaw(c, sensor)
        elif isinstance(sensor, YawRate):
            places[sensor.sensor] = _gyro(c, sensor)
        elif isinstance(sensor, CameraPoses):
            places[sensor.sensor] = _camera(c, sensor)
        elif isinstance(sensor, PositionFixes | PoseFixes):
            name = sensor.mount_name or sensor.sensor
            places[sensor.sensor] = Place(c.mount(name, sensor.mount, sensor.mount_sigma))
    return Layout(robot, c.free, tuple(c.parameters), places, c.width)
