"""Semi-real sensors against the error models that they state, on courses known by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from fgloc.core import bases
from fgloc.core.drive import Drive, Reference
from fgloc.core.geometry import between, compose, inverse
from fgloc.core.measurements import CameraPoses, Floats, Stamps, WheelIncrements, YawRate
from fgloc.core.robot import Robot
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.registry import expand, is_dataset_id, load_drive
from fgloc.datasets.simulator.recorded_course import local_fit, record
from fgloc.datasets.simulator.semi_real import MPU6050, T265, SemiRealSpec, parse, with_semi_real
from fgloc.datasets.vitko_swerve import frame_times
from fgloc.errors import FglocError

DEGREE = math.pi / 180.0
SEEDS = 300
SPREAD = 4.0 / math.sqrt(2.0 * SEEDS)
"""Four sigmas of a relative standard deviation over the seeds: 16 %."""


def drive_of(seconds: float, poses: Floats | None = None, name: str = "drive") -> Drive:
    """Return a drive of 0.1 m/s straight ahead, or with these true poses at 50 Hz."""
    stamps = (np.arange(round(seconds * 50) + 1) * 20_000_000).astype(np.int64)
    if poses is None:
        poses = np.zeros((stamps.size, 3))
        poses[:, 0] = 0.1 * stamps * 1e-9
    robot = Robot.typical("robot", bases.differential(0.05, 0.05, 0.3))
    wheels = WheelIncrements(
        "wheels", stamps, np.full((stamps.size - 1, 2), 0.04), ("left", "right")
    )
    return Drive(name, robot, wheels, truth=Reference(Trajectory(stamps, poses)))


def sensors(drive: Drive) -> tuple[CameraPoses, YawRate]:
    return drive.each(CameraPoses)[0], drive.each(YawRate)[0]


@pytest.fixture(scope="module")
def many() -> list[Drive]:
    """Return 4 m of a straight drive with the sensors of many seeds."""
    drive = drive_of(40.0)
    return [with_semi_real(drive, SemiRealSpec(seed)) for seed in range(SEEDS)]


def drawn(drives: list[Drive], name: str) -> Floats:
    return np.array([d.true_calibration[name] for d in drives if d.true_calibration is not None])


def test_mount_scale_and_bias_are_drawn_as_stated(many: list[Drive]) -> None:
    stated = {
        "camera_x": (0.15, 0.02),
        "camera_y": (0.0, 0.02),
        "camera_yaw": (0.0, 2 * DEGREE),
        "camera_scale": (1.0, 0.01),
        "gyro_bias": (0.0, 0.5 * DEGREE),
    }
    for name, (mean, sigma) in stated.items():
        values = drawn(many, name)
        assert values.mean() == pytest.approx(mean, abs=4 * sigma / math.sqrt(SEEDS)), name
        assert np.sqrt(np.mean((values - mean) ** 2)) == pytest.approx(sigma, rel=SPREAD), name
    # The bias has a fixed size and either sign; nothing is cut off a normal distribution.
    np.testing.assert_allclose(np.abs(drawn(many, "gyro_bias")), 0.5 * DEGREE)
    assert np.abs(drawn(many, "camera_scale") - 1.0).max() > 0.025


def test_estimators_are_told_sigmas_and_the_nominal_place(many: list[Drive]) -> None:
    camera, gyro = sensors(many[0])
    assert camera.mount == (0.15, 0.0, 0.0)
    assert camera.mount_sigma == pytest.approx((0.02, 0.02, 2 * DEGREE))
    assert camera.scale_sigma == 0.01
    assert (camera.position_walk, camera.heading_walk) == (0.003, 0.15 * DEGREE)
    assert max(camera.position_sigma, camera.heading_sigma) <= 1e-6
    assert (gyro.density, gyro.bias_sigma) == (0.005 * DEGREE, 0.5 * DEGREE)
    assert gyro.bias_walk == 0.002 * DEGREE
    assert np.diff(camera.stamps_ns).mean() == pytest.approx(1e9 / 30, rel=1e-3)
    assert np.diff(gyro.stamps_ns).mean() == pytest.approx(1e9 / 100, rel=1e-3)


def test_the_camera_walks_with_the_root_of_its_way(many: list[Drive]) -> None:
    off = []
    for drive in many:
        camera, truth = sensors(drive)[0], drive.true_calibration
        assert truth is not None
        moved = between(camera.poses[0], camera.poses[-1])
        # A straight drive: the camera moves 4 m along -yaw in its own axes, times its scale.
        way, yaw = 4.0 * truth["camera_scale"], truth["camera_yaw"]
        off.append([moved[0] - way * math.cos(yaw), moved[1] + way * math.sin(yaw), moved[2]])
    x, y, heading = np.std(off, axis=0)
    assert heading == pytest.approx(0.15 * DEGREE * 2.0, rel=SPREAD)  # sqrt(4 m) = 2
    assert x == pytest.approx(0.003 * 2.0, rel=SPREAD)
    # The heading's walk bends the path: its integral has sigma walk·sqrt(L³/3) more.
    assert y == pytest.approx(math.hypot(0.006, 0.15 * DEGREE * math.sqrt(64 / 3)), rel=SPREAD)


def test_gyro_noise_is_white_on_a_bias_that_walks(many: list[Drive]) -> None:
    white, walked = [], []
    for drive in many:
        rate = sensors(drive)[1].rate
        white.append(np.std(np.diff(rate)) / math.sqrt(2.0))
        walked.append(rate[-100:].mean() - rate[:100].mean())
    # A density over samples of 0.01 s: 0.005·sqrt(100).
    assert np.mean(white) == pytest.approx(0.05 * DEGREE, rel=0.01)
    # 39 s between the middles of two means of 1 s; each has white noise of its own.
    expected = math.hypot(0.002 * math.sqrt(39.0), math.sqrt(2.0) * 0.005) * DEGREE
    assert np.std(walked) == pytest.approx(expected, rel=SPREAD)


def test_a_turn_on_the_spot_swings_the_camera() -> None:
    stamps = np.arange(501) * 0.02
    turning = np.stack([0 * stamps, 0 * stamps, 0.5 * stamps], axis=1)
    quiet = replace(T265, position_walk=0.0, heading_walk=0.0)
    silent = replace(MPU6050, density=0.0, bias_walk=0.0)
    drive = with_semi_real(drive_of(10.0, turning), SemiRealSpec(3, quiet, silent))
    camera, gyro = sensors(drive)
    truth = drive.true_calibration
    assert truth is not None
    np.testing.assert_allclose(gyro.rate, 0.5 + truth["gyro_bias"], atol=1e-9)
    place = math.hypot(truth["camera_x"], truth["camera_y"]) * truth["camera_scale"]
    # Half a turn takes it across its circle.
    half = int(np.argmin(np.abs(camera.stamps_ns * 1e-9 - 2 * math.pi)))
    across = np.hypot(*(camera.poses[half] - camera.poses[0])[:2])
    assert across == pytest.approx(2.0 * place, rel=1e-4)
    mount = np.array([truth["camera_x"], truth["camera_y"], truth["camera_yaw"]])
    seen = compose(compose(mount, between(camera.poses[0], camera.poses[half])), inverse(mount))
    assert seen[2] == pytest.approx(0.5 * camera.stamps_ns[half] * 1e-9, abs=1e-9)


def test_seeds_and_drives_differ_and_repeat() -> None:
    first, again = (with_semi_real(drive_of(5.0), SemiRealSpec(4)) for _ in range(2))
    for one, other in zip(sensors(first), sensors(again), strict=True):
        np.testing.assert_array_equal(one.stamps_ns, other.stamps_ns)
    np.testing.assert_array_equal(sensors(first)[0].poses, sensors(again)[0].poses)
    np.testing.assert_array_equal(sensors(first)[1].rate, sensors(again)[1].rate)
    # The camera is mounted once; scale and walks are each drive's own.
    other = with_semi_real(drive_of(5.0, name="other"), SemiRealSpec(4))
    truth, others = first.true_calibration, other.true_calibration
    assert truth is not None
    assert others is not None
    assert truth["camera_x"] == others["camera_x"]
    assert truth["camera_scale"] != others["camera_scale"]
    seed = with_semi_real(drive_of(5.0), SemiRealSpec(5)).true_calibration
    assert seed is not None
    assert truth["camera_x"] != seed["camera_x"]
    # What is switched off changes nothing in the rest.
    alone = with_semi_real(drive_of(5.0), replace(SemiRealSpec(4), camera=replace(T265, on=False)))
    np.testing.assert_array_equal(alone.each(YawRate)[0].rate, sensors(first)[1].rate)
    assert not alone.each(CameraPoses)


def test_names_of_the_recording_are_kept() -> None:
    once = with_semi_real(drive_of(5.0), SemiRealSpec(1))
    twice = with_semi_real(once, SemiRealSpec(2))
    assert [s.sensor for s in twice.sensors] == ["camera", "gyro", "semi_camera", "semi_gyro"]
    assert any("semi-real" in note for note in twice.notes)


def test_nothing_is_read_where_the_truth_is_lost() -> None:
    drive = drive_of(10.0)
    assert drive.truth is not None
    truth = drive.truth.trajectory
    kept = (truth.stamps_ns <= 4_000_000_000) | (truth.stamps_ns >= 5_000_000_000)
    gappy = Trajectory(truth.stamps_ns[kept], truth.poses[kept])
    with_gap = replace(drive, truth=Reference(gappy))
    for sensor in sensors(with_semi_real(with_gap, SemiRealSpec(0))):
        inside = (sensor.stamps_ns > 4_000_000_000) & (sensor.stamps_ns < 5_000_000_000)
        assert not inside.any()
        assert sensor.stamps_ns[-1] > 9_900_000_000
    # The camera still knows how far it went meanwhile.
    camera = sensors(with_semi_real(with_gap, SemiRealSpec(0)))[0]
    assert np.hypot(*camera.poses[-1, :2]) == pytest.approx(1.0, rel=0.05)


def test_a_local_fit_is_exact_for_a_parabola_and_calms_noise() -> None:
    seconds = np.sort(np.random.default_rng(0).uniform(0.0, 4.0, 400))
    parabola = np.stack([1.0 - 2.0 * seconds + 0.7 * seconds**2, 3.0 + 0.0 * seconds], axis=1)
    at = np.linspace(0.0, 4.0, 77)[1:-1]
    exact = np.stack([1.0 - 2.0 * at + 0.7 * at**2, 3.0 + 0.0 * at], axis=1)
    np.testing.assert_allclose(local_fit(seconds, parabola, at), exact, atol=1e-9)
    noise = np.random.default_rng(1).normal(size=(400, 1))
    # 20 values in a window, tricube: the variance is about a sixth.
    assert np.std(local_fit(seconds, noise, at)) < 0.55
    # Too few near: linear between neighbours.
    few = local_fit(np.array([0.0, 10.0, 20.0]), np.array([[0.0], [5.0], [7.0]]), np.array([15.0]))
    assert few[0, 0] == pytest.approx(6.0)


def test_late_frames_are_put_where_they_belong() -> None:
    rng = np.random.default_rng(2)
    frames: Stamps = np.flatnonzero(rng.random(2000) > 0.02).astype(np.int64)
    true = np.round(frames * 15_625_000 + 1e9).astype(np.int64)
    late = rng.uniform(0.0, 0.01, frames.size) + 0.1 * (rng.random(frames.size) < 0.03)
    arrived = np.maximum.accumulate(true + np.round(late * 1e9).astype(np.int64))
    arrived += np.arange(frames.size)  # strictly one after the other
    found = frame_times(arrived, frames + 77)
    assert found is not None
    off = (found - true) * 1e-9
    assert off.mean() == pytest.approx(0.005, abs=1e-3)  # the usual delay
    assert np.ptp(off) < 1e-3
    assert frame_times(arrived, np.zeros_like(frames)) is None
    assert frame_times(arrived, rng.integers(0, 10**6, frames.size).cumsum()) is None


def test_errors_say_what_to_do() -> None:
    with pytest.raises(FglocError, match="no recorded truth"):
        with_semi_real(replace(drive_of(5.0), truth=None), SemiRealSpec())
    off = SemiRealSpec(0, replace(T265, on=False), replace(MPU6050, on=False))
    with pytest.raises(FglocError, match="both off"):
        with_semi_real(drive_of(5.0), off)
    for query in ("seed=-1", "seed=x", "camera=perhaps", "speed=3"):
        with pytest.raises(FglocError, match="not known"):
            parse(query)
    with pytest.raises(FglocError, match="lacks a drive"):
        load_drive("semi:?seed=1")
    with pytest.raises(FglocError, match="too short"):
        record(drive_of(0.04))


def test_semi_goes_before_any_recorded_drive(data_dir: object) -> None:
    ids = expand(["semi:vitko-swerve:2[123]?seed=7"])
    assert ids == [f"semi:vitko-swerve:{run}?seed=7" for run in (21, 22, 23)]
    assert is_dataset_id(ids[0])
    drive, recorded = load_drive(ids[0]), load_drive("vitko-swerve:21")
    assert drive.name == ids[0]
    np.testing.assert_array_equal(drive.wheels.angles, recorded.wheels.angles)
    camera, gyro = sensors(drive)
    # A turn and a bit, seen by all: the truth, the camera, the gyro less its bias.
    assert recorded.truth is not None
    assert drive.true_calibration is not None
    turned = np.ptp(recorded.truth.trajectory.poses[:, 2])
    assert np.ptp(camera.poses[:, 2]) == pytest.approx(turned, abs=0.02)
    rate = gyro.rate - drive.true_calibration["gyro_bias"]
    assert rate.mean() * drive.duration_s == pytest.approx(turned, abs=0.03)


def test_the_recorded_truth_does_not_shake_the_gyro(data_dir: object) -> None:
    """Before the robot moves, its rate is that of a gyro, not of differenced frames."""
    recorded = load_drive("vitko-swerve:3")
    moving = np.flatnonzero(np.abs(recorded.wheels.angles).sum(axis=1) > 0.0)[0]
    stands = int(recorded.wheels.stamps_ns[moving]) - 300_000_000
    perfect = SemiRealSpec(0, replace(T265, on=False), replace(MPU6050, density=0.0, bias_walk=0.0))
    gyro = with_semi_real(recorded, perfect).each(YawRate)[0]
    still = gyro.rate[gyro.stamps_ns < stands]
    assert still.size > 200
    # Angle over a second: less than what 0.005 °/s/√Hz adds in it.
    angle = np.cumsum(still - still.mean()) * 0.01
    wandered = angle[100:] - angle[:-100]
    assert np.std(wandered) < 0.005 * DEGREE


def test_a_noisy_truth_is_stated() -> None:
    clean = drive_of(10.0)
    assert clean.truth is not None
    rng = np.random.default_rng(5)
    truth = clean.truth.trajectory
    noise = np.array([0.5e-3, 0.5e-3, 5e-3])
    shaken = Trajectory(truth.stamps_ns, truth.poses + noise * rng.normal(size=truth.poses.shape))
    drive = with_semi_real(replace(clean, truth=Reference(shaken)), SemiRealSpec(0))
    camera, gyro = sensors(drive)
    recorded = record(replace(clean, truth=Reference(shaken)))
    # Ten poses in a fit: what is left is seen in the course itself, which was straight.
    left = np.std(recorded.course.poses[20:-20, 2])
    assert camera.heading_sigma == pytest.approx(left, rel=0.35)
    assert gyro.density == pytest.approx(left * math.sqrt(20.0), rel=0.35)
    assert any("truth is noisy" in note for note in drive.notes)
    assert not any("noisy" in note for note in with_semi_real(clean, SemiRealSpec(0)).notes)


def test_the_swerve_s_truth_is_not_noisy(data_dir: object) -> None:
    for run in (1, 6, 11, 16, 21, 26):
        assert max(record(load_drive(f"vitko-swerve:{run}")).noise) < 2e-4
