"""MATLAB files of the Penn robot: made here, damaged here, and as published."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from fgloc.core.measurements import Acceleration, YawRate
from fgloc.datasets import penn_skidsteer
from fgloc.datasets.registry import list_drives, load_drive
from fgloc.errors import FglocError

T0 = 1298445270.0
COUNTS = np.array([[0, 3, 0, 36], [0, 1, 0, 36], [0, 3, 0, 36], [0, 1, 0, -36]], np.int16)
VALUES = np.arange(18.0).reshape(6, 3) / 10.0


def write(tmp_path: Path, encoders: Any = None, imu: Any = None) -> Path:
    """Write run 7 and return its folder."""
    stamps = T0 + 0.025 * np.arange(COUNTS.shape[1])
    record = {"Encoders": {"counts": COUNTS, "ts": stamps[None]}} if encoders is None else encoders
    savemat(tmp_path / "Encoders7.mat", record)
    values = {"ts": T0 + 0.01 * np.arange(3.0)[None], "vals": VALUES} if imu is None else imu
    savemat(tmp_path / "imu7.mat", values)
    return tmp_path


def encoders(counts: Any, stamps: Any) -> dict[str, Any]:
    return {"Encoders": {"counts": counts, "ts": stamps}}


def load(folder: Path) -> Any:
    return penn_skidsteer.load(folder, "7", "x")


def test_counts_and_imu(tmp_path: Path) -> None:
    folder = write(tmp_path)
    assert penn_skidsteer.runs(folder) == ["7"]
    drive = load(folder)
    # 360 counts a turn; columns fr, fl, rr, rl.
    expected = np.radians([[3, 1, 3, 1], [0, 0, 0, 0], [36, 36, 36, -36]])
    np.testing.assert_allclose(drive.wheels.angles, expected, atol=1e-12)
    assert drive.wheels.wheels == ("fr", "fl", "rr", "rl")
    # The first interval: the right side rolls 2° more on both axles: a turn to the left.
    moved = drive.robot.base.displacements(drive.wheels.angles)
    assert moved[0, 2] == pytest.approx(math.radians(2) * 0.127 / 0.3937)
    assert drive.wheels.stamps_ns[0] == round(T0) * 1_000_000_000
    (gyro,), (acc,) = drive.each(YawRate), drive.each(Acceleration)
    # Rows are accelerations x y z in g, then rates x y z; stamps 0.17 s late.
    np.testing.assert_allclose(gyro.rate, [1.5, 1.6, 1.7])
    np.testing.assert_allclose(acc.forward, [0, 0.980665, 1.96133])
    assert gyro.stamps_ns[0] - drive.wheels.stamps_ns[0] == pytest.approx(-170_000_000, abs=500)


def test_odd_samples_are_counted(tmp_path: Path) -> None:
    # A counter that wrapped; the wheels went on as in the interval after.
    counts = np.array([[0, 2, 32767, 4, 4, 4, 4]] * 4, np.float64)
    counts[0, 5] = np.nan
    stamps = T0 + 0.025 * np.array([0, 1, 2, 3, 3, 4, 5.0])
    drive = load(write(tmp_path, encoders(counts, stamps[None])))
    assert drive.rejected == {
        "repeated stamp": 1,
        "implausible encoder count": 1,
        "wheels not a number": 1,
    }
    np.testing.assert_allclose(drive.wheels.angles[:, 1], np.radians([2, 8, 8]), rtol=1e-4)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"Encodes": 1}, "the variable Encoders is missing, there is Encodes"),
        ({"Encoders": 1.0}, "Encoders: must be a struct with counts and ts"),
        ({"Encoders": {"ts": [1.0]}}, "Encoders: must be a struct with counts and ts"),
        (encoders(COUNTS[:3], np.arange(4.0)), "Encoders.counts: must have shape (4, 4)"),
        (encoders("rubbish", np.arange(4.0)), "Encoders.counts: must hold numbers"),
        (encoders(COUNTS[:, :1], [1.0]), "fewer than two usable samples"),
    ],
)
def test_faulty_encoders_name_file_and_variable(
    tmp_path: Path, bad: dict[str, Any], message: str
) -> None:
    with pytest.raises(FglocError) as error:
        load(write(tmp_path, bad))
    assert "Encoders7.mat: " in str(error.value)
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"vals": VALUES}, "the variable ts is missing"),
        ({"ts": np.arange(4.0), "vals": VALUES}, "vals: must have shape (6, 4)"),
        ({"ts": np.zeros(3), "vals": VALUES}, "ts: fewer than two usable samples"),
    ],
)
def test_a_faulty_imu_names_file_and_variable(
    tmp_path: Path, bad: dict[str, Any], message: str
) -> None:
    with pytest.raises(FglocError) as error:
        load(write(tmp_path, None, bad))
    assert "imu7.mat: " in str(error.value)
    assert message in str(error.value)


@pytest.mark.parametrize("damage", [lambda d: d[: len(d) // 2], lambda d: b"no mat", lambda d: b""])
def test_damaged_files(tmp_path: Path, damage: Any) -> None:
    file = write(tmp_path) / "imu7.mat"
    file.write_bytes(damage(file.read_bytes()))
    with pytest.raises(FglocError, match=r"imu7.mat: cannot be read as a MATLAB 5 file"):
        load(tmp_path)


def test_the_published_runs(data_dir: Path) -> None:
    if not (data_dir / penn_skidsteer.NAME).is_dir():
        pytest.skip("penn-skidsteer is not here; fgloc datasets fetch penn-skidsteer")
    assert list_drives(penn_skidsteer.NAME)[0] == "penn-skidsteer:20"
    drive = load_drive("penn-skidsteer:20")
    assert drive.rejected == {}
    # 43,606 counts of the front right wheel, by adding up the file.
    assert math.degrees(drive.wheels.angles[:, 0].sum()) == pytest.approx(43606, abs=1e-6)
    # The robot comes back as it left: wheels and gyro agree on the net turn, by their own scale.
    (gyro,) = drive.each(YawRate)
    turned = float(np.sum(0.5 * (gyro.rate[1:] + gyro.rate[:-1]) * np.diff(gyro.stamps_ns))) * 1e-9
    assert abs(turned) < 0.3
