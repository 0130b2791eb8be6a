"""What EKF-SLAM's compiled loop knows of streams, sightings and landmarks: columns and codes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Codes = npt.NDArray[np.int64]

POINT, WALL = range(2)
"""Kinds of streams: range and bearing of a mark; a straight piece of wall in a scan."""

REJECTED, TOLD, BORN, USED = range(4)
"""What became of a sighting: not believed; told of a landmark that is not used yet; made one;
corrected the state."""

NUMBER, STREAM, IDENTITY, SIGHTINGS, LIVES, LAST, REFUSED, COLUMNS = range(8)
"""Columns of a landmark: its number, the stream that sees it, its identity for that (-1: none), in
how many scans it was seen, lives left (-1: never dies), the group that saw it last, rejections in a
row."""

(
    NORMAL_X,
    NORMAL_Y,
    RIGHT_X,
    RIGHT_Y,
    LEFT_X,
    LEFT_Y,
    PLACE_X,
    PLACE_Y,
    SHAPE,
) = range(9)
"""Columns of a landmark's shape in the map: WALL: its normal when it was first seen, the right and
the left end of what was seen [m]; where it is taken to be, a wall's foot [m]."""

(
    MOUNT_X,
    MOUNT_Y,
    MOUNT_YAW,
    RANGE_VARIANCE,
    RANGE_SHARE,
    BEARING_VARIANCE,
    ANGLE_MIN,
    ANGLE_STEP,
    BEAMS,
    MIN_RANGE,
    MAX_RANGE,
    STREAM_COLUMNS,
) = range(12)
"""Columns of a stream: mount [m, m, rad]; variance of a range [m²], its share of the range squared,
variance of a bearing [rad²]; WALL: direction of the first beam, angle between beams [rad], number
of beams, shortest and longest range [m]."""

FIELD_RANGE, FIELD_RIGHT, FIELD_LEFT, FIELD = range(4)
"""Columns of what a POINT stream has shown it can see: farthest range [m], bearings [rad]."""

BIRTHS, DEATHS, AMBIGUOUS, NUMBERS, LANDMARKS, CANDIDATES, TALLY = range(7)
"""Columns of the tally: landmarks born and forgotten, sightings with two landmarks in the gate,
numbers given so far, landmarks in the state, landmarks that wait to be used."""
