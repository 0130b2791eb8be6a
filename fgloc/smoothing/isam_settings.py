"""What may be set about the incremental smoother."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class IncrementalSettings:
    """Typed settings of the incremental smoother."""

    lag_s: float | None = 30.0
    """How long a keyframe stays a variable [s]; None keeps all of them (short drives only). It
    must be longer than the time between absolute fixes."""
    segment_keyframes: int = 75
    """Keyframes that share one calibration variable; a random walk joins the segments."""
    relinearize_threshold: float = 0.01
    """A variable that moved by more in any component (m, rad, solver units) is linearised anew."""
    relinearize_skip: int = 5
    """Updates between two looks for such variables."""
    relinearize_s: float = 2.0
    """How old keyframes are at most that every look may move [s]: moving one eliminates all
    newer ones again."""
    relinearize_all: int = 40
    """Every so many looks all keyframes are looked at."""
    relinearize_far: float = 5.0
    """All are also looked at when one of a few older ones is this many thresholds off, as when a
    fix comes after a long time without."""
    reweigh_s: float = 3.0
    """For how long a measurement's robust weight is still looked at [s]."""
    reweigh_change: float = 0.1
    """Change of a robust weight, as a fraction of the larger one, that makes it count."""
    reweigh_bundles: int = 6
    """Most intervals whose robust weights are looked at in one update."""
    snapshot_keyframes: int = 50
    """Keyframes between two snapshots of the newest state, the last resort after a failure."""
    landmark_patience: int = 150
    """Updates between two that forget what is older than the lag, while there are landmarks:
    with them most of the window is eliminated again for it, so it is done for many keyframes at
    once. Without landmarks every update forgets."""
    reentry_inflation: float = 4.0
    """Factor on the covariance of an archived landmark when it is seen again: how its errors and
    the robot's hang together has been forgotten, and taking it as it was would count common
    errors as independent ones."""
