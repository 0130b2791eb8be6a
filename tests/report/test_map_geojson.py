"""GeoJSON as RFC 7946 has it, with the numbers that a user looks for."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np

from fgloc.core.trajectory import Trajectory
from fgloc.lidar.walls import Map
from fgloc.report.map_geojson import geojson_text, map_geojson
from fgloc.report.map_json import map_json
from fgloc.report.map_segments import PlacedSegments
from tests.report.mapped import drive, result, room_map, room_walls, sightings


def read(text: str) -> dict[str, Any]:
    """Parse strictly: NaN and infinity are no JSON."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    document: dict[str, Any] = json.loads(text, parse_constant=refuse)
    return document


def check_structure(document: dict[str, Any]) -> None:
    """RFC 7946, sections 3.1 (geometry), 3.2 (feature), 3.3 (collection), 7.1 (foreign members)."""
    assert document["type"] == "FeatureCollection"
    assert not {"coordinates", "geometries", "geometry", "properties", "crs"} & document.keys()
    names = [feature["id"] for feature in document["features"]]
    assert len(set(names)) == len(names)
    for feature in document["features"]:
        assert feature["type"] == "Feature"
        assert set(feature) == {"type", "id", "geometry", "properties"}
        assert isinstance(feature["properties"], dict)
        geometry = feature["geometry"]
        assert set(geometry) == {"type", "coordinates"}
        positions = geometry["coordinates"]
        if geometry["type"] == "Point":
            positions = [positions]
        else:
            assert geometry["type"] == "LineString"
            assert len(positions) >= 2
        for position in positions:
            assert len(position) == 2
            assert all(isinstance(number, float) for number in position)


def features(document: dict[str, Any], kind: str) -> list[dict[str, Any]]:
    """All features of a kind."""
    return [f for f in document["features"] if f["properties"]["kind"] == kind]


def test_room() -> None:
    document = read(geojson_text(map_geojson(result(room_map()), drive(sightings()))))
    check_structure(document)
    assert document["frame"]["unit"] == "m"
    walls = features(document, "wall")
    assert len(walls) == 4
    # x = 3 is seen from inside, so its normal points to -x, and its right end is the upper one.
    assert walls[0]["geometry"]["coordinates"] == [[3.0, 3.0], [3.0, -3.0]]
    assert walls[0]["properties"] == {
        "kind": "wall",
        "sigma_offset_m": 0.02,
        "sigma_direction_deg": 0.572958,
        "normal_deg": 180.0,
        "length_m": 6.0,
        "sightings": 20,
        "seen_m": None,
    }
    first, second = features(document, "mark")
    assert first["geometry"] == {"type": "Point", "coordinates": [1.0, 2.0]}
    # 2.4477 times the square roots of 0.04 (along x) and 0.01.
    assert first["properties"]["ellipse_95_major_m"] == 0.48954
    assert first["properties"]["ellipse_95_minor_m"] == 0.24477
    assert first["properties"]["ellipse_95_major_axis_deg"] in (0.0, 180.0)
    assert first["properties"]["surveyed_m"] == [1.1, 2.0]
    assert second["properties"]["ellipse_95_major_m"] is None
    assert second["properties"]["surveyed_m"] is None
    path = features(document, "trajectory")[0]
    assert path["properties"]["method"] == "batch"
    # 0.4 rad and 1 s on: 20 poses of 50 ms.
    assert path["geometry"]["coordinates"][20] == [round(np.cos(0.4), 4), round(np.sin(0.4), 4)]
    assert path["properties"]["seconds"][20] == 1.0
    assert path["properties"]["heading_deg"][20] == round(np.degrees(0.4) + 90.0, 4)
    assert len(features(document, "truth")) == 1


def test_which_parts_were_seen() -> None:
    ends = np.array([[[-2.0, 3.0], [-1.0, 3.0]], [[0.0, 3.0], [3.0, 3.0]]])
    segments = PlacedSegments(np.zeros(2, np.int64), ends, np.ones(2, np.int64))
    document = read(geojson_text(map_geojson(result(room_map()), drive(), segments)))
    parts = [wall["properties"]["seen_m"] for wall in features(document, "wall")]
    # From the right end, which is at x = -3.
    assert parts == [[], [[1.0, 2.0], [3.0, 6.0]], [], []]


def test_without_a_map_or_a_truth_the_path_is_left() -> None:
    document = read(geojson_text(map_geojson(result(), drive(truth=False))))
    check_structure(document)
    assert [f["properties"]["kind"] for f in document["features"]] == ["trajectory"]


def test_a_simulated_world_has_true_walls() -> None:
    room = replace(drive(), name="sim:seed-b-room?seed=3")
    document = read(geojson_text(map_geojson(result(), room)))
    check_structure(document)
    true = features(document, "true_wall")
    # Four walls, the pillar and the cupboard; the room is 6 m by 5 m.
    ends = np.array([f["geometry"]["coordinates"] for f in true])
    assert len(true) > 8
    np.testing.assert_allclose(np.ptp(ends.reshape(-1, 2), axis=0), [6.0, 5.0])


def test_a_single_pose_is_no_line() -> None:
    alone = replace(
        result(), trajectory=Trajectory(np.zeros(1, np.int64), np.array([[1.0, 2.0, 0.0]]))
    )
    document = read(geojson_text(map_geojson(alone, drive(truth=False))))
    check_structure(document)
    assert document["features"] == []


def test_walls_without_covariance() -> None:
    unknown = replace(room_walls(), covariance=np.full((4, 2, 2), np.nan))
    document = read(geojson_text(map_geojson(result(Map(walls=unknown)), drive())))
    check_structure(document)
    assert features(document, "wall")[0]["properties"]["sigma_offset_m"] is None


def test_json_of_the_command() -> None:
    found = map_json(room_map())
    assert found["segments"] == {"seen": 1, "associated": 1}
    wall = found["walls"][0]
    np.testing.assert_allclose(wall["ends"], [[3.0, 3.0], [3.0, -3.0]], atol=1e-12)
    assert (wall["normal"], wall["offset"], wall["length"]) == (np.pi, 0.0, 6.0)
    np.testing.assert_allclose([wall["sigma_offset"], wall["sigma_normal"]], [0.02, 0.01])
    assert found["marks"][1]["landmark"] == 14
    assert (found["marks"][1]["x"], found["marks"][1]["y"]) == (-1.5, 0.5)
    assert map_json(Map()) == {"walls": None, "marks": None, "segments": None}
