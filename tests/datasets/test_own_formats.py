"""Our npz and CSV: nothing is lost, nothing is executed, nothing half-written is left."""

from __future__ import annotations

import dataclasses
import io
import json
import pickle
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fgloc.core import bases
from fgloc.core.drive import Drive, Reference
from fgloc.core.measurements import (
    Acceleration,
    CameraPoses,
    LandmarkSightings,
    PoseFixes,
    PositionFixes,
    Scans,
    Survey,
    WheelIncrements,
    Yaw,
    YawRate,
)
from fgloc.core.robot import Robot, WheelNoise
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.own_csv import read_csv, write_csv
from fgloc.datasets.own_format import read_npz, write_npz
from fgloc.datasets.registry import load_drive
from fgloc.errors import FglocError

FORMATS = [(write_npz, read_npz, ".npz"), (write_csv, read_csv, ".csv")]


def differences(a: Any, b: Any, at: str = "drive") -> list[str]:
    """Return where two values differ, bit for bit and type for type."""
    if isinstance(a, np.ndarray):
        same = isinstance(b, np.ndarray) and a.dtype == b.dtype and a.shape == b.shape
        return [] if same and a.tobytes() == b.tobytes() else [at]
    if type(a) is not type(b):
        return [f"{at}: {type(a).__name__} {type(b).__name__}"]
    if dataclasses.is_dataclass(a):
        names = [f.name for f in dataclasses.fields(a)]
        found = [differences(getattr(a, n), getattr(b, n), f"{at}.{n}") for n in names]
        return [d for part in found for d in part]
    if isinstance(a, tuple) and len(a) == len(b):
        pairs = enumerate(zip(a, b, strict=True))
        return [d for k, (x, y) in pairs for d in differences(x, y, f"{at}[{k}]")]
    return [] if a == b else [at]


def whole_drive() -> Drive:
    """Return a drive with every kind of stream, awkward numbers included."""
    rng = np.random.default_rng(7)
    start = 1_769_070_661_400_000_001

    def stamps(n: int) -> np.ndarray:
        return start + np.cumsum(rng.integers(1, 10**9, n))

    base = bases.skid_steer(("fl", "rl"), ("fr", "rr"), 0.135, 0.48, order=("fl", "fr", "rl", "rr"))
    covariance = rng.normal(size=(4, 3, 3))
    return Drive(
        "sim:some?seed=1",
        Robot("Jaguar, 4×4 #1", base, WheelNoise(rolling=1 / 3)),
        WheelIncrements(
            "wheels", stamps(6), rng.normal(size=(5, 4)), base.driven_names, rng.normal(size=(5, 4))
        ),
        (
            Yaw("yaw", stamps(3), np.array([1e-300, -0.1, np.pi]), 0.01, resolution=0.01),
            YawRate("gyro", stamps(2), rng.normal(size=2), 0.01),
            Acceleration("acc", stamps(2), rng.normal(size=2)),
            CameraPoses("camera", stamps(2), rng.normal(size=(2, 3)), 0.01, 0.02),
            PositionFixes("gps", stamps(1), rng.normal(size=(1, 2)), np.ones((1, 2))),
            PoseFixes("truth", stamps(2), rng.normal(size=(2, 3)), np.ones((2, 3))),
            Scans(
                "lidar",
                stamps(2),
                np.where(rng.uniform(size=(2, 5)) > 0.5, rng.uniform(size=(2, 5)), 0.0),
                -1.0,
                -0.1,
                1 / 3,
                (0.1, -0.2, 0.3),
                (0.01, 0.02, 0.03),
                0.02,
                0.01,
                0.003,
                0.1,
                8.0,
            ),
            LandmarkSightings(
                "marks",
                np.repeat(stamps(2), 2),
                np.array([1, 2**53 + 1, 3, 4]),
                rng.uniform(size=4),
                rng.uniform(size=4),
                mount=(0.1, 0.2, 0.3),
                survey=Survey(
                    np.array([9, 1, 3]), rng.normal(size=(3, 2)), rng.uniform(1.0, 2.0, (3, 2))
                ),
            ),
        ),
        truth=Reference(Trajectory(stamps(4), rng.normal(size=(4, 3)), covariance), "optitrack"),
        motion="spin",
        rejected={"type": 2, "array": 1},
        notes=("one, with a comma", "zwei\nLinien"),
        true_calibration={"effective_track": 0.1 + 0.2},
    )


