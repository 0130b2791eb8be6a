"""Comparisons: the JSON contract, skipped methods, seeded fixes."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgloc.core import bases
from fgloc.core.drive import Drive, Reference
from fgloc.core.geometry import integrate
from fgloc.core.measurements import PositionFixes, WheelIncrements, Yaw
from fgloc.core.robot import Robot
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError
from fgloc.experiments.compare import compare, compare_drives
from fgloc.experiments.fixes import FixSpec, parse, with_fixes
from fgloc.experiments.methods import METHODS, available, create
from fgloc.experiments.methods import parse as parse_methods
from fgloc.report.outcomes import Settings
from fgloc.report.results_json import comparison_json, dumps


def drive(
    name: str = "tiny", *, yaw: bool = True, truth: bool = True, spins: bool = False
) -> Drive:
    """20 s at 10 Hz, an arc or spins to and fro, with a true track 10 % over the nominal."""
    nominal, actual = (bases.differential(0.05, 0.05, track) for track in (0.40, 0.44))
    stamps = np.arange(201, dtype=np.int64) * 100_000_000
    angles = np.tile([0.4, 0.5], (200, 1))
    if spins:
        # Both ways, or the radii's ratio would explain the turns as well as the track does.
        side = np.repeat([0.5, -0.5, 0.5, -0.5], 50)
        angles = np.column_stack([-side, side])
    poses = integrate(actual.displacements(angles), np.array([1.0, 2.0, 0.3]), 0)
    return Drive(
        name,
        Robot("tiny robot", nominal),
        WheelIncrements("wheels", stamps, angles, ("left", "right")),
        (Yaw("yaw", stamps, poses[:, 2] + 1.0, 0.01),) if yaw else (),
        Reference(Trajectory(stamps, poses), mount=(0.0, 0.0, 0.0)) if truth else None,
    )


def test_json_has_the_keys_of_the_contract_and_the_right_numbers() -> None:
    found = compare_drives([drive()], ["model1", "model2"], Settings())
    document = json.loads(dumps(comparison_json(found)))
    assert set(document) >= {"drives", "total"}
    (entry,) = document["drives"]
    assert entry["drive"] == "tiny"
    assert entry["duration_s"] == 20.0
    for method in ("model1", "model2"):
        scores = entry["methods"][method]
        assert set(scores) >= {
            "ate_rmse_m",
            "ate_aligned_rmse_m",
            "ate_heading_rmse_deg",
            "end_position_m",
            "end_heading_deg",
            "e_max",
            "nees",
            "seconds",
            "sensors_used",
            "calibration",
        }
        assert set(scores["e_max"]) == {"x", "y", "theta"}
        assert set(document["total"][method]) == {"x", "y", "theta", "sum"}
        assert scores["nees"] is None
    # 200 steps of 0.005 m difference: 2.5 rad over 0.40 m, 2.2727… over 0.44 m.
    end = np.degrees(1.0 / 0.40 - 1.0 / 0.44)
    assert entry["methods"]["model1"]["end_heading_deg"] == pytest.approx(end)
    assert entry["methods"]["model2"]["end_heading_deg"] == pytest.approx(0.0, abs=1e-9)
    assert entry["methods"]["model2"]["sensors_used"] == ["wheels", "yaw"]
    total = document["total"]["model1"]
    assert total["theta"] == pytest.approx(np.radians(end))
    assert total["sum"] == pytest.approx(total["x"] + total["y"] + total["theta"])


def test_a_calibrating_method_reports_its_parameters() -> None:
    found = compare_drives([drive(spins=True)], ["batch"], Settings())
    (entry,) = comparison_json(found)["drives"]
    track = entry["methods"]["batch"]["calibration"]["effective_track"]
    assert set(track) >= {"nominal", "value", "sigma", "prior_sigma", "observed"}
    assert track["nominal"] == pytest.approx(0.40)
    # Spins and yaw tell track/radius only, which is ln(0.44/0.40) = 0.0953 off nominal. The
    # priors share that: variances are 25 (track, 5 %) and 8.55 (mean of two radii, 3 % each,
    # correlation 0.9), so the track takes 0.745 of it.
    assert track["value"] == pytest.approx(0.40 * math.exp(0.745 * 0.0953), rel=0.005)
    # What is left of it: 5 %·√(1 - 0.745), just over half of the prior's 5 %.
    assert track["sigma"] == pytest.approx(track["value"] * 0.05 * math.sqrt(0.255), rel=0.01)
    assert track["observed"] is False


def test_a_method_that_cannot_run_is_skipped_with_its_reason() -> None:
    found = compare_drives([drive("a", yaw=False), drive("b")], ["model1", "model2"], Settings())
    document = comparison_json(found)
    assert document["drives"][0]["skipped"] == {"model2": "model2 needs a yaw sensor; a has none"}
    assert "model2" not in document["drives"][0]["methods"]
    assert document["total_drives"] == {"model1": 2, "model2": 1}


def test_nothing_to_show_is_an_error() -> None:
    with pytest.raises(FglocError, match="model2 needs a yaw sensor"):
        compare_drives([drive(yaw=False)], ["model2"], Settings())


def test_without_truth_scores_are_null() -> None:
    document = comparison_json(compare_drives([drive(truth=False)], ["model1"], Settings()))
    scores = document["drives"][0]["methods"]["model1"]
    assert scores["ate_rmse_m"] is None
    assert scores["e_max"] == {"x": None, "y": None, "theta": None}
    assert document["total"]["model1"] == {"x": None, "y": None, "theta": None, "sum": None}


def test_nan_becomes_null() -> None:
    found = compare_drives([drive()], ["batch"], Settings())
    outcome = found.drives[0].methods["batch"]
    lost = tuple(replace(c, sigma=float("nan")) for c in outcome.result.calibration)
    broken = replace(outcome, result=replace(outcome.result, calibration=lost))
    changed = replace(found, drives=(replace(found.drives[0], methods={"batch": broken}),))
    document = json.loads(dumps(comparison_json(changed)))
    calibration = document["drives"][0]["methods"]["batch"]["calibration"]
    assert calibration["effective_track"]["sigma"] is None
    assert calibration["effective_track"]["observed"] is False


def test_swerve_recordings_reproduce_the_published_total(data_dir: Path) -> None:
    if not (data_dir / "vitko-swerve").is_dir():
        pytest.skip("vitko-swerve is not in FGLOC_DATA")
    found = compare(["vitko-swerve:all"], "model1", integrator="euler", data=data_dir)
    assert len(found.drives) == 18
    # Checked independently on the published recordings with the seed's kinematics: 1.2607.
    assert found.total["model1"].sum == pytest.approx(1.2607, abs=1e-3)


def fixes_of(found: Drive) -> PositionFixes:
    return next(s for s in found.each(PositionFixes) if s.sensor == "fixes")


def test_fixes_are_the_truth_sparse_noisy_and_seeded() -> None:
    one, again, other = (fixes_of(with_fixes(drive(), 0.5, 0.02, seed)) for seed in (1, 1, 2))
    # 20 s, the first after 0.5 s: 40 fixes.
    np.testing.assert_array_equal(one.stamps_ns, np.arange(1, 41) * 500_000_000)
    np.testing.assert_array_equal(one.positions, again.positions)
    assert not np.array_equal(one.positions, other.positions)
    truth = drive().truth
    assert truth is not None
    noise = (one.positions - truth.trajectory.poses[5::5, :2]).ravel()
    # Chi² of 80 standard normal values lies in 45…125 with all but 1e-3 probability.
    assert 45.0 < float(np.sum((noise / 0.02) ** 2)) < 125.0
    # What a fix says of itself adds the truth's own 1 mm: sqrt(0.02² + 0.001²).
    assert float(one.sigma[0, 0]) == pytest.approx(0.0200250, abs=1e-7)
    elsewhere = fixes_of(with_fixes(drive("another name"), 0.5, 0.02, 1))
    assert not np.array_equal(one.positions, elsewhere.positions)


def test_fixes_stand_at_recorded_stamps_and_keep_away_from_gaps() -> None:
    whole = drive()
    assert whole.truth is not None
    t = whole.truth.trajectory
    keep = (t.stamps_ns < 7_000_000_000) | (t.stamps_ns > 13_000_000_000)
    cut = replace(whole.truth, trajectory=Trajectory(t.stamps_ns[keep], t.poses[keep]))
    with_gap = fixes_of(with_fixes(replace(whole, truth=cut), 5.0, 0.01, 0))
    np.testing.assert_array_equal(with_gap.stamps_ns, np.array([5, 15, 20]) * 1_000_000_000)
    everywhere = fixes_of(with_fixes(whole, 5.0, 0.01, 0))
    np.testing.assert_array_equal(with_gap.positions, everywhere.positions[[0, 2, 3]])


def test_fixes_of_a_drive_that_has_fixes_get_a_name_of_their_own() -> None:
    twice = with_fixes(with_fixes(drive(), 5.0, 0.01, 0), 5.0, 0.01, 1)
    assert [s.sensor for s in twice.sensors][-2:] == ["fixes", "truth_fixes"]


def test_fixes_carry_the_reference_s_mounting() -> None:
    whole = drive()
    assert whole.truth is not None
    mounted = replace(
        whole.truth, sensor="marker", mount=(0.1, -0.2, 0.5), mount_sigma=(0.01, 0.02, 0.03)
    )
    found = fixes_of(with_fixes(replace(whole, truth=mounted), 5.0, 0.01, 0))
    assert (found.mount, found.mount_sigma) == ((0.1, -0.2), (0.01, 0.02))
    assert found.mount_name == "marker"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: with_fixes(drive(truth=False), 5.0, 0.01, 0), "no recorded truth"),
        (lambda: with_fixes(drive(), 30.0, 0.01, 0), "too short"),
        (lambda: with_fixes(drive(), -1.0, 0.01, 0), "positive"),
        (lambda: with_fixes(drive(), 1e-9, 0.01, 0), "more than any truth holds"),
        (lambda: parse("ten"), "EVERY_S"),
        (lambda: parse("10:"), "EVERY_S"),
        (lambda: parse("10:0"), "positive"),
    ],
)
def test_impossible_fixes_are_refused(make: object, message: str) -> None:
    assert callable(make)
    with pytest.raises(FglocError, match=message):
        make()


def test_fixes_are_parsed() -> None:
    assert parse("10") == FixSpec(10.0, 0.01)
    assert parse("2.5:0.002") == FixSpec(2.5, 0.002)


def test_method_ids() -> None:
    assert [m.id for m in METHODS] == [
        "model1",
        "model2",
        "model3",
        "pose-ekf",
        "rl-ekf",
        "ekf-slam",
        "batch",
        "online",
    ]
    assert parse_methods("model1, batch,model1") == ("model1", "batch")
    for method in available():
        assert create(method).method == method
    with pytest.raises(FglocError, match="unknown method 'model9'"):
        parse_methods("model9")
    with pytest.raises(FglocError, match="no method is named"):
        parse_methods(",")


def test_encoders_are_selected_for_every_method_and_recorded() -> None:
    drives = ["sim:seed-a-straight-slip20"]
    plain = compare(drives, "model1,model2", integrator="midpoint")
    chosen = compare(drives, "model1,model2", integrator="midpoint", encoder_selection=True)
    assert comparison_json(plain)["encoder_selection"] is False
    document = comparison_json(chosen)
    assert document["encoder_selection"] is True
    (entry,) = document["drives"]
    assert any("one encoder a side is believed" in note for note in entry["notes"])
    for method in ("model1", "model2"):
        assert entry["methods"][method]["end_position_m"] < 1e-9
        assert comparison_json(plain)["drives"][0]["methods"][method]["end_position_m"] > 0.08


def test_encoders_that_cannot_be_selected_are_an_error() -> None:
    with pytest.raises(FglocError, match="two or more encoders on each side"):
        compare(["sim:square?robot=differential"], "model1", encoder_selection=True)
