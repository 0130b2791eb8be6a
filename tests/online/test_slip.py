"""Slip found while driving: the poses as they were emitted, and what a look must leave alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fgloc.core.evaluation import evaluate
from fgloc.datasets.simulator import load_sim
from fgloc.estimator import Result
from fgloc.online.checkpoint import restore, save
from fgloc.online.online import OnlineSmoother
from fgloc.online.replay import packets
from fgloc.online.settings import OnlineSettings

from .driving import engine_for, run

CASES = ("straight", "spin", "circle")
WITHOUT = OnlineSettings(slip=None)


def drive_live(spec: str, settings: OnlineSettings | None = None) -> tuple[Result, float]:
    """Return what the engine emitted on a simulated drive, and the position error at the end."""
    drive = load_sim(spec)
    result = OnlineSmoother(settings).estimate(drive)
    assert drive.truth is not None
    return result, evaluate(result.trajectory, drive.truth).end_position_m


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("scenario", ["slip20", "slip40ticks", "bothleft"])
def test_emitted_poses_hardly_notice_a_slip(case: str, scenario: str) -> None:
    spec = f"seed-a-{case}-{scenario}?nominal_track=0.48"
    result, end = drive_live(spec)
    assert end < 0.02
    assert end < 0.5 * drive_live(spec, WITHOUT)[1]
    # The yaw was right: the wheels slipped.
    assert "yaw" in result.sensors_used
    assert not any("left out" in note for note in result.notes)


@pytest.mark.parametrize(
    "spec",
    [
        *(f"seed-a-{case}-noise?nominal_track=0.48" for case in CASES),
        "figure-eight?camera=on&seed=3&duration=40",
        "random?robot=mecanum&seed=4&duration=40&fix_every=5",
        "random?robot=differential&gyro=on&duration=40&fix_every=5",
    ],
)
def test_without_slip_nothing_changes(spec: str) -> None:
    np.testing.assert_array_equal(
        drive_live(spec)[0].trajectory.poses, drive_live(spec, WITHOUT)[0].trajectory.poses
    )


def test_slips_of_a_demo_halve_the_error_and_mend_the_covariance() -> None:
    drive = load_sim("demo?seed=2")
    assert drive.truth is not None
    found = evaluate(drive_live("demo?seed=2")[0].trajectory, drive.truth)
    without = evaluate(drive_live("demo?seed=2", WITHOUT)[0].trajectory, drive.truth)
    assert found.ate_rmse_m < 0.6 * without.ate_rmse_m
    assert found.nees is not None
    assert without.nees is not None
    assert found.nees < 3.5 < without.nees


def test_a_checkpoint_in_the_middle_of_a_slip_goes_on_to_the_last_bit(tmp_path: Path) -> None:
    drive = load_sim("seed-a-circle-slip20?nominal_track=0.48")
    stream = list(packets(drive))
    middle = next(k for k, p in enumerate(stream) if p.stamp_ns >= 4_300_000_000)
    straight, broken = engine_for(drive), engine_for(drive)
    run(straight, stream)
    run(broken, stream[:middle])
    assert broken.window.slipping.any()
    save(broken, tmp_path / "state")
    settings = broken.settings
    again = restore(
        tmp_path / "state",
        drive.robot,
        drive.sensors,
        drive.truth,
        settings,
        drive.wheels.resolution,
    )
    run(again, stream[middle:])
    np.testing.assert_array_equal(again.window.states.view, straight.window.states.view)
    np.testing.assert_array_equal(again.window.slips.view, straight.window.slips.view)
    # From 3 to 5 s the front left wheel, from 4 to 5 s the rear right one as well.
    slips = straight.window.slips.view
    assert np.flatnonzero(slips[:, 0]).tolist() == list(range(16, 26))
    assert np.flatnonzero(slips[:, 3]).tolist() == list(range(21, 26))
    assert not slips[:, 1:3].any()
    np.testing.assert_allclose(slips[slips != 0.0], 1 / 6, atol=0.02)


def test_a_track_that_a_straight_run_does_not_observe_says_nothing_against_the_yaw() -> None:
    # Rounded counts pull the unknown track far out, by 3.7 prior sigmas; that is noise.
    result, end = drive_live("seed-a-vehicle-straight?seed=15&yaw_zero=0.001927&nominal_track=0.48")
    assert "yaw" in result.sensors_used
    assert not any("left out" in note for note in result.notes)
    assert end < 0.05
