"""The map as GeoJSON (RFC 7946) in the map frame's own metres.

RFC 7946 has coordinates in WGS 84 unless those who exchange them agreed on something else; a
robot's map lies nowhere on Earth, so a foreign member `frame` says what they are. Programs that
draw plain coordinates show the map as it is.
"""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from fgloc import __version__
from fgloc.core.drive import Drive
from fgloc.core.measurements import Floats
from fgloc.core.trajectory import Trajectory
from fgloc.estimator import Result
from fgloc.lidar.walls import Marks, Walls
from fgloc.report.ellipses import ellipse_axes
from fgloc.report.map_segments import PlacedSegments, seen_parts
from fgloc.report.map_truth import base_truth, surveyed, true_walls
from fgloc.report.map_walls import wall_lengths, wall_sigmas

DIGITS = 4
"""Decimals of a coordinate: tenths of a millimetre."""
FRAME = {
    "name": "map",
    "unit": "m",
    "axes": ["x", "y"],
    "description": "local Cartesian coordinates of the robot's map, not longitude and latitude",
}


def map_geojson(
    result: Result, drive: Drive, segments: PlacedSegments | None = None
) -> dict[str, Any]:
    """Return a FeatureCollection: walls, marks, trajectory and, where known, the truth.

    Of `segments` follows which parts of a wall were seen.

    Every feature has an `id` and a property `kind`: `wall`, `mark`, `trajectory`, `truth` and,
    of a simulated world, `true_wall`.
    """
    features: list[dict[str, Any]] = []
    if result.map is not None and result.map.walls is not None:
        features += _walls(result.map.walls, segments)
    if result.map is not None and result.map.marks is not None:
        features += _marks(result.map.marks, surveyed(drive))
    features += _path(result.trajectory, "trajectory", {"method": result.method})
    truth = base_truth(result, drive)
    if truth is not None:
        features += _path(truth, "truth", {})
    features += [
        _feature(
            f"true-wall-{k}",
            {"type": "LineString", "coordinates": _rounded(ends)},
            {"kind": "true_wall", "length_m": _number(np.hypot(*(ends[1] - ends[0])), DIGITS)},
        )
        for k, ends in enumerate(true_walls(drive))
    ]
    return {
        "type": "FeatureCollection",
        "frame": FRAME,
        "drive": drive.name,
        "method": result.method,
        "fgloc_version": __version__,
        "features": features,
    }


def geojson_text(document: dict[str, Any]) -> str:
    """Return the text, one feature a line, so that it can be read and compared by line."""
    head = {key: value for key, value in document.items() if key != "features"}
    lines = ",\n".join(_dumps(feature) for feature in document["features"])
    return f'{_dumps(head)[:-1]}, "features": [\n{lines}\n]}}\n'


def _walls(walls: Walls, segments: PlacedSegments | None) -> list[dict[str, Any]]:
    """Return a LineString for each wall, from its right to its left end as the robot saw it."""
    parts = None if segments is None else seen_parts(walls, segments)
    offset, direction = wall_sigmas(walls)
    lengths = wall_lengths(walls)
    return [
        _feature(
            f"wall-{k}",
            {"type": "LineString", "coordinates": _rounded(ends)},
            {
                "kind": "wall",
                "sigma_offset_m": _number(offset[k], 6),
                "sigma_direction_deg": _number(math.degrees(direction[k]), 6),
                "normal_deg": _number(math.degrees(walls.normal[k]) % 360.0, DIGITS),
                "length_m": _number(lengths[k], DIGITS),
                "sightings": int(walls.sightings[k]),
                "seen_m": None if parts is None else _rounded(parts[k] - walls.reach[k, 0]),
            },
        )
        for k, ends in enumerate(walls.ends)
    ]


def _marks(marks: Marks, known: dict[int, tuple[float, float]]) -> list[dict[str, Any]]:
    """Return a Point for each landmark, with its 95 % ellipse and where it was surveyed to be."""
    features = []
    for k, name in enumerate(marks.landmark.tolist()):
        sigma: tuple[float | None, float | None, float | None] = (None, None, None)
        if np.isfinite(marks.covariance[k]).all():
            long, short, angle = (float(v) for v in ellipse_axes(marks.covariance[k]))
            direction = math.degrees(angle) % 180.0
            sigma = (_number(long, 6), _number(short, 6), _number(direction, DIGITS))
        features.append(
            _feature(
                f"mark-{name}",
                {"type": "Point", "coordinates": _rounded(marks.positions[k])},
                {
                    "kind": "mark",
                    "landmark": name,
                    "ellipse_95_major_m": sigma[0],
                    "ellipse_95_minor_m": sigma[1],
                    "ellipse_95_major_axis_deg": sigma[2],
                    "sightings": int(marks.sightings[k]),
                    "surveyed_m": _rounded(np.array(known[name])) if name in known else None,
                },
            )
        )
    return features


def _path(trajectory: Trajectory, kind: str, properties: dict[str, Any]) -> list[dict[str, Any]]:
    """Return a LineString of base_link's way; none of fewer than the two poses that a line has."""
    if len(trajectory) < 2:
        return []
    seconds = (trajectory.stamps_ns - trajectory.stamps_ns[0]) * 1e-9
    return [
        _feature(
            kind,
            {"type": "LineString", "coordinates": _rounded(trajectory.poses[:, :2])},
            {
                "kind": kind,
                **properties,
                "begin_ns": int(trajectory.stamps_ns[0]),
                "seconds": np.round(seconds, DIGITS).tolist(),
                "heading_deg": np.round(np.degrees(trajectory.poses[:, 2]), DIGITS).tolist(),
            },
        )
    ]


def _feature(name: str, geometry: dict[str, Any], properties: dict[str, Any]) -> dict[str, Any]:
    """Return a GeoJSON feature."""
    return {"type": "Feature", "id": name, "geometry": geometry, "properties": properties}


def _rounded(coordinates: Floats) -> list[Any]:
    """Return coordinates as nested lists."""
    values: list[Any] = np.round(coordinates, DIGITS).tolist()
    return values


def _number(value: float, digits: int) -> float | None:
    """Return a rounded number; None, null in JSON, for what is not known."""
    return round(float(value), digits) if math.isfinite(value) else None


def _dumps(value: dict[str, Any]) -> str:
    """Return JSON on one line; raises ValueError for NaN, which JSON does not know."""
    return json.dumps(value, ensure_ascii=False, allow_nan=False)
