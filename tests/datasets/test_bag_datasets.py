"""The recorded bags against published figures, and against copies made by others."""

from __future__ import annotations

import functools
import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from fgloc.cli import main
from fgloc.core.drive import Drive
from fgloc.core.evaluation import evaluate
from fgloc.core.measurements import Acceleration, CameraPoses, PositionFixes, Yaw, YawRate
from fgloc.core.start import trim_to_truth
from fgloc.datasets.registry import load_drive, load_with_topics
from fgloc.errors import FglocError
from fgloc.estimator import run
from fgloc.experiments.fixes import with_fixes
from fgloc.filters.model1 import Model1
from fgloc.filters.model2 import Model2
from fgloc.io.topics import ImuTable, TopicMap, WheelsTable
from fgloc.smoothing.batch import BatchSmoother

pytest.importorskip("rosbags", reason="rosbags (extra `bags`) is not installed")


@functools.cache
def recorded(drive_id: str, data: Path) -> tuple[Drive, TopicMap | None] | str:
    """Return a recorded drive with its topic map, read once for all tests, or why it cannot be."""
    try:
        return load_with_topics(drive_id, data)
    except FglocError as error:
        return str(error)


def loaded(drive_id: str, data: Path) -> Drive:
    """Return a recorded drive, or skip where the recording is not here."""
    found = recorded(drive_id, data)
    if isinstance(found, str):
        if "not on this machine" in found or "has no run" in found:
            pytest.skip(f"{drive_id} is not on this machine")
        raise AssertionError(found)
    return found[0]


def rmse(drive: Drive) -> float:
    """Return the position RMSE of the wheels alone [m]."""
    assert drive.truth is not None
    return evaluate(run(Model1(), drive).trajectory, drive.truth).ate_rmse_m


@pytest.mark.parametrize(("run", "csv"), [("bag3", "calibration3"), ("bag1", "calibration1")])
def test_polimi_truth_is_that_of_the_publishers_own_copy(
    data_dir: Path, run: str, csv: str
) -> None:
    drive = loaded(f"polimi-mecanum:{run}", data_dir)
    assert drive.truth is not None
    copy = np.loadtxt(data_dir / "polimi-mecanum" / "csv" / f"{csv}.csv", delimiter=",", skiprows=1)
    stamps = copy[:, 0].astype(np.int64) * 1_000_000_000 + copy[:, 1].astype(np.int64)
    truth = drive.truth.trajectory
    places = [tuple(p) for p in truth.poses[:, :2].tolist()]
    times = dict(zip(places, truth.stamps_ns.tolist(), strict=True))
    # Every position of the copy is one of the bag's, to the last digit.
    copied = [tuple(p) for p in copy[:, 2:4].tolist()]
    assert set(copied) <= set(places)
    # Most are stamped about 31 ms before the copy's: that late the bag received them.
    once = {p for p, n in Counter(places).items() if n == 1}
    behind = [s - times[p] for p, s in zip(copied, stamps.tolist(), strict=True) if p in once]
    assert np.median(behind) == pytest.approx(0.032e9, abs=0.003e9)
    assert np.percentile(np.abs(behind), 95) < 0.05e9


def test_polimi_wheels_are_the_counts_of_the_publishers_own_copy(data_dir: Path) -> None:
    drive = loaded("polimi-mecanum:bag3", data_dir)
    copy = np.loadtxt(
        data_dir / "polimi-mecanum" / "csv" / "calibration3.csv", delimiter=",", skiprows=1
    )
    # Columns fl fr rl rr are the motors' speeds in rad/min; the gear is 5. Their integral and the
    # counts of 1/42 turn, which are worth 1/38, tell the same wheels' ways.
    seconds = np.diff(copy[:, 0] + copy[:, 1] * 1e-9)
    rates = copy[:, 4:] / 60.0 / 5.0
    ways = (0.5 * (rates[1:] + rates[:-1]) * seconds[:, None]).sum(axis=0)
    counted = drive.wheels.angles.sum(axis=0) * 42.0 / 38.0
    np.testing.assert_allclose(counted, ways, rtol=0.02)
    assert drive.wheels.wheels == ("fl", "fr", "rl", "rr")


