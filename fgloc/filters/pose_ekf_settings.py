"""What a user may set about the pose EKF, and what a tuner may fit."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from fgloc.errors import FglocError

MAY_BE_ZERO = ("calibration", "camera_growth", "yaw_drift", "horizon_s", "patience_s")
"""Settings that may be switched off; all others must be positive."""
MAY_BE_ENDLESS = ("leap_m", "leap_rad", "patience_s")
"""Settings that may be infinite, beside the gates."""


@dataclass(frozen=True)
class PoseEkfSettings:
    """Typed settings of the pose EKF; every factor multiplies a standard deviation."""

    process_noise: float = 1.0
    """Factor on all of the wheels' noise, the filter's Q: slip and calibration."""
    calibration: float = 1.0
    """Factor on the priors of radii, track and the like, which are part of Q; 0 takes the nominal
    robot to be exact."""
    camera_position: float = 1.0
    """Factor on the camera's position noise."""
    camera_heading: float = 1.0
    """Factor on the camera's heading noise."""
    camera_growth: float = 1.0
    """Factor on what makes the camera's noise grow with its way: random walk, mounting and scale. 0
    takes every pose to be as exact as the first, which is what a constant covariance says."""
    yaw: float = 1.0
    """Factor on the noise of a yaw reading."""
    yaw_drift: float = 1.0
    """Factor on the random walk of the yaw's zero."""
    gyro: float = 1.0
    """Factor on the gyro's noise, bias included."""
    fix: float = 1.0
    """Factor on the noise of position and pose fixes."""
    horizon_s: float = 10.0
    """What is wrong the same way for long (calibration, gyro bias, steady yaw drift, the camera's
    walk, mounting and scale, what a wrong heading does to the way) is not estimated. The filter is
    told of it as white noise that adds up to the same in this time [s]; 0 leaves it out."""
    camera_gate: float = 5.0
    """A camera pose further off than so many standard deviations (Mahalanobis distance of three
    numbers) is rejected; inf takes all."""
    yaw_gate: float = 5.0
    """The same for a yaw reading."""
    gyro_gate: float = math.inf
    """The same for the angle that a gyro turned between two moments, against the wheels. By default
    none is rejected: where the two differ by that much, it is the wheels that slip."""
    fix_gate: float = 5.0
    """The same for a position or pose fix."""
    leap_m: float = 0.3
    """A camera that moves by so much more or less than the wheels [m] from one pose to the next, or
    turns by `leap_rad`, has lost its frame: that is aligned anew with the filter's state."""
    leap_rad: float = 0.3
    """The same turn [rad]; also of a yaw reading, whose zero is then new."""
    patience_s: float = 1.0
    """A sensor that has been rejected for so long [s] is believed after all: the covariance of the
    state is multiplied until the reading fits, and the reading is used."""
    patience_count: int = 3
    """But not before so many readings in a row were rejected."""

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            endless = f.name.endswith("_gate") or f.name in MAY_BE_ENDLESS
            if not (value > 0.0 or (value == 0.0 and f.name in MAY_BE_ZERO)) or (
                math.isinf(value) and not endless
            ):
                lowest = "not negative" if f.name in MAY_BE_ZERO else "positive"
                limit = "" if endless else " and finite"
                raise FglocError(f"pose-ekf: {f.name} must be {lowest}{limit}, got {value!r}")
