"""The Husky's two logs without a common clock: by hand, and as published."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fgloc.core.measurements import Acceleration, Floats, YawRate
from fgloc.datasets import borealtc_husky
from fgloc.datasets.clock_alignment import align
from fgloc.datasets.registry import list_drives, load_drive
from fgloc.errors import FglocError
from fgloc.smoothing.keyframes import turned_angle

WHEELS = ["time,curL,curR,velL,velR", "0.0,1,2,0.2,0.4", "0.5,1,2,0.4,0.4", "1.0,1,2,0.0,0.2"]
IMU = ["time,wx,wy,wz,ax,ay,az", "0.0,1,2,0.1,0.3,5,9.8", "0.5,1,2,0.2,0.4,5,9.8"]
IMU += ["1.0,1,2,0.1,0.3,5,9.8"]


def write(tmp_path: Path, wheels: list[str], imu: list[str]) -> Path:
    """Write the run ICE/07 and return its folder."""
    folder = tmp_path / "ICE"
    folder.mkdir(exist_ok=True)
    (folder / "pro_07.csv").write_text("".join(f"{line}\n" for line in wheels))
    (folder / "imu_07.csv").write_text("".join(f"{line}\n" for line in imu))
    return tmp_path


def test_speeds_are_integrated(tmp_path: Path) -> None:
    folder = write(tmp_path, WHEELS, IMU)
    assert borealtc_husky.runs(folder) == ["ICE/07"]
    drive = borealtc_husky.load(folder, "ICE/07", "x")
    # Trapezoids over half a second: 0.3·0.5 m left, 0.4·0.5 m right.
    np.testing.assert_allclose(drive.wheels.angles * 0.1651, [[0.15, 0.2], [0.1, 0.15]], atol=1e-12)
    (gyro,), (acc,) = drive.each(YawRate), drive.each(Acceleration)
    assert gyro.rate.tolist() == [0.1, 0.2, 0.1]
    assert acc.forward.tolist() == [0.3, 0.4, 0.3]
    assert drive.motion == "ICE"


def test_the_files_of_a_run_last_equally_long(tmp_path: Path) -> None:
    slow = [IMU[0], IMU[1], IMU[2], IMU[3].replace("1.0,", "1.02,", 1)]
    drive = borealtc_husky.load(write(tmp_path, WHEELS, slow), "ICE/07", "x")
    assert drive.wheels.stamps_ns.tolist() == [0, 510_000_000, 1_020_000_000]
    # A file that was cut off does not stretch the other.
    half = [*IMU[:3], IMU[3].replace("1.0,", "0.8,", 1)]
    drive = borealtc_husky.load(write(tmp_path, WHEELS, half), "ICE/07", "x")
    assert drive.wheels.stamps_ns[-1] == 1_000_000_000


def test_bad_rows_are_counted(tmp_path: Path) -> None:
    wheels = [*WHEELS, "1.0,1,2,0.1,0.1", "0.9,1,2,0.1,0.1", "1.2,1,2,nan,0.1"]
    drive = borealtc_husky.load(write(tmp_path, wheels, [*IMU, "1.1,1,2,inf,1,1,1"]), "ICE/07", "x")
    assert drive.rejected == {
        "wheels not a number": 1,
        "imu not a number": 1,
        "wheels repeated stamp": 1,
        "wheels time goes back": 1,
    }
    assert drive.wheels.angles.shape == (2, 2)


@pytest.mark.parametrize(
    ("wheels", "imu", "message"),
    [
        ([*WHEELS[:2], "0.5,1,x,1,1", WHEELS[3]], IMU, "pro_07.csv:3: 'x' is not a number"),
        (WHEELS, [*IMU[:2], "0.5,1", IMU[3]], "imu_07.csv:3: 2 fields where 7 are expected"),
        ([WHEELS[0].replace("velR", "vr"), *WHEELS[1:]], IMU, "pro_07.csv:1: the header has no"),
        (WHEELS[:2], IMU, "pro_07.csv: fewer than two usable lines"),
    ],
)
def test_faults_name_file_and_line(
    tmp_path: Path, wheels: list[str], imu: list[str], message: str
) -> None:
    with pytest.raises(FglocError) as error:
        borealtc_husky.load(write(tmp_path, wheels, imu), "ICE/07", "x")
    assert message in str(error.value)


def test_wheels_that_began_first(tmp_path: Path) -> None:
    # The wheels' log began 1.2 s before the gyro's, which a correlation tells.
    own, gyro = np.arange(0.0, 60.0, 0.154), np.arange(0.0, 60.0, 0.01)
    rows = [f"{t},0,0,0.2,{0.2 + 0.8 * curves(t - 1.2)}" for t in own]
    turns = [f"{t},0,0,{curves(t)},0,0,9.8" for t in gyro]
    folder = write(tmp_path, [WHEELS[0], *rows], [IMU[0], *turns])
    drive = borealtc_husky.load(folder, "ICE/07", "x")
    assert drive.wheels.stamps_ns[0] == 0
    begin = drive.each(YawRate)[0].stamps_ns[0]
    assert begin * 1e-9 == pytest.approx(1.2, abs=0.06)
    assert "as the turns fit best: t = -1.2" in drive.notes[0]


def curves(t: Floats) -> Floats:
    """Return a yaw rate [rad/s] that does not repeat itself."""
    return 0.3 * np.sin(0.7 * t) + 0.2 * np.sin(1.9 * t + 1.0) + 0.1 * np.sin(0.23 * t * t / 10.0)


@pytest.mark.parametrize(("offset", "rate"), [(0.0, 1.0), (0.73, 1.012), (-1.6, 0.984)])
def test_clocks_are_found(offset: float, rate: float) -> None:
    rng = np.random.default_rng(1)
    gyro_s = np.arange(0.0, 90.0, 0.01)
    gyro = curves(gyro_s) + 0.02 * rng.normal(size=gyro_s.size)
    own = np.arange(0.0, 88.0, 0.154)
    # Wheels say half of the turn and are off by a constant; only the likeness counts.
    turn = 0.5 * curves(offset + rate * own) + 0.1 + 0.02 * rng.normal(size=own.size)
    found = align(own, turn, gyro_s, gyro, 1.0)
    at = np.array([0.0, 88.0])
    np.testing.assert_allclose(
        found.offset_s + found.rate * at, offset + rate * at, rtol=0, atol=0.05
    )


def test_a_straight_drive_tells_nothing_of_clocks() -> None:
    rng = np.random.default_rng(1)
    gyro_s, own = np.arange(0.0, 60.0, 0.01), np.arange(0.0, 60.0, 0.154)
    found = align(own, 0.01 * rng.normal(size=own.size), gyro_s, np.zeros(gyro_s.size), 0.99)
    assert (found.offset_s, found.rate, found.moved) == (0.0, 0.99, False)
    # Nor do wheels and gyro that have nothing to do with each other.
    found = align(own, rng.normal(size=own.size), gyro_s, curves(gyro_s), 0.99)
    assert (found.offset_s, found.rate, found.moved) == (0.0, 0.99, False)


@pytest.mark.parametrize(
    ("run", "low", "high"),
    # By regression of either on the other, on what wheels of 0.1651 m turned within a second;
    # the speeds are m/s: as rad/s they would make it 0.14 m.
    [("FLOORING/01", 0.78, 0.88), ("ICE/02", 0.78, 0.88), ("ASPHALT/00", 0.78, 0.88)],
)
def test_the_recorded_effective_track(data_dir: Path, run: str, low: float, high: float) -> None:
    if f"{borealtc_husky.NAME}:{run}" not in _there(data_dir):
        pytest.skip("borealtc-husky is not here; fgloc datasets fetch borealtc-husky")
    drive = load_drive(f"{borealtc_husky.NAME}:{run}")
    (gyro,) = drive.each(YawRate)
    stamps = drive.wheels.stamps_ns[::7]
    turned, known = turned_angle(gyro, stamps)
    rim = np.vstack([np.zeros(2), np.cumsum(drive.wheels.angles, axis=0)])[::7] * 0.1651
    difference = np.diff(rim[:, 1] - rim[:, 0])
    a, b = difference[known] - difference[known].mean(), turned[known] - turned[known].mean()
    correlation = float(a @ b) / math.sqrt(float(a @ a) * float(b @ b))
    assert correlation > 0.97
    assert low < float(a @ b) / float(b @ b) < float(a @ a) / float(a @ b) < high


def _there(data_dir: Path) -> list[str]:
    return list_drives(borealtc_husky.NAME) if (data_dir / borealtc_husky.NAME).is_dir() else []
