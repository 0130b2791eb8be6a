"""Robots of the simulator: nominal kinematics, encoders and what they are able to do."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from fgloc.core import bases
from fgloc.core.robot import Robot
from fgloc.errors import FglocError

JAGUAR_RADIUS = 0.135
"""Wheel radius of the Jaguar 4x4 [m]."""
JAGUAR_TRACK = 0.48
"""Distance between left and right wheels of the Jaguar 4x4 [m]."""
JAGUAR_TICKS = 300
"""Encoder counts per wheel revolution of the Jaguar 4x4."""
JAGUAR_ENCODER_HZ = 5.0
"""Encoder packets per second of the Jaguar 4x4."""


@dataclass(frozen=True)
class RobotModel:
    """A robot that can be simulated."""

    robot: Robot
    """Nominal kinematics with priors, and wheel noise."""
    ticks: int
    """Encoder counts per wheel revolution."""
    encoder_hz: float
    """Encoder packets per second."""
    speed: float
    """Usual speed [m/s]."""
    turn_rate: float
    """Usual yaw rate when turning [rad/s]."""
    acceleration: float = 0.8
    """Largest acceleration [m/s²]."""
    turn_acceleration: float = 1.5
    """Largest yaw acceleration [rad/s²]."""
    holonomic: bool = False
    """True if the base can drive sideways."""
    steered: bool = False
    """True if every driven wheel is steered; its steering angle is then measured."""


def jaguar(track: float = JAGUAR_TRACK) -> RobotModel:
    """Return seed A's 4×4 skid-steer vehicle with a nominal effective track [m]."""
    base = bases.skid_steer(
        ("fl", "rl"), ("fr", "rr"), JAGUAR_RADIUS, track, order=("fl", "fr", "rl", "rr")
    )
    return RobotModel(Robot.typical("Jaguar 4x4", base), JAGUAR_TICKS, JAGUAR_ENCODER_HZ, 0.8, 0.6)


def _differential(track: float = 0.3) -> RobotModel:
    """Return a small two-wheel robot; track [m]."""
    base = bases.differential(0.05, 0.05, track)
    return RobotModel(Robot.typical("differential", base), 2000, 20.0, 0.4, 0.8)


def _mecanum() -> RobotModel:
    """Return a four-wheel mecanum platform."""
    base = bases.mecanum(0.076, 0.235, 0.2, ("fl", "fr", "rl", "rr"))
    return RobotModel(Robot.typical("mecanum", base), 2000, 20.0, 0.5, 0.6, holonomic=True)


def _youbot() -> RobotModel:
    """Return seed B's mecanum platform, a KUKA youBot."""
    base = bases.mecanum(0.0475, 0.2355, 0.15, ("fl", "fr", "rl", "rr"))
    return RobotModel(Robot.typical("KUKA youBot", base), 2000, 20.0, 0.5, 0.6, holonomic=True)


def _omni3() -> RobotModel:
    """Return a three-wheel omni robot, wheels at 60°, 180° and 300°."""
    base = bases.omni3((0.05, 0.05, 0.05), 0.15, (math.pi / 3, math.pi, -math.pi / 3))
    return RobotModel(Robot.typical("omni-3", base), 2000, 20.0, 0.4, 0.8, holonomic=True)


def _tricycle() -> RobotModel:
    """Return a tricycle with a steered and driven front wheel."""
    base = bases.tricycle(0.1, 0.8)
    return RobotModel(Robot.typical("tricycle", base), 2000, 20.0, 0.8, 0.6, steered=True)


def _swerve() -> RobotModel:
    """Return a four-wheel-steer, four-wheel-drive platform."""
    positions = ((0.2, 0.2), (0.2, -0.2), (-0.2, 0.2), (-0.2, -0.2))
    base = bases.four_wheel_steer(("fl", "fr", "rl", "rr"), positions, (0.06,) * 4)
    return RobotModel(
        Robot.typical("4WIS4WID", base), 2000, 20.0, 0.5, 0.6, holonomic=True, steered=True
    )


ROBOTS: dict[str, Callable[[], RobotModel]] = {
    "skid": jaguar,
    "differential": _differential,
    "mecanum": _mecanum,
    "youbot": _youbot,
    "omni3": _omni3,
    "tricycle": _tricycle,
    "swerve": _swerve,
}
"""Constructors by the name used in `robot=…`; "skid" is seed A's Jaguar 4x4."""


def build(name: str, nominal_track: float | None = None) -> RobotModel:
    """Return a robot by name; `nominal_track` [m] is for skid and differential only.

    Raises FglocError for an unknown name, or for a track where the robot has none.
    """
    if name not in ROBOTS:
        raise FglocError(f"robot={name}: there is no such robot; use one of {', '.join(ROBOTS)}")
    if nominal_track is None:
        return ROBOTS[name]()
    if not nominal_track > 0.0:
        raise FglocError(f"nominal_track={nominal_track}: a track must be positive [m]")
    if name == "skid":
        return jaguar(nominal_track)
    if name == "differential":
        return _differential(nominal_track)
    raise FglocError(f"nominal_track: robot={name} has no track; use robot=skid or differential")
