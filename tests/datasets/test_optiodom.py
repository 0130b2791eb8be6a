"""The optiodom reader: by hand on small files, and against figures worked out independently."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fgloc.core import geometry
from fgloc.core.drive import Drive
from fgloc.datasets import optiodom
from fgloc.datasets.registry import expand, load_drive
from fgloc.errors import FglocError

METADATA = {
    "diff": "type,diff,\nngear,10,\nencRes,10,\nLi,0.2,\nDi,0.1,0.2\n",
    "omni3": "type,omni3,,\nngear,12,,\nencRes,1024,,\nLi,0.195,,\nDi,0.1,0.1,0.1\n",
    "omni4": "type,omni4\nngear,1\nencRes,1\nLi,0.2,0.2,,\nDi,0.06,0.06,0.06,0.06\n",
    "tricyc": "type,tricyc,\nngear,1,\nencRes,1600,\nLi,0.15,\nDi,0.065,\nThi,0,\n",
}


def make(tmp_path: Path, robot: str, rows: list[str], metadata: str | None = None) -> Path:
    """Write run circular/set/01 of a robot and return the run's file."""
    folder = tmp_path / "data" / robot / "circular" / "set"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "set_metadata.csv").write_text(metadata or METADATA[robot])
    file = folder / "set_run-01.csv"
    file.write_text("".join(f"{row}\n" for row in rows))
    return file


def load(tmp_path: Path, robot: str) -> Drive:
    return optiodom.load(tmp_path, f"{robot}/circular/set/01", "x")


def moved(drive: Drive) -> np.ndarray:
    return drive.robot.base.displacements(drive.wheels.angles, drive.wheels.steering)


def rmse(drive: Drive) -> float:
    """Return the position RMSE of the nominal wheels from the true start."""
    assert drive.truth is not None
    truth = drive.truth.trajectory.poses
    poses = geometry.integrate(moved(drive), truth[0], geometry.EXACT)
    return float(np.sqrt(((poses - truth)[:, :2] ** 2).sum(axis=1).mean()))


def test_diff_columns_are_right_then_left(tmp_path: Path) -> None:
    # 100 counts a turn; diameters right 0.1, left 0.2 m. 10 counts right = 0.01π m, none left:
    # forward 0.005π m, turn 0.01π/0.2 rad. The first row's 99 counts are no motion.
    make(tmp_path, "diff", ["0,0,0,0,99,99", "0.05,0,0,0,10,0", "0.1,0,0,0,0,10"])
    drive = load(tmp_path, "diff")
    expected = [[0.005 * math.pi, 0, 0.05 * math.pi], [0.01 * math.pi, 0, -0.1 * math.pi]]
    np.testing.assert_allclose(moved(drive), expected, atol=1e-15)
    assert drive.wheels.stamps_ns.tolist() == [0, 50_000_000, 100_000_000]
    assert drive.motion == "diff/circular"
    assert drive.wheels.resolution == pytest.approx(2 * math.pi / 100)


def test_omni3_published_matrix(tmp_path: Path) -> None:
    # Inverse kinematics of the published robot, wheel distances d in m: v_x = (-d1 + d2)/√3,
    # v_y = (-d1 - d2 + 2 d3)/3, turn = -(d1 + d2 + d3)/(3 L).
    rng = np.random.default_rng(1)
    counts = rng.integers(-500, 500, (6, 3))
    rows = [f"{0.04 * k},0,0,0,{a},{b},{c}" for k, (a, b, c) in enumerate(counts)]
    make(tmp_path, "omni3", rows)
    d = counts[1:] * (math.pi * 0.1 / (12 * 1024))
    expected = np.stack(
        [
            (d[:, 1] - d[:, 0]) / math.sqrt(3),
            (-d[:, 0] - d[:, 1] + 2 * d[:, 2]) / 3,
            -d.sum(axis=1) / (3 * 0.195),
        ],
        axis=1,
    )
    np.testing.assert_allclose(moved(load(tmp_path, "omni3")), expected, atol=1e-12)


def test_omni4_published_matrix(tmp_path: Path) -> None:
    # v_x = (d1 - d2 + d3 - d4)/4, v_y = (-d1 - d2 + d3 + d4)/4, turn = -Σd / (2 (L1 + L2)).
    turns = np.array([[0, 0, 0, 0], [0.01, 0.02, -0.03, 0.05], [0.02, 0.0, 0.01, -0.04]])
    rows = [f"{0.01 * k},0,0,0," + ",".join(map(str, r)) for k, r in enumerate(turns)]
    make(tmp_path, "omni4", rows)
    d1, d2, d3, d4 = (turns[1:] * math.pi * 0.06).T
    turn = -(d1 + d2 + d3 + d4) / 0.8
    expected = np.stack([(d1 - d2 + d3 - d4) / 4, (-d1 - d2 + d3 + d4) / 4, turn], axis=1)
    np.testing.assert_allclose(moved(load(tmp_path, "omni4")), expected, atol=1e-12)


