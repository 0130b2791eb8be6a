"""Which packets cannot be true, whatever the robot: they are rejected before they do harm."""

from __future__ import annotations

import numpy as np

from fgloc.core.measurements import (
    CameraPoses,
    Floats,
    LandmarkSightings,
    PoseFixes,
    PositionFixes,
    Scans,
    Sensor,
)

LARGEST = 1e9
"""No position [m], angle [rad] or rate [rad/s] is larger: digits are lost beyond."""
SMALLEST_SIGMA = 1e-9
"""No fix is more exact [m, rad]; its square would drown everything else."""
LARGEST_SIGMA = 1e9
"""A fix less exact than this tells nothing."""
FASTEST = 1e3
"""No wheel turns faster [rad/s]: an encoder that jumps would throw the robot over the horizon."""
SHORTEST_S = 1.0
"""Over shorter times the wheels may turn as far as in this: packets come in bursts."""


def size_of(sensor: Sensor) -> int:
    """Return how many numbers a reading of a sensor has."""
    if isinstance(sensor, CameraPoses | PoseFixes | LandmarkSightings):
        return 3
    if isinstance(sensor, Scans):
        return int(sensor.ranges.shape[1])
    return 2 if isinstance(sensor, PositionFixes) else 1


def reading_fault(values: Floats, size: int, scan: bool = False) -> str:
    """Return what is wrong with a reading of `size` numbers, "" if nothing.

    In a scan single beams may be missing, whatever stands there for them; but not all.
    """
    if values.shape != (size,):
        return "it has another number of values"
    if scan:
        with np.errstate(invalid="ignore"):
            return "" if bool((np.isfinite(values) & (values > 0.0)).any()) else "no beam returned"
    if not np.isfinite(values).all():
        return "not finite"
    return "larger than possible" if np.abs(values).max() > LARGEST else ""


def sigma_fault(sigma: Floats | None, size: int) -> str:
    """Return what is wrong with the sigmas of a fix, "" if nothing."""
    if sigma is None or sigma.shape != (size,):
        return "it has another number of sigmas"
    if not (np.isfinite(sigma).all() and (sigma > 0.0).all()):
        return "its sigma is zero, negative or not finite"
    if sigma.min() < SMALLEST_SIGMA or sigma.max() > LARGEST_SIGMA:
        return "its sigma is smaller or larger than possible"
    return ""


def wheels_fault(angles: Floats, steering: Floats | None, driven: int, seconds: float) -> str:
    """Return what is wrong with the wheels' turns (D,) in some time, "" if nothing.

    Where `seconds` is negative (a late packet) the time that they took is not known.
    """
    for values in (angles,) if steering is None else (angles, steering):
        if values.shape != (driven,):
            return "it has another number of values"
        if not np.isfinite(values).all():
            return "not finite"
    if np.abs(angles).max(initial=0.0) > FASTEST * max(seconds, SHORTEST_S):
        return "faster than wheels turn"
    if steering is not None and np.abs(steering).max(initial=0.0) > LARGEST:
        return "larger than possible"
    return ""
