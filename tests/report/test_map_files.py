"""All files of a map appear, whole or not at all, and hold what they should."""

from __future__ import annotations

import json
import os
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fgloc.errors import FglocError
from fgloc.lazy import import_open3d
from fgloc.lidar.walls import Map
from fgloc.report import map_files
from fgloc.report.figures import colour
from fgloc.report.map_figure import POINT, WALL, draw_map
from fgloc.report.map_files import MapFiles, check_mappable, write_map
from tests.report.mapped import HALF, drive, result, room_map, room_scans, room_walls, sightings

ALL = ("map.png", "map.svg", "map.geojson", "map.ply", "map.pgm", "map.yaml")


def pixels_like(path: Path, wanted: str) -> int:
    """How many pixels of a picture have nearly the colour #rrggbb."""
    with Image.open(path) as image:
        picture = np.asarray(image.convert("RGB"), dtype=int)
    rgb = [int(wanted[k : k + 2], 16) for k in (1, 3, 5)]
    return int(np.count_nonzero(np.abs(picture - rgb).max(axis=2) < 12))


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> MapFiles:
    """The map of the room, in a folder that was not there."""
    folder = tmp_path_factory.mktemp("maps") / "new" / "map"
    return write_map(result(room_map()), drive(room_scans(), sightings()), folder)


def test_all_files(room: MapFiles) -> None:
    folder = room.folder
    assert (room.names, room.notes) == (ALL, ())
    assert sorted(os.listdir(folder)) == sorted(ALL)
    open3d = import_open3d()
    points = np.asarray(open3d.io.read_point_cloud(str(folder / "map.ply")).points)
    # A wall of 24 m with a point at least every 12 cm and at most every 6 cm.
    assert 200 < len(points) < 400
    np.testing.assert_array_equal(points[:, 2], 0.0)
    np.testing.assert_allclose(np.abs(points[:, :2]).max(axis=1), HALF, atol=1e-9)
    document = json.loads((folder / "map.geojson").read_text())
    assert len(document["features"]) == 4 + 2 + 2


def test_figures_show_walls_points_and_path(room: MapFiles, tmp_path: Path) -> None:
    for wanted in (WALL, POINT, colour("batch")):
        assert pixels_like(room.folder / "map.png", wanted) > 200
    text = (room.folder / "map.svg").read_text()
    ElementTree.fromstring(text)
    # Lines stay lines: walls and path are vectors, points one picture.
    assert WALL.lower() in text
    assert text.count("<image") == 1
    draw_map(result(), drive(room_scans()), np.zeros((0, 2)), tmp_path / "bare.png")
    assert pixels_like(tmp_path / "bare.png", WALL) == 0


def test_axes_are_equal(tmp_path: Path) -> None:
    # The room is a square, so its walls are as far apart on paper in x as in y.
    walls = result(Map(walls=room_walls()))
    draw_map(walls, drive(), np.zeros((0, 2)), tmp_path / "map.png")
    with Image.open(tmp_path / "map.png") as image:
        picture = np.asarray(image.convert("RGB"), dtype=int)
    rgb = [int(WALL[k : k + 2], 16) for k in (1, 3, 5)]
    blue = np.abs(picture - rgb).max(axis=2) < 12
    # Lines of blue through half the picture are walls; the legend has shorter ones.
    rows = np.flatnonzero(blue.sum(axis=1) > 500)
    columns = np.flatnonzero(blue.sum(axis=0) > 500)
    assert abs(int(np.ptp(rows)) - int(np.ptp(columns))) <= 3
    assert np.ptp(rows) > 500


def test_landmarks_alone_have_no_grid(tmp_path: Path) -> None:
    made = write_map(result(room_map()), drive(sightings()), tmp_path)
    assert made.names == ALL[:3]
    assert sorted(os.listdir(tmp_path)) == sorted(ALL[:3])


def test_scans_that_see_nothing_are_told(tmp_path: Path) -> None:
    scans = room_scans(30)
    blind = replace(scans, ranges=np.zeros_like(scans.ranges))
    made = write_map(result(), drive(blind), tmp_path)
    assert made.names == ALL[:3]
    # Scans at 4 s and later begin when the path of four seconds ends, or after.
    assert made.notes == (
        "10 of 30 scans of lidar lie outside the trajectory or in a gap of it, and are not in the "
        "map.",
        "No beam of a scan in the map returned: there are no points and no grid.",
    )


def test_nothing_is_left_of_what_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "map.pgm").write_text("of an earlier run")

    def fail(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(map_files, "draw_map", fail)
    with pytest.raises(KeyboardInterrupt):
        write_map(result(), drive(room_scans()), tmp_path)
    assert os.listdir(tmp_path) == ["map.pgm"]
    assert (tmp_path / "map.pgm").read_text() == "of an earlier run"


def test_refusals(tmp_path: Path) -> None:
    with pytest.raises(FglocError, match="neither laser scans nor landmark sightings"):
        check_mappable(drive())
    (tmp_path / "file").write_text("")
    with pytest.raises(FglocError, match=r"file: cannot hold a map: .*; choose another folder"):
        write_map(result(), drive(room_scans()), tmp_path / "file")
    with pytest.raises(FglocError, match="ask for cells of"):
        write_map(result(), drive(room_scans()), tmp_path / "fine", 1e-5)
