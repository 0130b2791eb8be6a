"""One estimate over time as a single HTML page with a time slider, for any browser, offline."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from fgloc.atomic import write_text
from fgloc.core.measurements import Floats
from fgloc.core.trajectory import Trajectory
from fgloc.report.ellipses import ellipse_axes
from fgloc.report.map_points import PlacedScans, all_points
from fgloc.report.map_segments import PlacedSegments
from fgloc.report.map_thinning import thin
from fgloc.report.map_walls import wall_bands
from fgloc.report.scene import SHOWN_S, Scene, evenly, wall_colour

MOST_SCANS = 1000
"""Scans of a lidar that the page holds, some kilobytes each."""
MOST_POSES = 5000
"""Poses of a path that the page holds."""


def save_page(scene: Scene, path: Path) -> Path:
    """Write the page, atomically; return the path. Nothing in it comes from elsewhere."""
    template = files("fgloc.report").joinpath("view_page.html").read_text(encoding="utf-8")
    text = json.dumps(page_scene(scene), separators=(",", ":"), allow_nan=False)
    # A drive called </script> must not end the element that holds it.
    write_text(path, template.replace("@SCENE@", text.replace("<", "\\u003c")))
    return path


def page_scene(scene: Scene) -> dict[str, Any]:
    """Return what the page draws: times in s, lengths in whole mm from the scene's own origin.

    Of long drives every second, third, … scan and pose is taken, as `note` says.
    """
    points = thin(all_points(scene.scans))
    origin = np.round(scene.trajectory.poses[0, :2], 3)
    marks, walls = scene.marks, scene.walls
    has = {
        "points": points.shape[0] > 0,
        "scan": any(s.scan.size for s in scene.scans),
        "walls": walls is not None and walls.normal.size > 0,
        "bands": walls is not None and bool(np.isfinite(walls.covariance).any()),
        "segments": scene.segments is not None and scene.segments.row.size > 0,
        "marks": bool(scene.surveyed) or (marks is not None and marks.landmark.size > 0),
        "path": True,
        "ellipse": scene.trajectory.covariances is not None,
        "truth": scene.truth is not None,
        "true_walls": scene.true_walls.shape[0] > 0,
    }
    notes = [
        f"{evenly(s.scan.size, MOST_SCANS).size} of {s.scan.size} scans of {s.sensor} are shown."
        for s in scene.scans
        if s.scan.size > MOST_SCANS
    ]
    seconds = scene.seconds(scene.trajectory.stamps_ns)
    return {
        "drive": scene.drive,
        "method": scene.method,
        "note": " ".join(notes),
        "has": [name for name, there in has.items() if there],
        "begin": float(seconds[0]),
        "end": float(seconds[-1]),
        "origin_m": origin.tolist(),
        "box": _mm(scene.box(points), origin),
        "points": _mm(points, origin),
        "lidars": [_lidar(scene, k, origin) for k in range(len(scene.scans))],
        "walls": _walls(scene, origin),
        "true_walls": [_mm(ends, origin) for ends in scene.true_walls],
        "marks": _marks(scene, origin),
        "surveyed": [
            {"x": xy[0], "y": xy[1]}
            for xy in (_mm(np.array(p), origin) for p in scene.surveyed.values())
        ],
        "path": _track(scene, scene.trajectory, origin),
        "truth": None if scene.truth is None else _track(scene, scene.truth, origin),
        "slips": [
            {
                "wheel": slip.wheel,
                "begin": (slip.begin_ns - scene.begin_ns) * 1e-9,
                "end": (slip.end_ns - scene.begin_ns) * 1e-9,
                "slip": slip.slip,
            }
            for slip in scene.slips
        ],
    }


def _mm(points: Floats, origin: Floats) -> list[int]:
    """Return points (..., 2) as one list x, y, x, y, … of whole millimetres."""
    whole: list[int] = np.rint(1e3 * (points - origin)).astype(np.int64).ravel().tolist()
    return whole


def _hex(wall: int) -> str:
    """Return a wall's colour as browsers read it."""
    return "#{:02x}{:02x}{:02x}".format(*wall_colour(wall))


def _lidar(scene: Scene, number: int, origin: Floats) -> dict[str, Any]:
    """Return the scans of one lidar, each thinned by itself, and what was found in them."""
    scans = scene.scans[number]
    chosen = evenly(scans.scan.size, MOST_SCANS)
    return {
        "sensor": scans.sensor,
        "t": np.round(scene.seconds(scans.stamps_ns[chosen]), 3).tolist(),
        "scans": [_mm(thin(scans.points[k][scans.valid[k]]), origin) for k in chosen],
        # Segments belong to the first lidar.
        "segments": None
        if number or scene.segments is None
        else _segments(scene, scans, scene.segments, origin),
    }


def _segments(
    scene: Scene, scans: PlacedScans, segments: PlacedSegments, origin: Floats
) -> dict[str, Any]:
    """Return when segments were seen, and which, with the colours of their walls."""
    rows, begins = np.unique(segments.row, return_index=True)
    bounds = [*begins.tolist(), segments.row.size]
    chosen = evenly(rows.size, MOST_SCANS)
    return {
        "shown": SHOWN_S,
        "t": np.round(scene.seconds(scans.stamps_ns[rows[chosen]]), 3).tolist(),
        "seen": [
            [
                {"ends": _mm(segments.ends[m], origin), "colour": _hex(int(segments.wall[m]))}
                for m in range(bounds[k], bounds[k + 1])
            ]
            for k in chosen.tolist()
        ],
    }


def _walls(scene: Scene, origin: Floats) -> list[dict[str, Any]]:
    """Return ends, colour and, where it is known, the 2σ band of each wall."""
    if scene.walls is None:
        return []
    bands = wall_bands(scene.walls)
    return [
        {
            "ends": _mm(ends, origin),
            "band": _mm(bands[k], origin) if np.isfinite(bands[k]).all() else None,
            "colour": _hex(k),
        }
        for k, ends in enumerate(scene.walls.ends)
    ]


def _marks(scene: Scene, origin: Floats) -> list[dict[str, Any]]:
    """Return name, place and, where it is known, the 95 % ellipse of each landmark."""
    if scene.marks is None:
        return []
    found = []
    for k, name in enumerate(scene.marks.landmark.tolist()):
        x, y = _mm(scene.marks.positions[k], origin)
        covariance = scene.marks.covariance[k]
        axes = _axes(covariance[None])[0] if np.isfinite(covariance).all() else None
        found.append({"name": str(name), "x": x, "y": y, "axes": axes})
    return found


def _track(scene: Scene, trajectory: Trajectory, origin: Floats) -> dict[str, Any]:
    """Return a path with its headings and, where it has them, its ellipses."""
    chosen = evenly(len(trajectory), MOST_POSES)
    poses = trajectory.poses[chosen]
    flat = _mm(poses[:, :2], origin)
    covariances = trajectory.covariances
    return {
        "t": np.round(scene.seconds(trajectory.stamps_ns[chosen]), 3).tolist(),
        "x": flat[0::2],
        "y": flat[1::2],
        "h": np.round(poses[:, 2], 4).tolist(),
        "axes": None if covariances is None else _axes(covariances[chosen, :2, :2]),
    }


def _axes(covariances: Floats) -> list[list[float]]:
    """Return half axes [mm] and direction [rad] of 95 % ellipses (N, 2, 2)."""
    long, short, angle = ellipse_axes(covariances)
    table = np.stack([1e3 * long, 1e3 * short, angle], axis=1)
    numbers: list[list[float]] = np.round(table, 3).tolist()
    return numbers
