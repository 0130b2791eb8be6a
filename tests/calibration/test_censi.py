"""The closed form against the answers its authors published, and against a truth made by hand."""

from __future__ import annotations

import json
import math
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgloc.calibration import censi
from fgloc.core import geometry
from fgloc.core.bases import differential, mecanum
from fgloc.core.drive import Drive, Reference
from fgloc.core.measurements import CameraPoses, Floats, WheelIncrements
from fgloc.core.robot import Robot
from fgloc.core.trajectory import Trajectory
from fgloc.datasets import censi_calibration
from fgloc.datasets.registry import load_drive
from fgloc.errors import FglocError

TRUTH = np.array([0.04, 0.041, 0.3, 0.1, -0.05, 2.5])
"""Radii, track, sensor x, y, yaw."""
PARTS = ("", "_0", "_1", "_2")


@pytest.fixture
def folder(data_dir: Path) -> Path:
    """Return the folder of the published data."""
    found = data_dir / censi_calibration.NAME
    if not found.is_dir():
        pytest.skip("censi-calibration is not here; fgloc datasets fetch censi-calibration")
    return found


def driven(rows: list[tuple[float, float]], times: int = 10) -> tuple[Floats, Floats, Floats]:
    """Return angles, seconds and what the sensor sees of TRUTH, by composing poses."""
    angles = np.array(rows * times)
    left, right = TRUTH[0] * angles[:, 0], TRUTH[1] * angles[:, 1]
    turn = (right - left) / TRUTH[2]
    # The chord of an arc, as geometry books have it: 2 R sin(θ/2) along half the turn.
    with np.errstate(divide="ignore", invalid="ignore"):
        chord = np.where(
            turn == 0.0, left, (left + right) / 2.0 * np.sin(turn / 2.0) / (turn / 2.0)
        )
    robot = np.column_stack([chord * np.cos(turn / 2.0), chord * np.sin(turn / 2.0), turn])
    seen = geometry.between(TRUTH[3:], geometry.compose(robot, TRUTH[3:]))
    return angles, np.full(angles.shape[0], 0.8), seen


VARIED = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (2.0, 1.0), (1.0, 3.0), (-1.0, -1.2)]


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("run", ["lmov", "lstraight"])
def test_the_published_answers(folder: Path, run: str, part: str) -> None:
    answer = json.loads((folder / f"{run}{part}_results.json").read_text())
    table = censi_calibration.read_tuples(folder / f"{run}.tuple", Counter())
    if part:
        # The thirds take every third interval of the whole.
        table = table[int(part[1]) :: 3]
    found = censi.solve(table[:, 1:3] * table[:, :1], table[:, 0], table[:, 3:])
    published = np.array(
        [
            answer["l_diam"] / 2,
            answer["r_diam"] / 2,
            answer["axle"],
            answer["l_x"],
            answer["l_y"],
            answer["l_theta"],
        ]
    )
    sigma = np.sqrt(np.diag(answer["covariance"]))
    # Three standard deviations would be good enough; it is the same method, so digits agree.
    assert np.all(np.abs(found.values - published) < 0.001 * sigma)
    np.testing.assert_allclose(found.sigmas, sigma, rtol=0.03)
    np.testing.assert_allclose(
        found.covariance / np.outer(found.sigmas, found.sigmas),
        np.array(answer["covariance"]) / np.outer(sigma, sigma),
        atol=0.02,
    )


def test_a_truth_is_found_without_noise() -> None:
    found = censi.solve(*driven(VARIED), trims=0)
    np.testing.assert_allclose(found.values, TRUTH, atol=1e-10)
    np.testing.assert_allclose(found.residuals, 0.0, atol=1e-10)
    assert found.value("effective_track") == pytest.approx(0.3)


