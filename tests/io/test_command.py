"""Bags and topic maps as typed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fgloc.cli import main
from fgloc.datasets.registry import load_drive

from .bagfiles import SECOND, Arc, joints, pose_stamped, write_bag

ARC = Arc(seconds=6.0)
TOPICS = """
[base]
kind = "differential"
name = "typed by hand"
radius_left = 0.1
radius_right = 0.1
track = 0.4
[wheels]
joints = ["l", "r"]
"""


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Return a bag with wheel joints and truth of an arc: 0.5 m/s, 0.25 rad/s, wheels of 0.1 m."""
    messages = []
    for s in ARC.stamps:
        t = (s - ARC.start) / SECOND
        # v ∓ ω·0.2 over 0.1 m: 4.5 and 5.5 rad/s.
        messages += [joints(s, ["l", "r"], [4.5 * t, 5.5 * t]), pose_stamped(s, ARC.pose(s))]
    return write_bag(tmp_path / "run.bag", messages)


def test_compare_smooth_localise_and_convert_take_a_topic_map(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    topics = tmp_path / "topics.toml"
    topics.write_text(TOPICS)
    file = tmp_path / "out.json"
    with_topics = ["--topics", str(topics), "--json", str(file)]
    assert main(["compare", str(bag), "--methods", "model1", *with_topics]) == 0
    result = json.loads(file.read_text())
    assert result["topics_file"] == str(topics)
    assert result["drives"][0]["robot"] == "typed by hand"
    assert result["drives"][0]["methods"]["model1"]["ate_rmse_m"] < 1e-6
    for command in ("smooth", "localise"):
        assert main([command, str(bag), "--fixes", "1:0.01", *with_topics]) == 0
        assert json.loads(file.read_text())["drives"][0]["base"] == "differential"
    converted = tmp_path / "run.npz"
    assert main(["datasets", "convert", str(bag), str(converted), "--topics", str(topics)]) == 0
    assert load_drive(str(converted)).wheels.wheels == ("left", "right")
    assert "wheels ← /joint_states" in capsys.readouterr().out


def test_settings_of_a_run_folder_name_the_topic_map(bag: Path, tmp_path: Path) -> None:
    topics = tmp_path / "topics.toml"
    topics.write_text(TOPICS)
    arguments = ["--methods", "model1", "--topics", str(topics), "--out", str(tmp_path / "runs")]
    assert main(["compare", str(bag), *arguments]) == 0
    settings = json.loads((tmp_path / "runs" / "latest" / "settings.json").read_text())
    assert str(topics) in json.dumps(settings)


def test_errors_are_one_line(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["datasets", "info", str(bag)]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"fgloc: error: {bag}: wheel joints are here")
    assert len(error.splitlines()) == 1
    topics = tmp_path / "topics.toml"
    topics.write_text(TOPICS.replace('["l", "r"]', '["l", "right"]'))
    assert main(["smooth", str(bag), "--topics", str(topics)]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert lines[-1].startswith(f"fgloc: error: {topics}:9: ")
    assert main(["smooth", "sim:demo", "--topics", str(topics)]) == 1
    assert "is no ROS bag; leave out --topics" in capsys.readouterr().err
