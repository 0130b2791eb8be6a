"""`fgloc compare --ekf`: a user's own configuration beside the other methods."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fgloc.cli import main

CONFIG = """\
ekf_filter_node:
  ros__parameters:
    frequency: 20.0
    two_d_mode: true
    odom0: /odom
    odom0_config: [false, false, false, false, false, false,
                   true, true, false, false, false, true, false, false, false]
    pose0: /gps
    pose0_config: [true, true, false, false, false, false,
                   false, false, false, false, false, false, false, false, false]
    publish_tf: true
    no_such_key: 1
"""
DRIVE = "sim:figure-eight?duration=20&fix_every=5&yaw=off"


def test_a_configuration_is_used_and_recorded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, numbers = tmp_path / "ekf.yaml", tmp_path / "numbers.json"
    config.write_text(CONFIG)
    arguments = ["compare", DRIVE, "--methods", "rl-ekf,pose-ekf", "--ekf", str(config)]
    assert main([*arguments, "--json", str(numbers), "--out", str(tmp_path / "runs")]) == 0
    shown = capsys.readouterr().out
    for note in (
        "rl-ekf: odom0 (/odom) reads wheels: vx, vy, vyaw.",
        "rl-ekf: pose0 (/gps) reads fixes: x, y.",
        "rl-ekf: without effect on recorded drives: publish_tf.",
        "rl-ekf: key is not known and not honoured: no_such_key (line 12).",
    ):
        assert note in shown
    document = json.loads(numbers.read_text())
    assert document["ekf_file"] == str(config)
    found = document["drives"][0]["methods"]["rl-ekf"]
    assert found["sensors_used"] == ["wheels", "fixes"]
    assert len(found["notes"]) == 4
    settings = json.loads((tmp_path / "runs" / "latest" / "settings.json").read_text())
    assert settings["ekf"] == str(config)
    assert settings["settings"]["rl-ekf"]["frequency"] == 20.0
    assert [i["name"] for i in settings["settings"]["rl-ekf"]["inputs"]] == ["odom0", "pose0"]


def test_without_it_the_file_is_null(tmp_path: Path) -> None:
    numbers = tmp_path / "numbers.json"
    assert main(["compare", DRIVE, "--methods", "rl-ekf", "--json", str(numbers)]) == 0
    assert json.loads(numbers.read_text())["ekf_file"] is None


def test_errors_are_one_line_and_come_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "ekf.yaml"
    config.write_text(CONFIG.replace("20.0", "often"))
    assert main(["compare", "sim:no-such-drive", "--ekf", str(config)]) == 1
    line = capsys.readouterr().err.splitlines()[-1]
    assert line == f"fgloc: error: {config}:3: frequency expected float, got str"
    assert main(["compare", DRIVE, "--ekf", str(config), "--methods", "model1"]) == 1
    assert "which --methods leaves out" in capsys.readouterr().err.splitlines()[-1]
