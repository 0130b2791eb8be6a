"""The Khepera's tuples: by hand on small files, and the published ones."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from fgloc.core import geometry
from fgloc.core.measurements import CameraPoses
from fgloc.datasets import censi_calibration
from fgloc.datasets.registry import list_drives, load_drive
from fgloc.errors import FglocError

ONE = '{ "T": 0.5, "phi_l": 2.0, "phi_r": -1.0, "sm": [ 0.1, 0.2, 0.3 ] }'
TWO = '{ "T": 0.25, "phi_l": 4.0, "phi_r": 8.0, "sm": [ 0.0, 0.1, -0.3 ] }'


def write(tmp_path: Path, text: str) -> Path:
    """Write the run x and return its folder."""
    (tmp_path / "x.tuple").write_text(text)
    return tmp_path


def test_rates_become_angles_and_displacements_poses(tmp_path: Path) -> None:
    # The publisher joined recordings without an end of line, and the last has none.
    drive = censi_calibration.load(write(tmp_path, f"{ONE}{TWO}\n{ONE}"), "x", "x")
    np.testing.assert_allclose(drive.wheels.angles, [[1, -0.5], [1, 2], [1, -0.5]])
    assert drive.wheels.wheels == ("left", "right")
    assert drive.wheels.stamps_ns.tolist() == [0, 500_000_000, 750_000_000, 1_250_000_000]
    (laser,) = drive.each(CameraPoses)
    assert laser.stamps_ns.tolist() == drive.wheels.stamps_ns.tolist()
    moved = geometry.between(laser.poses[:-1], laser.poses[1:])
    expected = [[0.1, 0.2, 0.3], [0, 0.1, -0.3], [0.1, 0.2, 0.3]]
    np.testing.assert_allclose(moved, expected, atol=1e-12)
    assert drive.rejected == {}


def test_what_cannot_be_used_is_counted(tmp_path: Path) -> None:
    none, nan = ONE.replace("0.5", "0"), ONE.replace("0.1", "NaN")
    text = f"{ONE}\n{none}\n{nan}\n\n{TWO}\n" + ONE[:30]
    drive = censi_calibration.load(write(tmp_path, text), "x", "x")
    assert drive.wheels.angles.shape == (2, 2)
    assert drive.rejected == {
        "truncated line": 1,
        "not a number": 1,
        "interval of no possible length": 1,
    }


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ("rubbish", "x.tuple:2: this is not a JSON object"),
        ("[1, 2]", "x.tuple:2: this is not a JSON object"),
        (ONE.replace("phi_l", "phi"), "x.tuple:2: the field 'phi_l' is missing"),
        (ONE.replace("0.1,", ""), "x.tuple:2: T, phi_l and phi_r must be numbers and sm three"),
        (ONE.replace("2.0", '"2"'), "x.tuple:2: T, phi_l and phi_r must be numbers"),
        (ONE.replace("2.0", "[2.0, 1.0]").replace("0.1,", ""), "x.tuple:2: T, phi_l"),
        (ONE[:30], "x.tuple:2: this is not a JSON object"),
    ],
)
def test_faults_name_file_and_line(tmp_path: Path, bad: str, message: str) -> None:
    with pytest.raises(FglocError) as error:
        censi_calibration.load(write(tmp_path, f"{ONE}\n{bad}\n{TWO}\n"), "x", "x")
    assert message in str(error.value)


def test_nothing_usable(tmp_path: Path) -> None:
    with pytest.raises(FglocError, match="no usable interval"):
        censi_calibration.load(write(tmp_path, ONE.replace("0.5", "-1") + "\n"), "x", "x")
    with pytest.raises(FglocError, match="empty"):
        censi_calibration.load(write(tmp_path, "\n"), "x", "x")


def test_the_published_runs(data_dir: Path) -> None:
    if not (data_dir / censi_calibration.NAME).is_dir():
        pytest.skip("censi-calibration is not here; fgloc datasets fetch censi-calibration")
    assert list_drives("censi-calibration") == [
        "censi-calibration:lmov",
        "censi-calibration:lstraight",
    ]
    table = censi_calibration.read_tuples(
        data_dir / censi_calibration.NAME / "lmov.tuple", Counter()
    )
    text = (data_dir / censi_calibration.NAME / "lmov.tuple").read_text()
    assert table.shape[0] == text.count('"T"') == 4345
    first = json.loads(text.splitlines()[0])
    np.testing.assert_allclose(
        table[0], [first["T"], first["phi_l"], first["phi_r"], *first["sm"]], rtol=0
    )
    drive = load_drive("censi-calibration:lmov")
    assert drive.rejected == {}
    # Nearly an hour at a centimetre a second and less.
    assert drive.duration_s == pytest.approx(table[:, 0].sum(), abs=1e-5)
