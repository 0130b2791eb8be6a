"""The robot_localization-like filter on drives: inputs, modes, what it makes of each stream."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from fgloc.core import bases
from fgloc.core.drive import Drive, Reference
from fgloc.core.evaluation import evaluate
from fgloc.core.geometry import compose
from fgloc.core.measurements import (
    Acceleration,
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
from fgloc.core.robot import Robot, WheelNoise
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.simulator import load_sim
from fgloc.errors import FglocError
from fgloc.filters.model1 import Model1
from fgloc.filters.rl_ekf import RlEkf, default_config
from fgloc.filters.rl_inputs import Messages, bind, messages_of
from fgloc.io.ekf_config import EkfConfig, EkfInput, diagonal

POSE, TWIST = ("x", "y", "yaw"), ("vx", "vy", "vyaw")


def ns(*seconds: float) -> Stamps:
    return np.round(np.asarray(seconds) * 1e9).astype(np.int64)


def drive_with(*sensors: Sensor, start: Floats | None = None) -> Drive:
    """1 s straight on at 1 m/s in two packets."""
    base = bases.differential(0.1, 0.1, 0.5)
    noise = WheelNoise(0.1, 0.0, 0.0, 0.0, 0.0)
    wheels = WheelIncrements("wheels", ns(0.0, 0.5, 1.0), np.full((2, 2), 5.0), ("left", "right"))
    truth = None
    if start is not None:
        truth = Reference(Trajectory(ns(0.0, 1.0), np.stack([start, start])))
    return Drive("straight", Robot("test", base, noise), wheels, sensors, truth)


def messages(one: EkfInput, *sensors: Sensor, start: Floats | None = None) -> list[Messages]:
    drive = drive_with(*sensors, start=start)
    (binding,) = bind(EkfConfig((one,)), drive)
    return messages_of(binding, drive, np.zeros(3) if start is None else start)


def test_wheels_become_a_twist_and_an_integrated_pose() -> None:
    pose, twist = messages(EkfInput("odom0", "", POSE + TWIST))
    assert pose.states == (0, 1, 2)
    assert twist.states == (3, 4, 5)
    np.testing.assert_array_equal(twist.stamps_ns, ns(0.5, 1.0))
    np.testing.assert_allclose(twist.values, [[1.0, 0.0, 0.0]] * 2, atol=1e-12)
    np.testing.assert_allclose(pose.values, [[0.5, 0.0, 0.0], [1.0, 0.0, 0.0]], atol=1e-12)
    # Each wheel's 0.5 m has variance 0.01 · 0.5 = 0.005, the mean of both 0.0025; over 0.5 s that
    # is 0.0025 / 0.25 = 0.01 (m/s)² forward, and 4 · 0.0025 / 0.25 / 0.25 = 0.16 (rad/s)² of turn.
    np.testing.assert_allclose(twist.noises[0, [0, 2], [0, 2]], [0.01, 0.16])
    # Differencing the pose gives the twist its covariance back: (C + C) dt = 0.01.
    (difference,) = messages(EkfInput("odom0", "", ("x",), differential=True))
    assert difference.states == (3,)
    np.testing.assert_allclose(difference.values, [[1.0]])
    np.testing.assert_allclose(difference.noises, [[[0.01]]])


def test_differential_poses_by_hand() -> None:
    # From (1, 2) facing along y to (1, 2.3), turned by 0.1 rad, in 0.2 s: 0.3 m forward in the axes
    # of the first pose is 1.5 m/s, and 0.5 rad/s. Covariance: (0.04 + 0.04) · 0.2 = 0.016 for x.
    poses = np.array([[1.0, 2.0, math.pi / 2], [1.0, 2.3, math.pi / 2 + 0.1]])
    sigma = np.array([[0.2, 0.3, 0.1]] * 2)
    fixes = PoseFixes("map", ns(0.3, 0.5), poses, sigma)
    (twist,) = messages(EkfInput("pose0", "", POSE, differential=True, pose_threshold=7.0), fixes)
    assert twist.states == (3, 4, 5)
    np.testing.assert_array_equal(twist.stamps_ns, ns(0.5))
    np.testing.assert_allclose(twist.values, [[1.5, 0.0, 0.5]], atol=1e-12)
    np.testing.assert_allclose(np.diag(twist.noises[0]), [0.016, 0.036, 0.004])
    assert twist.threshold == 7.0


def test_relative_poses_begin_at_nothing() -> None:
    poses = np.array([[1.0, 2.0, math.pi / 2], [1.0, 2.3, math.pi / 2 + 0.1]])
    fixes = PoseFixes("map", ns(0.3, 0.5), poses, np.full((2, 3), 0.1))
    (relative,) = messages(EkfInput("pose0", "", POSE, relative=True), fixes)
    np.testing.assert_allclose(relative.values, [[0.0, 0.0, 0.0], [0.3, 0.0, 0.1]], atol=1e-12)
    # Absolute ones are seen from the start: here the robot starts at (1, 1) facing along y.
    start = np.array([1.0, 1.0, math.pi / 2])
    (absolute,) = messages(EkfInput("pose0", "", POSE), fixes, start=start)
    np.testing.assert_allclose(absolute.values, [[1.0, 0.0, 0.0], [1.3, 0.0, 0.1]], atol=1e-12)


def test_an_imu_is_yaw_rate_and_acceleration() -> None:
    stamps = ns(0.1, 0.2, 0.3)
    imu = EkfInput("imu0", "", ("yaw", "vyaw", "ax"), pose_threshold=1.0, twist_threshold=2.0,
                   acceleration_threshold=3.0)  # fmt: skip
    yaw = Yaw("yaw", stamps, np.array([1.0, 1.1, 1.2]), 0.01)
    gyro = YawRate("gyro", stamps, np.ones(3), 0.02, bias_sigma=0.03)
    acc = Acceleration("acc", stamps, np.full(3, 0.5))
    heading, rate, forward = messages(imu, yaw, gyro, acc)
    # The zero of a yaw is arbitrary: the first reading is the heading of the start.
    np.testing.assert_allclose(heading.values[:, 0], [0.0, 0.1, 0.2])
    assert (heading.states, rate.states, forward.states) == ((2,), (5,), (6,))
    # 0.02² at 10 Hz and the bias: 0.0004 · 10 + 0.0009 = 0.0049.
    np.testing.assert_allclose(rate.noises, 0.0049)
    assert (heading.threshold, rate.threshold, forward.threshold) == (1.0, 2.0, 3.0)


def test_a_camera_is_a_pose_of_the_base() -> None:
    # The camera looks to the left, 0.3 m ahead, its frame is its first pose. The base drives 1 m
    # forward: the camera goes 1 m to its right.
    seen = np.array([[0.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    mount = (0.3, 0.0, math.pi / 2)
    camera = CameraPoses("camera", ns(0.0, 1.0), seen, 0.01, 0.01, 0.02, 0.03, mount)
    (pose,) = messages(EkfInput("pose0", "", POSE), camera)
    np.testing.assert_allclose(pose.values, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(np.diag(pose.noises[1]), [4e-4, 4e-4, 9e-4])


def test_inputs_find_streams_by_kind_and_order() -> None:
    none, zeros = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    camera = CameraPoses("camera", none, zeros, 0.1, 0.1)
    second = CameraPoses("rear", none, zeros, 0.1, 0.1)
    gps = PositionFixes("gps", none, zeros[:, :2], zeros[:, :2])
    yaw, other = Yaw("yaw", none, np.zeros(0), 0.1), Yaw("ahrs", none, np.zeros(0), 0.1)
    drive = drive_with(camera, second, gps, yaw, other)
    inputs = (
        EkfInput("odom0", "/odom", TWIST),
        EkfInput("odom1", "/odometry/gps", ("x", "y", "yaw")),
        EkfInput("pose0", "/rear/pose", POSE),
        EkfInput("pose1", "/vo", POSE),
        EkfInput("pose2", "/map", POSE),
        EkfInput("twist0", "/twist", ("vx",)),
        EkfInput("imu0", "/ahrs/data", ("yaw", "vyaw")),
        EkfInput("imu1", "", ("yaw",)),
    )
    said = [str(b) for b in bind(EkfConfig(inputs), drive)]
    assert said == [
        "odom0 (/odom) reads wheels: vx, vy, vyaw",
        # The poses have taken both cameras and the fixes before any odometry chose.
        "odom1 (/odometry/gps) has no stream on this drive",
        "pose0 (/rear/pose) reads rear: x, y, yaw",
        "pose1 (/vo) reads camera: x, y, yaw",
        "pose2 (/map) reads gps: x, y; gps has no yaw",
        "twist0 (/twist) reads wheels: vx",
        "imu0 (/ahrs/data) reads ahrs: yaw; ahrs has no vyaw",
        "imu1 reads yaw: yaw",
    ]


def test_the_default_takes_every_sensor() -> None:
    drive = load_sim("random?camera=on&gyro=on&acc=on&fix_every=5&duration=20&robot=swerve")
    result = RlEkf().estimate(drive)
    assert result.sensors_used == ("wheels", "yaw", "gyro", "acc", "camera", "fixes")
    np.testing.assert_array_equal(result.trajectory.stamps_ns, drive.wheels.stamps_ns)
    assert result.notes == ()
    names = [i.name for i in default_config(drive).inputs]
    assert names == ["odom0", "pose0", "pose1", "imu0"]
    assert drive.truth is not None
    assert evaluate(result.trajectory, drive.truth).ate_rmse_m < 0.2


def test_wheels_alone_follow_the_wheels() -> None:
    drive = load_sim("random?yaw=off&duration=30&robot=differential&calibration=nominal")
    result = RlEkf().estimate(drive)
    assert result.sensors_used == ("wheels",)
    # Smoothed velocities lag behind by a packet or two, so by some centimetres.
    apart = result.trajectory.poses - Model1().estimate(drive).trajectory.poses
    assert np.hypot(apart[:, 0], apart[:, 1]).max() < 0.15
    assert np.abs(apart[:, 2]).max() < 0.1


def test_starts_and_covariances_are_in_the_map() -> None:
    # A start that faces along y: 0.5 m/s are along map y, and so is the uncertainty of the wheels.
    start = np.array([3.0, -1.0, math.pi / 2])
    config = EkfConfig(
        (EkfInput("odom0", "", TWIST),), process_noise=diagonal((0.1, 0.0, *[0.01] * 6))
    )
    result = RlEkf(config).estimate(drive_with(start=start))
    poses, covariances = result.trajectory.poses, result.trajectory.covariances
    np.testing.assert_allclose(poses[0], start, atol=1e-12)
    assert poses[-1, 0] == pytest.approx(3.0, abs=1e-6)
    assert poses[-1, 1] > -0.8
    assert covariances is not None
    assert covariances[-1, 1, 1] > 3.0 * covariances[-1, 0, 0]


def test_output_has_a_rate_of_its_own() -> None:
    drive = load_sim("random?yaw=off&duration=10&robot=differential")
    slow = replace(default_config(drive), frequency=4.0, predict_to_current_time=True)
    stamps = RlEkf(slow).estimate(drive).trajectory.stamps_ns
    np.testing.assert_array_equal(stamps, np.arange(41) * 250_000_000)
    # Without predicting, poses are those of the last wheel packet, at 20 Hz.
    last = replace(slow, predict_to_current_time=False, frequency=3.0)
    stamps = RlEkf(last).estimate(drive).trajectory.stamps_ns
    assert bool(np.isin(stamps, drive.wheels.stamps_ns).all())
    assert stamps[-1] == drive.wheels.stamps_ns[-1]


def test_thresholds_reject_and_count() -> None:
    drive = load_sim("random?fix_every=2&fix_sigma=0.05&seed=5&robot=differential")
    (fixes,) = drive.each(PositionFixes)
    positions = fixes.positions.copy()
    positions[3::5] += 8.0
    wild = replace(fixes, positions=positions)
    broken = replace(drive, sensors=tuple(wild if s is fixes else s for s in drive.sensors))
    config = default_config(broken)
    inputs = tuple(replace(i, pose_threshold=5.0) for i in config.inputs)
    result = RlEkf(replace(config, inputs=inputs)).estimate(broken)
    assert result.counts["fixes"].rejected == positions[3::5].shape[0]
    assert RlEkf().estimate(broken).counts["fixes"].rejected == 0


def test_a_silent_sensor_is_predicted_through() -> None:
    drive = load_sim("random?duration=20&robot=differential&gyro=on")
    begin = drive.wheels.stamps_ns[0] + 8_000_000_000
    wheels = drive.wheels
    keep = (wheels.stamps_ns < begin) | (wheels.stamps_ns > begin + 2_000_000_000)
    first = int(np.flatnonzero(~keep)[0])
    # One long increment over the gap.
    angles = wheels.angles[keep[1:]].copy()
    angles[first - 1] = wheels.angles[first - 1 : int(np.flatnonzero(~keep)[-1]) + 1].sum(axis=0)
    paused = replace(drive, wheels=replace(wheels, stamps_ns=wheels.stamps_ns[keep], angles=angles))
    result = RlEkf(replace(default_config(paused), frequency=20.0)).estimate(paused)
    assert bool(np.isfinite(result.trajectory.poses).all())
    # Poses go on in the gap, every 0.05 s of it.
    inside = (result.trajectory.stamps_ns > begin) & (
        result.trajectory.stamps_ns < begin + 2_000_000_000
    )
    assert int(inside.sum()) >= 35


def test_nothing_to_filter_is_an_error() -> None:
    drive = load_sim("random?duration=5&yaw=off")
    config = EkfConfig((EkfInput("imu0", "/imu", ("yaw",)), EkfInput("odom0", "/odom")))
    with pytest.raises(
        FglocError, match=r"nothing that the configuration uses is there: imu0 \(/im"
    ):
        RlEkf(config).estimate(drive)


def test_covariances_stay_positive_over_a_long_drive() -> None:
    drive = load_sim("random?camera=on&gyro=on&fix_every=7&duration=1800")
    covariances = RlEkf().estimate(drive).trajectory.covariances
    assert covariances is not None
    np.testing.assert_array_equal(covariances, covariances.swapaxes(1, 2))
    assert np.linalg.eigvalsh(covariances).min() > 0.0


def test_a_matrix_that_is_no_covariance_is_refused() -> None:
    with pytest.raises(FglocError, match="process noise is no covariance"):
        EkfConfig((), process_noise=diagonal((-1.0, *[1.0] * 7)))
    with pytest.raises(FglocError, match="frequency must be positive"):
        EkfConfig((), frequency=0.0)


def test_without_a_truth_the_first_fixes_place_the_start() -> None:
    drive = load_sim("random?fix_every=3&fix_sigma=0.02&seed=4&robot=differential")
    assert drive.truth is not None
    # The start is not the origin, and a heading of its own.
    frame = np.array([5.0, -2.0, 2.0])
    (fixes,) = drive.each(PositionFixes)
    moved = compose(frame, np.column_stack([fixes.positions, np.zeros(len(fixes.positions))]))
    fixes = replace(fixes, positions=moved[:, :2])
    others = tuple(s for s in drive.sensors if not isinstance(s, PositionFixes))
    result = RlEkf().estimate(replace(drive, truth=None, sensors=(*others, fixes)))
    assert result.notes == ("no truth to start from: 3 fixes told where the start is",)
    truth = Trajectory(
        drive.truth.trajectory.stamps_ns, compose(frame, drive.truth.trajectory.poses)
    )
    assert evaluate(result.trajectory, Reference(truth)).ate_rmse_m < 0.2
    # One pose is enough.
    k = 40
    one = PoseFixes(
        "map", truth.stamps_ns[k : k + 1], truth.poses[k : k + 1], np.full((1, 3), 0.01)
    )
    result = RlEkf().estimate(replace(drive, truth=None, sensors=(*others, one)))
    assert result.notes == ("no truth to start from: a fix told where the start is",)
    np.testing.assert_allclose(result.trajectory.poses[0], frame, atol=0.1)
    # Fixes too coarse to tell a heading are left alone.
    coarse = replace(fixes, sigma=np.full_like(fixes.sigma, 100.0))
    result = RlEkf().estimate(replace(drive, truth=None, sensors=(*others, coarse)))
    assert "do not tell the heading" in result.notes[0]
    assert "fixes" not in result.sensors_used
    np.testing.assert_array_equal(result.trajectory.poses[0], np.zeros(3))
