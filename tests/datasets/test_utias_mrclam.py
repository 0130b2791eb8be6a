"""The MRCLAM reader: by hand, and against figures of the recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fgloc.core import geometry
from fgloc.core.drive import Drive
from fgloc.core.measurements import LandmarkSightings
from fgloc.datasets import utias_mrclam
from fgloc.datasets.registry import list_drives, load_drive
from fgloc.errors import FglocError

HEAD = "# UTIAS Multi-Robot Cooperative Localization and Mapping Dataset\n"
FILES = {
    "Barcodes": "  1 \t  5\n  2 \t 14\n  6 \t 90\n  7 \t 72\n",
    "Landmark_Groundtruth": "  6 \t 1.5 \t -4.25 \t 0.00004 \t 0.00027\n  7 \t 2 3 0.01 0.02\n",
    "Robot1_Odometry": "100.0 \t 0.1 \t 0.0\n100.5 \t 0.2 \t -0.4\n101.5 \t 0.0 \t 0.0\n",
    "Robot1_Measurement": "100.25 \t 90 \t 3.5 \t -0.25\n100.25 14 1 0\n101 \t 72 \t 4 \t 0.5\n",
    "Robot1_Groundtruth": "100.0 \t 1 \t 2 \t 3.1\n100.5 1.1 2 -3.1\n102 \t 1.2 \t 2 \t 3\n",
}


def made(root: Path, **changed: str) -> Path:
    """Write data set 3 with one robot, some files changed, and return the data folder."""
    folder = root / utias_mrclam.NAME / "MRCLAM_Dataset3"
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in (FILES | changed).items():
        (folder / f"{name}.dat").write_text(HEAD + text)
    return root


def loaded(root: Path, **changed: str) -> Drive:
    """Return run 3/1."""
    return load_drive("utias-mrclam:3/1", made(root, **changed))


def sightings(drive: Drive) -> LandmarkSightings:
    """Return the one stream of sightings."""
    (found,) = drive.each(LandmarkSightings)
    return found


def test_a_run_by_hand(tmp_path: Path) -> None:
    drive = loaded(tmp_path)
    # A command holds until the next one, and is carried out 0.2 s later.
    assert drive.wheels.stamps_ns.tolist() == [100_200_000_000, 100_700_000_000, 101_700_000_000]
    np.testing.assert_allclose(drive.wheels.angles, [[0.05, 0, 0, 0], [0.2, 0, -0.4, 0.08]])
    # Turning with 0.4 rad/s costs 1.1 · 0.4 of the way.
    moved = drive.robot.base.displacements(drive.wheels.angles)
    np.testing.assert_allclose(moved, [[0.05, 0, 0], [0.2 * 0.56, 0, -0.4]], atol=1e-15)
    seen = sightings(drive)
    assert seen.landmark.tolist() == [6, 7]
    # Depths, 4 % too large, and stamped 40 ms late.
    expected = [3.5 / 1.04 / np.cos(0.25), 4.0 / 1.04 / np.cos(0.5)]
    np.testing.assert_allclose(seen.range_m, expected)
    assert seen.bearing.tolist() == [-0.25, 0.5]
    assert seen.stamps_ns.tolist() == [100_210_000_000, 100_960_000_000]
    assert seen.survey is not None
    assert seen.survey.landmark.tolist() == [6, 7]
    assert seen.survey.positions.tolist() == [[1.5, -4.25], [2, 3]]
    assert seen.survey.sigma.tolist() == [[1e-3, 1e-3], [0.01, 0.02]]
    assert drive.truth is not None
    heading = drive.truth.trajectory.poses[:, 2]
    np.testing.assert_allclose(heading, [3.1, 2 * np.pi - 3.1, 3.0])
    assert drive.rejected == {"sighting of another robot": 1}


def test_the_priors_hold_what_the_robots_do(tmp_path: Path) -> None:
    # True over told on robots 1 and 2 of data set 6: speed 1.01 to 1.06, yaw rate 0.91 to 0.95.
    known = {p.name: p for p in loaded(tmp_path).robot.base.parameters}
    assert 1 + 2 * known["odometry_scale"].prior_sigma > 1.06
    assert 1 - 2 * known["rotation_scale"].prior_sigma < 0.91
    assert known["turn_loss"].prior_sigma > 0.0


def test_what_cannot_be_used_is_counted(tmp_path: Path) -> None:
    drive = loaded(
        tmp_path,
        Robot1_Odometry=FILES["Robot1_Odometry"]
        + "101.5 9 9\n101.4 9 9\nnan 0 0\n1e18 0 0\n102 0 0\n103 0",
        Robot1_Measurement=FILES["Robot1_Measurement"]
        + "101 43 1 1\n101 90 nan 1\n100.9 90 1 1\n101 90 0 1\n101 90 1 1.3\n101 5 1 1\n",
        Robot1_Groundtruth=FILES["Robot1_Groundtruth"] + "102 1 1 1\n103 1 1 inf\n",
    )
    assert drive.rejected == {
        "truncated line": 1,
        "odometry not a number": 1,
        "odometry stamp out of range": 1,
        "odometry repeated stamp": 1,
        "odometry time goes back": 1,
        "sighting not a number": 1,
        "sighting of an unknown barcode": 1,
        "sighting of another robot": 2,
        "sighting without a distance": 1,
        "sighting out of the camera's sight": 1,
        "sighting time goes back": 1,
        "truth repeated stamp": 1,
        "truth not a number": 1,
    }
    assert sightings(drive).landmark.tolist() == [6, 7]
    assert drive.wheels.stamps_ns[-1] == 102_200_000_000


@pytest.mark.parametrize(
    ("file", "text", "what"),
    [
        ("Robot1_Odometry", "100 0.1\n101 0 0\n", r"Robot1_Odometry\.dat:2: 2 fields where 3"),
        ("Robot1_Odometry", "100 0.1 x\n101 0 0\n", r"Odometry\.dat:2: 'x' is not a number"),
        ("Robot1_Odometry", "100 0.1 0\n", r"Robot1_Odometry\.dat: fewer than two"),
        ("Robot1_Measurement", "100 9.5 1 1\n", r"Measurement\.dat:2: 9\.5 is not a number of"),
        ("Barcodes", "1 5\n6 5\n", r"Barcodes\.dat: two subjects"),
        ("Landmark_Groundtruth", "6 0 0 1\n7 0 0 1 1\n", r"Landmark_Groundtruth\.dat:2: 4 fields"),
    ],
)
def test_errors_name_file_and_line(tmp_path: Path, file: str, text: str, what: str) -> None:
    with pytest.raises(FglocError, match=what):
        loaded(tmp_path, **{file: text})


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    made(tmp_path)
    folder = tmp_path / utias_mrclam.NAME / "MRCLAM_Dataset3"
    (folder / "Robot1_Groundtruth.dat").unlink()
    assert load_drive("utias-mrclam:3/1", tmp_path).truth is None
    (folder / "Barcodes.dat").unlink()
    with pytest.raises(FglocError, match=r"Barcodes\.dat: no such file"):
        load_drive("utias-mrclam:3/1", tmp_path)


def test_runs_are_in_order_of_their_numbers(tmp_path: Path) -> None:
    root = made(tmp_path) / utias_mrclam.NAME
    for other in ("MRCLAM_Dataset10/Robot2", "MRCLAM_Dataset10/Robot11", "MRCLAM_Dataset2/Robot1"):
        (root / other).parent.mkdir(exist_ok=True)
        (root / f"{other}_Odometry.dat").touch()
    (root / "MRCLAM_Dataset2" / "RobotX_Odometry.dat").touch()
    runs = [f"utias-mrclam:{run}" for run in ("2/1", "3/1", "10/2", "10/11")]
    assert list_drives("utias-mrclam", tmp_path) == runs


@pytest.mark.parametrize(("run", "others"), [("6/1", 407), ("6/2", 792)])
def test_sightings_fit_the_truth_as_recorded(data_dir: Path, run: str, others: int) -> None:
    drive = load_drive(f"utias-mrclam:{run}", data_dir)
    seen = sightings(drive)
    assert drive.rejected["sighting of another robot"] == others
    assert drive.truth is not None
    assert seen.survey is not None
    truth = drive.truth.trajectory
    at = [
        np.interp(seen.stamps_ns - truth.stamps_ns[0], truth.stamps_ns - truth.stamps_ns[0], c)
        for c in truth.poses.T
    ]
    where = seen.survey.positions[np.searchsorted(seen.survey.landmark, seen.landmark)]
    east, north = where[:, 0] - at[0], where[:, 1] - at[1]
    distance = np.hypot(east, north)
    turned = geometry.wrap(seen.bearing - (np.arctan2(north, east) - at[2]))
    # The drive's sigmas are for all five robots; these two are within a factor of two of them.
    off = seen.range_m - distance
    assert 0.5 < float(np.sqrt(np.mean(off**2))) / seen.range_sigma < 2
    assert 0.5 < float(np.std(turned)) / seen.bearing_sigma < 2
    assert abs(float(np.median(turned))) < 0.005
    # What is published is no distance: it is four times as far off, even with a scale of its own.
    published = seen.range_m * np.cos(seen.bearing)
    kept = [
        float(np.std(v / distance / np.median(v / distance))) for v in (seen.range_m, published)
    ]
    assert kept[0] < 0.016
    assert kept[1] > 3 * kept[0]
