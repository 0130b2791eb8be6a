"""The topic map: what it takes, what it refuses and where, how two maps join, what is guessed."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import pytest

from fgloc.errors import FglocError
from fgloc.io.bags import Topic
from fgloc.io.guess import guess
from fgloc.io.messages import FIX, IMU, JOINTS, ODOMETRY, SCAN
from fgloc.io.topics import (
    TABLES,
    CameraTable,
    ImuTable,
    OdometryTable,
    TopicMap,
    TruthTable,
    WheelsTable,
    load_topics,
    topics_toml,
)

POSE = "geometry_msgs/msg/PoseStamped"
TWIST = "geometry_msgs/msg/TwistStamped"

FULL = """
ignore = ["/a", "/b"]
[base]
kind = "differential"
radius_left = 0.03
radius_right = 0.03
track = 0.16
[wheels]
topic = "/joint_states"
field = "position"
joints = ["left", "right"]
counts_per_revolution = 1024
gear = 43.7
reverse = ["right"]
[imu]
use = ["yaw", "rate"]
axis = "-z"
yaw_sigma = 0.01
[truth]
sigma = [0.001, 0.001, 0.002]
mount = [0.1, 0, 0]
[camera]
topic = "/zed/odom"
position_walk = 0.01
[scan]
mount = [0.2, 0.0, 3.14]
[gps]
origin = [45.0, 7.0]
sigma = 0.02
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "topics.toml"
    path.write_text(text)
    return path


def test_every_role_has_a_place() -> None:
    assert set(TABLES) <= {f.name for f in fields(TopicMap)}


def test_what_is_read_is_written_alike(tmp_path: Path) -> None:
    first = load_topics(written(tmp_path, FULL))
    assert first.imu == ImuTable(use=("yaw", "rate"), axis="-z", yaw_sigma=0.01)
    assert first.truth is not None
    assert first.truth.mount == (0.1, 0.0, 0.0)
    again = load_topics(written(tmp_path, topics_toml(first)))
    assert list(again.roles()) == list(first.roles())
    assert (again.base, again.ignore) == (first.base, first.ignore)
    assert topics_toml(again) == topics_toml(first)


def test_an_empty_map_says_nothing(tmp_path: Path) -> None:
    found = load_topics(written(tmp_path, ""))
    assert list(found.roles()) == []
    assert topics_toml(found) == ""


