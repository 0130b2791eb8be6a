"""`fgloc datasets` as typed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fgloc.cli import main
from fgloc.datasets.registry import load_drive


@pytest.fixture(autouse=True)
def _alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("FGLOC_DATA", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def write_drive(tmp_path: Path) -> Path:
    path = tmp_path / "hand.csv"
    robot = '{"kind": "differential", "radius_left": 0.1, "radius_right": 0.1, "track": 0.5}'
    rows = ["wheels,0", "wheels,1000000000,1,2", "wheels,2000000000,1,2", "wheels,2000000000,1,1"]
    rows += ["yaw,0,0.0", "yaw,2000000000,0.4"]
    path.write_text("\n".join(["# fgloc-drive 1", f'# {{"robot": {robot}}}', *rows]) + "\n")
    return path


def test_list(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "data" / "vitko-swerve"
    folder.mkdir(parents=True)
    (folder / "odom_3.csv").touch()
    (folder / "abs_3.csv").touch()
    file = tmp_path / "list.json"
    assert main(["datasets", "list", "--data", str(folder.parent), "--json", str(file)]) == 0
    out = capsys.readouterr().out
    assert "not here; fetch it" in out
    entries = {e["dataset"]: e for e in json.loads(file.read_text())["datasets"]}
    assert entries["vitko-swerve"]["runs"] == ["3"]
    assert entries["vitko-swerve"]["folder"] == str(folder)
    assert entries["optiodom"]["folder"] is None


def test_info(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "info.json"
    assert main(["datasets", "info", str(write_drive(tmp_path)), "--json", str(file)]) == 0
    out = capsys.readouterr().out
    assert "rejected: 1 × repeated stamp" in out
    assert "longest gap [s]" in out
    about = json.loads(file.read_text())
    assert about["duration_s"] == 2.0
    # Two intervals of wheels turning 1 and 2 rad with 0.1 m: 0.15 m and 0.2 rad each.
    assert about["path_m"] == pytest.approx(0.3)
    assert about["turned_rad"] == pytest.approx(0.4)
    assert about["sensors"][1] == {
        "name": "yaw",
        "kind": "Yaw",
        "samples": 2,
        "rate_hz": 0.5,
        "longest_gap_s": 2.0,
    }
    assert about["parameters"]["effective_track"]["nominal"] == 0.5
    assert about["rejected"] == {"repeated stamp": 1}


def test_convert_and_back(tmp_path: Path) -> None:
    source = write_drive(tmp_path)
    npz, csv = tmp_path / "a.npz", tmp_path / "b.csv"
    assert main(["datasets", "convert", str(source), str(npz)]) == 0
    assert main(["datasets", "convert", str(npz), str(csv)]) == 0
    angles = load_drive(str(csv)).wheels.angles
    assert angles.tolist() == load_drive(str(source)).wheels.angles.tolist()


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["info", "vitko-swerv:1"], "did you mean vitko-swerve?"),
        (["info", "vitko-swerve:1"], "fgloc datasets fetch vitko-swerve"),
        (["info", "none.log"], "no such file"),
        (["fetch", "vitko"], "no dataset is called 'vitko'"),
        (["list", "--data", "none"], "no such data folder"),
        (["convert", "sim:demo?seed=1", "a.xls"], "must end in .npz or .csv"),
        (["convert", "none.log", "a.npz"], "no such file"),
    ],
)
def test_one_line_and_exit_1(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    what: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["datasets", *words]) == 1
    error = capsys.readouterr().err
    assert error.startswith("fgloc: error: ")
    assert what in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
