"""`fgloc compare` and `fgloc smooth` as they are typed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fgloc.cli import main
from fgloc.core.trajectory_io import load_trajectory


def test_compare_writes_json_and_says_how_far_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "out.json"
    drives = ["sim:seed-a-straight-slip20", "sim:seed-a-spin-slip20"]
    assert main(["compare", *drives, "--methods", "model1,model2", "--json", str(target)]) == 0
    shown = capsys.readouterr()
    assert "position RMSE" in shown.out
    assert str(target) in shown.out
    lines = [line for line in shown.err.splitlines() if line.startswith("[")]
    assert [line.split(" ")[0] for line in lines] == ["[1/4]", "[2/4]", "[3/4]", "[4/4]"]
    assert lines[1].startswith("[2/4] sim:seed-a-straight-slip20 model2 ")
    document = json.loads(target.read_text())
    assert [d["drive"] for d in document["drives"]] == drives


def test_one_bad_drive_among_several_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["compare", "sim:seed-a-spin-ideal", "no/such/file.csv", "--methods", "model1"]
    status = main([*arguments, "--json", str(tmp_path / "a.json"), "--out", str(tmp_path / "b")])
    assert status == 1
    shown = capsys.readouterr()
    assert shown.err.splitlines()[-1].startswith("fgloc: error: no/such/file.csv: ")
    assert list(tmp_path.iterdir()) == []


def test_smooth_saves_and_reports_like_compare(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    track, numbers = tmp_path / "track.tum", tmp_path / "numbers.json"
    arguments = ["smooth", "sim:seed-a-circle-noise", "--fixes", "2:0.005"]
    assert main([*arguments, "--save", str(track), "--json", str(numbers)]) == 0
    (entry,) = json.loads(numbers.read_text())["drives"]
    assert list(entry["methods"]) == ["batch"]
    scores = entry["methods"]["batch"]
    assert scores["sensors_used"] == ["wheels", "yaw", "fixes"]
    assert scores["ate_rmse_m"] < 0.05
    assert len(load_trajectory(track)) == scores["poses"]
    assert "effective_track" in capsys.readouterr().out


def test_smooth_takes_one_drive(data_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if not (data_dir / "vitko-swerve").is_dir():
        pytest.skip("vitko-swerve is not in FGLOC_DATA")
    assert main(["smooth", "vitko-swerve:all", "--data", str(data_dir)]) == 1
    assert "fgloc compare vitko-swerve:all" in capsys.readouterr().err


def test_a_place_that_cannot_be_written_is_known_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "file"
    file.write_text("")
    for option, place in (("--json", tmp_path), ("--json", file / "a.json"), ("--out", file)):
        assert main(["compare", "sim:no-such-drive", option, str(place)]) == 1
        assert str(place) in capsys.readouterr().err.splitlines()[-1]
    assert main(["smooth", "sim:no-such-drive", "--save", str(file / "a.tum")]) == 1
    assert "is not a folder" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_fixes_closer_than_any_truth_are_refused_in_one_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["compare", "sim:seed-a-spin-ideal", "--fixes", "1e-9"]) == 1
    assert "1e-09 s is more than any truth holds" in capsys.readouterr().err


def test_encoder_selection_reaches_every_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive, numbers = "sim:seed-a-circle-slip20", tmp_path / "numbers.json"
    for command in (["compare", "--methods", "model1"], ["smooth"], ["localise"]):
        arguments = [*command, drive, "--encoder-selection", "--json", str(numbers)]
        runs = ["--out", str(tmp_path / "runs")] if command[0] == "compare" else []
        assert main([*arguments, *runs]) == 0
        assert "one encoder a side is believed" in capsys.readouterr().out
        assert json.loads(numbers.read_text())["encoder_selection"] is True
    settings = (tmp_path / "runs" / "latest" / "settings.json").read_text()
    assert json.loads(settings)["encoder_selection"] is True
    assert main(["compare", "sim:square?robot=mecanum", "--encoder-selection"]) == 1
    assert "a mecanum base is not one" in capsys.readouterr().err.splitlines()[-1]


def test_a_checkpoint_does_not_go_on_with_other_encoders(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["localise", "sim:seed-a-circle-slip20", "--checkpoint", str(tmp_path)]
    assert main([*arguments, "--encoder-selection"]) == 0
    assert main([*arguments, "--resume"]) == 1
    assert "was written on another drive" in capsys.readouterr().err