@pytest.mark.parametrize(
    ("text", "line", "what"),
    [
        ("[imu\n", ":1", "is not TOML"),
        ("[lidar]\n", ":1", "unknown key 'lidar'; known are base, wheels"),
        ("[imu]\naxes = '+z'\n", ":2", "unknown key 'axes' in imu; known are topic, use"),
        ("[imu]\naxis = 'z'\n", ":2", "imu.axis: invalid enum value 'z'"),
        ("[imu]\ntopic = 3\n", ":2", "imu.topic: expected str, got int"),
        ("[imu]\nyaw_sigma = 0.0\n", ":2", "imu.yaw_sigma must be finite and positive"),
        ("[truth]\nmount = [1, 2]\n", ":2", "truth.mount: expected "),
        ("[truth]\nmount = [1, 2, inf]\n", ":2", "truth.mount must be a finite number"),
        ("[truth]\nsigma = [1, -1, 1]\n", ":2", "truth.sigma must be finite and positive"),
        ("[truth]\nmount_sigma = [1, -1, 1]\n", ":2", "truth.mount_sigma must be finite and not"),
        ("[wheels]\ngear = -5\n", ":2", "wheels.gear must be finite and positive"),
        ("[wheels]\ncounter_bits = 8\n", ":2", "wheels.counter_bits: "),
        ("imu = 3\n", ":1", "imu: expected a table"),
        ("base = 3\n", ":1", "base must be a table"),
        ("ignore = '/a'\n", ":1", "ignore must be a list of topics"),
        ("[wheels]\n[odometry]\n", ":2", "a drive has one of them"),
    ],
)
def test_what_is_wrong_and_where(tmp_path: Path, text: str, line: str, what: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(FglocError) as error:
        load_topics(path)
    assert str(error.value).startswith(f"{path}{line}: ")
    assert what in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(FglocError, match="no such topic map; --topics wants a TOML file"):
        load_topics(tmp_path / "none.toml")


def test_maps_join_key_by_key() -> None:
    below = TopicMap(
        base={"kind": "a"},
        wheels=WheelsTable(topic="/w", gear=5.0, counts_per_revolution=42.0),
        imu=ImuTable(topic="/i", axis="+y"),
        truth=TruthTable(topic="/t"),
    )
    above = TopicMap(
        wheels=WheelsTable(counts_per_revolution=38.0), imu=ImuTable(topic="/other"), ignore=("/x",)
    )
    joined = above.over(below)
    assert joined.wheels == WheelsTable(topic="/w", gear=5.0, counts_per_revolution=38.0)
    # Another IMU is mounted in a way of its own.
    assert joined.imu == ImuTable(topic="/other")
    assert joined.truth == TruthTable(topic="/t")
    assert joined.base == {"kind": "a"}
    assert joined.ignore == ("/x",)
    assert TopicMap(odometry=OdometryTable(topic="/o")).over(below).wheels is None
    assert TopicMap(ignore=("/t",)).over(below).truth is None


def topics(**kinds: str) -> dict[str, Topic]:
    """Return topics with ten messages each; two underscores stand for a slash."""
    names = {"/" + name.replace("__", "/"): kind for name, kind in kinds.items()}
    return {name: Topic(name, kind, 10) for name, kind in names.items()}


@pytest.mark.parametrize(
    ("there", "expected"),
    [
        ({"odom": ODOMETRY}, {"odometry": "/odom"}),
        (
            {"odom": ODOMETRY, "wheel_odom": ODOMETRY, "odometry__filtered": ODOMETRY},
            {"odometry": "/wheel_odom"},
        ),
        (
            {"husky_velocity_controller__odom": ODOMETRY, "imu__data": IMU, "fix": FIX},
            {"odometry": "/husky_velocity_controller/odom", "imu": "/imu/data", "gps": "/fix"},
        ),
        (
            {"odom": ODOMETRY, "camera__odom__sample": ODOMETRY, "scan": SCAN},
            {"odometry": "/odom", "camera": "/camera/odom/sample", "scan": "/scan"},
        ),
        (
            {"odom": ODOMETRY, "base_pose_ground_truth": ODOMETRY},
            {"odometry": "/odom", "truth": "/base_pose_ground_truth"},
        ),
        (
            {"odom": ODOMETRY, "robot__pose": POSE, "goal_pose": POSE, "amcl_pose": POSE},
            {"odometry": "/odom", "truth": "/robot/pose"},
        ),
        (
            {"odom": ODOMETRY, "robot__pose": POSE, "vicon__robot": POSE},
            {"odometry": "/odom", "truth": "/vicon/robot"},
        ),
        ({"twist": TWIST, "cmd_vel": TWIST, "joint_states": JOINTS}, {"odometry": "/twist"}),
        ({"ground_truth__twist": TWIST, "odom": ODOMETRY}, {"odometry": "/odom"}),
        ({"visual_odom": ODOMETRY}, {"odometry": "/visual_odom"}),
        ({"t265__odom": ODOMETRY, "icp": ODOMETRY, "odom": ODOMETRY}, {
            "odometry": "/odom", "camera": "/t265/odom",
        }),
    ],
)  # fmt: skip
def test_what_is_guessed(there: dict[str, str], expected: dict[str, str]) -> None:
    notes: list[str] = []
    found = guess(topics(**there), TopicMap(), notes, "run.bag")
    assert {role: t.name for role, t in found.items()} == expected
    # Every topic of a known type is either used or named with the reason why it is not.
    for name in topics(**there):
        assert (name in expected.values()) != any(f"Left out: {name} " in n for n in notes)


def test_what_was_doubtful_is_said() -> None:
    notes: list[str] = []
    guess(topics(odometry__filtered=ODOMETRY, robot__pose=POSE), TopicMap(), notes, "run.bag")
    assert any("/robot/pose is taken for the truth" in n for n in notes)
    assert any("/odometry/filtered" in n and "estimate of several sensors" in n for n in notes)
    sure: list[str] = []
    guess(topics(odom=ODOMETRY, vicon__robot=POSE), TopicMap(), sure, "run.bag")
    assert sure == []
    given = TopicMap(truth=TruthTable(topic="/robot/pose"))
    guess(topics(odom=ODOMETRY, robot__pose=POSE), given, sure, "run.bag")
    assert sure == []


def test_topics_to_ignore_and_empty_ones_are_not_guessed() -> None:
    there = topics(odom=ODOMETRY, wheel_odom=ODOMETRY)
    there["/imu"] = Topic("/imu", IMU, 0)
    found = guess(there, TopicMap(ignore=("/wheel_odom",)), [], "run.bag")
    assert {role: t.name for role, t in found.items()} == {"odometry": "/odom"}


def test_a_named_topic_is_taken_for_what_it_is_said_to_be() -> None:
    there = topics(odom=ODOMETRY, visual_odom=ODOMETRY)
    given = TopicMap(
        odometry=OdometryTable(topic="/visual_odom"), camera=CameraTable(topic="/odom")
    )
    found = guess(there, given, [], "run.bag")
    assert {r: t.name for r, t in found.items()} == {"odometry": "/visual_odom", "camera": "/odom"}
