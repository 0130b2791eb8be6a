"""`fgloc smooth --map`, `fgloc localise --map` and `fgloc view` as they are typed."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fgloc.cli import main
from fgloc.core.drive import Drive
from fgloc.experiments import compare
from tests.report.mapped import drive, room_scans

DRIVE = "sim:figure-eight?duration=20"
"""A drive without any sensor for a map."""
ALL = ["map.geojson", "map.pgm", "map.ply", "map.png", "map.svg", "map.yaml"]


@pytest.fixture
def room(monkeypatch: pytest.MonkeyPatch) -> str:
    """Return a drive's id behind which the room of the tests of maps stands."""

    def load(*_: object) -> Drive:
        return drive(room_scans())

    monkeypatch.setattr(compare, "load_drive", load)
    return DRIVE


def test_smooth_writes_a_map_into_a_folder(
    room: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, numbers = tmp_path / "map", tmp_path / "out.json"
    line = ["smooth", room, "--map", str(folder), "--map-resolution", "0.1", "--json", str(numbers)]
    assert main(line) == 0
    assert sorted(os.listdir(folder)) == ALL
    assert "resolution: 0.1\n" in (folder / "map.yaml").read_text()
    out = capsys.readouterr().out
    assert f"Map: {folder} (map.png, map.svg, map.geojson, map.ply, map.pgm, map.yaml)" in out
    with Image.open(folder / "map.pgm") as image:
        # A room of 6 m with half a metre of border: 70 or 71 cells of 10 cm.
        assert all(70 <= side <= 72 for side in image.size)
    found = json.loads(numbers.read_text())["drives"][0]["methods"]["batch"]
    assert "map" in found
    path = json.loads((folder / "map.geojson").read_text())["features"][-2]
    assert path["properties"]["kind"] == "trajectory"


def test_localise_writes_a_map_into_the_run_folder(
    room: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["localise", room, "--map", "--out", str(tmp_path)]) == 0
    run = (tmp_path / "latest").resolve()
    inside = run / "a_room_1"
    assert set(ALL) < set(os.listdir(inside))
    assert f"Map: {run / 'a_room_1'} (map.png, " in capsys.readouterr().out
    assert "map.png" in (run / "report.md").read_text()
    settings = json.loads((run / "settings.json").read_text())
    assert (settings["map"], settings["map_resolution"]) == (True, 0.05)
    assert sorted(os.listdir(tmp_path)) == sorted([run.name, "latest"])


def test_without_a_folder_the_map_goes_here(
    room: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["smooth", room, "--map"]) == 0
    assert os.listdir(tmp_path) == ["map"]


def test_a_drive_that_sees_nothing_is_refused_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["smooth", DRIVE, "--map", str(tmp_path / "map")]) == 1
    told = capsys.readouterr()
    assert told.err.splitlines()[-1].startswith(
        f"fgloc: error: {DRIVE} has neither laser scans nor landmark sightings, so there is "
    )
    assert told.out == ""
    assert os.listdir(tmp_path) == []


def test_a_grid_too_large_leaves_no_run_folder(
    room: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = ["smooth", room, "--map", "--map-resolution", "1e-4", "--out", str(tmp_path)]
    assert main(line) == 1
    told = capsys.readouterr()
    assert "ask for cells of" in told.err.splitlines()[-1]
    # The work was done, so its tables are shown.
    assert "batch" in told.out
    assert os.listdir(tmp_path) == []


def test_view_writes_both(room: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    recording, page = tmp_path / "v.rrd", tmp_path / "v.html"
    line = ["view", room, "--method", "model1", "--save", str(recording), "--html", str(page)]
    assert main(line) == 0
    assert recording.stat().st_size > 10_000
    assert page.read_text().startswith("<!doctype html>")
    out = capsys.readouterr().out.splitlines()
    assert out[0].startswith(f"Recording: {recording} ")
    assert out[1].startswith(f"Page: {page} ")
    assert sorted(os.listdir(tmp_path)) == ["v.html", "v.rrd"]


def test_view_without_the_viewer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    for more in ([], ["--save", str(tmp_path / "v.rrd")]):
        assert main(["view", DRIVE, *more]) == 1
        error = capsys.readouterr().err.splitlines()
        assert len(error) == 1
        assert "pip install 'fgloc[viz]'" in error[0]
    page = tmp_path / "v.html"
    assert main(["view", DRIVE, "--html", str(page)]) == 0
    assert os.listdir(tmp_path) == ["v.html"]


@pytest.mark.parametrize(
    ("line", "text"),
    [
        (["view", DRIVE, "--method", "model1,batch", "--html", "x"], "one method at a time"),
        (["view", DRIVE, "--method", "none", "--html", "x"], "none"),
        (["view", DRIVE, "--html", "."], "is a folder"),
        (["smooth", DRIVE, "--map", "/dev/null/map"], "is not a folder"),
    ],
)
def test_refusals(line: list[str], text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(line) == 1
    error = capsys.readouterr().err.splitlines()
    assert len(error) == 1
    assert text in error[0]


@pytest.mark.parametrize(
    "line", [["view"], ["view", "a", "--save", "a.html"], ["smooth", "a", "--map-resolution", "0"]]
)
def test_wrong_usage_exits_2(line: list[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(line)
    assert caught.value.code == 2


def test_room_of_the_tests_is_driven_as_its_wheels_say() -> None:
    told = drive()
    moved = told.robot.base.displacements(told.wheels.angles, None)
    np.testing.assert_allclose(moved[0], [0.02, 0.0, 0.02], atol=1e-12)


def test_the_walls_of_batch_are_in_the_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    numbers = tmp_path / "out.json"
    line = ["smooth", "sim:seed-b-room?seed=1&duration=12", "--json", str(numbers)]
    assert main(line) == 0
    capsys.readouterr()
    found = json.loads(numbers.read_text())["drives"][0]["methods"]["batch"]["map"]
    assert found["marks"] is None
    # The room has walls that are seen from everywhere, each some dozen times.
    assert len(found["walls"]) >= 5
    assert found["segments"]["associated"] == sum(w["sightings"] for w in found["walls"])
    assert found["segments"]["associated"] > 0.8 * found["segments"]["seen"]
    for wall in found["walls"]:
        assert wall["sightings"] >= 3
        assert 0.0 < wall["sigma_offset"] < 0.1
        (x1, y1), (x2, y2) = wall["ends"]
        assert wall["length"] == pytest.approx(np.hypot(x2 - x1, y2 - y1))
        # Right end first, seen along the normal turned by +90°.
        tangent = wall["normal"] + np.pi / 2
        assert (x2 - x1) * np.cos(tangent) + (y2 - y1) * np.sin(tangent) > 0.0
    assert max(w["length"] for w in found["walls"]) > 3.0