def test_sigmas_are_those_of_repeated_draws() -> None:
    rng = np.random.default_rng(2)
    angles, seconds, seen = driven(VARIED, 60)
    noise = np.array([1e-3, 1e-3, 4e-3])
    found = [
        censi.solve(angles, seconds, seen + noise * rng.normal(size=seen.shape), trims=0)
        for _ in range(120)
    ]
    off = np.array([(f.values - TRUTH) / f.sigmas for f in found])
    # 120 draws: a standard deviation is known to 6.5 %; four of these.
    assert np.all(np.abs(off.std(axis=0) - 1.0) < 0.26)
    np.testing.assert_allclose(found[0].noise, noise, rtol=0.15)


def test_wild_matches_are_left_out() -> None:
    rng = np.random.default_rng(3)
    angles, seconds, seen = driven(VARIED, 60)
    seen = seen + np.array([1e-3, 1e-3, 4e-3]) * rng.normal(size=seen.shape)
    wild = np.array([5, 100, 250, 300])
    seen[wild] += np.array([0.3, -0.2, 0.8])
    found = censi.solve(angles, seconds, seen)
    assert not np.isin(wild, found.kept).any()
    assert np.all(np.abs(found.values - TRUTH) < 4.0 * found.sigmas)
    kept_all = censi.solve(angles, seconds, seen, trims=0)
    assert kept_all.kept.size == angles.shape[0]
    assert abs(kept_all.values[5] - TRUTH[5]) > abs(found.values[5] - TRUTH[5])


def test_jacobian_against_finite_differences() -> None:
    # A turn on either side of where the series takes over, and none at all.
    angles = np.array([(1.0, 1.2), (1.0, -1.0), (1.0, 0.9756097561), (2.0, 1.9575), (0.0, 0.0)])
    jacobian = censi.predicted_jacobian(TRUTH, angles)
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-6
        slope = (
            censi.predicted(TRUTH + step, angles) - censi.predicted(TRUTH - step, angles)
        ) / 2e-6
        np.testing.assert_allclose(jacobian[:, :, k], slope, atol=2e-9)


@pytest.mark.parametrize(
    ("rows", "advice"),
    [
        ([(1.0, 1.0), (2.0, 2.0), (1.0, 1.01)], "hardly turns; add spins in both directions"),
        ([(1.0, -1.0), (-1.0, 1.0), (1.0, -1.02)], "only spins; add straight stretches"),
        ([(1.0, 2.0), (2.0, 4.0), (-1.0, -2.01)], "always turn in the same ratio"),
        ([(0.0, 0.0)], "stand still"),
    ],
)
def test_what_does_not_excite_is_named(rows: list[tuple[float, float]], advice: str) -> None:
    with pytest.raises(FglocError, match=advice):
        censi.solve(*driven(rows))


def test_wheels_that_count_backwards() -> None:
    angles, seconds, seen = driven(VARIED)
    with pytest.raises(FglocError, match="check that both wheels count forward"):
        censi.solve(angles * np.array([1.0, -1.0]), seconds, seen)


def test_arrays_that_do_not_fit() -> None:
    angles, seconds, seen = driven(VARIED)
    with pytest.raises(FglocError, match=r"needs angles \(N, 2\)"):
        censi.solve(angles[:, :1], seconds, seen)
    with pytest.raises(FglocError, match="at least 6"):
        censi.solve(angles[:5], seconds[:5], seen[:5])
    with pytest.raises(FglocError, match="positive length"):
        censi.solve(angles, 0.0 * seconds, seen)
    seen[3, 1] = np.nan
    with pytest.raises(FglocError, match="finite"):
        censi.solve(angles, seconds, seen)


def made(order: tuple[str, str] = ("left", "right")) -> Drive:
    """Return a drive that turned as VARIED, with a sensor that was mounted as TRUTH says."""
    angles, _, seen = driven(VARIED)
    stamps = np.arange(angles.shape[0] + 1) * 800_000_000
    columns = angles if order[0] == "left" else angles[:, ::-1]
    camera = CameraPoses("eye", stamps, geometry.chain(seen, np.array([3.0, 2.0, 1.0])), 0.01, 0.01)
    robot = Robot.typical("x", differential(0.04, 0.04, 0.3, order))
    return Drive("x", robot, WheelIncrements("wheels", stamps, columns.copy(), order), (camera,))


