"""The simulated lidar: where its beams end, when they are sent, and how noisy they are."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from fgloc.core import geometry
from fgloc.core.drive import Drive
from fgloc.core.measurements import Floats, Scans
from fgloc.datasets.registry import load_drive, world_of
from fgloc.datasets.simulator.course import Course
from fgloc.datasets.simulator.models import LidarModel
from fgloc.datasets.simulator.people import RADIUS_M, Walker
from fgloc.datasets.simulator.rplidar import measure_scans
from fgloc.datasets.simulator.streams import generator
from fgloc.datasets.simulator.worlds import World
from fgloc.errors import FglocError
from fgloc.lidar.scan import cloud

EXACT = LidarModel(
    "a2", share=0.0, range_sigma=1e-12, angle_sigma=0.0, dropout=0.0, x=0.0, mount_sigma=0.0,
    yaw_sigma=0.0,
)  # fmt: skip
BOX = np.array(
    [[-4.0, -3.0, 5.0, -3.0], [5.0, -3.0, 5.0, 2.0], [5.0, 2.0, -4.0, 2.0], [-4.0, 2.0, -4.0, -3.0]]
)


def room(walls: Floats = BOX) -> World:
    """Return a world of these walls."""
    way = np.array([[0.0, 0.0], [1.0, 0.0]])
    return World("room", "", walls, np.zeros(len(walls), np.bool_), way)


def moving(*twist: float, seconds: float = 1.0) -> Course:
    """Return a course of a constant twist [m/s, m/s, rad/s] from the origin."""
    steps = round(seconds * 200)
    return Course.follow(np.tile(np.array(twist) * 0.005, (steps, 1)), 5_000_000)


def scanned(course: Course, model: LidarModel = EXACT, **options: int) -> Scans:
    """Return the scans of a drive in the box."""
    return measure_scans(course, room(), model, options.get("people", 0), options.get("seed", 1))[0]


def lidar_of(drive: Drive) -> Scans:
    """Return the one stream of scans."""
    (scans,) = drive.each(Scans)
    return scans


def test_beams_at_rest_by_hand() -> None:
    scans = scanned(moving(0, 0, 0))
    assert scans.ranges.shape == (10, 400)
    # Clockwise from behind: beam 0 behind, 100 to the left, 200 ahead, 300 to the right, and 150
    # ahead to the left at 45°, where the left wall comes first.
    expected = [4, 2, 5, 3, 2 * math.sqrt(2)]
    np.testing.assert_allclose(scans.ranges[0, [0, 100, 200, 300, 150]], expected)
    assert scans.angle_min == math.pi
    assert scans.angle_increment == -2 * math.pi / 400
    assert (scans.min_range, scans.max_range) == (0.2, 12.0)
    # 400 beams ten times a second.
    assert scans.beam_period == pytest.approx(1 / 4000)
    assert np.diff(scans.stamps_ns).tolist() == [100_000_000] * 9


def test_each_beam_is_sent_at_its_own_time_in_a_fast_turn() -> None:
    # Turning with 3 rad/s at the origin: beam k of scan n looks along 3·t + π - 2π·k/400 at
    # t = n/10 + k/4000.
    scans = scanned(moving(0, 0, 3))
    for n, k in ((0, 0), (0, 399), (3, 137), (9, 250)):
        direction = 3 * (n / 10 + k / 4000) + math.pi - 2 * math.pi * k / 400
        c, s = math.cos(direction), math.sin(direction)
        expected = min(
            5 / c if c > 0 else -4 / c if c < 0 else math.inf,
            2 / s if s > 0 else -3 / s if s < 0 else math.inf,
        )
        assert scans.ranges[n, k] == pytest.approx(expected, abs=1e-6)


def test_undoing_the_motion_puts_every_point_on_its_wall() -> None:
    twist = np.array([0.5, 0.1, 3.0])
    course, model = moving(*twist), replace(EXACT, x=0.2, y=-0.1, yaw=0.3)
    scans = scanned(course, model)
    mount = np.array([0.2, -0.1, 0.3])
    starts = geometry.compose(course.poses_at(scans.stamps_ns), mount)
    after = geometry.compose(course.poses_at(scans.stamps_ns + 99_999_999), mount)
    seen = cloud(scans, geometry.log(geometry.between(starts, after)))

    def off(points: Floats) -> float:
        """Return how far the points are off the walls at most [m]."""
        c, s = np.cos(starts[:, 2:]), np.sin(starts[:, 2:])
        x = starts[:, :1] + c * points[..., 0] - s * points[..., 1]
        y = starts[:, 1:2] + s * points[..., 0] + c * points[..., 1]
        apart = np.stack([x - 5, x + 4, y - 2, y + 3])
        return float(np.abs(apart).min(axis=0).max())

    assert off(seen.points) < 1e-6
    assert off(cloud(scans).points) > 0.3


def test_noise_is_what_the_scans_state() -> None:
    model = LidarModel("a1", x=0.0, mount_sigma=0.0, yaw_sigma=0.0)
    scans = scanned(moving(0, 0, 0, seconds=200.0), model)
    assert (scans.range_sigma, scans.range_sigma_share) == (0.003, 0.01)
    assert scans.bearing_sigma == 0.0026
    # Beams at right angles to a wall: the direction has no part in the range.
    for k, expected in ((0, 4.0), (100, 2.0), (300, 3.0)):
        beam = scans.ranges[:, k]
        assert np.mean(beam == 0.0) == pytest.approx(0.02, abs=0.01)
        beam = beam[beam > 0.0]
        assert beam.mean() == pytest.approx(expected, abs=5e-3)
        assert beam.std() == pytest.approx(math.hypot(0.003, 0.01 * expected), rel=0.06)
    # At 45° a range of r changes by r a radian.
    beam = scans.ranges[:, 150]
    beam = beam[beam > 0.0]
    r = 2 * math.sqrt(2)
    expected = math.hypot(0.003, 0.01 * r, 0.0026 * r)
    assert beam.std() == pytest.approx(expected, rel=0.06)


def test_what_is_too_near_or_too_far_is_no_return() -> None:
    far = np.array([[12.1, -9.0, 12.1, 9.0], [-0.19, -9.0, -0.19, 9.0]])
    scans = measure_scans(moving(0, 0, 0), room(far), EXACT, 0, 1)[0]
    assert scans.ranges[0, 200] == 0.0
    assert scans.ranges[0, 0] == 0.0
    # -0.19 m is 0.2 m away at acos(0.95) = 18.2° from straight behind: from beam 21 on it is seen.
    assert scans.ranges[0, 20] == 0.0
    assert scans.ranges[0, 21] == pytest.approx(0.19 / math.cos(21 * 2 * math.pi / 400))


def test_an_empty_world_has_no_returns() -> None:
    nothing = measure_scans(moving(0.5, 0, 0), room(np.zeros((0, 4))), EXACT, 0, 1)[0]
    assert not nothing.ranges.any()


def test_the_true_mount_is_drawn_and_told() -> None:
    drive = load_drive("sim:seed-b-room?duration=2")
    assert drive.true_calibration is not None
    scans = lidar_of(drive)
    assert scans.mount == (0.15, 0.0, 0.0)
    assert scans.mount_sigma == (0.005, 0.005, 0.003)
    off = [drive.true_calibration[n] for n in ("lidar_x", "lidar_y", "lidar_yaw")]
    apart = np.abs(np.array(off) - scans.mount) / scans.mount_sigma
    assert 0.0 < apart.max() <= 2.5


def test_people_are_seen_where_they_are() -> None:
    course = moving(0, 0, 0, seconds=30.0)
    with_them, without = scanned(course, people=2), scanned(course)
    walkers_rng = generator(1, "people")
    walkers = [Walker(room(), walkers_rng) for _ in range(2)]
    changed = with_them.ranges != without.ranges
    assert changed.any()
    assert (with_them.ranges <= without.ranges + 1e-9)[with_them.ranges > 0].all()
    times = without.stamps_ns[:, None] + np.arange(400) * 250_000
    angle = math.pi - 2 * math.pi * np.arange(400) / 400
    x, y = with_them.ranges * np.cos(angle), with_them.ranges * np.sin(angle)
    apart = np.full(changed.shape, np.inf)
    for walker in walkers:
        at = walker.positions(times.ravel()).reshape(*times.shape, 2)
        apart = np.minimum(apart, np.abs(np.hypot(x - at[..., 0], y - at[..., 1]) - RADIUS_M))
    assert apart[changed & (with_them.ranges > 0)].max() < 1e-6
    speeds = [
        np.hypot(*np.diff(w.positions(np.array([0, 10**6])), axis=0)[0]) * 1e3 for w in walkers
    ]
    assert all(0.49 < v < 1.41 for v in speeds)


@pytest.mark.parametrize("name", ["seed-b-room", "seed-c-1", "seed-c-2", "office", "hall"])
def test_the_robot_keeps_to_its_way_and_away_from_walls(name: str) -> None:
    drive = load_drive(f"sim:{name}?lidar=off&seed=4")
    assert not drive.sensors
    assert drive.truth is not None
    world = world_of(drive.name)
    assert world is not None
    poses = drive.truth.trajectory.poses
    np.testing.assert_allclose(poses[0, :2], world.waypoints[0])
    start, step = world.walls[:, :2], world.walls[:, 2:] - world.walls[:, :2]
    to = poses[:, None, :2] - start
    share = np.clip((to * step).sum(axis=2) / (step**2).sum(axis=1), 0, 1)
    apart = np.hypot(*np.moveaxis(to - share[..., None] * step, 2, 0))
    # Doors are a metre wide, and the base slips all the way.
    assert apart.min() > 0.4
    moved = drive.robot.base.displacements(drive.wheels.angles, drive.wheels.steering)
    nominal = geometry.integrate(moved, poses[0], geometry.EXACT)
    assert np.hypot(*(nominal - poses)[-1, :2]) > 0.1
    assert 60 <= drive.duration_s <= 300


@pytest.mark.parametrize("robot", ["skid", "differential", "mecanum", "omni3", "swerve"])
def test_every_base_that_turns_on_the_spot_drives_in_a_world(robot: str) -> None:
    drive = load_drive(f"sim:seed-c-1?robot={robot}&seed=2")
    assert drive.truth is not None
    world = world_of(drive.name)
    assert world is not None
    poses = drive.truth.trajectory.poses
    # The errors of a hundred metres of slip are steered back to within a few centimetres.
    assert np.hypot(*(poses[-1, :2] - world.waypoints[0])) < 0.15
    assert drive.true_calibration is not None
    names = [p.name for p in drive.robot.base.parameters]
    values = np.array([drive.true_calibration[n] for n in names])
    clean = load_drive(f"sim:seed-c-1?robot={robot}&seed=2&wheel_noise=0&encoder_ticks=0&rate=100")
    assert clean.truth is not None
    moved = clean.robot.base.displacements(clean.wheels.angles, clean.wheels.steering, values)
    known = clean.truth.trajectory.poses
    found = geometry.integrate(moved, known[0], geometry.EXACT)
    assert np.abs(found - known)[:, :2].max() < 5e-3


def test_the_same_text_gives_the_same_drive_and_a_seed_another() -> None:
    text = "sim:seed-c-2?duration=8&people=1&seed="
    one, again, other = (load_drive(f"{text}{seed}") for seed in (5, 5, 6))
    np.testing.assert_array_equal(lidar_of(one).ranges, lidar_of(again).ranges)
    assert one.true_calibration == again.true_calibration
    assert (lidar_of(one).ranges != lidar_of(other).ranges).any()
    # Adding a lidar changes nothing else.
    blind = load_drive("sim:seed-c-2?duration=8&seed=5&lidar=off")
    np.testing.assert_array_equal(blind.wheels.angles, one.wheels.angles)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("hall?lidar=a3", "lidar=a3: there is no such lidar; use a1, a2 or off"),
        ("hall?people=-1", "people=-1: from 0 to 100"),
        ("hall?lidar_beams=1", "lidar_beams=1"),
        ("hall?lidar_range_sigma=0", "lidar_range_sigma=0"),
        ("hall?lidar_dropout=1", "lidar_dropout=1"),
        ("hall?world=attic", "no world 'attic'"),
        ("hall?world=attic.toml", r"attic\.toml: no such world; world= wants a TOML file"),
        ("figure-eight?lidar=a2", "unknown key 'lidar'"),
        ("figure-eight?people=1", "unknown key 'people'"),
        ("seed-a-spin-ideal?world=hall", "unknown key 'world'"),
        ("seed-b-room?speed=3", r"there is no room for the turns.*speed="),
        ("seed-c-1?robot=tricycle", "cannot turn on the spot"),
    ],
)
def test_errors_say_what_there_is(text: str, what: str) -> None:
    with pytest.raises(FglocError, match=what):
        load_drive(f"sim:{text}")
