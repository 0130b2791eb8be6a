"""The map in the JSON of `smooth`, `localise` and `compare`; its keys are a contract."""

from __future__ import annotations

from typing import Any

import numpy as np

from fgloc.lidar.walls import Map, Marks, Walls
from fgloc.report.map_walls import wall_lengths, wall_sigmas


def map_json(found: Map) -> dict[str, Any]:
    """Return `walls`, `marks` and how many `segments` were seen, in m and rad.

    Each is None where the method makes none. What is not known is NaN, which the writer of the
    file turns into null.
    """
    segments = None
    if found.segments is not None:
        wall = np.full(found.segments.scan.size, -1) if found.wall is None else found.wall
        segments = {"seen": int(wall.size), "associated": int(np.count_nonzero(wall >= 0))}
    return {
        "walls": None if found.walls is None else _walls(found.walls),
        "marks": None if found.marks is None else _marks(found.marks),
        "segments": segments,
    }


def _walls(walls: Walls) -> list[dict[str, Any]]:
    """Return an entry for each wall, in their order."""
    offset, direction = wall_sigmas(walls)
    lengths, ends = wall_lengths(walls), walls.ends
    return [
        {
            "ends": ends[k].tolist(),
            "normal": walls.normal[k],
            "offset": walls.offset[k],
            "anchor": walls.anchor[k].tolist(),
            "length": lengths[k],
            "sigma_offset": offset[k],
            "sigma_normal": direction[k],
            "covariance": walls.covariance[k].tolist(),
            "sightings": walls.sightings[k],
        }
        for k in range(walls.normal.size)
    ]


def _marks(marks: Marks) -> list[dict[str, Any]]:
    """Return an entry for each point landmark, in their order."""
    return [
        {
            "landmark": marks.landmark[k],
            "x": marks.positions[k, 0],
            "y": marks.positions[k, 1],
            "covariance": marks.covariance[k].tolist(),
            "sightings": marks.sightings[k],
        }
        for k in range(marks.landmark.size)
    ]
