"""The pose EKF on whole drives: what it believes, what it rejects, how sure it is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgloc.core import bases
from fgloc.core.consistency import average, squared_normalised
from fgloc.core.drive import Drive, Reference
from fgloc.core.evaluation import Evaluation, error_series, evaluate
from fgloc.core.geometry import compose
from fgloc.core.measurements import (
    CameraPoses,
    Floats,
    PoseFixes,
    PositionFixes,
    Sensor,
    Stamps,
    WheelIncrements,
    Yaw,
    YawRate,
)
from fgloc.core.robot import Robot
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.registry import load_drive
from fgloc.datasets.simulator import load_sim
from fgloc.errors import FglocError
from fgloc.estimator import Result
from fgloc.experiments.fixes import with_fixes
from fgloc.filters.model1 import Model1
from fgloc.filters.pose_ekf import PoseEkf
from fgloc.filters.pose_ekf_settings import PoseEkfSettings

WHITE = PoseEkfSettings(calibration=0.0, horizon_s=0.0)
"""For drives whose robot is exactly as stated and whose sensors have white noise only."""


def scores(result: Result, drive: Drive) -> Evaluation:
    assert drive.truth is not None
    return evaluate(result.trajectory, drive.truth)


def changed(drive: Drive, change: Callable[[Sensor], Sensor | None]) -> Drive:
    sensors = (change(s) for s in drive.sensors)
    return replace(drive, sensors=tuple(s for s in sensors if s is not None))


def ns(seconds: Floats) -> Stamps:
    return np.round(seconds * 1e9).astype(np.int64)


@pytest.mark.parametrize(
    "robot", ["differential", "skid", "mecanum", "omni3", "tricycle", "swerve"]
)
def test_wheels_alone_are_wheel_odometry_with_a_covariance(robot: str) -> None:
    drive = load_sim(f"random?robot={robot}&yaw=off&duration=20")
    result = PoseEkf().estimate(drive)
    by_wheels = Model1().estimate(drive).trajectory.poses
    np.testing.assert_allclose(result.trajectory.poses, by_wheels, rtol=0, atol=1e-9)
    assert result.sensors_used == ("wheels",)
    assert result.trajectory.covariances is not None
    sigma = np.sqrt(result.trajectory.covariances[-1, [0, 1], [0, 1]])
    assert bool(np.all(sigma > 0.01))


@pytest.mark.parametrize(
    "sensors",
    [
        "yaw=off",
        "yaw=off&fix_every=5&fix_sigma=0.05",
        "yaw_resolution=0&yaw_sigma=0.01&yaw_drift=0&yaw_walk=0.002",
        "yaw=off&gyro=on&gyro_bias_sigma=0&gyro_bias_walk=0&gyro_density=0.005&fix_every=5",
    ],
)
def test_covariances_are_right_where_the_noise_is_as_stated(sensors: str) -> None:
    """NEES of the last pose over 40 drives without slip, with a start as uncertain as stated."""
    start_sigma = np.array([0.02, 0.02, 0.01])
    found = []
    for seed in range(40):
        drive = load_sim(
            f"random?robot=differential&calibration=nominal&encoder_ticks=0&duration=40&{sensors}"
            f"&seed={seed}"
        )
        assert drive.truth is not None
        poses = drive.truth.trajectory.poses.copy()
        poses[0] += start_sigma * np.random.default_rng([seed, 1]).standard_normal(3)
        start = Reference(
            Trajectory(drive.truth.trajectory.stamps_ns, poses), sigma=tuple(start_sigma.tolist())
        )
        result = PoseEkf(WHITE).estimate(replace(drive, truth=start))
        series = error_series(result.trajectory, drive.truth)
        assert series.covariances is not None
        found.append(squared_normalised(series.errors[-1], series.covariances[-1]))
    assert average(found, 3, 0.99).verdict == "inside"


def test_lasting_errors_are_allowed_for() -> None:
    """Unknown track, gyro bias and camera mounting: NEES of a few, where white noise says 100s."""
    wide, narrow = [], []
    for seed in range(8):
        drive = load_sim(f"random?robot=swerve&yaw=off&gyro=on&camera=on&duration=40&seed={seed}")
        for settings, out in ((PoseEkfSettings(), wide), (WHITE, narrow)):
            nees = scores(PoseEkf(settings).estimate(drive), drive).nees
            assert nees is not None
            out.append(nees)
    assert np.mean(wide) < 8.0
    assert np.mean(narrow) > 30.0


def test_nothing_later_than_a_pose_changes_it() -> None:
    drive = load_sim("random?camera=on&gyro=on&fix_every=5&duration=20&slip=on")
    assert drive.truth is not None
    whole = PoseEkf().estimate(drive).trajectory
    n = 50
    end = drive.wheels.stamps_ns[n]

    def until(s: Sensor) -> Sensor:
        known = s.stamps_ns <= end
        arrays = {
            name: value[known]
            for name, value in vars(s).items()
            if isinstance(value, np.ndarray) and value.shape[:1] == known.shape
        }
        return replace(s, **arrays)

    wheels = replace(
        drive.wheels, stamps_ns=drive.wheels.stamps_ns[: n + 1], angles=drive.wheels.angles[:n]
    )
    early = PoseEkf().estimate(replace(changed(drive, until), wheels=wheels)).trajectory
    np.testing.assert_allclose(early.poses, whole.poses[: n + 1], rtol=0, atol=1e-12)
    assert early.covariances is not None
    assert whole.covariances is not None
    np.testing.assert_allclose(early.covariances, whole.covariances[: n + 1], rtol=0, atol=1e-12)


def test_covariances_stay_symmetric_and_positive_over_an_hour() -> None:
    drive = load_sim("random?camera=on&gyro=on&fix_every=7&duration=3600&fix_sigma=0.01")
    covariances = PoseEkf().estimate(drive).trajectory.covariances
    assert covariances is not None
    np.testing.assert_array_equal(covariances, covariances.swapaxes(1, 2))
    assert np.linalg.eigvalsh(covariances).min() > 0.0


def test_wild_fixes_are_rejected_and_counted() -> None:
    drive = load_sim("random?fix_every=4&fix_sigma=0.05&seed=3")

    def wild(s: Sensor) -> Sensor:
        if not isinstance(s, PositionFixes):
            return s
        positions = s.positions.copy()
        positions[::4] += 5.0
        return replace(s, positions=positions)

    broken = changed(drive, wild)
    result = PoseEkf().estimate(broken)
    (fixes,) = drive.each(PositionFixes)
    total = fixes.stamps_ns.size
    assert result.counts["fixes"].rejected == len(range(0, total, 4))
    assert result.counts["fixes"].accepted == total - len(range(0, total, 4))
    clean = scores(PoseEkf().estimate(drive), drive).ate_rmse_m
    assert scores(result, drive).ate_rmse_m < 1.5 * clean
    # Rejected innovations are shown, with weight 0.
    (innovations,) = (r for r in result.residuals if r.sensor == "fixes")
    assert innovations.weights.tolist() == [float(k % 4 != 0) for k in range(total)]
    # Without a gate they are believed.
    open_gate = PoseEkf(PoseEkfSettings(fix_gate=math.inf)).estimate(broken)
    assert open_gate.counts["fixes"].rejected == 0
    assert scores(open_gate, drive).ate_rmse_m > 10.0 * clean


def test_a_robot_that_was_carried_away_is_found_again() -> None:
    """3 m to the side, unseen by the wheels: the fixes are rejected thrice, then believed."""
    drive = load_sim("random?fix_every=2&fix_sigma=0.02&seed=1&robot=differential&yaw=off")
    assert drive.truth is not None
    (fixes,) = drive.each(PositionFixes)
    half = fixes.stamps_ns.size // 2
    moved = fixes.positions.copy()
    moved[half:] += [3.0, 0.0]
    result = PoseEkf().estimate(replace(drive, sensors=(replace(fixes, positions=moved),)))
    assert 2 <= result.counts["fixes"].rejected <= 4
    assert any("believed again 1 time" in note for note in result.notes)
    true_end = drive.truth.trajectory.poses[-1, :2] + [3.0, 0.0]
    assert np.hypot(*(result.trajectory.poses[-1, :2] - true_end)) < 0.3


def leaping(drive: Drive) -> Drive:
    """Camera and yaw both lose their frame in the middle, the yaw for 3 s."""

    def leap(s: Sensor) -> Sensor:
        middle = s.stamps_ns.size // 2
        if isinstance(s, CameraPoses):
            poses = s.poses.copy()
            poses[middle:] = compose(np.array([1.0, -0.5, 0.6]), poses[middle:])
            return replace(s, poses=poses)
        if isinstance(s, Yaw):
            yaw = s.yaw.copy()
            yaw[middle : middle + 150] += 0.5
            return replace(s, yaw=yaw)
        return s

    return changed(drive, leap)


def test_a_frame_that_leaps_is_aligned_anew() -> None:
    drive = load_sim("random?camera=on&seed=2")
    clean = scores(PoseEkf().estimate(drive), drive).ate_rmse_m
    result = PoseEkf().estimate(leaping(drive))
    assert "yaw leapt 2 times: its frame was aligned anew" in result.notes
    assert "camera leapt 1 time: its frame was aligned anew" in result.notes
    assert scores(result, drive).ate_rmse_m < 1.5 * clean
    deaf = PoseEkf(PoseEkfSettings(leap_m=math.inf, leap_rad=math.inf)).estimate(leaping(drive))
    assert scores(deaf, drive).ate_rmse_m > 5.0 * clean


def test_the_camera_is_aligned_by_its_nominal_mount() -> None:
    """A camera that looks to the left, 0.4 m ahead, in a frame of its own; wheels that are off."""
    t = np.arange(0.0, 20.0, 0.05)
    true = np.column_stack([2.0 * np.sin(0.3 * t), 2.0 - 2.0 * np.cos(0.3 * t), 0.3 * t])
    mount = (0.4, 0.1, 1.5)
    frame = np.array([7.0, -3.0, 2.0])
    camera = CameraPoses(
        "camera",
        ns(t),
        compose(frame, compose(true, np.array(mount))),
        1e-6,
        1e-6,
        mount=mount,
        mount_sigma=(0.0, 0.0, 0.0),
        scale_sigma=0.0,
    )
    turning = np.tile([0.25, 0.3], (t.size - 1, 1))
    wheels = WheelIncrements("wheels", ns(t), turning, ("left", "right"))
    base = bases.differential(0.1, 0.1, 0.5)
    truth = Reference(Trajectory(ns(t), true))
    drive = Drive("looking left", Robot("test", base), wheels, (camera,), truth)
    result = PoseEkf().estimate(drive)
    assert scores(result, drive).ate_rmse_m < 0.01
    # The heading goes on past pi.
    assert result.trajectory.poses[-1, 2] == pytest.approx(0.3 * t[-1], abs=0.02)


def test_without_a_truth_the_first_fixes_tell_the_map() -> None:
    drive = load_sim("random?fix_every=3&fix_sigma=0.02&seed=4&robot=differential")
    assert drive.truth is not None
    result = PoseEkf().estimate(replace(drive, truth=None))
    assert any("until 3 fixes told where it is" in note for note in result.notes)
    stamps, poses = result.trajectory.stamps_ns, result.trajectory.poses
    # Until then the path begins at the origin.
    np.testing.assert_array_equal(poses[0], np.zeros(3))
    late = stamps > stamps[0] + 20_000_000_000
    known = Trajectory(stamps[late], poses[late])
    assert evaluate(known, drive.truth).ate_rmse_m < 0.15
    # A pose fix tells everything at once.
    k = 10
    pose = drive.truth.trajectory.poses[k]
    fix = PoseFixes(
        "map", drive.truth.trajectory.stamps_ns[k : k + 1], pose[None], np.full((1, 3), 0.01)
    )
    result = PoseEkf().estimate(replace(drive, truth=None, sensors=(fix,)))
    at = int(np.searchsorted(result.trajectory.stamps_ns, fix.stamps_ns[0]))
    np.testing.assert_allclose(result.trajectory.poses[at], pose, rtol=0, atol=1e-9)
    assert any("until 1 fix told" in note for note in result.notes)


def test_fixes_that_tell_no_heading_are_left_alone() -> None:
    drive = load_sim("random?fix_every=3&seed=4&duration=10")
    fixes = replace(drive.each(PositionFixes)[0], sigma=np.full((3, 2), 50.0))
    result = PoseEkf().estimate(replace(drive, truth=None, sensors=(fixes,)))
    assert result.counts["fixes"].accepted == 0
    assert any("do not tell the heading" in note for note in result.notes)


def test_silent_empty_and_foreign_streams() -> None:
    drive = load_sim("random?duration=20&gyro=on&camera=on&fix_every=5&seed=2")
    far = 10**15

    def elsewhere(s: Sensor) -> Sensor:
        return replace(s, stamps_ns=s.stamps_ns + far)

    alone = PoseEkf().estimate(replace(drive, sensors=()))
    result = PoseEkf().estimate(changed(drive, elsewhere))
    np.testing.assert_array_equal(result.trajectory.poses, alone.trajectory.poses)
    assert result.sensors_used == ("wheels",)
    assert all(c.accepted == 0 for name, c in result.counts.items() if name != "wheels")
    none = np.zeros(0, dtype=np.int64)
    empty = (
        Yaw("yaw", none, np.zeros(0), 0.1),
        YawRate("gyro", none, np.zeros(0), 0.1),
        CameraPoses("camera", none, np.zeros((0, 3)), 0.1, 0.1),
        PositionFixes("fixes", none, np.zeros((0, 2)), np.zeros((0, 2))),
    )
    result = PoseEkf().estimate(replace(drive, sensors=empty))
    np.testing.assert_array_equal(result.trajectory.poses, alone.trajectory.poses)
    # A gap of five seconds in everything but the wheels.
    begin = drive.wheels.stamps_ns[0] + 8_000_000_000

    def paused(s: Sensor) -> Sensor:
        heard = (s.stamps_ns < begin) | (s.stamps_ns > begin + 5_000_000_000)
        if isinstance(s, YawRate):
            return replace(s, stamps_ns=s.stamps_ns[heard], rate=s.rate[heard])
        if isinstance(s, Yaw):
            return replace(s, stamps_ns=s.stamps_ns[heard], yaw=s.yaw[heard])
        if isinstance(s, CameraPoses):
            return replace(s, stamps_ns=s.stamps_ns[heard], poses=s.poses[heard])
        return s

    assert scores(PoseEkf().estimate(changed(drive, paused)), drive).ate_rmse_m < 0.5


def test_numbers_beyond_reason_are_one_error() -> None:
    drive = load_sim("random?duration=10&fix_every=5")
    (fixes,) = drive.each(PositionFixes)
    huge = replace(fixes, positions=np.full_like(fixes.positions, 1e100))
    settings = PoseEkfSettings(fix_gate=math.inf)
    with pytest.raises(FglocError, match="off by orders of magnitude"):
        PoseEkf(settings).estimate(replace(drive, sensors=(huge,)))


@pytest.mark.parametrize(
    ("name", "value"),
    [("process_noise", 0.0), ("camera_heading", math.inf), ("yaw_gate", -1.0), ("gyro", math.nan)],
)
def test_settings_are_checked(name: str, value: float) -> None:
    with pytest.raises(FglocError, match=f"pose-ekf: {name} must be positive"):
        PoseEkfSettings(**{name: value})
    with pytest.raises(FglocError, match="horizon_s must be not negative"):
        PoseEkfSettings(horizon_s=-1.0)


def test_a_heading_that_is_hardly_known_does_not_lose_the_robot(data_dir: Path) -> None:
    """A skidding robot whose nominal track is off by half, with a fix every 10 s and nothing else.

    The heading is off by a radian between fixes, more than linearising allows. A filter told of
    white noise only is lost.
    """
    if not (data_dir / "jackal-jackass").is_dir():
        pytest.skip("jackal-jackass is not in FGLOC_DATA")
    drive = with_fixes(load_drive("jackal-jackass:1", data_dir), 10.0, 0.05, 0)
    found = {}
    for settings in (PoseEkfSettings(), WHITE):
        result = PoseEkf(settings).estimate(drive)
        found[settings] = (scores(result, drive), result.counts["fixes"].rejected)
    good, rejected = found[PoseEkfSettings()]
    assert rejected == 0
    assert good.nees is not None
    assert good.nees < 6.0
    assert good.ate_rmse_m < 1.0
    assert found[WHITE][0].ate_rmse_m > 1.0
