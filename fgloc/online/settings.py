"""What a user may set about the online engine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from fgloc.smoothing.settings import Settings


@dataclass(frozen=True)
class OnlineSettings(Settings):
    """Settings of the online engine: the losses of batch, and how the window moves."""

    lag_s: float = 30.0
    """Keyframes older than this are summed up in a prior [s]; inf keeps the whole drive."""
    keyframe_distance_m: float = 0.5
    """A keyframe is due after this way, even before its time [m]."""
    keyframe_turn: float = 0.35
    """A keyframe is due after this turn, even before its time [rad]."""
    relinearise_every: int = 10
    """The whole window is linearised anew after so many keyframes."""
    gate_probability: float = 0.999
    """A new measurement less likely than one minus this loses weight at once."""
    engine: Literal["chain", "isam2"] = "chain"
    """chain: square-root filter and smoother of this project; isam2: GTSAM's, for comparison."""
    calibration_walk: float = 1e-3
    """Change of the robot's own parameters that is allowed for: share of the prior's sigma over
    the square root of a second. Tyres warm, grounds change."""
