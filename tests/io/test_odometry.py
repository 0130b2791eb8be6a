"""Odometry as it comes: jumps, two robots under one name, wrong frames, bad numbers."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgloc.core.geometry import EXACT, compose, integrate
from fgloc.core.measurements import CameraPoses
from fgloc.core.robot import typical_noise
from fgloc.errors import FglocError
from fgloc.experiments.compare import compare
from fgloc.experiments.fixes import FixSpec
from fgloc.io.bag_drive import BagDrive, read_bag
from fgloc.io.sources import bridge, one_source
from fgloc.io.topics import CameraTable, OdometryTable, TopicMap

from .bagfiles import SECOND, START, Arc, Message, diagonal, odometry, pose_stamped, write_bag

ARC = Arc()
STEP = (0.05, 0.0, 0.025)
"""What the arc drives in a tenth of a second."""


def read(tmp_path: Path, messages: list[Message], given: TopicMap | None = None) -> BagDrive:
    return read_bag(write_bag(tmp_path / "run.bag", messages), given=given)


def recorded_in_turn(messages: list[Message]) -> list[Message]:
    """Return messages recorded in this order, a tenth of a second apart, whatever their stamps."""
    return [replace(m, received=START + k * SECOND // 10) for k, m in enumerate(messages)]


def test_poses_of_a_frame_that_starts_anywhere(tmp_path: Path) -> None:
    origin = np.array([5.4e6, 4.5e5, 2.0])
    messages = [odometry(s, tuple(compose(origin, np.array(ARC.pose(s))))) for s in ARC.stamps]
    drive = read(tmp_path, messages).drive
    # A coordinate of 5.4e6 m has a resolution of 1e-9 m.
    np.testing.assert_allclose(drive.wheels.angles, np.tile(STEP, (80, 1)), atol=3e-9)
    reached = integrate(drive.robot.base.displacements(drive.wheels.angles), np.zeros(3), EXACT)
    np.testing.assert_allclose(reached[-1], ARC.pose(ARC.stamps[-1]), atol=1e-7)


def test_a_heading_that_wraps_and_a_robot_that_moves_sideways(tmp_path: Path) -> None:
    poses = [(0.0, 0.02 * k, math.pi - 0.05 + 0.03 * k) for k in range(6)]
    messages = [odometry(START + k * SECOND // 10, p) for k, p in enumerate(poses)]
    drive = read(tmp_path, messages).drive
    np.testing.assert_allclose(drive.wheels.angles[:, 2], 0.03, atol=1e-12)
    # Seen from a robot that looks back, +y is to its right.
    assert np.all(drive.wheels.angles[:, 1] < -0.0199)


def test_a_reset_keeps_the_rate_of_its_neighbours(tmp_path: Path) -> None:
    messages = ARC.odometry()
    half = len(messages) // 2
    again = [
        odometry(s, ARC.pose(s - ARC.stamps[half] + START), (0.5, 0.0, 0.25))
        for s in ARC.stamps[half:]
    ]
    # At 4 s the robot is 2·2·sin(0.5) = 1.9 m away; there its odometry begins anew.
    found = read(tmp_path, messages[:half] + again).drive
    np.testing.assert_allclose(found.wheels.angles, np.tile(STEP, (80, 1)), atol=1e-12)
    assert found.rejected == {}
    assert any("jumps once" in n for n in found.notes)


def test_one_stray_pose_is_dropped_and_the_interval_across_it_is_whole(tmp_path: Path) -> None:
    messages = ARC.odometry()
    messages[30] = odometry(ARC.stamps[30], (500.0, -3.0, 1.0), (0.5, 0.0, 0.25))
    drive = read(tmp_path, messages).drive
    assert drive.rejected == {"odometry pose of another source": 1}
    assert drive.wheels.stamps_ns.size == 80
    np.testing.assert_allclose(drive.wheels.angles[29], 2 * np.array(STEP), atol=1e-12)
    np.testing.assert_allclose(drive.wheels.angles.sum(axis=0), [4.0, 0.0, 2.0], atol=1e-12)


def test_a_truth_with_stray_poses_keeps_a_heading_without_jumps(tmp_path: Path) -> None:
    # 3.0 rad, strays at 0 and -3.0 rad: unwrapped one after the other they lead a turn astray.
    strays = {20: (50.0, 0.0, 0.0), 21: (50.5, 0.0, -3.0)}
    messages = ARC.odometry()
    for k, s in enumerate(ARC.stamps):
        x, y, _ = ARC.pose(s)
        messages.append(pose_stamped(s, strays.get(k, (x, y, 3.0))))
    drive = read(tmp_path, messages).drive
    assert drive.truth is not None
    assert drive.rejected == {"truth pose of another source": 2}
    np.testing.assert_allclose(drive.truth.trajectory.poses[:, 2], 3.0, atol=1e-12)


def test_two_robots_under_one_name_are_told_apart(tmp_path: Path) -> None:
    other = Arc(seconds=6.0, speed=0.3, rate=-0.1)
    messages = ARC.odometry()
    for s in other.stamps:
        x, y, theta = other.pose(s)
        messages.append(odometry(s + 7_000_000, (x + 5.0, y, theta)))
    messages.sort(key=lambda m: m.stamp)
    drive = read(tmp_path, messages).drive
    assert drive.rejected == {"odometry pose of another source": 61}
    np.testing.assert_allclose(drive.wheels.angles, np.tile(STEP, (80, 1)), atol=1e-12)
    assert any("(81 messages, and 61 elsewhere)" in n for n in drive.notes)


def test_poses_that_jump_all_the_time_do_not_take_for_ever() -> None:
    rng = np.random.default_rng(0)
    n = 20_000
    poses = rng.uniform(-1e6, 1e6, (n, 3))
    stamps = np.arange(n, dtype=np.int64) * 10_000_000
    rejected: Counter[str] = Counter()
    kept, _ = one_source(stamps, poses, "/odom", "odometry", rejected, [])
    assert kept.size + rejected["odometry pose of another source"] == n


def test_bridge_interpolates_the_rate() -> None:
    seconds = np.array([1.0, 2.0, 1.0, 1.0])
    moved = np.array([[1.0], [99.0], [3.0], [99.0]])
    # Rates are 1 before and 3 after, so 2 between; at the end the nearest one.
    np.testing.assert_allclose(
        bridge(moved, seconds, np.array([False, True, False, True]))[:, 0], [1.0, 4.0, 3.0, 3.0]
    )
    assert bridge(moved, seconds, np.ones(4, np.bool_)).tolist() == [[0.0]] * 4


def test_quaternions_that_are_not_normalised_or_zero_and_numbers_that_are_none(
    tmp_path: Path,
) -> None:
    messages = [
        odometry(s, ARC.pose(s), scale=0.5 + 0.1 * (k % 7)) for k, s in enumerate(ARC.stamps)
    ]
    messages[10] = odometry(ARC.stamps[10], ARC.pose(ARC.stamps[10]), scale=0.0)
    messages[20] = odometry(ARC.stamps[20], (float("nan"), 0.0, 0.0))
    messages[25] = odometry(ARC.stamps[25], (1e300, 0.0, 0.0))
    drive = read(tmp_path, messages).drive
    assert drive.rejected == {
        "odometry not a number": 2,
        "odometry quaternion of length zero": 1,
    }
    np.testing.assert_allclose(drive.wheels.angles.sum(axis=0), [4.0, 0.0, 2.0], atol=1e-12)


def test_stamps_that_repeat_or_go_back(tmp_path: Path) -> None:
    messages = ARC.odometry()
    late = odometry(ARC.stamps[40], (9.0, 9.0, 0.0), received=ARC.stamps[50])
    doubled = odometry(ARC.stamps[60], ARC.pose(ARC.stamps[60]), received=ARC.stamps[61])
    drive = read(tmp_path, [*messages[:50], late, *messages[50:61], doubled, *messages[61:]]).drive
    # The late one repeats a stamp as well; what came first stays.
    assert drive.rejected == {"odometry repeated stamp": 2}
    np.testing.assert_allclose(drive.wheels.angles, np.tile(STEP, (80, 1)), atol=1e-12)
    out_of_order = [*messages[:50], messages[51], messages[50], *messages[52:]]
    path = tmp_path / "order"
    path.mkdir()
    drive = read(path, recorded_in_turn(out_of_order)).drive
    assert drive.rejected == {"odometry time goes back": 1}


def test_a_stamp_from_the_future_costs_one_message(tmp_path: Path) -> None:
    messages = ARC.odometry()
    messages[30] = odometry(ARC.stamps[30] + 500 * SECOND, ARC.pose(ARC.stamps[30]))
    drive = read(tmp_path, recorded_in_turn(messages)).drive
    assert drive.rejected == {"odometry time goes back": 1}
    assert drive.wheels.stamps_ns.size == 80


def test_a_clock_that_is_set_back(tmp_path: Path) -> None:
    messages = ARC.odometry()
    anew = [
        odometry(s - 3600 * SECOND, ARC.pose(s), received=s + 20 * SECOND) for s in ARC.stamps[:31]
    ]
    drive = read(tmp_path, messages + anew).drive
    assert drive.rejected == {"odometry time goes back": 31}
    assert any("set back" in n and "81 of 112" in n for n in drive.notes)
    np.testing.assert_allclose(drive.wheels.angles, np.tile(STEP, (80, 1)), atol=1e-12)


def test_times_of_recording_where_stamps_are_zero(tmp_path: Path) -> None:
    blank = [odometry(0, ARC.pose(s), received=s) for s in ARC.stamps]
    drive = read(tmp_path, blank).drive
    assert drive.wheels.stamps_ns.tolist() == ARC.stamps
    assert any("/odom has no stamps" in n for n in drive.notes)
    some = ARC.odometry()
    some[5] = odometry(0, ARC.pose(ARC.stamps[5]), received=ARC.stamps[5] + 1000)
    path = tmp_path / "some"
    path.mkdir()
    drive = read(path, some).drive
    assert drive.wheels.stamps_ns[5] == ARC.stamps[5] + 1000
    assert any("1 messages of /odom have no stamp" in n for n in drive.notes)


def test_a_blank_stamp_among_those_of_another_clock_is_dropped(tmp_path: Path) -> None:
    # Simulated time in the stamps, the date in the times of recording.
    messages = [odometry(s - START + SECOND, ARC.pose(s), received=s) for s in ARC.stamps]
    messages[7] = odometry(0, ARC.pose(ARC.stamps[7]), received=ARC.stamps[7])
    drive = read(tmp_path, messages).drive
    assert drive.rejected == {"odometry without a stamp": 1}
    assert any("another clock" in n for n in drive.notes)


def test_a_twist_in_the_frame_of_the_odometry_is_noticed(tmp_path: Path) -> None:
    messages = []
    for s in ARC.stamps:
        x, y, theta = ARC.pose(s)
        twist = (0.5 * math.cos(theta), 0.5 * math.sin(theta), 0.25)
        messages.append(odometry(s, (x, y, theta), twist))
    drive = read(tmp_path, messages).drive
    assert any("in the odometry's frame" in n for n in drive.notes)
    given = TopicMap(odometry=OdometryTable(field="twist", twist_frame="parent"))
    path = tmp_path / "turned"
    path.mkdir()
    turned = read(path, messages, given).drive
    # The trapezoid of a velocity that turns by 0.025 rad a step is exact in the robot's frame.
    np.testing.assert_allclose(turned.wheels.angles, np.tile(STEP, (80, 1)), atol=1e-12)


def test_poses_that_stand_still_give_way_to_twists(tmp_path: Path) -> None:
    messages = [odometry(s, (0.0, 0.0, 0.0), (0.5, 0.0, 0.25)) for s in ARC.stamps]
    found = read(tmp_path, messages)
    assert found.topics.odometry is not None
    assert found.topics.odometry.field == "twist"
    np.testing.assert_allclose(found.drive.wheels.angles, np.tile(STEP, (80, 1)), atol=1e-12)
    assert any("do not move" in n for n in found.drive.notes)


def test_poses_and_twists_that_disagree(tmp_path: Path) -> None:
    messages = [odometry(s, ARC.pose(s), (1.0, 0.0, 0.25)) for s in ARC.stamps]
    drive = read(tmp_path, messages).drive
    assert any("drive 4 m, its twists 8 m" in n for n in drive.notes)


@pytest.mark.parametrize(
    ("variance", "expected"),
    [(0.0, None), (-1.0, None), (1e6, None), (float("nan"), None), (0.002, 0.02)],
)
def test_noise_from_the_covariance_only_where_it_says_something(
    tmp_path: Path, variance: float, expected: float | None
) -> None:
    messages = [
        odometry(s, ARC.pose(s), (0.5, 0.0, 0.25), **{"twist.covariance": diagonal(6, variance)})
        for s in ARC.stamps
    ]
    given = TopicMap(odometry=OdometryTable(noise="covariance"))
    found = read(tmp_path, messages, given).drive
    if expected is None:
        assert found.robot.noise == typical_noise("odometry")
        assert any("no measure of its noise" in n for n in found.notes)
    else:
        # 0.002 (m/s)² at 10 Hz and 0.5 m/s: √(0.002·0.1/0.5) = 0.02 m/√m.
        assert found.robot.noise.rolling == pytest.approx(expected)
        assert found.robot.noise.veering == pytest.approx(expected)


def test_wheels_and_vision_are_told_apart_by_name(tmp_path: Path) -> None:
    messages = []
    for s in ARC.stamps:
        messages += [odometry(s, ARC.pose(s), topic=t) for t in ("/zed/odom", "/odom")]
        messages += [odometry(s, ARC.pose(s), topic=t) for t in ("/icp_odom", "/odometry/filtered")]
    found = read(tmp_path, messages)
    assert found.topics.odometry is not None
    assert found.topics.camera is not None
    assert found.topics.odometry.topic == "/odom"
    assert found.topics.camera.topic == "/zed/odom"
    left = [n for n in found.drive.notes if n.startswith("Left out")]
    assert len(left) == 2
    assert any("/icp_odom" in n and "odometry of a lidar" in n for n in left)
    assert any("/odometry/filtered" in n and "estimate of several" in n for n in left)


def test_the_only_odometry_is_taken_whatever_its_name(tmp_path: Path) -> None:
    messages = [odometry(s, ARC.pose(s), topic="/odometry/filtered") for s in ARC.stamps]
    found = read(tmp_path, messages)
    assert found.topics.odometry is not None
    assert found.topics.odometry.topic == "/odometry/filtered"
    given = TopicMap(camera=CameraTable(topic="/odometry/filtered"))
    path = tmp_path / "none"
    path.mkdir()
    with pytest.raises(FglocError, match="nothing here tells how the robot moved"):
        read(path, messages, given)


def test_a_camera_of_a_mirrored_world_still_reads(tmp_path: Path) -> None:
    messages = ARC.odometry()
    for s in ARC.stamps:
        x, y, theta = ARC.pose(s)
        messages.append(odometry(s, (x, -y, -theta), topic="/vio/odom"))
    drive = read(tmp_path, messages).drive
    (camera,) = drive.each(CameraPoses)
    assert camera.poses[-1, 2] == pytest.approx(-2.0)
    # Without a covariance what is usual of a visual odometry.
    assert (camera.position_walk, camera.heading_walk) == (0.02, 0.01)
    assert any("0.02 m/√m" in n and "what is usual" in n for n in drive.notes)


def test_a_camera_that_begins_anew_goes_on(tmp_path: Path) -> None:
    messages = ARC.odometry()
    for k, s in enumerate(ARC.stamps):
        pose = ARC.pose(s if k < 60 else s - ARC.stamps[60] + START)
        messages.append(odometry(s, pose, topic="/vio/odom"))
    drive = read(tmp_path, messages).drive
    (camera,) = drive.each(CameraPoses)
    np.testing.assert_allclose(camera.poses, [ARC.pose(s) for s in ARC.stamps], atol=1e-9)
    assert any("/vio/odom jumps once" in n and "steady" in n for n in drive.notes)


def test_every_method_runs_on_a_body_odometry(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    long = Arc(seconds=40.0)
    messages = []
    for s in long.stamps:
        # The wheels are 4 % too large: the truth is the arc, the odometry goes further.
        theta = long.pose(s)[2]
        scaled = (2.08 * math.sin(theta), 2.08 * (1.0 - math.cos(theta)), theta)
        messages.append(odometry(s, scaled))
        messages.append(
            Message(
                "/ground_truth",
                "geometry_msgs/msg/PoseStamped",
                s,
                {
                    "pose.position.x": long.pose(s)[0] + rng.normal(0.0, 1e-4),
                    "pose.position.y": long.pose(s)[1] + rng.normal(0.0, 1e-4),
                    "pose.orientation.z": math.sin(theta / 2),
                    "pose.orientation.w": math.cos(theta / 2),
                },
            )
        )
    path = write_bag(tmp_path / "run.bag", messages)
    # On a circle a scale and a lever arm look alike, so the arm is said to be none.
    topics = tmp_path / "topics.toml"
    topics.write_text("[truth]\nmount_sigma = [0, 0, 0]\nsigma = [1e-3, 1e-3, 1e-3]\n")
    found = compare(
        [str(path)], "model1,batch,online", fixes=FixSpec(5.0, 0.002), topics_file=topics
    )
    methods = found.drives[0].methods
    assert not found.drives[0].skipped
    # Model 1 drives a circle of 2.08 m for one of 2 m.
    assert methods["model1"].evaluation is not None
    assert methods["model1"].evaluation.ate_rmse_m > 0.05
    for name in ("batch", "online"):
        values = {c.name: (c.value, c.sigma) for c in methods[name].result.calibration}
        value, sigma = values["odometry_scale"]
        assert sigma < 0.015
        assert value == pytest.approx(1 / 1.04, abs=3.5 * sigma)
    assert methods["batch"].evaluation is not None
    assert methods["batch"].evaluation.ate_rmse_m < 0.01
