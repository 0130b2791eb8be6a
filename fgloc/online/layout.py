"""Which columns of state and calibration belong to which sensor, before anything is measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from fgloc.core.drive import Reference
from fgloc.core.kinematics import Parameter
from fgloc.core.measurements import (
    CameraPoses,
    Floats,
    LandmarkSightings,
    PoseFixes,
    PositionFixes,
    Scans,
    Sensor,
    Yaw,
    YawRate,
)
from fgloc.core.robot import Robot
from fgloc.smoothing.problem import physical_values
from fgloc.smoothing.sensors import Columns, camera_parameters, gyro_parameters, yaw_parameters


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
        return physical_values(self.robot, self.free, self.parameters, u)


def make_layout(robot: Robot, sensors: Sequence[Sensor], reference: Reference | None) -> Layout:
    """Return the unknowns of a robot with these sensors (their data are not looked at).

    `reference` is what the start is measured with; its mounting may be an unknown.
    """
    c = Columns(robot)
    places: dict[str, Place] = {"start": Place()}
    if reference is not None:
        block = c.mount(reference.sensor, reference.mount, reference.mount_sigma)
        places["start"] = Place(block)
    for sensor in sensors:
        name = sensor.sensor
        if isinstance(sensor, Yaw):
            slot = c.slot() if sensor.drift_sigma > 0.0 else -1
            places[name] = Place(c.block(name, yaw_parameters(sensor)), slot)
        elif isinstance(sensor, YawRate):
            slot = c.slot() if sensor.bias_walk > 0.0 else -1
            places[name] = Place(c.block(name, gyro_parameters(sensor)), slot)
        elif isinstance(sensor, CameraPoses):
            places[name] = Place(c.block(name, camera_parameters(sensor)))
        elif isinstance(sensor, PositionFixes | PoseFixes):
            mount = sensor.mount_name or name
            places[name] = Place(c.mount(mount, sensor.mount, sensor.mount_sigma))
        elif isinstance(sensor, LandmarkSightings | Scans):
            places[name] = Place(c.mount(name, sensor.mount, sensor.mount_sigma))
    return Layout(robot, c.free, tuple(c.parameters), places, c.width)