@pytest.mark.parametrize(("write", "read", "suffix"), FORMATS)
def test_a_whole_drive_comes_back(tmp_path: Path, write: Any, read: Any, suffix: str) -> None:
    drive = whole_drive()
    path = tmp_path / f"a{suffix}"
    write(drive, path)
    expected = drive
    if suffix == ".csv":
        # Text goes through doubles: identities are exact up to 2^53.
        marks = dataclasses.replace(drive.sensors[-1], landmark=np.array([1, 2**53, 3, 4]))
        expected = dataclasses.replace(drive, sensors=(*drive.sensors[:-1], marks))
        write(expected, path)
    assert differences(expected, read(path)) == []
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    assert load_drive(str(path)).name == str(path)


@pytest.mark.parametrize(("write", "read", "suffix"), FORMATS)
def test_an_empty_survey_comes_back(tmp_path: Path, write: Any, read: Any, suffix: str) -> None:
    drive = whole_drive()
    nothing = Survey(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2)))
    marks = dataclasses.replace(drive.sensors[-1], landmark=np.arange(4), survey=nothing)
    drive = dataclasses.replace(drive, sensors=(marks,))
    write(drive, tmp_path / f"a{suffix}")
    assert differences(drive, read(tmp_path / f"a{suffix}")) == []


def test_an_npz_from_before_surveys_and_noise_of_scans_reads(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    drive = whole_drive()
    marks = dataclasses.replace(drive.sensors[-1], survey=None, mount=(0.0, 0.0, 0.0))
    stripped = dataclasses.replace(drive, sensors=(drive.sensors[-2], marks))
    write_npz(stripped, path)
    with np.load(path) as archive:
        arrays = dict(archive)
    header = json.loads(arrays["header"].tobytes())
    for node in header["drive"]["sensors"]:
        for new in ("survey", "mount", "mount_sigma", "range_sigma", "range_sigma_share"):
            node.pop(new, None)
        for new in ("bearing_sigma", "min_range", "max_range"):
            node.pop(new, None)
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), np.uint8)
    np.savez(path, **arrays)
    scans = read_npz(path).each(Scans)[0]
    np.testing.assert_array_equal(scans.ranges, stripped.sensors[0].ranges)
    assert scans.max_range == 1000.0
    assert read_npz(path).each(LandmarkSightings)[0].survey is None


def test_sightings_of_a_csv_that_go_back_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    write_csv(whole_drive(), path)
    lines = path.read_text().splitlines()
    first = next(line for line in lines if line.startswith("marks,"))
    path.write_text("\n".join([*lines, first]) + "\n")
    drive = read_csv(path)
    assert drive.rejected["marks time goes back"] == 1
    assert drive.each(LandmarkSightings)[0].stamps_ns.size == 4


@pytest.mark.parametrize(("write", "read", "suffix"), FORMATS)
@pytest.mark.parametrize("name", ["optiodom:tricyc/free/140120211508/01", "csail:0"])
def test_a_recorded_drive_comes_back(
    tmp_path: Path, data_dir: Path, name: str, write: Any, read: Any, suffix: str
) -> None:
    drive = load_drive(name, data_dir)
    write(drive, tmp_path / f"a{suffix}")
    assert differences(drive, read(tmp_path / f"a{suffix}")) == []