def test_polimi_by_its_nominal_and_by_its_published_values(data_dir: Path, tmp_path: Path) -> None:
    drive = loaded("polimi-mecanum:bag3", data_dir)
    # An independent fit found 0.31 m for the nominal values.
    assert rmse(drive) == pytest.approx(0.306, abs=0.005)
    # The same fit: counts worth 1.085 times as much, L+W 0.362 m, and 0.040 m are left once the
    # tracked body's heading is fitted too, which is -0.042 rad.
    topics = tmp_path / "fitted.toml"
    topics.write_text(
        '[base]\nkind = "mecanum"\nradius = 0.07595\nhalf_length = 0.1962\nhalf_width = 0.1658\n'
        'order = ["fl", "fr", "rl", "rr"]\n'
        "[truth]\nmount = [0, 0, -0.042]\nmount_sigma = [0, 0, 0]\n"
    )
    fitted = load_drive("polimi-mecanum:bag3", data_dir, topics)
    assert rmse(fitted) == pytest.approx(0.040, abs=0.001)
    # The prior for counts is the stated robot's; who states another one has the usual prior.
    assert fitted.robot.base.parameters[0].prior_sigma == pytest.approx(0.03 * 0.07595)
    assert drive.robot.base.parameters[0].prior_sigma > 0.1 * 0.07


def test_polimi_calibrates_to_the_published_values(data_dir: Path) -> None:
    drive = with_fixes(loaded("polimi-mecanum:bag3", data_dir), 10.0, 0.002, seed=0)
    result = run(BatchSmoother(), drive)
    values = {c.name: (c.value, c.sigma) for c in result.calibration}
    # 0.0678 m at 38 counts is 0.0678·42/38 = 0.0749 m at 42; an independent fit found 1.085·0.07 =
    # 0.0760 m and L+W 0.362 m, the publishers 0.353 m.
    radii = [v for n, (v, _) in values.items() if n.startswith("wheel_radius")]
    assert np.mean(radii) == pytest.approx(0.0754, abs=0.001)
    assert values["base_radius"][0] == pytest.approx(0.3575, abs=0.0065)
    assert drive.truth is not None
    x, y, yaw = (values[f"optitrack_{axis}"][0] for axis in ("x", "y", "yaw"))
    assert evaluate(result.trajectory, drive.truth, (x, y, yaw)).ate_rmse_m < 0.02


def test_husky_reaches_the_end_that_robot_localization_reaches(data_dir: Path) -> None:
    # Its test of this bag fuses velocities and IMU to (-40.0454, -76.9988) ± 1.0452 m, starting at
    # the origin with the IMU's heading; our map starts with heading 0, so only the distance counts.
    drive = loaded("robot-localization-bags:husky_test1", data_dir)
    end = run(Model2(), drive).trajectory.poses[-1]
    away = float(np.hypot(end[0], end[1]))
    assert away == pytest.approx(float(np.hypot(40.0454, 76.9988)), abs=1.0452)


def test_husky_streams(data_dir: Path) -> None:
    drive = loaded("robot-localization-bags:husky_test1", data_dir)
    assert drive.robot.base.kind == "odometry"
    assert drive.wheels.stamps_ns.size == 3952
    kinds = {type(s): s for s in drive.sensors}
    assert set(kinds) == {Yaw, YawRate, Acceleration, PositionFixes}
    # The IMU lies on its side; about its y axis it turns as the wheels do.
    gyro = drive.each(YawRate)[0]
    turned = float(np.sum(gyro.rate[1:] * np.diff(gyro.stamps_ns) * 1e-9))
    assert turned == pytest.approx(float(drive.wheels.angles[:, 2].sum()), abs=0.2)
    assert drive.each(PositionFixes)[0].sigma[0].tolist() == [0.9, 0.9]


