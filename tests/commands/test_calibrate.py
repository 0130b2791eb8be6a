"""`fgloc calibrate` as it is typed."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from fgloc.calibration.evaluate import open_loop_trajectory
from fgloc.cli import main
from fgloc.datasets.registry import load_drive
from fgloc.errors import FglocError
from fgloc.robot_file import apply_robot_file

DATA = Path(os.environ.get("FGLOC_DATA", "/nowhere"))
recorded = pytest.mark.skipif(not (DATA / "optiodom").is_dir(), reason="no recorded drives here")
OPTIONS = "duration=30&yaw=off&gyro=on&slip=off"
CONTRACT = {"fit", "parameters", "evaluation", "total"}


def sims(*seeds: int) -> list[str]:
    """Return drives of one robot whose effective track is 0.55 m, not 0.48 m as stated."""
    robot = "calibration=nominal&effective_track=0.55"
    return [f"sim:random?seed={k}&{OPTIONS}&{robot}" for k in seeds]


def test_report_json_robot_file_and_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot, numbers, out = tmp_path / "robot.toml", tmp_path / "c.json", tmp_path / "runs"
    command = ["calibrate", *sims(1, 2, 3), "--evaluate", *sims(4, 5)]
    command += ["--save", str(robot), "--json", str(numbers), "--out", str(out)]
    assert main(command) == 0
    printed = capsys.readouterr().out
    assert "3 drives against truth" in printed
    assert "on drives not used for the fit" in printed
    assert f"Robot file, for --robot: {robot}" in printed
    document = json.loads(numbers.read_text())
    assert set(document) >= CONTRACT
    assert document["fit"] == sims(1, 2, 3)
    track = document["parameters"]["effective_track"]
    assert set(track) >= {"nominal", "value", "sigma", "observed"}
    assert track["observed"]
    assert abs(track["value"] - 0.55) < 4.0 * track["sigma"] < 0.05
    entry = document["evaluation"][0]
    keys = {"drive", "nominal_rmse_m", "rmse_m", "nominal_heading_rmse_deg", "heading_rmse_deg"}
    assert set(entry) >= keys | {"e_max"}
    assert set(entry["e_max"]) == {"x", "y", "theta"}
    assert entry["rmse_m"] < 0.5 * entry["nominal_rmse_m"]
    total = document["total"]
    assert total["change_percent"] == pytest.approx(
        100.0 * (total["value"] / total["nominal"] - 1.0)
    )
    matrix = np.array(document["correlation"])
    np.testing.assert_allclose(np.diag(matrix), 1.0)
    folder = (out / "latest").resolve()
    names = {p.name for p in folder.iterdir()}
    assert names >= {"robot.toml", "report.json", "report.txt", "settings.json"}
    for figure in ("parameters.png", "correlations.png", "paths.png", "errors.png"):
        assert (folder / figure).stat().st_size > 10_000


def test_the_robot_file_makes_the_calibrated_robot(tmp_path: Path) -> None:
    file, numbers = tmp_path / "robot.toml", tmp_path / "c.json"
    model = ["--model", "full-linear+rotation-scale"]
    command = ["calibrate", *sims(1, 2, 3), "--evaluate", *sims(4), *model]
    assert main([*command, "--save", str(file), "--json", str(numbers)]) == 0
    drive = apply_robot_file(load_drive(sims(4)[0]), file)
    assert [p.name for p in drive.robot.base.parameters][-1] == "rotation_scale"
    assert drive.truth is not None
    found = open_loop_trajectory(drive, drive.robot)
    from fgloc.core.evaluation import evaluate

    again = evaluate(found, drive.truth).ate_rmse_m
    written = json.loads(numbers.read_text())["evaluation"][0]["rmse_m"]
    assert again == pytest.approx(written, rel=1e-9)


def test_a_file_with_a_sensor_that_is_not_there_says_so(tmp_path: Path) -> None:
    file = tmp_path / "robot.toml"
    file.write_text('[sensors."mocap"]\nx = 0.1\n[sensors."camera"]\nyaw = 0.2\nyaw_sigma = 0.01\n')
    drive = apply_robot_file(load_drive("sim:random?camera=on"), file)
    assert any("mocap" in note for note in drive.notes)
    camera = next(s for s in drive.sensors if s.sensor == "camera")
    assert camera.mount[2] == 0.2  # type: ignore[union-attr]
    assert camera.mount_sigma[2] == 0.01  # type: ignore[union-attr]
    file.write_text('[sensors."camera"]\nyaw_sigma = -1.0\n')
    with pytest.raises(FglocError, match=r"robot.toml:2: sensors.camera.yaw_sigma must be"):
        apply_robot_file(load_drive("sim:random?camera=on"), file)
    file.write_text('[robot]\nmodels = ["magic"]\n')
    with pytest.raises(FglocError, match=r"robot.toml:2: robot.models: unknown model 'magic'"):
        apply_robot_file(load_drive("sim:random?camera=on"), file)


def test_against_sensors(capsys: pytest.CaptureFixture[str]) -> None:
    drives = [f"{name}&camera=on" for name in sims(1, 2)]
    assert main(["calibrate", *drives, "--reference", "sensors"]) == 0
    printed = capsys.readouterr().out
    assert "2 drives against camera, gyro" in printed
    assert "on the drives of the fit itself" in printed


def test_without_evaluate_errors_are_in_sample(tmp_path: Path) -> None:
    numbers = tmp_path / "c.json"
    assert main(["calibrate", *sims(1), "--model", "geometry", "--json", str(numbers)]) == 0
    assert [e["in_sample"] for e in json.loads(numbers.read_text())["evaluation"]] == [True]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([*sims(1), "--evaluate", *sims(1)], "is among the drives to fit and to evaluate"),
        ([*sims(1), "sim:demo", "--model", "magic"], "unknown model 'magic'"),
        (["sim:random?seed=1&robot=mecanum", *sims(1)], "is of another robot"),
    ],
)
def test_known_errors_are_one_line(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", *arguments]) == 1
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith("fgloc: error:")
    assert message in error


@recorded
def test_the_husky_on_ice_against_its_gyro(tmp_path: Path) -> None:
    numbers = tmp_path / "c.json"
    if not (DATA / "borealtc-husky").is_dir():
        pytest.skip("borealtc-husky is not here")
    command = ["calibrate", "cut:borealtc-husky:ICE/02?end=40", "--data", str(DATA)]
    assert main([*command, "--json", str(numbers)]) == 0
    document = json.loads(numbers.read_text())
    assert document["reference"] == "gyro"
    assert document["evaluation"] == []
    # Independently by regression of the gyro's angle on the wheels': 0.80 to 0.87 m.
    assert 0.76 < document["parameters"]["effective_track"]["value"] < 0.92
    assert any("tells no distances" in text for text in document["advice"])
