"""`fgloc simulate` as a user calls it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fgloc.cli import main
from fgloc.core.trajectory_io import load_trajectory
from fgloc.datasets import jaguar
from fgloc.datasets.own_format import read_npz
from fgloc.datasets.simulator import load_sim


def test_writes_what_it_simulates(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "sim:square?seed=2", "--json", "about.json"]) == 0
    back, drive = read_npz(tmp_path / "square.npz"), load_sim("square?seed=2")
    assert back.name == drive.name
    assert np.array_equal(back.wheels.angles, drive.wheels.angles)
    about = json.loads((tmp_path / "about.json").read_text())
    assert about["drive"] == "sim:square?seed=2"
    assert about["true_calibration"] == drive.true_calibration


def test_run_folder_with_a_log(tmp_path: Path) -> None:
    out = tmp_path / "runs"
    assert main(["simulate", "demo", "--format", "jaguar", "--out", str(out)]) == 0
    back = jaguar.load(out / "latest" / "drive.log")
    drive = load_sim("demo")
    assert back.wheels.angles == pytest.approx(drive.wheels.angles, abs=1e-9)
    truth = load_trajectory(out / "latest" / "truth.tum")
    assert drive.truth is not None
    assert truth.poses == pytest.approx(drive.truth.trajectory.poses, abs=1e-9)


def test_errors_leave_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "demo?camera=perhaps", "--out", str(tmp_path / "runs")]) == 1
    assert main(["simulate", "demo", "--out", str(tmp_path / "a.csv")]) == 1
    words = capsys.readouterr().err.splitlines()
    assert len(words) == 2
    assert "camera=perhaps" in words[0]
    assert ".npz" in words[1]
    assert not list(tmp_path.iterdir())