def test_npz_cut_at_any_place_is_one_clear_error(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    write_npz(whole_drive(), path)
    data = path.read_bytes()
    for size in range(1, len(data), 97):
        path.write_bytes(data[:size])
        with pytest.raises(FglocError, match=r"a\.npz: "):
            read_npz(path)


def test_a_pickle_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, header=np.array([{"x": 1}], dtype=object))
    with pytest.raises(FglocError, match="not a complete npz"):
        read_npz(path)
    path.write_bytes(pickle.dumps({"x": 1}))
    with pytest.raises(FglocError, match="not a complete npz"):
        read_npz(path)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ('"type": "Yaw"', '"type": "Popen"', "no class 'Popen'"),
        ('"version": 1', '"version": 9', "version 9"),
        ('"fgloc-drive"', '"other"', "not that of a fgloc drive"),
        ('"yaw.yaw"', '"yaw.none"', "yaw.none is missing"),
        ('"type": "Drive"', '"type": "Wheel"', "not valid"),
        ('"sigma": 0.01', '"sigmo": 0.01', "sigmo"),
        ('"sigma": 0.01', '"sigma": "0.01"', "Yaw: sigma cannot be"),
        ('"sigma": 0.01', '"sigma": NaN', "Yaw: sigma cannot be"),
        ('"sigma": 0.01', '"sigma": null', "Yaw: sigma cannot be"),
        ('"sigma": 0.01', '"sigma": 0', "sigma must be positive"),
    ],
)
def test_a_changed_header_is_refused(tmp_path: Path, old: str, new: str, what: str) -> None:
    path = tmp_path / "a.npz"
    write_npz(whole_drive(), path)
    with np.load(path) as archive:
        arrays = dict(archive)
    header = arrays["header"].tobytes().decode()
    assert old in header
    arrays["header"] = np.frombuffer(header.replace(old, new).encode(), np.uint8)
    np.savez(path, **arrays)
    with pytest.raises(FglocError, match=what):
        read_npz(path)


def test_an_npz_of_something_else(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, x=np.zeros(3))
    with pytest.raises(FglocError, match="no fgloc drive"):
        read_npz(path)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("a.txt", "x")
    path.write_bytes(buffer.getvalue())
    with pytest.raises(FglocError):
        read_npz(path)


ROBOT = {"kind": "differential", "radius_left": 0.1, "radius_right": 0.1, "track": 0.5}


def by_hand(tmp_path: Path, *rows: str, **header: Any) -> Path:
    path = tmp_path / "hand.csv"
    text = json.dumps({"robot": ROBOT, **header})
    path.write_text("\n".join(["# fgloc-drive 1", f"# {text}", *rows]) + "\n")
    return path


def test_a_csv_by_hand(tmp_path: Path) -> None:
    path = by_hand(
        tmp_path,
        "# stream,stamp_ns,values",
        "wheels,0",
        "truth,0,0,0,3.1",
        "yaw,50,0.01",
        "wheels,100000000,0.5,0.6",
        "fixes,100000000,1,2,0.02",
        "gyro,120,0.3",
        "truth,100000000,1,2,-3.1",
        "wheels,200000000,0.5,0.6",
        motion="line",
    )
    drive = load_drive(str(path))
    assert drive.motion == "line"
    assert drive.wheels.stamps_ns.tolist() == [0, 100_000_000, 200_000_000]
    assert drive.wheels.angles.tolist() == [[0.5, 0.6], [0.5, 0.6]]
    assert drive.each(PositionFixes)[0].sigma.tolist() == [[0.02, 0.02]]
    assert drive.each(YawRate)[0].rate.tolist() == [0.3]
    assert drive.truth is not None
    np.testing.assert_allclose(drive.truth.trajectory.poses[1, 2], 2 * np.pi - 3.1)
    assert drive.rejected == {}


def test_csv_rows_that_cannot_be_used_are_counted(tmp_path: Path) -> None:
    path = by_hand(
        tmp_path,
        "wheels,0,9,9",
        "wheels,100,1,1",
        "wheels,100,7,7",
        "wheels,200,nan,1",
        "wheels,300,1,1",
        "wheels,250,7,7",
        "yaw,100,0.1",
        "yaw,90,0.1",
        "yaw,200,inf",
    )
    with path.open("a") as file:
        file.write("wheels,400,1")
    drive = read_csv(path)
    assert drive.wheels.angles.tolist() == [[1.0, 1.0], [2.0, 2.0]]
    assert drive.rejected == {
        "increment before the first stamp": 1,
        "repeated stamp": 1,
        "time goes back": 1,
        "wheels not a number": 1,
        "yaw time goes back": 1,
        "yaw not a number": 1,
        "truncated line": 1,
    }


@pytest.mark.parametrize(
    ("row", "what"),
    [
        ("wheels,300,1", "1 fields where 2"),
        ("wheels,300,1,x", "'x' is not a number"),
        ("wheels,3.5,1,1", "'3.5' is not a stamp"),
        ("wheels,99999999999999999999,1,1", "not a stamp"),
        ("sonar,300,1", "'sonar' is not known"),
        ("yaw,300", "values are expected"),
        ("truth,300,1,2", "2 fields where 3"),
    ],
)
def test_csv_errors_name_the_line(tmp_path: Path, row: str, what: str) -> None:
    path = by_hand(tmp_path, "wheels,0", "wheels,100,1,1", row, "wheels,400,1,1")
    with pytest.raises(FglocError, match=what) as error:
        read_csv(path)
    assert (error.value.file, error.value.line) == (path, 5)


