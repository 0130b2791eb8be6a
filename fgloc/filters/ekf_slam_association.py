"""Which landmark a sighting is of, and how landmarks become known and are forgotten, compiled.

Landmarks in the state and landmarks that wait to be used stand in tables of the same columns
(`ekf_slam_tables`)."""

from __future__ import annotations

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats
from fgloc.filters.ekf_slam_sight import missed
from fgloc.filters.ekf_slam_steps import remove
from fgloc.filters.ekf_slam_tables import (
    AMBIGUOUS,
    CANDIDATES,
    DEATHS,
    IDENTITY,
    LANDMARKS,
    LAST,
    LIVES,
    NORMAL_X,
    NORMAL_Y,
    RIGHT_X,
    RIGHT_Y,
    SIGHTINGS,
    STREAM,
    WALL,
    Codes,
)
from fgloc.lidar.nearest import nearest

SHARE = 0.2
"""Part of the way to a further end that a wall's end moves at a sighting."""


@compiled
def find(
    x: Floats,
    codes: Codes,
    waiting: Codes,
    waiting_places: Floats,
    tally: Codes,
    stream: int,
    identity: int,
    point: Floats,
    gate: float,
) -> int:
    """Return the landmark of a sighting, -2 - k for the waiting one k, -1 if it is new."""
    count = tally[LANDMARKS]
    if identity >= 0:
        for k in range(count):
            if codes[k, STREAM] == stream and codes[k, IDENTITY] == identity:
                return k
        return -1
    places = x[3 : 3 + 2 * count].reshape((count, 2))
    best, distance, second = nearest(
        places, codes[:, STREAM], count, stream, point[0], point[1], gate
    )
    other, other_distance, other_second = nearest(
        waiting_places, waiting[:, STREAM], tally[CANDIDATES], stream, point[0], point[1], gate
    )
    within = (best >= 0) + (other >= 0) + (second <= gate) + (other_second <= gate)
    if within > 1:
        tally[AMBIGUOUS] += 1
    if other >= 0 and other_distance < distance:
        return -2 - other
    return best


@compiled
def widen(shape: Floats, kind: int, value: Floats, normal: float, mount: Floats, x: Floats) -> None:
    """Let a landmark's shape include the piece of wall that was seen now.

    `normal` is the piece's in the map. An end moves outwards by a share of what is new, so that one
    piece that reaches too far does not make the wall longer for good.
    """
    if kind != WALL:
        return
    fresh = shape[NORMAL_X] == 0.0 and shape[NORMAL_Y] == 0.0
    if fresh:
        shape[NORMAL_X], shape[NORMAL_Y] = np.cos(normal), np.sin(normal)
    tx, ty = -shape[NORMAL_Y], shape[NORMAL_X]
    c, s = np.cos(x[2]), np.sin(x[2])
    ox, oy = x[0] + c * mount[0] - s * mount[1], x[1] + s * mount[0] + c * mount[1]
    turn = x[2] + mount[2]
    ct, st = np.cos(turn), np.sin(turn)
    px, py = ox + ct * value[1] - st * value[2], oy + st * value[1] + ct * value[2]
    for a in range(2):
        ex, ey = px - value[3 + a] * np.sin(normal), py + value[3 + a] * np.cos(normal)
        if fresh:
            shape[RIGHT_X + 2 * a], shape[RIGHT_Y + 2 * a] = ex, ey
            continue
        for b in range(2):
            # Seen from the other side, the right end is the left one: both ends are tried.
            dx, dy = ex - shape[RIGHT_X + 2 * b], ey - shape[RIGHT_Y + 2 * b]
            out = (tx * dx + ty * dy) * (1.0 if b == 1 else -1.0)
            if out > 0.0:
                shape[RIGHT_X + 2 * b] += SHARE * dx
                shape[RIGHT_Y + 2 * b] += SHARE * dy


@compiled
def see(code: Codes, group: int, lives: int) -> None:
    """Count a sighting of a landmark, once a scan, and give all its lives back."""
    if code[LAST] != group:
        code[SIGHTINGS] += 1
        code[LAST] = group
    if code[LIVES] >= 0:
        code[LIVES] = lives


@compiled
def tire(
    x: Floats,
    kind: int,
    stream: int,
    group: int,
    unseen: int,
    codes: Codes,
    shapes: Floats,
    count: int,
    row: Floats,
    field: Floats,
    ranges: Floats,
    begin: int,
    turn: float,
) -> None:
    """Take a life of every landmark of a stream that should have been in a scan and was not.

    With `unseen` it does not matter whether it should have been. See `missed` for the rest.
    """
    for k in range(count):
        if codes[k, STREAM] != stream or codes[k, LAST] == group or codes[k, LIVES] <= 0:
            continue
        if unseen != 0 or missed(x, kind, row, shapes[k], field, ranges, begin, turn):
            codes[k, LIVES] -= 1


@compiled
def forget(
    x: Floats,
    p: Floats,
    n: int,
    codes: Codes,
    shapes: Floats,
    waiting: Codes,
    waiting_shapes: Floats,
    waiting_places: Floats,
    tally: Codes,
) -> int:
    """Take landmarks without lives out of state and covariance; return the new n."""
    for k in range(tally[LANDMARKS] - 1, -1, -1):
        if codes[k, LIVES] == 0:
            remove(x, p, n, 3 + 2 * k)
            n -= 2
            last = tally[LANDMARKS] - 1
            codes[k], shapes[k] = codes[last], shapes[last]
            tally[LANDMARKS] = last
            tally[DEATHS] += 1
    for k in range(tally[CANDIDATES] - 1, -1, -1):
        if waiting[k, LIVES] == 0:
            last = tally[CANDIDATES] - 1
            waiting[k], waiting_shapes[k] = waiting[last], waiting_shapes[last]
            waiting_places[k] = waiting_places[last]
            tally[CANDIDATES] = last
    return n
