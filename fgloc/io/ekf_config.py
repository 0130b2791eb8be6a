"""The configuration of a robot_localization-like filter in the plane, typed and checked."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.errors import FglocError

FLAGS = (
    "x",
    "y",
    "z",
    "roll",
    "pitch",
    "yaw",
    "vx",
    "vy",
    "vz",
    "vroll",
    "vpitch",
    "vyaw",
    "ax",
    "ay",
    "az",
)
"""The fifteen states of robot_localization, in the order of its configuration vectors."""
PLANAR = ("x", "y", "yaw", "vx", "vy", "vyaw", "ax", "ay")
"""Those that are left in the plane, in the order of this filter's state."""
PLANAR_INDEX = tuple(FLAGS.index(name) for name in PLANAR)
"""Where the states of this filter stand among the fifteen."""
Kind = Literal["odom", "pose", "twist", "imu"]
KINDS: tuple[Kind, ...] = ("odom", "pose", "twist", "imu")
"""Kinds of input; a key such as odom0 is a kind and a number."""
Matrix = tuple[tuple[float, ...], ...]
PROCESS_NOISE = (0.05, 0.05, 0.06, 0.025, 0.025, 0.02, 0.01, 0.01)
"""Diagonal of the process noise a second, in the order of PLANAR, that robot_localization has."""
INITIAL_VARIANCE = 1e-9
"""Variance of every state at the start that robot_localization has."""
FREQUENCY_HZ = 30.0
"""Rate of output that robot_localization has [Hz]."""


@dataclass(frozen=True)
class EkfInput:
    """One input of the filter: which of its numbers are used, and how."""

    name: str
    """Kind and number, e.g. "odom0"."""
    topic: str = ""
    """Topic that it was configured for; only a hint here."""
    flags: tuple[str, ...] = ()
    """Names of the states that it measures, out of PLANAR and in that order."""
    differential: bool = False
    """Poses are turned into velocities: the step since the reading before over the time between."""
    relative: bool = False
    """Poses are taken relative to the first one."""
    pose_threshold: float = math.inf
    """A pose at this Mahalanobis distance or further is rejected; inf: none is."""
    twist_threshold: float = math.inf
    """The same for velocities."""
    acceleration_threshold: float = math.inf
    """The same for accelerations."""

    @property
    def kind(self) -> Kind:
        """Return the part of the name before the number."""
        return next(k for k in KINDS if self.name.startswith(k))


def diagonal(values: tuple[float, ...]) -> Matrix:
    """Return a diagonal matrix as tuples."""
    return tuple(
        tuple(float(v) if i == j else 0.0 for j in range(len(values))) for i, v in enumerate(values)
    )


DEFAULT_PROCESS_NOISE = diagonal(PROCESS_NOISE)
"""The process noise that robot_localization has unless told otherwise."""


@dataclass(frozen=True)
class EkfConfig:
    """All that is honoured of a configuration."""

    inputs: tuple[EkfInput, ...]
    """Inputs in the order of their kinds and numbers."""
    process_noise: Matrix = DEFAULT_PROCESS_NOISE
    """(8, 8) process noise a second, in the order of PLANAR."""
    initial_covariance: Matrix | None = None
    """(8, 8) covariance of the state at the start; None: what is known of the start's pose, and 1
    for velocities and accelerations."""
    frequency: float | None = None
    """Rate of output [Hz]; None: a pose at every wheel stamp."""
    sensor_timeout: float | None = None
    """After so long without a measurement [s] a pose is predicted; None: one period of output."""
    dynamic_process_noise: bool = False
    """The process noise of the pose grows with the square of the speed."""
    predict_to_current_time: bool = False
    """Poses are predicted to the moment of output; else they are those of the last measurement."""
    notes: tuple[str, ...] = field(default=())
    """What of the user's configuration is not honoured, one sentence each."""

    def __post_init__(self) -> None:
        for name, value in (("frequency", self.frequency), ("sensor_timeout", self.sensor_timeout)):
            if value is not None and not 0.0 < value < math.inf:
                raise FglocError(f"{name} must be positive and finite, got {value!r}")
        for name, matrix in (
            ("process noise", self.process_noise),
            ("initial covariance", self.initial_covariance),
        ):
            problem = None if matrix is None else covariance_problem(np.array(matrix))
            if problem is not None:
                raise FglocError(f"{name} {problem}")


def covariance_problem(matrix: Floats) -> str | None:
    """Return what keeps a matrix from being a covariance of the planar state; None if nothing."""
    n = len(PLANAR)
    if matrix.shape != (n, n):
        return f"must be {n} by {n}"
    if not np.isfinite(matrix).all():
        return "holds a number that is not finite"
    if not np.allclose(matrix, matrix.T, rtol=1e-9, atol=0.0):
        return "is not symmetric"
    if float(np.linalg.eigvalsh(matrix).min()) < -1e-12 * float(np.abs(matrix).max(initial=0.0)):
        return "is no covariance: it has a negative eigenvalue"
    return None
