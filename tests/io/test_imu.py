"""IMUs as they are mounted: on their side, upside down, without orientation, with bad numbers."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fgloc.core.measurements import Acceleration, Yaw, YawRate
from fgloc.io.bag_drive import BagDrive, read_bag
from fgloc.io.messages import rotated_axis, yaw_of
from fgloc.io.topics import ImuTable, TopicMap

from .bagfiles import SECOND, Arc, Message, diagonal, imu, write_bag

ARC = Arc()
UPRIGHT = Rotation.identity()
ON_ITS_SIDE = Rotation.from_euler("xyz", [90, 0, -90], degrees=True)
"""The Husky's IMU of robot_localization's first test: +90° about x, then -90° about z."""
UPSIDE_DOWN = Rotation.from_euler("x", 180, degrees=True)


def mounted(mounting: Rotation, *, oriented: bool = True, **more: Any) -> list[Message]:
    """Return what an IMU in this mounting (sensor to robot) measures on the arc."""
    messages = []
    for s in ARC.stamps:
        heading = Rotation.from_euler("z", ARC.pose(s)[2])
        rate = mounting.inv().apply([0.0, 0.0, 0.25])
        # Forward nothing but a little vibration, to the left v·w, and gravity.
        shake = 0.1 * math.sin(0.7 * (s - ARC.start) / SECOND * 10)
        acceleration = mounting.inv().apply([shake, 0.125, 9.81])
        q = (heading * mounting).as_quat() if oriented else np.zeros(4)
        messages.append(imu(s, tuple(rate), tuple(acceleration), tuple(q), **more))
    return messages


def read(tmp_path: Path, messages: list[Message], table: ImuTable | None = None) -> BagDrive:
    path = write_bag(tmp_path / "run.bag", [*ARC.odometry(), *messages])
    return read_bag(path, given=TopicMap(imu=table))


def headings() -> np.ndarray[Any, Any]:
    """Return what the robot turned since the first stamp."""
    return np.array([ARC.pose(s)[2] for s in ARC.stamps])


def test_yaw_of_any_quaternion_is_that_of_its_rotated_x_axis() -> None:
    rng = np.random.default_rng(0)
    q = rng.normal(size=(200, 4))
    yaw, length = yaw_of(q)
    turned = Rotation.from_quat(q).apply([1.0, 0.0, 0.0])
    np.testing.assert_allclose(yaw, np.arctan2(turned[:, 1], turned[:, 0]), atol=1e-12)
    np.testing.assert_allclose(length, np.linalg.norm(q, axis=1))
    axis = np.array([0.0, 0.0, -1.0])
    ours = rotated_axis(q, axis) / length[:, None] ** 2
    np.testing.assert_allclose(ours, Rotation.from_quat(q).apply(axis), atol=1e-12)


def test_an_imu_on_its_side_is_read_about_the_axis_of_gravity(tmp_path: Path) -> None:
    drive = read(tmp_path, mounted(ON_ITS_SIDE)).drive
    np.testing.assert_allclose(drive.each(YawRate)[0].rate, 0.25, atol=1e-12)
    yaw = drive.each(Yaw)[0].yaw
    np.testing.assert_allclose(yaw - yaw[0], headings(), atol=1e-9)
    assert not drive.each(Acceleration)
    assert any("Gravity lies along +y" in n for n in drive.notes)
    assert any("imu.forward" in n for n in drive.notes)
    # The publishers' mounting: y up and z to the back.
    path = tmp_path / "given"
    path.mkdir()
    drive = read(path, mounted(ON_ITS_SIDE), ImuTable(axis="+y", forward="-z")).drive
    shake = [0.1 * math.sin(0.7 * (s - ARC.start) / SECOND * 10) for s in ARC.stamps]
    np.testing.assert_allclose(drive.each(Acceleration)[0].forward, shake, atol=1e-9)
    assert not any("Gravity" in n for n in drive.notes)


def test_an_imu_upside_down_is_reported_and_not_flipped(tmp_path: Path) -> None:
    found = read(tmp_path, mounted(UPSIDE_DOWN))
    np.testing.assert_allclose(found.drive.each(YawRate)[0].rate, -0.25, atol=1e-12)
    assert found.topics.imu is not None
    assert found.topics.imu.axis == "+z"
    assert any("mounted upside down" in n and 'axis = "-z"' in n for n in found.drive.notes)
    path = tmp_path / "given"
    path.mkdir()
    drive = read(path, mounted(UPSIDE_DOWN), ImuTable(axis="-z")).drive
    np.testing.assert_allclose(drive.each(YawRate)[0].rate, 0.25, atol=1e-12)
    # The orientation knows of the mounting: its heading was right all along.
    yaw = drive.each(Yaw)[0].yaw
    np.testing.assert_allclose(yaw - yaw[0], headings(), atol=1e-9)
    assert not any("upside down" in n for n in drive.notes)


def weaving() -> Arc:
    """Return a drive on which a correlation of rates can be told."""
    return Arc(seconds=30.0)


@pytest.mark.parametrize(("sign", "told"), [(1.0, False), (-1.0, True)])
def test_a_rate_that_turns_against_the_wheels_is_reported(
    tmp_path: Path, sign: float, told: bool
) -> None:
    arc = weaving()
    odometry, messages = [], []
    for k, s in enumerate(arc.stamps):
        theta = math.sin(0.2 * k)
        from .bagfiles import odometry as make

        odometry.append(make(s, (0.05 * k, 0.0, theta)))
        rate = 2.0 * math.cos(0.2 * k)
        messages.append(imu(s, (0.0, 0.0, sign * rate)))
    path = write_bag(tmp_path / "run.bag", [*odometry, *messages])
    drive = read_bag(path).drive
    np.testing.assert_allclose(drive.each(YawRate)[0].rate[0], sign * 2.0)
    assert any("turns against the wheels" in n for n in drive.notes) == told
    if told:
        turned = read_bag(path, given=TopicMap(imu=ImuTable(axis="-z"))).drive
        assert not any("against" in n for n in turned.notes)


def test_a_world_that_looks_down_turns_the_heading(tmp_path: Path) -> None:
    ned = [
        imu(s, (0.0, 0.0, 0.25), orientation=tuple(Rotation.from_euler("z", -h).as_quat()))
        for s, h in zip(ARC.stamps, headings(), strict=True)
    ]
    drive = read(tmp_path, ned, ImuTable(world="ned")).drive
    np.testing.assert_allclose(drive.each(Yaw)[0].yaw, headings(), atol=1e-9)


def test_an_unknown_orientation_gives_no_heading(tmp_path: Path) -> None:
    unknown = mounted(UPRIGHT, orientation_covariance=[-1.0, *[0.0] * 8])
    drive = read(tmp_path, unknown).drive
    assert not drive.each(Yaw)
    assert len(drive.each(YawRate)) == 1
    unmeasured = mounted(
        UPRIGHT,
        angular_velocity_covariance=[-1.0, *[0.0] * 8],
        linear_acceleration_covariance=[-1.0, *[0.0] * 8],
    )
    path = tmp_path / "unmeasured"
    path.mkdir()
    assert [type(s) for s in read(path, unmeasured).drive.sensors] == [Yaw]
    for name, q in (("none", (0.0, 0.0, 0.0, 0.0)), ("identity", (0.0, 0.0, 0.0, 1.0))):
        path = tmp_path / name
        path.mkdir()
        blank = [imu(s, (0.0, 0.0, 0.25), orientation=q) for s in ARC.stamps]
        assert not read(path, blank).drive.each(Yaw)


def test_what_is_zero_throughout_is_not_there(tmp_path: Path) -> None:
    zeros = [imu(s, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)) for s in ARC.stamps]
    drive = read(tmp_path, zeros, ImuTable(use=("rate",))).drive
    assert drive.sensors == ()
    assert any("has no rate, which the topic map asks for" in n for n in drive.notes)


@pytest.mark.parametrize(
    ("variance", "sigma"),
    [(0.0, 0.02), (-1.0, 0.02), (100.0, 0.02), (float("nan"), 0.02), (0.0025, 0.05)],
)
def test_noise_is_the_median_of_sensible_covariances(
    tmp_path: Path, variance: float, sigma: float
) -> None:
    covariance = diagonal(3, 0.5, 0.5, variance)
    messages = mounted(UPRIGHT, orientation_covariance=covariance)
    drive = read(tmp_path, messages).drive
    assert drive.each(Yaw)[0].sigma == pytest.approx(sigma)
    told = "the median of its covariance" if variance == 0.0025 else "what is usual"
    assert any(f"heading: {sigma:.2g} rad, {told}" in n for n in drive.notes)


def test_bad_numbers_and_quaternions(tmp_path: Path) -> None:
    messages = mounted(UPRIGHT)
    messages[3] = imu(ARC.stamps[3], (0.0, 0.0, float("nan")))
    messages[4] = imu(ARC.stamps[4], (0.0, 0.0, 0.25), orientation=(0.0, 0.0, 0.0, 0.0))
    messages[5] = imu(
        ARC.stamps[5], (0.0, 0.0, 0.25), (float("inf"), 0.0, 9.81), orientation=(0, 0, 0, 1)
    )
    drive = read(tmp_path, messages).drive
    assert drive.rejected == {
        "imu not a number": 1,
        "imu without orientation": 1,
        "imu acceleration not a number": 1,
    }
    assert drive.each(YawRate)[0].rate.size == 80
    assert drive.each(Yaw)[0].yaw.size == 79


def test_the_imu_of_a_camera_comes_second(tmp_path: Path) -> None:
    own = mounted(UPRIGHT)[::2]
    other = [imu(s, (0.25, 0.0, 0.0), topic="/camera/imu") for s in ARC.stamps]
    found = read(tmp_path, [*own, *other])
    assert found.topics.imu is not None
    assert found.topics.imu.topic == "/imu"
    assert any("Left out: /camera/imu" in n and "the imu is /imu" in n for n in found.drive.notes)