@pytest.mark.parametrize(
    ("robot", "what"),
    [
        ({"kind": "hovercraft"}, "'hovercraft'"),
        ({**ROBOT, "wings": 2}, "wings"),
        ({**ROBOT, "track": -1.0}, "positive"),
        ({**ROBOT, "track": "wide"}, "robot: "),
        (None, "robot.kind is None"),
    ],
)
def test_csv_robots_that_do_not_exist(tmp_path: Path, robot: Any, what: str) -> None:
    path = by_hand(tmp_path, "wheels,0", "wheels,100,1,1", robot=robot)
    with pytest.raises(FglocError, match=what) as error:
        read_csv(path)
    assert error.value.line == 2


@pytest.mark.parametrize(
    ("key", "value", "what"),
    [
        ("yaw_sigma", "abc", "yaw_sigma is 'abc', a number"),
        ("yaw_sigma", 0.0, "yaw: sigma must be positive"),
        ("gyro_density", {}, "gyro_density is {}"),
        ("motion", 3, "motion must be a text"),
        ("robot", {"kind": []}, "robot.kind is"),
    ],
)
def test_csv_header_values_of_a_wrong_kind(tmp_path: Path, key: str, value: Any, what: str) -> None:
    path = by_hand(
        tmp_path, "wheels,0", "wheels,100,1,1", "yaw,50,0.1", "gyro,50,0.1", **{key: value}
    )
    with pytest.raises(FglocError, match=re.escape(what)) as error:
        read_csv(path)
    assert error.value.file == path


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"shape": [', '"shape": 7, "other": ['),
        ('"dtype": "float64"', '"dtype": "object"'),
        ('"unit": "m"', '"unit": 3'),
        ('"nominal": 0.', '"nominal": "x", "other": 0.'),
        ('"wheels": [', '"wheels": null, "other": ['),
    ],
)
def test_a_damaged_full_csv_header_is_one_clear_error(tmp_path: Path, old: str, new: str) -> None:
    path = tmp_path / "a.csv"
    write_csv(whole_drive(), path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(FglocError) as error:
        read_csv(path)
    assert error.value.file == path


def test_csv_without_wheels(tmp_path: Path) -> None:
    with pytest.raises(FglocError, match="wheels,stamp_ns"):
        read_csv(by_hand(tmp_path, "yaw,0,1"))


@pytest.mark.parametrize("text", ["stream,a\n", "# fgloc-drive 1\nwheels,0\n", "# fgloc-drive 1\n"])
def test_csv_without_header(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(FglocError, match=r"a\.csv:[12]: "):
        read_csv(path)


def test_a_file_cut_before_its_truth_has_no_truth_and_says_so(tmp_path: Path) -> None:
    full = tmp_path / "full.csv"
    write_csv(load_drive("sim:figure-eight"), full)
    lines = full.read_text().splitlines(keepends=True)
    first = next(k for k, line in enumerate(lines) if line.startswith("truth,"))
    cut = tmp_path / "cut.csv"
    cut.write_text("".join(lines[:first]))
    drive = read_csv(cut)
    assert drive.truth is None
    assert drive.rejected["truth without rows"] == 1


def test_the_short_header_names_what_a_base_needs(tmp_path: Path) -> None:
    file = tmp_path / "short.csv"
    file.write_text('# fgloc-drive 1\n# {"robot": {"kind": "differential", "radius": 0.1}}\n')
    with pytest.raises(FglocError, match=r"short\.csv:2: .*needs radius_left, radius_right, track"):
        read_csv(file)


def test_the_file_that_the_documentation_shows_can_be_read(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "docs" / "datasets.md").read_text()
    block = next(b for b in text.split("```text\n") if b.startswith("# fgloc-drive"))
    file = tmp_path / "shown.csv"
    file.write_text(block.partition("```")[0])
    drive = load_drive(str(file))
    assert [s.sensor for s in drive.sensors] == ["yaw", "fixes"]
    np.testing.assert_array_equal(drive.wheels.angles, [[0.52, 0.55]])
    assert drive.truth is not None
