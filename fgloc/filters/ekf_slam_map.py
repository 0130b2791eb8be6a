"""The map that EKF-SLAM leaves: walls from their points, marks as they are."""

from __future__ import annotations

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.filters.ekf_slam_run import Run
from fgloc.filters.ekf_slam_tables import (
    BIRTHS,
    IDENTITY,
    LANDMARKS,
    LEFT_X,
    LEFT_Y,
    NORMAL_X,
    NORMAL_Y,
    NUMBER,
    NUMBERS,
    POINT,
    RIGHT_X,
    RIGHT_Y,
    SIGHTINGS,
    STREAM,
    WALL,
    Codes,
)
from fgloc.lidar.segments import Segments
from fgloc.lidar.walls import Map, Marks, Walls

THROUGH_ORIGIN_M = 0.5
"""A wall that passes the map's origin nearer than this [m] hardly has a direction as a point."""


def map_of(run: Run) -> Map:
    """Return the landmarks that were in the state at the end; walls where there is a lidar."""
    kinds = np.array([s.kind for s in run.events.streams])
    count = int(run.tally[LANDMARKS])
    codes = run.codes[:count]
    kind = kinds[codes[:, STREAM]]
    places = run.x[3 : 3 + 2 * count].reshape(count, 2)
    slots = 3 + 2 * np.arange(count)
    pairs = slots[:, None] + np.arange(2)
    blocks = run.p[pairs[:, :, None], pairs[:, None, :]]
    marks = walls = segments = wall = None
    if (kinds == POINT).any():
        mine = np.flatnonzero(kind == POINT)
        known = codes[mine, IDENTITY]
        own = int(known.max(initial=-1)) + 1 + codes[mine, NUMBER]
        marks = Marks(
            np.where(known >= 0, known, own),
            places[mine].copy(),
            blocks[mine],
            codes[mine, SIGHTINGS].copy(),
        )
    if (kinds == WALL).any():
        mine = np.flatnonzero(kind == WALL)
        walls = _walls(places[mine], blocks[mine], codes[mine], run.shapes[:count][mine])
        # One lidar's segments: those of a second one have axes of their own.
        stream = int(np.flatnonzero(kinds == WALL)[0])
        segments = run.events.streams[stream].segments
        wall = _assigned(run, stream, codes[mine, NUMBER], segments)
    return Map(walls, segments, wall, marks)


def _walls(feet: Floats, covariances: Floats, codes: Codes, shapes: Floats) -> Walls:
    """Return walls through their feet (L, 2), with their normals along the feet's directions.

    The normal points to the side from which the wall was first seen. With the foot ρ n(α):
    d α = t·d foot / ρ and d offset = ± n·d foot.
    """
    distance = np.hypot(feet[:, 0], feet[:, 1])
    safe = np.maximum(distance, 1e-12)
    first = shapes[:, [NORMAL_X, NORMAL_Y]]
    unit = np.where(distance[:, None] > 1e-12, feet / safe[:, None], first)
    side = np.where(np.sum(unit * first, axis=1) >= 0.0, 1.0, -1.0)
    normal = side[:, None] * unit
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    # The ends in the order of the first side, which is that of the normal.
    right = np.sum((shapes[:, [RIGHT_X, RIGHT_Y]] - feet) * tangent, axis=1)
    left = np.sum((shapes[:, [LEFT_X, LEFT_Y]] - feet) * tangent, axis=1)
    by_foot = np.empty((feet.shape[0], 2, 2))
    by_foot[:, 0, 0], by_foot[:, 0, 1] = -unit[:, 1] / safe, unit[:, 0] / safe
    by_foot[:, 1] = normal
    return Walls(
        np.arctan2(normal[:, 1], normal[:, 0]),
        np.zeros(feet.shape[0]),
        feet.copy(),
        np.stack([right, left], axis=1),
        by_foot @ covariances @ np.swapaxes(by_foot, 1, 2),
        codes[:, SIGHTINGS].copy(),
    )


def _assigned(run: Run, stream: int, numbers: Codes, segments: Segments | None) -> Codes:
    """Return (M,) the row of each segment's wall; -1 where it has none that lived to the end."""
    assert segments is not None
    row = np.full(int(run.tally[NUMBERS]) + 1, -1, dtype=np.int64)
    row[numbers] = np.arange(numbers.size)
    mine = run.events.stream_of == stream
    wall = np.full(segments.scan.size, -1, dtype=np.int64)
    kept = run.events.streams[stream].segment_of
    assert kept is not None
    # The entry behind the last number is -1: sightings without a landmark.
    wall[kept[run.events.reading_of[mine]]] = row[run.numbers[mine]]
    return wall


def map_notes(run: Run, walls: Walls | None) -> tuple[str, ...]:
    """Return what a user should know of the map."""
    from fgloc.filters.ekf_slam_tables import AMBIGUOUS, DEATHS

    born, died, ambiguous = (int(run.tally[k]) for k in (BIRTHS, DEATHS, AMBIGUOUS))
    notes = [
        f"{born} landmark{'s' * (born != 1)} entered the state, {died} of them "
        f"{'was' if died == 1 else 'were'} forgotten; {run.waiting_sightings()} sightings told of "
        "landmarks that were not in use"
    ]
    if ambiguous:
        notes.append(
            f"{ambiguous} sighting{'s' * (ambiguous != 1)} had more than one landmark in the "
            "gate: the nearest was taken"
        )
    if walls is not None:
        near = int(np.count_nonzero(np.hypot(*walls.anchor.T) < THROUGH_ORIGIN_M))
        if near:
            notes.append(
                f"{near} wall{'s' * (near != 1)} within {THROUGH_ORIGIN_M} m of the map's origin: "
                "as a point, which is how the seed has it, such a wall has hardly a direction"
            )
    return tuple(notes)
