"""Figures are real pictures, tables keep every digit, run folders hold what they promise."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgloc.core import bases
from fgloc.core.drive import Drive, Reference
from fgloc.core.geometry import integrate
from fgloc.core.measurements import PositionFixes, WheelIncrements
from fgloc.core.robot import Robot
from fgloc.core.trajectory import Trajectory
from fgloc.core.trajectory_io import load_trajectory
from fgloc.estimator import CalibrationEstimate, Result, SensorCount, SensorResiduals
from fgloc.report.figures import height
from fgloc.report.outcomes import Comparison, DriveOutcome, MethodOutcome
from fgloc.report.run_files import draw_figures, folder_names, write_run
from fgloc.report.tables import plain_text


@pytest.fixture
def comparison() -> Comparison:
    """A drive of 5 s, once without and once with covariance, residuals and calibration."""
    base = bases.differential(0.05, 0.05, 0.4)
    stamps = np.arange(51, dtype=np.int64) * 100_000_000
    angles = np.tile([0.4, 0.5], (50, 1))
    poses = integrate(base.displacements(angles), np.zeros(3), 0)
    drive = Drive(
        "a/drive:1",
        Robot("robot", base),
        WheelIncrements("wheels", stamps, angles, ("left", "right")),
        (PositionFixes("fixes", stamps[10:20], poses[10:20, :2], np.full((10, 2), 0.01)),),
        Reference(Trajectory(stamps, poses)),
        rejected={"truncated lines": 3},
        notes=("A note on this recording.",),
    )
    covariances = np.tile(np.diag([1e-4, 2e-4, 1e-3]), (51, 1, 1))
    rng = np.random.default_rng(0)
    values = rng.normal(size=(10, 2))
    smoothed = Result(
        "batch",
        drive.name,
        Trajectory(stamps, poses + 0.01, covariances),
        ("wheels", "fixes"),
        (
            CalibrationEstimate("wheel_radius.left", 0.05, 0.0512345, 0.0001, 0.002),
            CalibrationEstimate("effective_track", 0.4, 0.4, 0.02, 0.02),
        ),
        (
            SensorResiduals(
                "fixes", ("x [m]", "y [m]"), stamps[10:20], 0.01 * values, values, np.ones(10)
            ),
        ),
        {"wheels": SensorCount(50), "fixes": SensorCount(7, 2, 1)},
        1.5,
        "converged after 3 iterations",
    )
    plain = Result("model1", drive.name, Trajectory(stamps, poses + 0.1), ("wheels",))
    methods = {"model1": MethodOutcome(plain, None), "batch": MethodOutcome(smoothed, None)}
    outcome = DriveOutcome(drive, methods, {"model2": "model2 needs a yaw sensor"})
    return Comparison(("model1", "model2", "batch"), (outcome,), {})


def png_size(path: Path) -> tuple[int, int]:
    """Width and height from a PNG's header: bytes 16 to 24, big-endian."""
    content = path.read_bytes()
    assert content[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", content[16:24])
    return width, height


def test_figures_are_drawn_in_their_sizes(comparison: Comparison, tmp_path: Path) -> None:
    drawn = {p.name: p for p in draw_figures(comparison.drives[0], tmp_path)}
    assert set(drawn) == {
        "trajectory.png",
        "errors.png",
        "calibration-batch.png",
        "residuals-batch.png",
    }
    # Inches times 150 dots.
    assert png_size(drawn["errors.png"]) == (1950, 1125)
    assert png_size(drawn["calibration-batch.png"]) == (1500, 366)
    assert png_size(drawn["residuals-batch.png"]) == (1800, 645)
    width, height = png_size(drawn["trajectory.png"])
    assert 1000 < width < 1500
    assert 500 < height < 1500
    for path in drawn.values():
        # A blank picture of this size packs into a few kilobytes.
        assert path.stat().st_size > 15_000


def test_drawing_leaves_pyplot_alone(comparison: Comparison, tmp_path: Path) -> None:
    import matplotlib.pyplot as plt

    before = plt.get_fignums()
    draw_figures(comparison.drives[0], tmp_path)
    assert plt.get_fignums() == before


def test_plain_tables_are_whole_and_say_everything(comparison: Comparison) -> None:
    text = plain_text(comparison)
    assert not any(c in text for c in "─│┃━…\x1b")
    assert all(line == line.rstrip() for line in text.splitlines())
    for words in (
        "0.05123",
        "wheels, fixes",
        "model2 is skipped: model2 needs a yaw sensor.",
        "3 × truncated lines",
        "observed: ±σ is less than half the prior's",
        "A note on this recording.",
        "converged after 3 iterations",
    ):
        assert words in text
    lines = text.splitlines()
    assert next(x for x in lines if x.startswith("wheel_radius.left")).endswith("  observed")
    assert next(x for x in lines if x.startswith("effective_track")).endswith("not observed")
    assert next(x for x in lines if "fixes   " in x).split() == ["fixes", "7", "2", "1"]


def test_run_folder_holds_everything(comparison: Comparison, tmp_path: Path) -> None:
    folder, _ = write_run(comparison, tmp_path, "compare", {"fixes": "10:0.01"})
    assert (tmp_path / "latest").resolve() == folder.resolve()
    settings = json.loads((folder / "settings.json").read_text())
    assert settings["command"] == "compare"
    assert settings["fixes"] == "10:0.01"
    (name,) = folder_names([comparison.drives[0].drive.name])
    back = load_trajectory(folder / name / "batch.tum")
    kept = comparison.drives[0].methods["batch"].result.trajectory
    np.testing.assert_array_equal(back.stamps_ns, kept.stamps_ns)
    np.testing.assert_allclose(back.poses, kept.poses, rtol=0, atol=1e-12)
    report = (folder / "report.md").read_text()
    for figure in folder.rglob("*.png"):
        assert str(figure.relative_to(folder)) in report
    numbers = json.loads((folder / "report.json").read_text())
    assert numbers["drives"][0]["drive"] == "a/drive:1"


def test_folder_names_are_safe_and_differ() -> None:
    names = folder_names(["a:1", "a/1", "../../etc", "sim:demo?seed=1&x=2", ".."])
    assert len(set(names)) == 5
    for name in names:
        assert "/" not in name
        assert not name.startswith(".")


def test_without_truth_the_table_tells_where_the_drive_ends(comparison: Comparison) -> None:
    """The end of the fixture's arc plus 0.01, with sigmas 0.01, 0.0141 m and 1.81 degrees."""
    outcome = comparison.drives[0]
    text = plain_text(replace(comparison, drives=(replace(outcome, methods=outcome.methods),)))
    assert "position RMSE" not in text
    (row,) = [line.split() for line in text.splitlines() if line.startswith("batch   ")][:1]
    # 50 steps: 0.45 rad on average at 5 cm radius, and (0.5 - 0.4) · 0.05 / 0.4 rad of turn.
    turn = 50 * 0.1 * 0.05 / 0.4
    radius = 50 * 0.45 * 0.05 / turn
    x, y = radius * np.sin(turn) + 0.01, radius * (1 - np.cos(turn)) + 0.01
    assert row[2:4] == [f"{x:.4f}", f"{y:.4f}"]
    assert row[4:8] == [f"{np.degrees(turn + 0.01):.2f}", "0.0100", "0.0141", "1.81"]


def test_a_calibration_far_from_its_prior_is_remarked_on(comparison: Comparison) -> None:
    far = CalibrationEstimate("effective_track", 0.4, 0.55, 0.01, 0.02)
    near = CalibrationEstimate("icr_x", 0.0, -1e-9, 0.01, 0.02)
    outcome = comparison.drives[0]
    batch = outcome.methods["batch"]
    moved = replace(batch, result=replace(batch.result, calibration=(far, near)))
    methods = {**outcome.methods, "batch": moved}
    text = plain_text(replace(comparison, drives=(replace(outcome, methods=methods),)))
    assert "batch moves effective_track by more than 3 prior σ" in text
    assert "moves icr_x" not in text
    assert "-0.00000" not in text


def test_drives_that_differ_say_so(comparison: Comparison) -> None:
    one = comparison.drives[0]
    other = replace(
        one,
        drive=replace(one.drive, name="b", sensors=(), robot=replace(one.drive.robot, name="r2")),
    )
    text = plain_text(replace(comparison, drives=(one, other)))
    assert "Offered to every method, where a drive has it: wheels, fixes." in text
    assert "Calibration by batch, robot: one drive" in text
    assert "Calibration by batch, r2: one drive" in text


def test_equal_paths_are_both_seen() -> None:
    """Dashed lines lie above solid ones, and all lie below markers and ellipses (3 and up)."""
    assert height("batch") < height("model1") < 3.0
    assert height("batch") < height("model2") < 3.0