def test_tricycle_uses_the_mean_steering_angle(tmp_path: Path) -> None:
    make(tmp_path, "tricyc", ["0,0,0,0,0,0.1", "0.05,0,0,0,16,0.3", "0.1,0,0,0,16,0.3"])
    d = math.pi * 0.065 / 100
    expected = [[d * math.cos(a), 0, d * math.sin(a) / 0.15] for a in (0.2, 0.3)]
    np.testing.assert_allclose(moved(load(tmp_path, "tricyc")), expected, atol=1e-15)


def test_the_truth_is_unwrapped_and_its_gaps_do_not_stop_the_wheels(tmp_path: Path) -> None:
    make(tmp_path, "diff", ["0,0,0,3.1,0,0", "0.05,nan,0,0,5,5", "0.1,1,0,-3.1,5,5"])
    drive = load(tmp_path, "diff")
    assert drive.truth is not None
    np.testing.assert_allclose(drive.truth.trajectory.poses[:, 2], [3.1, 2 * math.pi - 3.1])
    assert drive.wheels.angles.shape == (2, 2)
    assert drive.rejected == {"truth not a number": 1}


def test_bad_rows_are_counted(tmp_path: Path) -> None:
    rows = ["0,0,0,0,0,0", "1,0,0,0,10,10", "2,0,0,0,nan,10", "3,0,0,0,10,10", "3,0,0,0,7,7"]
    file = make(tmp_path, "diff", [*rows, "2.5,0,0,0,7,7", "4,0,0,0,10,10"])
    with file.open("a") as handle:
        handle.write("5,0,0,0,1")
    drive = load(tmp_path, "diff")
    assert drive.rejected == {
        "wheels not a number": 1,
        "repeated stamp": 1,
        "time goes back": 1,
        "truncated line": 1,
    }
    # The lost interval keeps its rate: 20 counts from second 1 to 3, out of 100 a turn.
    np.testing.assert_allclose(drive.wheels.angles[:, 0], 2 * math.pi * np.array([0.1, 0.2, 0.1]))


@pytest.mark.parametrize(
    ("metadata", "what"),
    [
        (METADATA["diff"].replace("Di,0.1,0.2", "Di,0.1"), "2 diameters"),
        (METADATA["diff"].replace("0.2,\n", "wide,\n"), "not numbers"),
        (METADATA["diff"].replace("encRes,10", "encRes,"), "encRes is missing"),
        (METADATA["diff"].replace("type,diff", "type,boat"), "'boat'"),
        (METADATA["omni3"], "the folder says diff"),
    ],
)
def test_wrong_metadata(tmp_path: Path, metadata: str, what: str) -> None:
    make(tmp_path, "diff", ["0,0,0,0,0,0", "1,0,0,0,1,1"], metadata)
    with pytest.raises(FglocError, match=what) as error:
        load(tmp_path, "diff")
    assert "set_metadata.csv" in str(error.value)


def test_a_wrong_line_is_named(tmp_path: Path) -> None:
    file = make(tmp_path, "diff", ["0,0,0,0,0,0", "1,0,0,zero,1,1", "2,0,0,0,1,1"])
    with pytest.raises(FglocError, match="'zero'") as error:
        load(tmp_path, "diff")
    assert (error.value.file, error.value.line) == (file, 2)


def test_nominal_errors_known_independently(data_dir: Path) -> None:
    # 122 mm and 28 mm are independent figures for these sets (in the second, of ten runs).
    free = load_drive("optiodom:diff/free/020120212354/01", data_dir)
    assert rmse(free) == pytest.approx(0.122, abs=0.0015)
    ids = expand(["optiodom:diff/circular/250620202251/*"], data_dir)
    assert np.mean([rmse(load_drive(i, data_dir)) for i in ids]) == pytest.approx(0.028, abs=0.002)


@pytest.mark.parametrize(
    ("drive_id", "fit", "most"),
    [
        ("omni3/circular/221220201643/01", (0.05, 0.049, 0.0495, 0.1916), 0.5),
        ("omni4/circular/080920201911/01", (0.0315, 0.0315, 0.0315, 0.0315, 0.2), 0.9),
        ("tricyc/circular/140120211415/02", (0.032, 0.158, -0.02), 0.3),
    ],
)
def test_the_other_robots_follow_their_truth(
    data_dir: Path, drive_id: str, fit: tuple[float, ...], most: float
) -> None:
    # With the independently fitted radii, lengths and offset the error falls below `most` of the
    # nominal one; a wrong sign or order of wheels would drive another way altogether.
    drive = load_drive(f"optiodom:{drive_id}", data_dir)
    assert drive.truth is not None
    truth = drive.truth.trajectory.poses
    angles, steering = drive.wheels.angles, drive.wheels.steering
    steps = drive.robot.base.displacements(angles, steering, np.array(fit))
    poses = geometry.integrate(steps, truth[0], geometry.EXACT)
    fitted = float(np.sqrt(((poses - truth)[:, :2] ** 2).sum(axis=1).mean()))
    assert fitted < most * rmse(drive)
