"""All files of a map: figure, GeoJSON, points, occupancy grid."""

from __future__ import annotations

import os
import secrets
import shutil
from dataclasses import dataclass
from pathlib import Path

from fgloc.atomic import write_text
from fgloc.core.drive import Drive
from fgloc.core.measurements import LandmarkSightings, Scans
from fgloc.errors import FglocError
from fgloc.estimator import Result
from fgloc.report.map_figure import draw_map
from fgloc.report.map_geojson import geojson_text, map_geojson
from fgloc.report.map_grid import RESOLUTION_M, occupancy_grid, write_grid
from fgloc.report.map_ply import write_ply
from fgloc.report.map_points import all_points, placed_scans
from fgloc.report.map_segments import place_segments
from fgloc.report.map_thinning import thin


@dataclass(frozen=True)
class MapFiles:
    """What was written of a map."""

    folder: Path
    """Where it is."""
    names: tuple[str, ...]
    """Names of the files."""
    notes: tuple[str, ...]
    """What a user should know of them, one sentence each."""


def check_mappable(drive: Drive) -> None:
    """Raise FglocError if the drive has no sensor that sees its surroundings."""
    if not drive.each(Scans) and not drive.each(LandmarkSightings):
        raise FglocError(
            f"{drive.name} has neither laser scans nor landmark sightings, so there is nothing to "
            "make a map of; leave out --map, or choose another drive"
        )


def write_map(
    result: Result, drive: Drive, folder: Path, resolution: float = RESOLUTION_M
) -> MapFiles:
    """Write every file of the map into `folder`, which is created; return what was written.

    map.png, map.svg and map.geojson; with scans also map.ply (points thinned to 6 cm), map.pgm
    and map.yaml (occupancy grid of cells of `resolution` [m]). Files of those names are replaced,
    once all are complete. Raises FglocError if the drive has no sensor for a map
    (`check_mappable`), if the grid would be too large, or if the folder cannot be written.
    """
    check_mappable(drive)
    # Written beside and moved at the end: a map never is half of one run and half of another.
    working = folder / f".map.{secrets.token_hex(4)}.tmp"
    try:
        working.mkdir(parents=True)
        names, notes = _write(result, drive, working, resolution)
        for name in names:
            os.replace(working / name, folder / name)
    except OSError as error:
        reason = error.strerror or str(error)
        raise FglocError(
            f"cannot hold a map: {reason}; choose another folder", file=folder
        ) from error
    finally:
        shutil.rmtree(working, ignore_errors=True)
    return MapFiles(folder, tuple(names), tuple(notes))


def _write(
    result: Result, drive: Drive, folder: Path, resolution: float
) -> tuple[list[str], list[str]]:
    """Write the files into a folder that exists; return their names and notes on them."""
    placed = placed_scans(result, drive)
    everything = all_points(placed)
    points = thin(everything)
    names = ["map.png", "map.svg", "map.geojson"]
    notes = [
        f"{p.left_out} of {p.left_out + p.scan.size} scans of {p.sensor} lie outside the "
        "trajectory or in a gap of it, and are not in the map."
        for p in placed
        if p.left_out
    ]
    # The grid first: it is what can fail, and drawing takes the longest.
    if points.shape[0]:
        write_grid(occupancy_grid(placed, resolution), folder / "map.pgm", folder / "map.yaml")
        write_ply(points, folder / "map.ply")
        names += ["map.ply", "map.pgm", "map.yaml"]
    elif placed:
        notes.append("No beam of a scan in the map returned: there are no points and no grid.")
    segments = place_segments(result.map, placed[0]) if placed and result.map else None
    draw_map(result, drive, points, folder / "map.png", folder / "map.svg", segments)
    write_text(folder / "map.geojson", geojson_text(map_geojson(result, drive, segments)))
    return names, notes
