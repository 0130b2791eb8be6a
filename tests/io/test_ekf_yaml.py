"""Reading an ekf.yaml: both styles, what is honoured, what is named, what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fgloc.errors import FglocError
from fgloc.io.ekf_config import DEFAULT_PROCESS_NOISE, FLAGS, PLANAR, PLANAR_INDEX
from fgloc.io.ekf_yaml import load_ekf

OFF = [False] * 15


def vector(*on: str) -> str:
    return "[" + ", ".join(str(f in on).lower() for f in FLAGS) + "]"


ROS1 = f"""\
# A flat file, as ROS 1 has it.
frequency: 50
sensor_timeout: 0.2
two_d_mode: yes
odom0: /wheel_odom
odom0_config: {vector("vx", "vy", "vyaw")}
odom0_twist_rejection_threshold: 2.5
odom0_queue_size: 10
imu0: /imu/data
imu0_config: {vector("roll", "pitch", "yaw", "vyaw", "ax")}
imu0_relative: on
imu0_remove_gravitational_acceleration: true
pose0: /t265/pose
pose0_config: {vector("x", "y", "yaw")}
pose0_differential: True
pose0_rejection_threshold: 5
"""


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "ekf.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_flat_file(tmp_path: Path) -> None:
    config = load_ekf(write(tmp_path, ROS1))
    assert (config.frequency, config.sensor_timeout) == (50.0, 0.2)
    odom, pose, imu = config.inputs
    assert (odom.name, odom.topic, odom.flags) == ("odom0", "/wheel_odom", ("vx", "vy", "vyaw"))
    assert (odom.pose_threshold, odom.twist_threshold) == (math.inf, 2.5)
    assert (pose.flags, pose.differential, pose.relative) == (("x", "y", "yaw"), True, False)
    assert pose.pose_threshold == 5.0
    assert (imu.flags, imu.relative) == (("yaw", "vyaw", "ax"), True)
    assert config.process_noise == DEFAULT_PROCESS_NOISE
    np.testing.assert_array_equal(np.array(config.initial_covariance), 1e-9 * np.eye(8))
    assert config.notes == (
        "imu0_config: roll, pitch not used: not planar",
        "without effect on recorded drives: imu0_remove_gravitational_acceleration, "
        "odom0_queue_size",
    )


def test_the_style_of_ros_2(tmp_path: Path) -> None:
    body = "".join(f"    {line}\n" for line in ROS1.splitlines())
    for head in ("ekf_filter_node:\n  ros__parameters:\n", "/**:\n  ros__parameters:\n"):
        assert load_ekf(write(tmp_path, head + body)) == load_ekf(write(tmp_path, ROS1))
    nested = "robot:\n  ekf:\n    ros__parameters:\n" + "".join(
        f"      {line}\n" for line in ROS1.splitlines()
    )
    assert load_ekf(write(tmp_path, nested)) == load_ekf(write(tmp_path, ROS1))


def test_one_of_several_filters(tmp_path: Path) -> None:
    text = (
        f"ekf_odom:\n  two_d_mode: true\n  odom0: a\n  odom0_config: {vector('vx')}\n"
        f"ekf_map:\n  two_d_mode: true\n  odom0: b\n  odom0_config: {vector('vy')}\n"
        "navsat_transform:\n  frequency: 30\n"
    )
    path = write(tmp_path, text)
    with pytest.raises(FglocError, match=r"several filters, ekf_map, ekf_odom; write FILE:NAME"):
        load_ekf(path)
    assert load_ekf(f"{path}:ekf_map").inputs[0].topic == "b"
    with pytest.raises(FglocError, match="holds no filter 'other'; it has ekf_map, ekf_odom"):
        load_ekf(f"{path}:other")


def test_matrices_are_cut_to_the_plane(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    root = rng.standard_normal((15, 15))
    full = root @ root.T
    flat = ", ".join(repr(float(v)) for v in full.ravel())
    rows = ", ".join("[" + ", ".join(repr(float(v)) for v in row) + "]" for row in full)
    for written in (f"[{flat}]", f"[{rows}]"):
        config = load_ekf(write(tmp_path, f"{ROS1}process_noise_covariance: {written}\n"))
        planar = full[np.ix_(PLANAR_INDEX, PLANAR_INDEX)]
        np.testing.assert_allclose(np.array(config.process_noise), planar)
    # Newer versions take a diagonal; 1e-9 without a point is a number to ROS.
    diagonal = ", ".join(["1e-9"] * 5 + ["2e-3"] + ["1"] * 9)
    config = load_ekf(write(tmp_path, f"{ROS1}initial_estimate_covariance: [{diagonal}]\n"))
    assert config.initial_covariance is not None
    found = np.diag(np.array(config.initial_covariance))
    np.testing.assert_array_equal(found, [1e-9, 1e-9, 2e-3, 1, 1, 1, 1, 1])
    assert [FLAGS[k] for k in PLANAR_INDEX] == list(PLANAR)


def test_every_key_that_is_not_honoured_is_named(tmp_path: Path) -> None:
    text = ROS1.replace("two_d_mode: yes\n", "") + (
        "use_control: true\n"
        "control_timeout: 0.2\n"
        "initial_state: [1, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]\n"
        "publish_tf: true\n"
        "odom0_qeue_size: 3\n"
        "twist0: /t\n"
        "frequncy: 10\n"
        "dynamic_process_noise_covariance: true\n"
        "predict_to_current_time: true\n"
        "odom1: /gps\n"
        f"odom1_config: {vector('x', 'y', 'ax', 'z')}\n"
        "odom1_differential: true\nodom1_relative: true\n"
    )
    config = load_ekf(write(tmp_path, text))
    assert config.dynamic_process_noise
    assert config.predict_to_current_time
    said = "\n".join(config.notes)
    for expected in (
        "two_d_mode is not true",
        "use_control is not honoured: drives hold no commands",
        "initial_state is not honoured",
        "without effect on recorded drives: control_timeout, imu0_rem",
        "publish_tf",
        "keys are not known and not honoured: odom0_qeue_size (line 20), frequncy (line 22)",
        "twist0 has no twist0_config: nothing of it is used",
        "odom1_config: z not used: not planar",
        "odom1_config: ax not used: an odom input has none",
        "odom1 is differential and relative: differential is used",
    ):
        assert expected in said
    assert config.inputs[1].differential
    assert not config.inputs[1].relative


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("odom0_config: [true, false]", r":6: odom0_config has 2 flags, needs 15: x, y, z"),
        ("odom0_config: [1, 2, 3]", r":6: odom0_config expected bool, got int"),
        ("odom0_config: true", r":6: odom0_config expected array, got bool"),
        ("frequency: fast", r":2: frequency expected float, got str"),
        ("frequency: -3", r":2: frequency must be positive and finite, got -3.0"),
        ("frequency: .nan", r":2: frequency must be positive"),
        ("sensor_timeout: 0", r":3: sensor_timeout must be positive"),
        ("two_d_mode: 1", r":4: two_d_mode expected bool, got int"),
        ("odom0: 7", r":5: odom0 expected str, got int"),
        ("pose0_differential: maybe", r":15: pose0_differential expected bool"),
        ("pose0_rejection_threshold: 0", r":16: pose0_rejection_threshold must be positive, got 0"),
    ],
)
def test_what_is_wrong_is_named_with_its_line(tmp_path: Path, line: str, message: str) -> None:
    key = line.partition(":")[0]
    lines = [line if old.partition(":")[0] == key else old for old in ROS1.splitlines()]
    path = write(tmp_path, "\n".join(lines))
    with pytest.raises(FglocError, match=f"ekf.yaml{message}") as caught:
        load_ekf(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("[1.0, 2.0]", "has 2 numbers, needs 225 or 15"),
        ("[" + "1.0, " * 224 + "x]", "expected"),
        ("[" + ", ".join(["-1.0"] * 15) + "]", "is no covariance: it has a negative eigenvalue"),
        ("[" + ", ".join([".nan"] * 15) + "]", "holds a number that is not finite"),
        ("[0.0, 1.0, " + ", ".join(["0.0"] * 223) + "]", "is not symmetric"),
    ],
)
def test_bad_matrices_are_named(tmp_path: Path, value: str, message: str) -> None:
    path = write(tmp_path, f"{ROS1}process_noise_covariance: {value}\n")
    with pytest.raises(FglocError, match=rf"ekf.yaml:17: process_noise_covariance {message}"):
        load_ekf(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is not a mapping"),
        ("- 1\n- 2\n", "is not a mapping"),
        ("frequency: 30\n", "names no input"),
        ("odom0: [1\n", r":2: is not YAML"),
        ("a: b: c\n", r":1: is not YAML"),
        ("odom0: a\nodom0: b\n", r":2: odom0 is given twice"),
        ("odom0: !!python/object/apply:os.system [ls]\n", "odom0 expected str, got array"),
        ("\tx: 1\n", "is not YAML"),
        ("odom0: &a [*a]\n", "."),
    ],
)
def test_files_that_are_no_configuration(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(FglocError, match=rf"ekf\.yaml.*{message}"):
        load_ekf(write(tmp_path, text))


def test_a_few_lines_of_aliases_do_not_fill_the_memory(tmp_path: Path) -> None:
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 12)]
    with pytest.raises(FglocError, match="too many values"):
        load_ekf(write(tmp_path, "\n".join(lines)))


def test_missing_and_binary_files(tmp_path: Path) -> None:
    with pytest.raises(FglocError, match=r"nowhere.yaml: no such file"):
        load_ekf(tmp_path / "nowhere.yaml")
    with pytest.raises(FglocError, match="cannot be read"):
        load_ekf(tmp_path)
    path = tmp_path / "ekf.yaml"
    path.write_bytes(b"\xff\xfe\x00odom0")
    with pytest.raises(FglocError, match="is not UTF-8"):
        load_ekf(path)
