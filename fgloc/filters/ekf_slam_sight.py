"""Whether a landmark should have been seen in a scan, compiled: what is out of sight lives on."""

from __future__ import annotations

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.geometry import wrap_scalar
from fgloc.core.measurements import Floats
from fgloc.filters.ekf_slam_steps import sight
from fgloc.filters.ekf_slam_tables import (
    ANGLE_MIN,
    ANGLE_STEP,
    BEAMS,
    FIELD_LEFT,
    FIELD_RANGE,
    FIELD_RIGHT,
    LEFT_X,
    LEFT_Y,
    MAX_RANGE,
    MIN_RANGE,
    NORMAL_X,
    NORMAL_Y,
    PLACE_X,
    PLACE_Y,
    POINT,
    RIGHT_X,
    RIGHT_Y,
)

EDGE = 0.9
"""A mark near the border of what a sensor has shown it can see may be missed: part inside it."""
GRAZING = 0.26
"""Cosine of the steepest angle (75°) between a wall's normal and the beam that should find it."""
CLOSE_M, CLOSE_SHARE = 0.2, 0.05
"""A beam that ends nearer than expected by more than this [m] and share met something else."""


@compiled
def missed(
    x: Floats,
    kind: int,
    stream: Floats,
    shape: Floats,
    field: Floats,
    ranges: Floats,
    row: int,
    turn: float,
) -> bool:
    """Return whether a landmark should have been in a scan that does not show it.

    A mark: within the ranges and bearings at which the sensor has seen marks so far. A wall: the
    beam towards the middle of its seen part reaches there, neither grazing nor without a return.
    The scan's beams begin at `ranges[row]`, and the lidar turned by `turn` [rad] since the first.
    """
    z = np.empty(2)
    mount = stream[:3]
    if kind == POINT:
        sight(x, mount, shape[PLACE_X], shape[PLACE_Y], z)
        middle = 0.5 * (field[FIELD_LEFT] + field[FIELD_RIGHT])
        half = 0.5 * EDGE * (field[FIELD_LEFT] - field[FIELD_RIGHT])
        near = z[0] < EDGE * field[FIELD_RANGE]
        return bool(near and abs(wrap_scalar(z[1] - middle)) < half)
    px, py = 0.5 * (shape[RIGHT_X] + shape[LEFT_X]), 0.5 * (shape[RIGHT_Y] + shape[LEFT_Y])
    distance = sight(x, mount, px, py, z)
    if not (stream[MIN_RANGE] < distance < EDGE * stream[MAX_RANGE]):
        return False
    direction = x[2] + mount[2] + z[1]
    if abs(np.cos(direction) * shape[NORMAL_X] + np.sin(direction) * shape[NORMAL_Y]) < GRAZING:
        return False
    beams = int(stream[BEAMS])
    step = stream[ANGLE_STEP]
    full = 2.0 * np.pi / abs(step)
    beam = (z[1] - stream[ANGLE_MIN]) / step
    # The lidar has turned since that beam: its direction was another one then.
    beam = (z[1] + turn * (1.0 - (beam % full) / beams) - stream[ANGLE_MIN]) / step
    k = int(np.round(beam % full))
    if k >= beams:
        if full - beams > 1.0:
            return False
        k = 0
    read = ranges[row + k]
    if not read > 0.0:
        return False
    return bool(read > distance * (1.0 - CLOSE_SHARE) - CLOSE_M)
