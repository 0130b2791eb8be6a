"""Joint states as wheels: order, counts, signs, wraps, messages of other joints."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fgloc.core.bases import mecanum
from fgloc.errors import FglocError
from fgloc.io.bag_drive import BagDrive, read_bag
from fgloc.io.topics import TopicMap, WheelsTable, load_topics

from .bagfiles import SECOND, START, Arc, Message, joints, write_bag

BASE = {"kind": "differential", "radius_left": 0.1, "radius_right": 0.1, "track": 0.5}
NAMES = ["left", "right"]


def read(
    tmp_path: Path, messages: list[Message], base: dict[str, Any] = BASE, **options: Any
) -> BagDrive:
    path = write_bag(tmp_path / "run.bag", messages)
    return read_bag(path, given=TopicMap(base=base, wheels=WheelsTable(**options)))


def rolled(positions: list[list[float]], names: list[str] = NAMES) -> list[Message]:
    """Return messages a tenth of a second apart."""
    return [joints(START + k * SECOND // 10, names, p) for k, p in enumerate(positions)]


def test_positions_in_radians(tmp_path: Path) -> None:
    found = read(tmp_path, rolled([[0.0, 1.0], [0.1, 1.3], [0.3, 1.2]]))
    assert found.drive.wheels.wheels == ("left", "right")
    np.testing.assert_allclose(found.drive.wheels.angles, [[0.1, 0.3], [0.2, -0.1]], atol=1e-12)
    assert found.drive.wheels.resolution == 0.0
    assert found.drive.robot.base.kind == "differential"
    assert any("/joint_states" in n and "field position" in n for n in found.drive.notes)


def test_counts_gear_order_and_signs(tmp_path: Path) -> None:
    messages = rolled([[0.0, 100.0], [7.0, 97.0]], ["motor_r", "motor_l"])
    found = read(
        tmp_path,
        messages,
        joints=("motor_l", "motor_r"),
        counts_per_revolution=50.0,
        gear=2.0,
        reverse=("motor_l",),
    )
    count = 2.0 * math.pi / 100.0
    np.testing.assert_allclose(found.drive.wheels.angles, [[3.0 * count, 7.0 * count]])
    assert found.drive.wheels.resolution == pytest.approx(count)


def test_velocities_by_the_minute(tmp_path: Path) -> None:
    messages = [joints(START + k * SECOND, NAMES, [0.0, 0.0], [60.0 * k, 120.0]) for k in range(3)]
    # Nobody says so, but only velocities move: trapezoids of 0, 1, 2 rad/s and of 2 rad/s.
    found = read(tmp_path, messages, scale=1.0 / 60.0)
    assert found.topics.wheels is not None
    assert found.topics.wheels.field == "velocity"
    np.testing.assert_allclose(found.drive.wheels.angles, [[0.5, 2.0], [1.5, 2.0]])


def test_messages_of_an_arm_lie_between_and_the_order_changes(tmp_path: Path) -> None:
    messages = [
        joints(START, ["left", "right", "pan"], [0.0, 0.0, 9.0]),
        joints(START + 1 * SECOND // 10, ["elbow"], [5.0]),
        joints(START + 2 * SECOND // 10, ["pan", "right", "left"], [9.0, 0.2, 0.1]),
        joints(START + 3 * SECOND // 10, ["left", "right", "pan"], [0.2, 0.4, 9.0]),
        joints(START + 4 * SECOND // 10, ["left", "right"], [0.3]),
        joints(START + 5 * SECOND // 10, ["left", "right"], [0.4, float("nan")]),
    ]
    drive = read(tmp_path, messages).drive
    assert drive.rejected == {"wheels message of other joints": 1, "wheels not a number": 2}
    np.testing.assert_allclose(drive.wheels.angles, [[0.1, 0.2], [0.1, 0.2]], atol=1e-12)


def test_names_may_be_missing_altogether(tmp_path: Path) -> None:
    drive = read(tmp_path, rolled([[0.0, 0.0], [0.1, 0.2]], [])).drive
    np.testing.assert_allclose(drive.wheels.angles, [[0.1, 0.2]], atol=1e-12)


def test_a_counter_of_16_bits_wraps(tmp_path: Path) -> None:
    messages = rolled([[65530.0, 3.0], [4.0, 65533.0], [14.0, 65523.0]])
    found = read(tmp_path, messages, counts_per_revolution=100.0, counter_bits=16)
    count = 2.0 * math.pi / 100.0
    np.testing.assert_allclose(
        found.drive.wheels.angles, count * np.array([[10.0, -6.0], [10.0, -10.0]])
    )


def test_angles_that_are_kept_within_a_turn_are_unwrapped(tmp_path: Path) -> None:
    angle = 0.4 * np.arange(40)
    wrapped = np.stack([(angle + math.pi) % (2 * math.pi) - math.pi, np.zeros(40)], axis=1)
    found = read(tmp_path, rolled(wrapped.tolist()))
    np.testing.assert_allclose(found.drive.wheels.angles[:, 0], 0.4, atol=1e-9)
    assert any("wrapped to one turn" in n for n in found.drive.notes)


def test_a_board_that_restarts_keeps_the_rate_of_its_neighbours(tmp_path: Path) -> None:
    position = 0.3 * np.arange(60)
    position[30:] = 0.3 * np.arange(30) - 5000.0
    drive = read(tmp_path, rolled(np.stack([position, position], axis=1).tolist())).drive
    assert drive.rejected == {"implausible wheel increment": 1}
    np.testing.assert_allclose(drive.wheels.angles, 0.3, atol=1e-9)


def test_a_steered_base(tmp_path: Path) -> None:
    base = {"kind": "tricycle", "radius": 0.1, "wheelbase": 0.5}
    messages = rolled([[0.0, 0.1], [0.5, 0.3], [1.0, 0.3]], ["traction", "steering"])
    drive = read(
        tmp_path, messages, base, joints=("traction",), steering_joints=("steering",)
    ).drive
    np.testing.assert_allclose(drive.wheels.angles, [[0.5], [0.5]])
    assert drive.wheels.steering is not None
    np.testing.assert_allclose(drive.wheels.steering, [[0.2], [0.3]])


def test_a_mecanum_base_from_a_file(tmp_path: Path) -> None:
    topics = tmp_path / "topics.toml"
    topics.write_text(
        """
        [base]
        kind = "mecanum"
        name = "four rollers"
        radius = 0.07
        half_length = 0.2
        half_width = 0.17
        order = ["rr", "fl", "fr", "rl"]
        [wheels]
        joints = ["a", "b", "c", "d"]
        """
    )
    path = write_bag(tmp_path / "run.bag", rolled([[0.0] * 4, [1.0, 2.0, 3.0, 4.0]], list("abcd")))
    drive = read_bag(path, given=load_topics(topics)).drive
    assert drive.robot.name == "four rollers"
    expected = mecanum(0.07, 0.2, 0.17, ("rr", "fl", "fr", "rl"))
    assert drive.robot.base == expected
    assert drive.wheels.wheels == ("rr", "fl", "fr", "rl")


@pytest.mark.parametrize(
    ("text", "line", "what"),
    [
        ('[base]\nkind = "differentail"\n', ":1", "base.kind is 'differentail', known are"),
        ('[base]\nkind = "tricycle"\nradius = 0.1\n', ":1", "wheelbase is missing"),
        ("[base]\n{}\nwheel = 3\n", ":1", "unexpected keyword"),
        ('[base]\n{}\n[wheels]\njoints = ["left"]\n', ":7", "1 joints where the base has 2"),
        ('[base]\n{}\n[wheels]\njoints = ["l", "r"]\n', ":7", "it has left, right"),
        ('[base]\n{}\n[wheels]\nreverse = ["l"]\n', ":7", "not one of the joints left, right"),
        ('[wheels]\ntopic = "/joint_states"\n', ":1", r"\[wheels\] needs \[base\]"),
        ('[base]\n{}\n[wheels]\ntopic = "/joint_state"\n', ":7", "did you mean /joint_states"),
        ('[base]\n{}\n[wheels]\ntopic = "/odom"\n', ":7", "/odom is nav_msgs/Odometry"),
    ],
)
def test_a_map_that_does_not_fit_names_its_line(
    tmp_path: Path, text: str, line: str, what: str
) -> None:
    described = "\n".join(f"{k} = {v!r}".replace("'", '"') for k, v in BASE.items())
    topics = tmp_path / "topics.toml"
    topics.write_text(text.replace("{}", described))
    path = write_bag(
        tmp_path / "run.bag", [*rolled([[0.0, 0.0], [0.1, 0.2]]), *Arc(1.0).odometry()]
    )
    with pytest.raises(FglocError, match=what) as error:
        read_bag(path, given=load_topics(topics))
    assert str(error.value).startswith(f"{topics}{line}: ")


def test_a_role_that_is_described_and_not_there(tmp_path: Path) -> None:
    topics = tmp_path / "topics.toml"
    topics.write_text("[gps]\nsigma = 0.02\n")
    path = write_bag(tmp_path / "run.bag", Arc(1.0).odometry())
    notes = read_bag(path, given=load_topics(topics)).drive.notes
    assert any("[gps]" in n and "sensor_msgs/NavSatFix" in n for n in notes)
    topics.write_text("\n[wheels]\ngear = 2\n")
    with pytest.raises(FglocError, match=r":2: \[wheels\].*sensor_msgs/JointState"):
        read_bag(path, given=load_topics(topics))


def test_joints_without_a_described_robot(tmp_path: Path) -> None:
    wheels = rolled([[0.0, 0.0], [0.1, 0.2]])
    path = write_bag(tmp_path / "run.bag", wheels)
    with pytest.raises(FglocError, match=r"nothing says how large the wheels are.*--topics"):
        read_bag(path)
    # Where there is an odometry too, that is taken, and the note says what is needed.
    both = write_bag(tmp_path / "both.bag", [*wheels, *Arc(1.0).odometry()])
    found = read_bag(both)
    assert found.drive.robot.base.kind == "odometry"
    assert any("Left out: /joint_states" in n and "[base]" in n for n in found.drive.notes)
    described = read_bag(both, given=TopicMap(base=BASE))
    assert described.drive.robot.base.kind == "differential"
    assert any("Left out: /odom" in n for n in described.drive.notes)
