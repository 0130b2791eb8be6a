"""Bags of every format: what is in them comes out, and damaged ones say so in one line."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fgloc.core.drive import Drive
from fgloc.core.measurements import (
    Acceleration,
    CameraPoses,
    PositionFixes,
    Scans,
    Yaw,
    YawRate,
)
from fgloc.datasets.registry import load_drive
from fgloc.errors import FglocError
from fgloc.io.bag_drive import read_bag
from fgloc.io.bags import Bag

from .bagfiles import (
    SECOND,
    START,
    Arc,
    Message,
    diagonal,
    imu,
    odometry,
    pose_stamped,
    prefixed,
    write_bag,
)


def attempt(path: Path) -> Drive | str:
    """Return the drive in a bag, or the error that says why there is none."""
    try:
        return load_drive(str(path))
    except FglocError as error:
        return str(error)


FORMATS = ["run.bag", "run.db3", "run.mcap"]
ARC = Arc()


def everything() -> list[Message]:
    """Return messages of every sensor on the arc, in the order of their stamps."""
    messages = ARC.odometry()
    for s in ARC.stamps:
        turned = (0.0, 0.0, float(np.sin(ARC.pose(s)[2] / 2)), float(np.cos(ARC.pose(s)[2] / 2)))
        messages.append(
            imu(
                s,
                (0.0, 0.0, 0.25),
                (0.1, 0.125, 9.81),
                turned,
                orientation_covariance=diagonal(3, 0.0004),
                angular_velocity_covariance=diagonal(3, 0.0001),
            )
        )
        messages.append(pose_stamped(s, ARC.pose(s)))
        x, y, theta = ARC.pose(s)
        messages.append(
            odometry(
                s,
                (1000.0 + x, y, theta),
                (0.5, 0.0, 0.25),
                "/stereo/odom",
                **{"twist.covariance": diagonal(6, 0.001)},
            )
        )
    for k in range(3):
        messages.append(
            Message(
                "/scan",
                "sensor_msgs/msg/LaserScan",
                START + k * SECOND,
                {
                    "angle_min": -1.0,
                    "angle_increment": 0.5,
                    "time_increment": 0.001,
                    "range_min": 0.1,
                    "range_max": 10.0,
                    "ranges": [1.0, 0.05, 20.0, float("inf"), 2.0 + k],
                },
            )
        )
    messages.sort(key=lambda m: m.stamp)
    return messages


def check_everything(drive: Drive) -> None:
    """Assert that the drive is the arc."""
    wheels = drive.wheels
    assert wheels.wheels == ("forward", "left", "turn")
    assert wheels.stamps_ns.tolist() == ARC.stamps
    # A tenth of a second at 0.5 m/s and 0.25 rad/s, along the arc.
    np.testing.assert_allclose(wheels.angles, np.tile([0.05, 0.0, 0.025], (80, 1)), atol=1e-12)
    (yaw,) = drive.each(Yaw)
    np.testing.assert_allclose(yaw.yaw, [ARC.pose(s)[2] for s in ARC.stamps], atol=1e-12)
    assert yaw.sigma == pytest.approx(0.02)
    (gyro,) = drive.each(YawRate)
    assert gyro.rate.tolist() == [0.25] * 81
    # σ 0.01 rad/s at 10 Hz: 0.01·√0.1.
    assert gyro.density == pytest.approx(0.01 * np.sqrt(0.1))
    assert drive.each(Acceleration)[0].forward.tolist() == [0.1] * 81
    (camera,) = drive.each(CameraPoses)
    np.testing.assert_allclose(camera.poses, [ARC.pose(s) for s in ARC.stamps], atol=1e-9)
    # Variance 0.001 (m/s)² ten times a second at 0.5 m/s: 0.001·0.1/0.5 m² a metre.
    assert camera.position_walk == pytest.approx(np.sqrt(0.001 * 0.1 / 0.5))
    (scans,) = drive.each(Scans)
    assert scans.ranges.tolist() == [[1, 0, 0, 0, 2], [1, 0, 0, 0, 3], [1, 0, 0, 0, 4]]
    assert (scans.angle_min, scans.angle_increment) == (-1.0, 0.5)
    assert scans.beam_period == pytest.approx(0.001)
    assert (scans.min_range, scans.max_range) == (np.float32(0.1), 10.0)
    # Beams are 0.5 rad apart; a small lidar's noise is a centimetre and a percent.
    noise = (scans.range_sigma, scans.range_sigma_share, scans.bearing_sigma)
    assert noise == (0.01, 0.01, 0.125)
    assert drive.truth is not None
    np.testing.assert_allclose(
        drive.truth.trajectory.poses, [ARC.pose(s) for s in ARC.stamps], atol=1e-12
    )
    assert drive.rejected == {}


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_holds_the_same_drive(tmp_path: Path, name: str) -> None:
    check_everything(load_drive(str(write_bag(tmp_path / name, everything()))))


@pytest.mark.parametrize("name", ["run.db3", "run.mcap"])
def test_a_bare_file_of_ros_2_is_a_drive_too(tmp_path: Path, name: str) -> None:
    folder = write_bag(tmp_path / name, everything())
    (file,) = folder.glob(f"*{Path(name).suffix}")
    check_everything(load_drive(str(file)))
    (folder / "metadata.yaml").unlink()
    check_everything(load_drive(str(folder)))


def test_a_truth_leaves_gps_out_and_says_so(tmp_path: Path) -> None:
    fixes = [gps(START + k * SECOND, 45.0 + k * 1e-5, 7.0) for k in range(5)]
    drive = read_bag(write_bag(tmp_path / "run.bag", [*everything(), *fixes])).drive
    assert not drive.each(PositionFixes)
    assert any("/fix" in n and "map of its own" in n for n in drive.notes)
    drive = read_bag(write_bag(tmp_path / "two.bag", [*ARC.odometry(), *fixes])).drive
    (found,) = drive.each(PositionFixes)
    # A hundred-thousandth of a degree of latitude at 45°: the meridian's radius there is
    # 6378137·(1 - e²)/(1 - e²/2)^1.5 = 6367381.8 m, so 1.11132 m.
    np.testing.assert_allclose(found.positions[:, 1], 1.11132 * np.arange(5), atol=2e-5)
    np.testing.assert_allclose(found.positions[:, 0], 0.0, atol=1e-9)
    np.testing.assert_allclose(found.sigma, np.tile([0.5, 0.25], (5, 1)))


def gps(stamp: int, latitude: float, longitude: float, **more: object) -> Message:
    """Return a sensor_msgs/NavSatFix with σ 0.5 m east and 0.25 m north."""
    values: dict[str, object] = {
        "latitude": latitude,
        "longitude": longitude,
        "position_covariance": [0.25, 0, 0, 0, 0.0625, 0, 0, 0, 1.0],
        "position_covariance_type": 2,
    }
    return Message("/fix", "sensor_msgs/msg/NavSatFix", stamp, {**values, **more})


def test_gps_without_fix_or_covariance(tmp_path: Path) -> None:
    fixes = [
        gps(START, 45.0, 7.0),
        gps(START + SECOND, 45.1, 7.0, **{"status.status": -1}),
        gps(START + 2 * SECOND, float("nan"), 7.0),
        gps(START + 3 * SECOND, 45.0, 7.0, position_covariance_type=0),
        gps(START + 4 * SECOND, 45.0, 7.0, position_covariance=[-1.0, *[0.0] * 8]),
    ]
    drive = read_bag(write_bag(tmp_path / "run.bag", [*ARC.odometry(), *fixes])).drive
    assert drive.rejected == {"gps without fix": 1, "gps not a number": 1}
    assert drive.each(PositionFixes)[0].sigma.tolist() == [[0.5, 0.25], [2.5, 2.5], [2.5, 2.5]]
    assert any("2 of 3 fixes" in n and "2.5 m" in n for n in drive.notes)


@pytest.mark.parametrize(
    "kind",
    [
        "geometry_msgs/msg/PoseStamped",
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        "geometry_msgs/msg/TransformStamped",
        "geometry_msgs/msg/Pose",
        "nav_msgs/msg/Odometry",
    ],
)
def test_every_type_of_truth(tmp_path: Path, kind: str) -> None:
    messages = list(ARC.odometry())
    for s in ARC.stamps:
        x, y, yaw = ARC.pose(s)
        half = (float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
        names = ("translation", "rotation") if "Transform" in kind else ("position", "orientation")
        prefix = {
            "geometry_msgs/msg/Pose": "",
            "geometry_msgs/msg/PoseStamped": "pose.",
            "geometry_msgs/msg/TransformStamped": "transform.",
        }.get(kind, "pose.pose.")
        values = {
            f"{prefix}{names[0]}.x": x,
            f"{prefix}{names[0]}.y": y,
            f"{prefix}{names[1]}.z": half[0],
            f"{prefix}{names[1]}.w": half[1],
        }
        if "Covariance" in kind:
            values["pose.covariance"] = diagonal(6, 0.0001)
        stamp = 0 if kind.endswith("/Pose") else s
        messages.append(Message("/ground_truth", kind, stamp, values, received=s + 500))
    drive = read_bag(write_bag(tmp_path / "run.bag", messages)).drive
    assert drive.truth is not None
    expected = [ARC.pose(s) for s in ARC.stamps]
    np.testing.assert_allclose(drive.truth.trajectory.poses, expected, atol=1e-12)
    late = 500 if kind.endswith("/Pose") else 0
    assert drive.truth.trajectory.stamps_ns[0] == START + late
    assert any("has no stamps" in n for n in drive.notes) == bool(late)
    if "Covariance" in kind:
        assert drive.truth.sigma == pytest.approx((0.01, 0.01, 0.01))


def test_messages_of_other_topics_are_never_decoded(tmp_path: Path) -> None:
    noise = [
        Message("/chatter", "std_msgs/msg/String", 0, {"data": "x" * 100}, START + k)
        for k in range(20)
    ]
    path = write_bag(tmp_path / "run.bag", [*noise, *ARC.odometry()])
    with Bag(path) as bag:
        topics = bag.topics()
        assert topics["/chatter"].count == 20
        found = bag.read({"odometry": topics["/odom"]})
    assert list(found) == ["/odom"]
    assert len(found["/odom"]) == 81
    assert bag.cut_off is None


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("part", [0.0, 0.05, 0.5, 0.9])
def test_a_bag_that_was_cut_off_is_one_line_or_what_could_be_read(
    tmp_path: Path, name: str, part: float
) -> None:
    written = write_bag(tmp_path / name, everything())
    file = written if written.is_file() else next(written.glob(f"*{Path(name).suffix}"))
    data = file.read_bytes()
    cut = tmp_path / f"cut{file.suffix}"
    cut.write_bytes(data[: int(part * len(data))])
    found = attempt(cut)
    if isinstance(found, str):
        assert "\n" not in found
        assert found.startswith(f"{cut}: ")
        assert "cut off" in found or "empty" in found
    else:
        assert found.rejected["bag cut off or damaged"] == 1
        assert any("cut off" in n for n in found.notes)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.bag", b"#ROSBAG V2.0\nand then nothing of the kind"),
        ("a.db3", b"SQLite format 3\0 and then nothing of the kind"),
        ("a.mcap", b"\x89MCAP0\r\n and then nothing of the kind"),
        ("a.bag", b"\0" * 10_000),
    ],
)
def test_garbage_is_one_line(tmp_path: Path, name: str, content: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(FglocError, match="cannot be read") as error:
        load_drive(str(path))
    assert "\n" not in str(error.value)


def test_bytes_that_were_changed_are_never_a_traceback(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    for name in FORMATS:
        place = tmp_path / name.partition(".")[2]
        place.mkdir()
        written = write_bag(place / name, everything())
        file = written if written.is_file() else next(written.glob(f"*{Path(name).suffix}"))
        data = np.frombuffer(file.read_bytes(), np.uint8)
        for k in range(6):
            damaged = data.copy()
            at = rng.integers(0, data.size, 1 + 20 * (k % 3))
            damaged[at] = rng.integers(0, 256, at.size)
            path = tmp_path / f"damaged{file.suffix}"
            path.write_bytes(damaged.tobytes())
            found = attempt(path)
            assert isinstance(found, Drive) or "\n" not in found


def test_a_folder_without_its_file_is_one_line(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "run.db3", ARC.odometry())
    next(folder.glob("*.db3")).unlink()
    with pytest.raises(FglocError, match="missing"):
        load_drive(str(folder))
    with pytest.raises(FglocError, match="no such file"):
        load_drive(str(tmp_path / "none.bag"))
    (tmp_path / "many").mkdir()
    for name in ("a.bag", "b.bag"):
        write_bag(tmp_path / "many" / name, ARC.odometry())
    with pytest.raises(FglocError, match="holds 2 bags"):
        load_drive(str(tmp_path / "many"))
    renamed = tmp_path / "run.dat"
    renamed.write_bytes((tmp_path / "many" / "a.bag").read_bytes())
    with pytest.raises(FglocError, match=r"let its name end in \.bag"):
        load_drive(str(renamed))


def test_a_bag_in_which_nothing_moves(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "run.bag", [imu(START + k, (0, 0, 1)) for k in range(3)])
    with pytest.raises(FglocError, match=r"nothing here tells how the robot moved.*/imu"):
        load_drive(str(path))
    empty = write_bag(tmp_path / "empty.bag", [])
    with pytest.raises(FglocError, match="holds no messages"):
        load_drive(str(empty))
    one = write_bag(tmp_path / "one.bag", ARC.odometry()[:1])
    with pytest.raises(FglocError, match="how the robot moved"):
        load_drive(str(one))


def test_without_rosbags_one_line_says_what_to_install(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "run.bag", ARC.odometry())
    script = (
        "import sys\n"
        "class Refuse:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name.partition('.')[0] == 'rosbags': raise ImportError('refused')\n"
        "sys.meta_path.insert(0, Refuse())\n"
        "from fgloc.cli import main\n"
        f"sys.exit(main(['datasets', 'info', {str(path)!r}]))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.startswith("fgloc: error: ")
    assert "pip install 'fgloc[bags]'" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_twists_with_a_stamp_are_integrated(tmp_path: Path) -> None:
    kind = "geometry_msgs/msg/TwistStamped"
    twists = [
        Message("/twist", kind, START + k * SECOND, prefixed("twist", {"linear.x": float(k)}))
        for k in range(4)
    ]
    drive = read_bag(write_bag(tmp_path / "run.bag", twists)).drive
    # Trapezoids of 0, 1, 2, 3 m/s a second apart.
    assert drive.wheels.angles.tolist() == [[0.5, 0, 0], [1.5, 0, 0], [2.5, 0, 0]]
