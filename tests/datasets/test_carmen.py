"""CARMEN logs and gfs files, by hand and as recorded."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fgloc.core import geometry
from fgloc.core.drive import Drive
from fgloc.core.measurements import Scans
from fgloc.datasets.carmen import UNTIMED
from fgloc.datasets.registry import load_drive
from fgloc.errors import FglocError

GFS = (
    "PARAM maxrange 80",
    "ODOM 10.000 5.000 3.100000 1134864629.500000",
    "ODO_UPDATE 30 0.1 0.2",
    # This one has a stamp of its own, and its pose is odometry like any other.
    "LASER_READING 5 1.5 2.5 81.91 nan 3.5 10.500000 5.000000 3.120000 1134864629.600000",
    "ODOM 11.000 5.000 3.140000 1134864629.700000",
    # Stamp of the line before, pose of the line after.
    "LASER_READING 5 1.25 2.5 81.91 0.5 80.0 12.000400 5.000000 -3.100000 1134864629.700000",
    "ODOM 12.000 5.000 -3.100000 1134864629.900000",
)
LOG = (
    "FLASER 5 1.5 2.5 81.91 nan 3.5 0.1 0.2 3.1 0.1 0.2 3.1 1.13486e+09 host 1.13486e+09",
    "ODOM 0.3 0.2 3.1 0 0 0 1.13486e+09 host 1.13486e+09",
    "FLASER 5 1.25 2.5 81.91 0.5 80.0 0.5 0.2 -3.1 0.5 0.2 -3.1 1.13486e+09 host 1.13486e+09",
)


def written(folder: Path, name: str, *lines: str) -> str:
    """Write a log and return its path as a user would type it."""
    file = folder / name
    file.write_text("".join(f"{line}\n" for line in lines))
    return str(file)


def lidar(drive: Drive) -> Scans:
    """Return the one stream of scans."""
    (scans,) = drive.each(Scans)
    return scans


def test_a_gfs_by_hand(tmp_path: Path) -> None:
    drive = load_drive(written(tmp_path, "a.gfs", *GFS))
    start = 1134864629_500000000
    times = (drive.wheels.stamps_ns - start) * 1e-9
    np.testing.assert_allclose(times, [0, 0.1, 0.2, 0.4], atol=1e-6)
    # The robot heads for -x, so going to +x is backwards; the heading passes π.
    moved = geometry.integrate(drive.wheels.angles, np.array([10.0, 5.0, 3.1]), geometry.EXACT)
    np.testing.assert_allclose(
        moved, [[10, 5, 3.1], [10.5, 5, 3.12], [11, 5, 3.14], [12, 5, 2 * np.pi - 3.1]], atol=1e-12
    )
    # The second scan lies midway between the odometry lines about it.
    scans = lidar(drive)
    np.testing.assert_allclose((scans.stamps_ns - start) * 1e-9, [0.1, 0.3], atol=1e-6)
    np.testing.assert_array_equal(scans.ranges, [[1.5, 2.5, 0, 0, 3.5], [1.25, 2.5, 0, 0.5, 0]])
    assert scans.angle_min == -math.pi / 2
    assert scans.angle_increment == math.pi / 4
    assert drive.truth is None
    assert drive.rejected == {}
    assert drive.robot.noise == UNTIMED
    assert "0.10 s" in drive.notes[0]


def test_several_scans_between_two_lines_are_spread_evenly(tmp_path: Path) -> None:
    again = GFS[5].replace("1.25", "1.35")
    scans = lidar(load_drive(written(tmp_path, "a.gfs", *GFS[:6], again, GFS[6])))
    # Two in 200 ms, after one 100 ms before.
    np.testing.assert_allclose(np.diff(scans.stamps_ns) * 1e-9, [0.1 + 0.2 / 3, 0.2 / 3], atol=1e-6)


def test_the_log_beside_a_gfs_is_its_truth(tmp_path: Path) -> None:
    written(tmp_path, "a.log", *LOG)
    drive = load_drive(written(tmp_path, "a.gfs", *GFS))
    assert drive.truth is not None
    truth = drive.truth.trajectory
    assert truth.stamps_ns.tolist() == lidar(drive).stamps_ns.tolist()
    np.testing.assert_allclose(truth.poses, [[0.1, 0.2, 3.1], [0.5, 0.2, 2 * np.pi - 3.1]])


def test_the_log_of_another_drive_is_refused(tmp_path: Path) -> None:
    written(tmp_path, "a.log", LOG[0])
    with pytest.raises(FglocError, match=r"a\.log: the scan on line 6 of a\.gfs is not here"):
        load_drive(written(tmp_path, "a.gfs", *GFS))


def test_stamps_without_their_digits_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FglocError, match=r"a\.log:3: the stamps have too few digits: 1134860000"):
        load_drive(written(tmp_path, "a.log", *LOG))


CARMEN = (
    "# CARMEN Logfile",
    "ODOM 0 0 0 0.5 0 0 976052857.10 host 0.1",
    "FLASER 4 1 2 3 4 0.2 0 0 0.1 0 0 976052857.20 host 0.2",
    "ODOM 0.2 0 0 0.5 0 0 976052857.30 host 0.3",
    "FLASER 4 1 2 3 5 0.4 0 0 0.3 0 0 976052857.40 host 0.4",
)


def test_a_carmen_log_by_hand(tmp_path: Path) -> None:
    drive = load_drive(written(tmp_path, "a.log", *CARMEN))
    np.testing.assert_allclose(drive.wheels.angles, [[0.1, 0, 0]] * 3, atol=1e-15)
    scans = lidar(drive)
    times = (scans.stamps_ns - 976052857_000000000) * 1e-9
    np.testing.assert_allclose(times, [0.2, 0.4], atol=1e-6)
    # The laser sits 10 cm ahead; four beams see half a turn without its end.
    np.testing.assert_allclose(scans.mount, (0.1, 0, 0), atol=1e-15)
    assert scans.angle_increment == math.pi / 4
    assert drive.truth is None


def test_lasers_that_move_on_the_robot_are_corrected_poses(tmp_path: Path) -> None:
    lines = [line.replace(" 0.4 0 0 0.3", " 0.5 0.1 0 0.3") for line in CARMEN]
    drive = load_drive(written(tmp_path, "a.log", *lines))
    assert drive.truth is not None
    np.testing.assert_allclose(drive.truth.trajectory.poses, [[0.2, 0, 0], [0.5, 0.1, 0]])
    assert lidar(drive).mount == (0, 0, 0)


def test_the_loggers_stamps_stand_in_for_senders_without_digits(tmp_path: Path) -> None:
    lines = [line.replace("976052857.10", "1e9").replace("976052857.30", "1e9") for line in CARMEN]
    lines = [line.replace("976052857.20", "1e9").replace("976052857.40", "1e9") for line in lines]
    drive = load_drive(written(tmp_path, "a.log", *lines))
    assert drive.wheels.stamps_ns.tolist() == [10**8, 2 * 10**8, 3 * 10**8, 4 * 10**8]


def test_what_cannot_be_used_is_counted(tmp_path: Path) -> None:
    more = (
        "ODOM 12 5 nan 1134864630.100000",
        "ODOM 12 5 0 1134864629.000000",
        "ODOM 12 5 0 1e18",
        "LASER_READING 5 1 1 1 1 1 inf 5 0 1134864630.200000",
        "LASER_READING 5 1 1 1 1 1 12 5 0 1134864629.000000",
        # A stamp of the last odometry line with another pose: nothing tells when it was.
        "LASER_READING 5 1 1 1 1 1 12.5 5 -3.1 1134864629.900000",
    )
    path = written(tmp_path, "a.gfs", *GFS, *more)
    with Path(path).open("a") as file:
        file.write("ODOM 12 5 0 11348")
    drive = load_drive(path)
    assert drive.rejected == {
        "truncated line": 1,
        "odometry not a number": 1,
        "odometry time goes back": 1,
        "odometry stamp out of range": 1,
        "scan not a number": 1,
        "scan time goes back": 1,
        "scan after the last odometry line": 1,
    }
    assert lidar(drive).stamps_ns.size == 2


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("ODOM 1 2 3", r"a\.gfs:8: 3 fields where 4"),
        ("ODOM 1 2 x 1134864630", r"a\.gfs:8: 'x' is not a number"),
        ("LASER_READING 5 1 2 3 4 0 0 0 1134864630", r"a\.gfs:8: 9 fields where 10"),
        ("LASER_READING 4 1 2 3 4 5 0 0 0 1134864630", r"a\.gfs:8: this scan states 4 readings"),
    ],
)
def test_errors_name_file_and_line(tmp_path: Path, line: str, what: str) -> None:
    path = written(tmp_path, "a.gfs", *GFS, line, "ODOM 1 2 3 1134864640", GFS[3])
    with pytest.raises(FglocError, match=what):
        load_drive(path)


@pytest.mark.parametrize("number", ["-5", "many", "99999999999", "5.5"])
def test_a_scan_must_state_its_readings(tmp_path: Path, number: str) -> None:
    line = GFS[3].replace("LASER_READING 5", f"LASER_READING {number}")
    with pytest.raises(FglocError, match=r"a\.gfs:2: a scan must begin with"):
        load_drive(written(tmp_path, "a.gfs", GFS[1], line))


def test_a_log_without_lasers(tmp_path: Path) -> None:
    with pytest.raises(FglocError, match="no FLASER and no LASER_READING"):
        load_drive(written(tmp_path, "a.log", CARMEN[0], CARMEN[1]))


def test_csail_as_recorded(data_dir: Path) -> None:
    drive = load_drive("csail:0", data_dir)
    scans = lidar(drive)
    assert scans.ranges.shape == (406, 361)
    assert drive.rejected == {}
    assert drive.truth is not None
    truth = drive.truth.trajectory
    # 374 m of raw odometry, of which the end is 21 m off: independent figures.
    way = drive.wheels.angles
    assert np.hypot(way[:, 0], way[:, 1]).sum() == pytest.approx(374, abs=1)
    poses = geometry.integrate(way, np.zeros(3), geometry.EXACT)
    at = np.searchsorted(drive.wheels.stamps_ns, truth.stamps_ns)
    aligned = geometry.compose(
        geometry.compose(truth.poses[:1], geometry.inverse(poses[at[:1]])), poses[at[-1:]]
    )
    apart = np.hypot(*(aligned[0, :2] - truth.poses[-1, :2]))
    assert apart == pytest.approx(21, abs=3)


def test_csail_is_cut_off_anywhere(tmp_path: Path, data_dir: Path) -> None:
    data = (data_dir / "csail" / "csail.corrected.gfs").read_bytes()[:300_000]
    for size in range(250_000, 300_000, 9_973):
        (tmp_path / "a.gfs").write_bytes(data[:size])
        assert set(load_drive(str(tmp_path / "a.gfs")).rejected) <= {
            "truncated line",
            "scan after the last odometry line",
        }
