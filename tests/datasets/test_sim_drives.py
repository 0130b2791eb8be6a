"""Simulated drives: kinematics, courses, sensors and what a query may say."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fgloc.core import geometry
from fgloc.core.drive import Drive
from fgloc.core.measurements import Acceleration, CameraPoses, PositionFixes, Yaw, YawRate
from fgloc.core.preintegration import preintegrate, split_at
from fgloc.datasets.simulator import load_sim
from fgloc.datasets.simulator.course import Course, roll
from fgloc.datasets.simulator.drives import NAMED, true_values
from fgloc.datasets.simulator.faults import Slip, apply_slip
from fgloc.datasets.simulator.robots import ROBOTS, build
from fgloc.datasets.simulator.spec import keys, parse
from fgloc.errors import FglocError

MOTIONS = ("figure-eight", "square", "random", "corridor", "demo")
CLEAN = "wheel_noise=0&encoder_ticks=0&slip=off"


def truth(drive: Drive) -> geometry.Floats:
    assert drive.truth is not None
    return drive.truth.trajectory.poses


def values(drive: Drive) -> geometry.Floats:
    assert drive.true_calibration is not None
    return np.array([drive.true_calibration[p.name] for p in drive.robot.base.parameters])


def odometry(drive: Drive, parameters: geometry.Floats | None = None) -> geometry.Floats:
    """Return the poses that the wheels alone say, from the true start."""
    wheels = drive.wheels
    steps = drive.robot.base.displacements(wheels.angles, wheels.steering, parameters)
    return geometry.integrate(steps, truth(drive)[0], geometry.EXACT)


def test_course_is_exact_between_its_steps() -> None:
    # A constant twist (v, w) is at (v/w sin wt, v/w (1 - cos wt)) after t, whatever the steps.
    v, w = 0.7, 1.3
    course = Course.follow(np.tile([0.35, 0.0, 0.65], (8, 1)), 500_000_000)
    t = np.array([0.0, 0.123, 0.5, 2.7, 3.999])
    poses = course.poses_at(np.round(t * 1e9).astype(np.int64))
    expected = np.stack([v / w * np.sin(w * t), v / w * (1 - np.cos(w * t)), w * t], axis=1)
    assert poses == pytest.approx(expected, abs=1e-12)
    assert course.twists_at(np.array([1], dtype=np.int64))[0] == pytest.approx([v, 0.0, w])
    assert course.stamps(30.0).size == 121


@pytest.mark.parametrize("robot", ROBOTS)
def test_inverse_kinematics_undoes_the_forward_one(robot: str) -> None:
    model = build(robot)
    parameters = true_values(model, parse(f"random?seed=5&robot={robot}", NAMED))
    rng = np.random.default_rng(0)
    steps = rng.uniform((0.002, -0.001, -0.004), (0.004, 0.001, 0.004), (200, 3))
    if not model.holonomic:
        steps[:, 1] = 0.0
    angles, steering = roll(model.robot.base, parameters, model.steered, steps)
    assert (steering is not None) == model.steered
    back = model.robot.base.displacements(angles, steering, parameters)
    assert back == pytest.approx(steps, abs=1e-14)
    # The wrong parameters must show, else the test above could not fail.
    assert np.abs(model.robot.base.displacements(angles, steering) - steps).max() > 1e-6


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("motion", ["figure-eight", "square", "random", "corridor"])
def test_clean_wheels_with_the_true_calibration_follow_the_truth(robot: str, motion: str) -> None:
    drive = load_sim(f"{motion}?robot={robot}&rate=100&duration=40&{CLEAN}")
    error = np.abs(odometry(drive, values(drive)) - truth(drive))
    assert error[:, :2].max() < 2e-3
    assert error[:, 2].max() < 1e-3
    nominal = np.abs(odometry(drive) - truth(drive))
    assert nominal[:, :2].max() > 0.02


@pytest.mark.parametrize(("motion", "turn"), [("figure-eight", 0), ("square", 1), ("corridor", 3)])
def test_closed_motions_close(motion: str, turn: int) -> None:
    poses = truth(load_sim(f"{motion}?{CLEAN}"))
    # The figure-eight's knots every 50 ms cut its curvature: 1 mm is left.
    assert np.hypot(*poses[-1, :2]) < 2e-3
    assert poses[-1, 2] == pytest.approx(2 * math.pi * turn, abs=1e-6)
    assert np.ptp(poses[:, 0]) > 1.0


@pytest.mark.parametrize("motion", MOTIONS)
def test_speeds_stay_within_the_robot(motion: str) -> None:
    drive = load_sim(f"{motion}?seed=3&truth_rate=50&{CLEAN}")
    twist = geometry.log(geometry.between(truth(drive)[:-1], truth(drive)[1:])) * 50.0
    assert twist[0] == pytest.approx(np.zeros(3), abs=1e-9)
    assert twist[-1] == pytest.approx(np.zeros(3), abs=1e-9)
    assert np.abs(np.diff(twist[:, 0])).max() * 50.0 < 0.8 * 1.01
    assert np.abs(np.diff(twist[:, 2])).max() * 50.0 < 1.5 * 1.01
    assert np.abs(twist[:, 0]).max() > 0.5


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_driver_holds_the_course(robot: str) -> None:
    clean = truth(load_sim(f"square?robot={robot}&wheel_noise=0&rate=5"))
    slips = [truth(load_sim(f"square?robot={robot}&rate=5&seed={k}")) for k in range(8)]
    away = [np.hypot(*(poses - clean)[:, :2].T).max() for poses in slips]
    # The base slips (some centimetres over 16 m), but nobody lets it run off its course.
    assert 0.01 < float(np.median(away)) < 0.5
    assert max(np.abs((poses - clean)[:, 2]).max() for poses in slips) < 0.3


def test_wheel_noise_is_what_the_robot_says() -> None:
    # End-point errors over 80 seeds against the covariance that preintegration predicts: their
    # mean normalised square is chi² with 240 degrees of freedom over 80, so 3 ± 0.27 (1 sigma).
    nees = []
    for seed in range(80):
        drive = load_sim(f"figure-eight?seed={seed}&calibration=nominal&encoder_ticks=0&rate=10")
        ends = drive.wheels.stamps_ns[[0, -1]]
        moved = preintegrate(split_at(drive.wheels, ends), drive.robot)
        error = geometry.between(truth(drive)[0], truth(drive)[-1]) - moved.displacement[0]
        nees.append(error @ np.linalg.solve(moved.covariance[0], error))
    assert 2.1 < float(np.mean(nees)) < 3.9


def test_true_calibration_comes_from_the_prior() -> None:
    base = build("skid").robot.base
    track = next(p for p in base.parameters if p.name == "effective_track")
    drawn = []
    for seed in range(400):
        model = build("skid")
        spec = parse(f"random?seed={seed}", NAMED)
        drawn.append(
            [
                p.to_solver(v) / p.solver_sigma if p.prior_sigma else 0.0
                for p, v in zip(base.parameters, true_values(model, spec), strict=True)
            ]
        )
    z = np.array(drawn)
    assert np.abs(z).max() <= 2.5 + 1e-9
    # A normal cut at ±2.5 sigma has a standard deviation of 0.955; 400 draws: 3.5 % each.
    assert z[:, list(base.parameters).index(track)].std() == pytest.approx(0.955, abs=0.12)
    assert values(load_sim("square?calibration=nominal")) == pytest.approx(base.nominal())
    demo = load_sim("demo?seed=4")
    assert demo.true_calibration is not None
    assert demo.true_calibration["effective_track"] == 0.62
    assert demo.true_calibration["wheel_radius.left"] == pytest.approx(0.135, rel=0.026)


def test_adding_a_sensor_leaves_the_others_alone() -> None:
    plain = load_sim("demo?seed=7")
    full = load_sim("demo?seed=7&camera=on&gyro=on&acc=on")
    assert np.array_equal(plain.wheels.angles, full.wheels.angles)
    assert np.array_equal(plain.each(Yaw)[0].yaw, full.each(Yaw)[0].yaw)
    assert np.array_equal(
        plain.each(PositionFixes)[0].positions, full.each(PositionFixes)[0].positions
    )
    assert np.array_equal(full.wheels.angles, load_sim("demo?seed=7&yaw=off").wheels.angles)
    assert not np.array_equal(plain.wheels.angles, load_sim("demo?seed=8").wheels.angles)


def test_yaw_drifts_and_is_quantised() -> None:
    drive = load_sim("square?yaw_sigma=0&yaw_walk=0&yaw_drift=0.003&yaw_zero=0.4&truth_rate=50")
    (yaw,) = drive.each(Yaw)
    assert np.abs(yaw.yaw).max() <= math.pi + 0.005
    assert np.round(yaw.yaw * 100) == pytest.approx(yaw.yaw * 100, abs=1e-9)
    expected = truth(drive)[:, 2] + 0.4 + 0.003 * yaw.stamps_ns * 1e-9
    assert np.abs(geometry.wrap(yaw.yaw - expected)).max() <= 0.005 + 1e-9


def test_gyro_noise_and_bias() -> None:
    drive = load_sim("square?gyro=on&truth_rate=50&gyro_density=0.01&gyro_bias_walk=0&seed=2")
    (gyro,) = drive.each(YawRate)
    still = gyro.rate[:50]
    # Density 0.01 at 50 Hz is a sigma of 0.01·sqrt(50) = 0.0707; 50 samples: 10 % standard error.
    assert still.std() == pytest.approx(0.0707, rel=0.35)
    turned = gyro.rate.mean() * drive.duration_s - truth(drive)[-1, 2]
    # Left over is the bias (at most 2.5 · 0.01 rad/s) and 0.01·sqrt(T) of noise.
    assert abs(turned) < (0.025 + 0.03 / math.sqrt(drive.duration_s)) * drive.duration_s


def test_acceleration_adds_up_to_the_speed() -> None:
    drive = load_sim(
        "square?acc=on&acc_sigma=0&acc_bias_sigma=0&acc_resolution=0&truth_rate=50&wheel_noise=0"
    )
    (acc,) = drive.each(Acceleration)
    # A sample holds the change of speed from half a period before to half a period after it.
    speed = np.cumsum(acc.forward) / 50.0
    steps = np.hypot(*np.diff(truth(drive)[:, :2], axis=0).T) * 50.0
    assert np.abs(speed[:-1] - steps).max() < 0.01
    assert np.abs(acc.forward).max() == pytest.approx(0.8, rel=0.01)


def test_camera_sees_its_mount_and_scale() -> None:
    quiet = "camera_position_walk=0&camera_heading_walk=0&camera_position_sigma=0"
    drive = load_sim(f"figure-eight?camera=on&{quiet}&camera_heading_sigma=0&truth_rate=30&seed=9")
    (camera,) = drive.each(CameraPoses)
    true = drive.true_calibration
    assert true is not None
    mount = np.array([true["camera_x"], true["camera_y"], true["camera_yaw"]])
    assert camera.mount == (0.2, 0.0, 0.0)
    assert mount != pytest.approx(np.array(camera.mount))
    seen = geometry.compose(truth(drive), mount)
    expected = geometry.between(seen[0], seen)
    expected[:, :2] *= true["camera_scale"]
    assert camera.poses == pytest.approx(expected, abs=1e-9)


def test_camera_drift_grows_with_the_distance() -> None:
    ends = []
    for seed in range(40):
        drive = load_sim(
            f"square?camera=on&seed={seed}&camera_mount_sigma=0&camera_yaw_sigma=0"
            "&camera_scale_sigma=0&camera_heading_sigma=0&wheel_noise=0"
        )
        (camera,) = drive.each(CameraPoses)
        ends.append(camera.poses[-1, 2] - 2 * math.pi)
    # The lens goes round 16 m of sides and four corners of arm 0.2 m: 17.26 m; 40 draws: 11 %.
    assert np.std(ends) == pytest.approx(0.003 * math.sqrt(17.26), rel=0.35)


def test_fixes() -> None:
    drive = load_sim("random?duration=2000&fix_every=2&fix_sigma=0.03&fix_x=0.3&truth_rate=0.5")
    (fixes,) = drive.each(PositionFixes)
    assert fixes.stamps_ns[0] == 2_000_000_000
    assert fixes.stamps_ns.size == 1000
    antenna = geometry.compose(truth(drive)[1:], np.array([0.3, 0.0, 0.0]))[:, :2]
    assert (fixes.positions - antenna).std() == pytest.approx(0.03, rel=0.1)
    assert load_sim("demo").each(PositionFixes)[0].stamps_ns.size == 7


def test_dropout_loses_packets_but_no_counts() -> None:
    whole = load_sim("square?seed=3")
    holes = load_sim("square?seed=3&encoder_dropout=0.3&yaw_dropout=0.5")
    assert 0.6 < holes.wheels.stamps_ns.size / whole.wheels.stamps_ns.size < 0.8
    assert 0.4 < holes.each(Yaw)[0].stamps_ns.size / whole.each(Yaw)[0].stamps_ns.size < 0.6
    # Only the starting phase of the counter differs: one count at most.
    count = whole.wheels.resolution
    assert np.abs(holes.wheels.angles.sum(axis=0) - whole.wheels.angles.sum(axis=0)).max() <= (
        count * 1.001
    )


def test_quantisation_does_not_accumulate() -> None:
    coarse = load_sim("figure-eight?wheel_noise=0")
    fine = load_sim("figure-eight?wheel_noise=0&encoder_ticks=0")
    counts = coarse.wheels.angles / coarse.wheels.resolution
    assert counts == pytest.approx(np.round(counts), abs=1e-6)
    difference = np.cumsum(coarse.wheels.angles - fine.wheels.angles, axis=0)
    assert np.abs(difference).max() <= coarse.wheels.resolution * 1.001


def test_slip_in_a_query() -> None:
    plain = load_sim(f"square?{CLEAN}")
    slip = load_sim(f"square?{CLEAN.replace('slip=off', 'slip=fl+rl:2:4:1.5,rr:5:6:+10')}")
    ratio = slip.wheels.angles - plain.wheels.angles
    ends = plain.wheels.stamps_ns[1:]
    first = (ends > 2_000_000_000) & (ends <= 4_000_000_000)
    assert ratio[first][:, [0, 2]] == pytest.approx(0.5 * plain.wheels.angles[first][:, [0, 2]])
    second = (ends > 5_000_000_000) & (ends <= 6_000_000_000)
    moving = np.sign(plain.wheels.angles[second, 3])
    assert ratio[second, 3] == pytest.approx(10 * 2 * math.pi / 300 * moving)
    ratio[first] = 0.0
    ratio[second] = 0.0
    assert np.abs(ratio).max() < 1e-11
    assert np.array_equal(truth(plain), truth(slip))


def test_a_wheel_at_rest_does_not_slip() -> None:
    angles = np.zeros((4, 1))
    stamps = np.arange(5, dtype=np.int64) * 200_000_000
    slips = [Slip(("a",), 0.0, 1.0, factor=2.0, extra_rate=3.0)]
    assert not apply_slip(angles, stamps, ("a",), slips).any()


def test_length_of_a_drive() -> None:
    assert load_sim("random?keyframes=500&rate=10").wheels.stamps_ns.size == 501
    assert load_sim("corridor?duration=33").duration_s == pytest.approx(33.0)
    long = load_sim("random?duration=10000&rate=10")
    assert long.wheels.stamps_ns.size == 100_001


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("figure-nine", ("figure-nine", "figure-eight", "seed-a-spin-bothleft")),
        ("demo?speed", ("speed", "key=value")),
        ("demo?colour=red", ("colour", "effective_track", "camera_rate")),
        ("demo?seed=one", ("seed=one", "whole number")),
        ("demo?duration=nan", ("duration", "finite")),
        ("demo?rate=0", ("rate", "greater than 0")),
        ("demo?rate=1000", ("rate", "200")),
        ("demo?camera=maybe", ("camera=maybe", "on or off")),
        ("demo?robot=boat", ("boat", "tricycle")),
        ("demo?robot=omni3", ("effective_track", "robot=skid")),
        ("demo?slip=fl:3", ("slip=fl:3", "WHEEL:START:END:AMOUNT")),
        ("demo?slip=xx:3:5:1.2", ("xx", "fl, fr, rl, rr")),
        ("demo?yaw_dropout=2", ("yaw_dropout", "probability")),
        ("figure-eight?duration=5", ("duration", "at least")),
        ("random?duration=9&keyframes=9", ("duration", "keyframes")),
        ("seed-a-spin-ideal?duration=5", ("duration", "nominal_track")),
        ("seed-a-spin-ideal?yaw_drift=0", ("yaw_drift", "yaw_zero")),
        ("seed-a-vehicle-spin?speed=1", ("speed", "wheel_noise", "yaw_drift")),
    ],
)
def test_errors_say_what_there_is(spec: str, words: tuple[str, ...]) -> None:
    with pytest.raises(FglocError) as error:
        load_sim(spec)
    for word in words:
        assert word in str(error.value)


def test_every_drive_and_key_is_documented() -> None:
    text = (Path(__file__).parents[2] / "docs" / "simulator.md").read_text()
    for key in keys():
        assert f"| `{key}` |" in text
    for motion in MOTIONS:
        assert f"| `{motion}` |" in text
