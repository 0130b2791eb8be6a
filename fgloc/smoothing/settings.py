"""What a user may set about the smoothers; the defaults hold for every robot we know of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from fgloc.factors.robust import Loss
from fgloc.factors.slip import SlipModel

SLIPS = Loss("cauchy", 2.0)
"""For wheels: a slipping interval must be given up, or it pulls on the calibration for ever."""
DISTURBED = Loss("huber", 3.0)
"""For headings: wrong for a while in a magnetic disturbance, but seldom wildly."""
STRAYS = Loss("cauchy", 4.0)
"""For sensors with single wild readings: lost tracking, reflections, wrong matches."""

USUAL_SLIP = SlipModel()
"""Slip that comes seldom, lasts for seconds and is overspeed where wheels are driven."""


@dataclass(frozen=True)
class Settings:
    """Typed settings of the batch smoother."""

    keyframe_period_s: float = 0.1
    """Time between keyframes [s]; every fix has a keyframe of its own as well."""
    wheel_loss: Loss = SLIPS
    """Loss of wheel odometry: slip makes single intervals wrong."""
    yaw_loss: Loss = DISTURBED
    """Loss of absolute yaw."""
    camera_loss: Loss = STRAYS
    """Loss of camera odometry: it loses track at times."""
    fix_loss: Loss = STRAYS
    """Loss of position and pose fixes: reflections and wrong matches."""
    landmark_loss: Loss = STRAYS
    """Loss of what is seen of landmarks: wrong matches, people in the way."""
    robust: bool = True
    """Apply the losses; False trusts every measurement alike."""
    graduated: bool = True
    """Where robust losses gave up many fixes or tore the wheels, look again by graduated
    non-convexity; costs nothing elsewhere."""
    slip: SlipModel | None = USUAL_SLIP
    """Where wheels contradict each other or the other sensors, look for wheels that slip, with
    this prior; None: never."""
    max_iterations: int = 50
    """Limit of linearisations in each of the two phases (plain, then robust)."""
    tolerance: float = 1e-6
    """Stop when an accepted step lowers the cost by less than this fraction."""
    solver: Literal["arrow", "gtsam"] = "arrow"
    """arrow: specialised elimination of a chain with calibration; gtsam: its general one."""
    covariances: bool = True
    """Compute marginal covariances of all keyframes and the calibration."""
