"""The BreezySLAM reader: by hand and as recorded."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fgloc.core.drive import Drive
from fgloc.core.measurements import Scans
from fgloc.datasets import breezyslam
from fgloc.datasets.registry import load_drive
from fgloc.errors import FglocError


def line(
    stamp: object, left: object, right: object, ranges: dict[int, object] | None = None
) -> str:
    """Return a line with 7 for all that is not explained, and some ranges [mm]."""
    values: list[object] = [0] * breezyslam.BEAMS
    for k, value in (ranges or {}).items():
        values[k] = value
    others = [7] * (breezyslam.FIRST_RANGE - 4)
    return " ".join(map(str, [stamp, 7, left, right, *others, *values]))


def loaded(root: Path, *lines: str, end: str = "\n") -> Drive:
    """Write the lines as run exp7 and return it."""
    folder = root / breezyslam.NAME
    folder.mkdir(exist_ok=True)
    (folder / "exp7.dat").write_text("\n".join(lines) + end)
    return load_drive("breezyslam:exp7", root)


def test_a_run_by_hand(tmp_path: Path) -> None:
    seen = {341: 2000, 342: 15, 343: 4000, 344: 3999, 69: 500, 70: 600, 612: 700, 613: 800}
    drive = loaded(tmp_path, line(1_000_000, 100, 200, seen), line(1_100_000, 1100, 200))
    # Half a turn of the left wheel: π · 0.077 m.
    moved = drive.robot.base.displacements(drive.wheels.angles)
    way = math.pi * 0.077
    np.testing.assert_allclose(moved, [[way / 2, 0, -way / 0.33]], atol=1e-15)
    assert drive.wheels.stamps_ns.tolist() == [1_000_000_000, 1_100_000_000]
    (scans,) = drive.each(Scans)
    assert scans.ranges.shape == (2, 683)
    # The middle beam looks ahead; the robot hides 70 at either end, and 4 m is too far.
    assert scans.angle_min + 341 * scans.angle_increment == pytest.approx(0, abs=1e-12)
    at = {k: scans.ranges[0, k] for k in np.flatnonzero(scans.ranges[0]).tolist()}
    assert at == pytest.approx({341: 2.0, 344: 3.999, 70: 0.6, 612: 0.7})
    assert scans.mount == (0.145, 0, 0)
    # 1024 steps a turn of 0.1 s.
    assert scans.angle_increment == pytest.approx(2 * math.pi / 1024)
    assert scans.beam_period == pytest.approx(0.1 / 1024)
    assert drive.truth is None


def test_what_cannot_be_used_is_counted(tmp_path: Path) -> None:
    drive = loaded(
        tmp_path,
        line(1000, 0, 0),
        line(2000, "nan", 5),
        line(3000, 20, 20, {300: "nan"}),
        line(3000, 99, 99),
        line(2500, 99, 99),
        line("nan", 99, 99),
        line(4000, 30, 30),
        line(5000, 30, 30)[:900],
        end="",
    )
    assert drive.rejected == {
        "stamp not a number": 1,
        "wheels not a number": 1,
        "repeated stamp": 1,
        "time goes back": 1,
        "truncated line": 1,
    }
    # Counts of the whole drive: none is lost with the line that lacks one.
    np.testing.assert_allclose(drive.wheels.angles * 1000 / math.pi, [[20, 20], [10, 10]])
    assert drive.each(Scans)[0].stamps_ns.tolist() == [1_000_000, 2_000_000, 3_000_000, 4_000_000]


@pytest.mark.parametrize(
    ("wrong", "what"),
    [
        (line(2000, 0, 0) + " 5", r"exp7\.dat:2: 708 fields where 707"),
        (line(2000, "x", 0), r"exp7\.dat:2: 'x' is not a number"),
    ],
)
def test_errors_name_file_and_line(tmp_path: Path, wrong: str, what: str) -> None:
    with pytest.raises(FglocError, match=what):
        loaded(tmp_path, line(1000, 0, 0), wrong, line(3000, 0, 0))


def test_exp2_as_recorded(data_dir: Path) -> None:
    drive = load_drive("breezyslam:exp2", data_dir)
    (scans,) = drive.each(Scans)
    assert scans.ranges.shape == (641, 683)
    assert drive.rejected == {}
    # 177534 and 179420 counts: 43.17 m and 1.38 rad.
    total = drive.robot.base.displacements(drive.wheels.angles.sum(axis=0)[None])
    np.testing.assert_allclose(total[0], [43.174, 0, 1.3825], atol=1e-3)
