"""The swerve recordings against the total error published with them."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from fgloc.core import geometry
from fgloc.core.drive import Drive
from fgloc.datasets import vitko_swerve
from fgloc.datasets.registry import expand, load_drive
from fgloc.errors import FglocError

JOINTS = ["BL_Position", "BL_Wheel", "BR_Position", "BR_Wheel"]
JOINTS += ["FL_Position", "FL_Wheel", "FR_Position", "FR_Wheel"]


def e_max(drive: Drive) -> np.ndarray:
    """Return the largest absolute error of x, y, heading by the nominal wheels, Euler steps."""
    assert drive.truth is not None
    moved = drive.robot.base.displacements(drive.wheels.angles, drive.wheels.steering)
    truth = drive.truth.trajectory
    assert np.array_equal(truth.stamps_ns, drive.wheels.stamps_ns)
    poses = geometry.integrate(moved, truth.poses[0], geometry.EULER)
    largest: np.ndarray = np.abs(poses - truth.poses).max(axis=0)
    return largest


def test_the_published_total_of_nominal_parameters(data_dir: Path) -> None:
    drives = [load_drive(i, data_dir) for i in expand(["vitko-swerve:all"], data_dir)]
    if len(drives) < 18:
        pytest.skip("repetitions 1-3 of all motions are needed")
    total = np.zeros(3)
    for motion in vitko_swerve.MOTIONS:
        runs = [
            e_max(d)
            for d in drives
            if d.motion == motion and (int(d.name.split(":")[1]) - 1) % 5 < 3
        ]
        assert len(runs) == 3
        total += np.mean(runs, axis=0)
    assert total.sum() == pytest.approx(1.2607, abs=1e-3)


def write_run(folder: Path, names: list[str], odometry: list[str], truth: list[str]) -> None:
    """Write run 1 with lines of 'second; 8 positions; 8 velocities' and 'second; x'."""
    head = "time;.header.seq;.header.stamp.secs;.header.stamp.nsecs;.header.frame_id;"
    lines = [head + ".name;.position;.velocity;.effort"]
    for k, row in enumerate(odometry):
        second, position, velocity = row.split("|")
        lines.append(
            f"2024/05/03/12:34:{second};{k};0;0;;{names};({position});({velocity});({position})"
        )
    (folder / "odom_1.csv").write_text("\n".join(lines) + "\n")
    fields = [f".pose.position.{a}" for a in "xyz"] + [f".pose.orientation.{a}" for a in "xyzw"]
    lines = [head + ";".join(fields)]
    # Quaternion of 90°: z = w = sqrt(1/2).
    half = 0.5**0.5
    for row in truth:
        second, x = row.split("|")
        lines.append(f"2024/05/03/12:34:{second};0;0;0;world;{x};0;0;0;0;{half};{half}")
    (folder / "abs_1.csv").write_text("\n".join(lines) + "\n")


def table(position: float, velocity: float) -> str:
    """Return position (all joints) and velocity (joint k turns velocity + k)."""
    rates = ", ".join(str(velocity + k) for k in range(8))
    return f"{', '.join([str(position)] * 8)}|{rates}"


TRUTH = [f"{10 + 0.1 * k:09.6f}|{0.01 * k}" for k in range(33)]


def test_joints_are_found_by_name_and_rates_integrated(tmp_path: Path) -> None:
    write_run(tmp_path, JOINTS, [f"10.000000|{table(0, 1)}", f"20.000000|{table(1, 1)}"], TRUTH)
    drive = vitko_swerve.load(tmp_path, "1", "x")
    # Samples 0..28 are left out; 29..32 give three intervals of 0.1 s. Wheels 1-4 are FL BL BR FR
    # at joints 5, 1, 3, 7, so their rates are 6, 2, 4, 8 rad/s.
    np.testing.assert_allclose(drive.wheels.angles, np.full((3, 1), 0.1) * [6, 2, 4, 8])
    # Steering rises from 0 to 1 rad in 10 s and is 0.29 rad at the first kept sample.
    assert drive.wheels.steering is not None
    np.testing.assert_allclose(drive.wheels.steering[:, 0], [0.29, 0.30, 0.31])
    assert drive.truth is not None
    np.testing.assert_allclose(drive.truth.trajectory.poses[0], [0.29, 0.0, np.pi / 2])
    assert drive.motion == "line x"
    # Another order of joints in the file, same robot: same drive.
    turned = JOINTS[::-1]
    rates = ", ".join(str(1.0 + k) for k in range(8)[::-1])
    rows = [
        f"{s}|{', '.join([p] * 8)}|{rates}" for s, p in (("10.000000", "0"), ("20.000000", "1"))
    ]
    write_run(tmp_path, turned, rows, TRUTH)
    again = vitko_swerve.load(tmp_path, "1", "x")
    np.testing.assert_array_equal(again.wheels.angles, drive.wheels.angles)


def test_bad_samples_are_counted_once_each(tmp_path: Path) -> None:
    rows = [
        f"10.000000|{table(0, 1)}",
        f"11.000000|{table(0, float('nan'))}",
        f"12.000000|{table(0, 1)}",
        f"12.000000|{table(0, 5)}",
        f"11.500000|{table(0, 5)}",
        f"20.000000|{table(0, 1)}",
    ]
    write_run(tmp_path, JOINTS, rows, TRUTH)
    with (tmp_path / "odom_1.csv").open("a") as file:
        file.write("2024/05/03/12:34:21.0000")
    drive = vitko_swerve.load(tmp_path, "1", "x")
    assert drive.rejected == {
        "not a number": 1,
        "repeated stamp": 1,
        "time goes back": 1,
        "truncated line": 1,
    }
    # None of the rejected rates (5 rad/s and more) got in.
    np.testing.assert_allclose(drive.wheels.angles, np.full((3, 1), 0.1) * [6, 2, 4, 8])


@pytest.mark.parametrize(
    ("old", "new", "what", "line"),
    [
        ("2024/05/03/12:34:20.000000", "yesterday", "'yesterday' is not a time", 3),
        ("FL_Wheel", "FL_Motor", "lack a \\*_Wheel", 2),
        (".velocity", ".speed", "no column '.velocity'", 1),
        ("(1, 1,", "(1, one,", "'one' is not a number", 3),
        ("(1, 1,", "(1,", "7 fields where 8", 3),
    ],
)
def test_errors_name_file_and_line(
    tmp_path: Path, old: str, new: str, what: str, line: int
) -> None:
    write_run(tmp_path, JOINTS, [f"10.000000|{table(0, 1)}", f"20.000000|{table(1, 1)}"], TRUTH)
    file = tmp_path / "odom_1.csv"
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(FglocError, match=what) as error:
        vitko_swerve.load(tmp_path, "1", "x")
    assert (error.value.file, error.value.line) == (file, line)


def test_runs_need_both_files(tmp_path: Path) -> None:
    for name in ("odom_2.csv", "abs_2.csv", "odom_10.csv", "abs_10.csv", "odom_3.csv"):
        (tmp_path / name).touch()
    assert vitko_swerve.runs(tmp_path) == ["2", "10"]
    shutil.rmtree(tmp_path)