@pytest.mark.parametrize("order", [("left", "right"), ("right", "left")])
def test_displacements_of_a_drive(order: tuple[str, str]) -> None:
    angles, seconds, seen = censi.displacements_of(made(order))
    np.testing.assert_allclose(angles, driven(VARIED)[0], atol=1e-12)
    np.testing.assert_allclose(seconds, 0.8)
    np.testing.assert_allclose(seen, driven(VARIED)[2], atol=1e-12)
    np.testing.assert_allclose(censi.solve(angles, seconds, seen).values, TRUTH, atol=1e-9)


def test_poses_between_wheel_stamps() -> None:
    # Poses of the middles of the intervals: half of what the wheels turned before and after.
    drive = made()
    eye = drive.each(CameraPoses)[0]
    middle = eye.stamps_ns[:-1] + 400_000_000
    moved = replace(eye, stamps_ns=middle, poses=eye.poses[:-1])
    angles, _, _ = censi.displacements_of(replace(drive, sensors=(moved,)))
    whole = driven(VARIED)[0]
    np.testing.assert_allclose(angles, (whole[1:] + whole[:-1]) / 2.0, atol=1e-9)


def test_fast_poses_are_thinned_and_silences_left_out() -> None:
    drive = made()
    wheels = drive.wheels
    stamps = np.arange(0, wheels.stamps_ns[-1] + 1, 50_000_000)
    stamps = stamps[(stamps < 10_000_000_000) | (stamps > 20_000_000_000)]
    eye = CameraPoses("eye", stamps, np.zeros((stamps.size, 3)), 0.01, 0.01)
    angles, seconds, _ = censi.displacements_of(replace(drive, sensors=(eye,)), period_s=0.5)
    assert np.all((seconds > 0.45) & (seconds < 0.6))
    assert angles.shape[0] == pytest.approx((wheels.stamps_ns[-1] * 1e-9 - 10.0) / 0.5, abs=3)


def test_a_truth_serves_where_there_is_no_camera() -> None:
    drive = made()
    eye = drive.each(CameraPoses)[0]
    truth = Reference(Trajectory(eye.stamps_ns, eye.poses), "lidar")
    found = censi.displacements_of(replace(drive, sensors=(), truth=truth))
    np.testing.assert_allclose(found[2], driven(VARIED)[2], atol=1e-12)
    with pytest.raises(FglocError, match="no camera"):
        censi.displacements_of(replace(drive, sensors=()))
    with pytest.raises(FglocError, match="no camera called other; there is eye"):
        censi.displacements_of(drive, "other")


def test_other_bases_are_refused() -> None:
    names = ("fl", "fr", "rl", "rr")
    drive = made()
    wheels = WheelIncrements("wheels", drive.wheels.stamps_ns, np.ones((60, 4)), names)
    robot = Robot.typical("x", mecanum(0.05, 0.2, 0.2, names))
    with pytest.raises(FglocError, match="wheels left and right"):
        censi.displacements_of(replace(drive, robot=robot, wheels=wheels))


def test_the_recorded_drive_is_the_tuples(folder: Path) -> None:
    # Strung together and taken apart again: the answers stay the published ones.
    drive = load_drive("censi-calibration:lstraight")
    answer = json.loads((folder / "lstraight_results.json").read_text())
    found = censi.solve(*censi.displacements_of(drive))
    sigma = math.sqrt(answer["covariance"][2][2])
    assert abs(found.value("effective_track") - answer["axle"]) < 0.01 * sigma
    assert found.residuals.shape[0] == 4396