def test_groovys_odometries_are_told_apart_and_their_imu_is_not_flipped(data_dir: Path) -> None:
    name = "robot-localization-bags:groovy_wheel_vo_imu_test1"
    drive = loaded(name, data_dir)
    assert len(drive.each(CameraPoses)) == 1
    assert any("turns against the wheels" in n for n in drive.notes)
    assert any("in the odometry's frame" in n for n in drive.notes)
    assert any("left-handed" in n for n in drive.notes)
    given = TopicMap(imu=ImuTable(axis="-z", world="ned"))
    turned, used = load_with_topics(name, data_dir, given)
    assert used is not None
    assert used.imu is not None
    assert used.imu.topic == "/xsens/imu_data"
    assert not any("turns against the wheels" in n for n in turned.notes)
    np.testing.assert_allclose(turned.each(YawRate)[0].rate, -drive.each(YawRate)[0].rate)


def test_jackal_says_that_wheels_and_imu_disagree(data_dir: Path) -> None:
    drive = loaded("robot-localization-bags:jackal_test2", data_dir)
    assert any("times as much as the wheels" in n for n in drive.notes)


def test_turtlebots_two_robots_under_one_name(data_dir: Path) -> None:
    drive = loaded("turtlebot3-db3:0", data_dir)
    assert drive.rejected == {"odometry pose of another source": 531}
    assert drive.wheels.stamps_ns.size == 533
    # A TurtleBot3 drives 0.22 m/s at most; for 26.6 s that is less than 6 m.
    assert 1.0 < float(np.abs(drive.wheels.angles[:, 0]).sum()) < 6.0
    folder = load_drive(str(data_dir / "turtlebot3-db3"))
    np.testing.assert_array_equal(folder.wheels.angles, drive.wheels.angles)


def test_a_dataset_takes_parts_of_a_topic_map(data_dir: Path) -> None:
    given = TopicMap(wheels=WheelsTable(counts_per_revolution=38.0))
    usual = loaded("polimi-mecanum:bag1", data_dir)
    other = load_drive("polimi-mecanum:bag1", data_dir, given)
    np.testing.assert_allclose(other.wheels.angles, usual.wheels.angles * 42.0 / 38.0)
    assert trim_to_truth(other).wheels.stamps_ns.size > 2000


def test_what_is_no_bag_takes_no_topic_map(data_dir: Path, tmp_path: Path) -> None:
    with pytest.raises(FglocError, match="sim:demo is no ROS bag; leave out --topics"):
        load_drive("sim:demo", data_dir, TopicMap())
    if (data_dir / "jackal-jackass").is_dir():
        with pytest.raises(FglocError, match="no ROS bag"):
            load_drive("jackal-jackass:0", data_dir, TopicMap())


def test_the_command_prints_a_map_that_it_reads_again(
    data_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = "robot-localization-bags:jackal_test2"
    loaded(name, data_dir)
    file = tmp_path / "info.json"
    assert main(["datasets", "info", name, "--data", str(data_dir), "--json", str(file)]) == 0
    out = capsys.readouterr().out
    assert "odometry ← /jackal_velocity_controller/odom (nav_msgs/Odometry, 3060 messages)" in out
    printed = out.partition("given as --topics FILE:\n\n")[2]
    topics = tmp_path / "topics.toml"
    topics.write_text(printed)
    about = json.loads(file.read_text())
    assert about["topics"]["imu"]["axis"] == "+z"
    path = str(data_dir / "robot-localization-bags" / "jackal_test2.bag")
    again = tmp_path / "again.json"
    arguments = ["datasets", "info", path, "--topics", str(topics), "--json", str(again)]
    assert main(arguments) == 0
    repeated = json.loads(again.read_text())
    assert repeated["topics"] == about["topics"]
    assert repeated["sensors"] == about["sensors"]
