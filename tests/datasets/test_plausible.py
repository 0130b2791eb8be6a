"""Units that are wrong by a known factor are named; drives that are right pass."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgloc.core import bases
from fgloc.core.drive import Drive, Reference
from fgloc.core.measurements import PositionFixes, WheelIncrements, Yaw, YawRate
from fgloc.core.robot import Robot
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.plausible import check_plausible
from fgloc.datasets.registry import load_drive
from fgloc.errors import FglocError

T = np.arange(0, 60_000_000_000, 100_000_000, dtype=np.int64)
"""One minute at 10 Hz."""


def drive(angle: float = 0.5, turn: float = 0.05, radius: float = 0.1) -> Drive:
    """Return a slow bend (0.5 m/s, 0.2 rad/s) with yaw, gyro, fixes and truth to match."""
    base = bases.differential(radius, radius, 0.5)
    angles = np.tile([angle - turn, angle + turn], (T.size - 1, 1))
    step = base.displacements(np.tile([0.45, 0.55], (T.size - 1, 1)) * 0.1 / radius)
    heading = np.append(0.0, np.cumsum(step[:, 2]))
    ahead = step[:, :1] * np.stack([np.cos(heading[1:]), np.sin(heading[1:])], axis=1)
    places = np.vstack([[0.0, 0.0], np.cumsum(ahead, axis=0)])
    every = slice(0, None, 50)
    return Drive(
        "bend",
        Robot("test", base),
        WheelIncrements("wheels", T, angles, base.driven_names),
        (
            Yaw("yaw", T, heading, 0.02),
            YawRate("gyro", T, np.full(T.size, 0.2), 0.01),
            PositionFixes("gps", T[every], places[every], np.full((T[every].size, 2), 0.01)),
        ),
        truth=Reference(Trajectory(T, np.column_stack([places, heading]))),
    )


def with_sensor(name: str, **changes: object) -> Drive:
    """Return the drive with one sensor changed."""
    good = drive()
    sensors = tuple(replace(s, **changes) if s.sensor == name else s for s in good.sensors)  # type: ignore[arg-type]
    return replace(good, sensors=sensors)


def test_matching_measurements_pass() -> None:
    check_plausible(drive())


@pytest.mark.parametrize(
    ("wrong", "stream", "unit"),
    [
        (drive(radius=100.0), "wheel_radius.left", "millimetres"),
        (drive(angle=250.0, turn=20.0), "wheels", "counts"),
        (with_sensor("yaw", yaw=np.degrees(drive().sensors[0].yaw) % 360.0), "yaw", "degrees"),  # type: ignore[union-attr]
        (with_sensor("gyro", rate=np.full(T.size, 0.2 * 57.3)), "gyro", "degrees"),
        (with_sensor("gps", positions=1e3 * drive().sensors[2].positions), "gps", "span"),  # type: ignore[union-attr]
        (with_sensor("gps", positions=9e-6 * drive().sensors[2].positions), "gps", "latitude"),  # type: ignore[union-attr]
    ],
    ids=["radius in mm", "ticks", "yaw in deg", "gyro in deg/s", "fixes in mm", "fixes in deg"],
)
def test_wrong_unit_is_named(wrong: Drive, stream: str, unit: str) -> None:
    with pytest.raises(FglocError, match=f"bend: .*{stream}.*{unit}"):
        check_plausible(wrong)


def test_truth_in_degrees_is_named() -> None:
    good = drive()
    assert good.truth is not None
    poses = good.truth.trajectory.poses * [1.0, 1.0, 57.3]
    with pytest.raises(FglocError, match=r"truth: the heading turns by .* degrees"):
        check_plausible(replace(good, truth=Reference(Trajectory(T, poses))))


@pytest.mark.parametrize("factor", [1e-9, 1e-3], ids=["seconds", "microseconds"])
def test_stamps_not_in_nanoseconds_are_named(factor: float) -> None:
    good = drive()
    stamps = np.arange(T.size, dtype=np.int64) * max(int(1e8 * factor), 1)
    wheels = replace(good.wheels, stamps_ns=stamps)
    with pytest.raises(FglocError, match="write whole nanoseconds"):
        check_plausible(replace(good, wheels=wheels, sensors=(), truth=None))


def test_a_clock_that_is_set_during_the_drive_is_named() -> None:
    # A computer without a battery clock boots in 1970 and hears of the present later.
    good = drive()
    now = np.where(T[300] < T, T + 1_700_000_000_000_000_000, T)
    leapt = replace(good, wheels=replace(good.wheels, stamps_ns=now))
    with pytest.raises(FglocError, match=r"leap by 1\.7e\+09 s after increment 300"):
        check_plausible(leapt)
    # Other streams may have early readings; the drive's time is that of its wheels.
    (yaw,) = good.each(Yaw)
    early = replace(yaw, stamps_ns=np.where(T[2] > T, T - 1_700_000_000_000_000_000, T))
    check_plausible(replace(good, sensors=(early,)))


def test_a_counter_that_overflows_is_named() -> None:
    good = drive()
    angles = good.wheels.angles.copy()
    angles[17, 1] = -(2.0**32) * 2 * np.pi / 4096
    with pytest.raises(FglocError, match=r"increment 17 turns a wheel by .* overflow"):
        check_plausible(replace(good, wheels=replace(good.wheels, angles=angles)))


def test_wheels_that_cannot_tell_the_motion_are_named_with_the_drive() -> None:
    good = drive()
    base = bases.differential(0.1, 0.1, 1e-200)
    with pytest.raises(FglocError, match=r"bend: .*do not determine"):
        check_plausible(replace(good, robot=Robot("test", base)))


def test_standing_robot_with_noise_passes() -> None:
    """Ten minutes on the spot: gyro noise and drift, and a truth that trembles, are no motion."""
    rng = np.random.default_rng(1)
    t = np.arange(0, 600_000_000_000, 20_000_000, dtype=np.int64)
    base = bases.differential(0.1, 0.1, 0.5)
    still = np.zeros((t.size - 1, 2))
    poses = rng.normal(0.0, 0.005, (t.size, 3))
    gyro = YawRate("gyro", t, 0.01 + rng.normal(0.0, 0.07, t.size), 0.01)
    check_plausible(
        Drive(
            "still",
            Robot("test", base),
            WheelIncrements("wheels", t, still, base.driven_names),
            (gyro,),
            truth=Reference(Trajectory(t, poses)),
        )
    )


def test_one_strange_reading_in_a_tenth_of_a_second_passes() -> None:
    """0.7 rad between two readings 20 ms apart is 35 rad/s, and says nothing about units."""
    t = np.array([0, 20_000_000, 40_000_000], dtype=np.int64)
    base = bases.differential(0.1, 0.1, 0.5)
    wheels = WheelIncrements("wheels", t, np.full((2, 2), 0.01), base.driven_names)
    yaw = Yaw("yaw", t, np.array([0.0, 0.7, 0.7]), 0.02)
    check_plausible(Drive("short", Robot("test", base), wheels, (yaw,)))


def test_reading_a_file_checks_it(tmp_path: Path) -> None:
    rows = [f"wheels,{100_000_000 * k},0.1,0.1" for k in range(1, 30)]
    head = '{"robot": {"kind": "differential", "radius_left": 84, "radius_right": 84, "track": 9}}'
    file = tmp_path / "mm.csv"
    file.write_text("\n".join(["# fgloc-drive 1", f"# {head}", "wheels,0", *rows, ""]))
    with pytest.raises(FglocError, match=r"mm\.csv: the robot's wheel_radius\.left is 84"):
        load_drive(str(file))


def test_recorded_drives_pass(data_dir: Path) -> None:
    for run in ("vitko-swerve:1", "vitko-swerve:21", "jackal-jackass:0"):
        load_drive(run, data_dir)  # 21 turns on the spot, the Jackal's yaw is wrong by radians
