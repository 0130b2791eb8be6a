"""The Jaguar log writer against the published sample, and through the log's reader."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from fgloc.core import geometry
from fgloc.core.drive import Drive
from fgloc.core.measurements import Acceleration, PositionFixes, Yaw
from fgloc.datasets import jaguar
from fgloc.datasets.simulator import load_sim
from fgloc.datasets.simulator.jaguar_log import LogSettings, checksum, to_degrees, write_log
from fgloc.errors import FglocError

SPEC = "demo?seed=3&gyro=on&acc=on"


def written(path: Path, drive: Drive, **changes: float) -> Path:
    """Write a log with changed settings and return its path."""
    write_log(drive, path, LogSettings(**changes), np.random.default_rng(1))  # type: ignore[arg-type]
    return path


def test_checksum_of_the_published_sentence() -> None:
    body = "GPRMC,083101.4,A,4446.47702,N,02028.10553,E,000.32,031.2,220126,004.2,E"
    assert checksum(body) == 0x5B


def test_a_degree_has_the_published_length() -> None:
    # Lengths of a degree on WGS84 at 45°: 111131.745 m of latitude, 78846.806 m of longitude.
    north, east = to_degrees(np.array([[78846.806, 111131.745]]), 45.0, 20.0)
    assert north[0] - 45.0 == pytest.approx(1.0, abs=1e-6)
    assert east[0] - 20.0 == pytest.approx(1.0, abs=1e-6)


def test_form_of_the_log(tmp_path: Path) -> None:
    lines = written(tmp_path / "a.log", load_sim(SPEC)).read_text().splitlines()
    assert lines[0].startswith("#205,YAW,0.00,GYRO,")
    assert lines[1:3] == ["MM0 C=4761:-4718", "MM1 C=4644:-4906"]
    imu = [int(line[1 : line.index(",")]) for line in lines if line.startswith("#")]
    assert imu == [(205 + k) % 256 for k in range(len(imu))]
    packets = [k for k, line in enumerate(lines) if line.startswith("MM0 C=")]
    between = [sum(x.startswith("#") for x in lines[a:b]) for a, b in pairwise(packets)]
    assert set(between) == {10}
    # The first straight is driven forward: left counts rise, mirrored right counts fall.
    front = np.array([lines[k][6:].replace(" ", ":").split(":") for k in packets], dtype=int)
    assert front[60, 0] > front[0, 0]
    assert front[60, 1] < front[0, 1]


def test_round_trip(tmp_path: Path) -> None:
    drive = load_sim(SPEC)
    back = jaguar.load(written(tmp_path / "a.log", drive))
    start = back.wheels.stamps_ns[0]
    assert np.array_equal(back.wheels.stamps_ns - start, drive.wheels.stamps_ns)
    # 2026-01-22 08:31:00 UTC in seconds since 1970, counted by hand: 20475 days and 30660 s.
    assert start == (20475 * 86400 + 30660) * 1_000_000_000
    # The writer's counters are whole numbers of the encoder's own counts.
    assert back.wheels.angles == pytest.approx(drive.wheels.angles, abs=1e-9)
    assert back.wheels.wheels == drive.wheels.wheels

    seen, meant = back.each(Yaw)[0], drive.each(Yaw)[0]
    assert np.array_equal(seen.stamps_ns - start, meant.stamps_ns)
    assert np.abs(geometry.wrap(seen.yaw - meant.yaw)).max() < 1e-9
    forward = back.each(Acceleration)[0].forward
    assert forward == pytest.approx(drive.each(Acceleration)[0].forward, abs=1e-9)

    fixes, given = back.each(PositionFixes)[0], drive.each(PositionFixes)[0]
    assert np.array_equal(fixes.stamps_ns - start, given.stamps_ns)
    # 1e-5 minutes are 1.9 cm; the reader's origin is the first fix.
    moved = given.positions - given.positions[0]
    assert np.abs(fixes.positions - moved).max() < 0.02
    assert set(back.rejected) <= {"GPS without fix"}


def test_a_damaged_log_is_read_and_the_damage_counted(tmp_path: Path) -> None:
    drive = load_sim(SPEC)
    back = jaguar.load(written(tmp_path / "a.log", drive, drop=0.02, truncate=True))
    assert back.rejected["truncated line"] == 1
    assert 40 < back.rejected["lost IMU packet"] < 140
    # Counters are cumulative: lines lost in between leave the turned angle at common stamps.
    start = back.wheels.stamps_ns[0]
    common, ours, theirs = np.intersect1d(
        back.wheels.stamps_ns - start, drive.wheels.stamps_ns, return_indices=True
    )
    assert common.size > 0.8 * drive.wheels.stamps_ns.size
    total = [np.vstack([np.zeros(4), np.cumsum(d.wheels.angles, axis=0)]) for d in (back, drive)]
    moved = total[1][theirs] - total[1][theirs[0]]
    assert total[0][ours] - total[0][ours[0]] == pytest.approx(moved, abs=1e-9)


@pytest.mark.parametrize(
    ("spec", "word"),
    [
        ("demo", "gyro=on"),
        ("square?robot=swerve&gyro=on&acc=on", "robot=skid"),
        ("square?rate=7&gyro=on&acc=on", "20 ms"),
        ("square?fix_every=0.5&gyro=on&acc=on", "0.2 s"),
    ],
)
def test_drives_that_no_jaguar_log_can_hold(tmp_path: Path, spec: str, word: str) -> None:
    with pytest.raises(FglocError, match=word):
        written(tmp_path / "a.log", load_sim(spec))
    assert not list(tmp_path.iterdir())


def test_seed_a_case_through_the_log(tmp_path: Path) -> None:
    drive = load_sim("seed-a-circle-slip20?gyro=on&acc=on")
    back = jaguar.load(written(tmp_path / "a.log", drive))
    assert np.array_equal(back.wheels.stamps_ns, drive.wheels.stamps_ns)
    assert back.wheels.angles == pytest.approx(drive.wheels.angles, abs=1e-9)
