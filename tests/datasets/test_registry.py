"""What a user types, and what comes of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fgloc.core import geometry
from fgloc.core.measurements import Yaw
from fgloc.datasets import jackal_jackass, registry
from fgloc.errors import FglocError


@pytest.fixture
def alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty folder on a machine without any data."""
    monkeypatch.delenv("FGLOC_DATA", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def jackal(root: Path, *lines: str) -> Path:
    """Write run 0 into a data folder and return its file."""
    folder = root / jackal_jackass.NAME
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / jackal_jackass.FILES["0"]
    file.write_text("".join(f"{line}\n" for line in lines))
    return file


LINES = (
    "100.0 2 1 0.5 0 0 0",
    "100.02 4 1 0.6 0 0 0 1 2 3.1 100.01",
    "100.04 4 3 0.7 0 0 0 1 2 -3.1 100.03",
)


def test_a_jackal_by_hand(alone: Path) -> None:
    jackal(alone, *LINES)
    drive = registry.load_drive("jackal-jackass:0", alone)
    # Columns are right, left; trapezoids of 20 ms.
    assert drive.wheels.wheels == ("left", "right")
    np.testing.assert_allclose(drive.wheels.angles, [[0.02, 0.06], [0.04, 0.08]])
    assert drive.each(Yaw)[0].yaw.tolist() == [0.5, 0.6, 0.7]
    assert drive.truth is not None
    assert drive.truth.trajectory.stamps_ns.tolist() == [100_010_000_000, 100_030_000_000]
    np.testing.assert_allclose(drive.truth.trajectory.poses[1], [1, 2, 2 * np.pi - 3.1])


def test_bad_jackal_lines_are_counted(alone: Path) -> None:
    more = ("100.04 9 9 9 0 0 0", "100.03 9 9 9 0 0 0", "100.05 nan 9 9 0 0 0")
    file = jackal(alone, *LINES, *more, "100.06 4 3 0.7 0 0 0 1 2 3 100.03")
    with file.open("a") as handle:
        handle.write("100.08 4 3")
    drive = registry.load_drive("jackal-jackass:0", alone)
    assert drive.rejected == {
        "repeated stamp": 1,
        "time goes back": 1,
        "not a number": 1,
        "truth repeated stamp": 1,
        "truncated line": 1,
    }
    assert drive.wheels.stamps_ns[-1] == 100_060_000_000


def test_the_recorded_jackal_by_its_nominal_wheels(data_dir: Path) -> None:
    # 3.84 m is an independent figure for the nominal radius and track.
    drive = registry.load_drive("jackal-jackass:0", data_dir)
    assert drive.truth is not None
    truth = drive.truth.trajectory
    moved = drive.robot.base.displacements(drive.wheels.angles)
    poses = geometry.integrate(moved, truth.poses[0], geometry.EXACT)
    origin = truth.stamps_ns[0]
    at, known = (truth.stamps_ns - origin) * 1e-9, (drive.wheels.stamps_ns - origin) * 1e-9
    x, y = (np.interp(at, known, poses[:, k]) for k in (0, 1))
    error = np.hypot(x - truth.poses[:, 0], y - truth.poses[:, 1])
    assert np.sqrt((error**2).mean()) == pytest.approx(3.84, abs=0.005)


@pytest.mark.parametrize(
    ("drive_id", "what"),
    [
        ("vitko-swerv:1", "no dataset is called 'vitko-swerv'; did you mean vitko-swerve"),
        ("martian:1", "known are vitko-swerve, optiodom, jackal-jackass, polimi-mecanum, robot-"),
        ("vitko-swerve:1", "fgloc datasets fetch vitko-swerve"),
        ("vitko-swerve", "write it like vitko-swerve:1"),
        ("jackal-jackass:7", "no run '7' here; there are 0"),
        ("nothing.npz", r"nothing\.npz: no such file"),
        ("folder", "holds no drive.npz"),
        ("empty.log", "empty"),
        ("words.txt", "format is not known"),
        ("broken.npz", "not a complete npz"),
    ],
)
def test_one_clear_line(alone: Path, drive_id: str, what: str) -> None:
    jackal(alone / "cache" / "fgloc", *LINES)
    (alone / "folder").mkdir()
    (alone / "empty.log").touch()
    (alone / "words.txt").write_text("some words\n")
    (alone / "broken.npz").write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(FglocError, match=what) as error:
        registry.load_drive(drive_id)
    assert "\n" not in str(error.value)


def test_a_wrong_data_folder_is_named(alone: Path) -> None:
    with pytest.raises(FglocError, match="no such data folder"):
        registry.load_drive("vitko-swerve:1", alone / "none")


def test_places_are_searched_in_order(alone: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given, environment, cache = alone / "given", alone / "environment", alone / "cache" / "fgloc"
    jackal(cache, *LINES)
    assert registry.find_folder("jackal-jackass").parent == cache
    jackal(environment, *LINES)
    monkeypatch.setenv("FGLOC_DATA", str(environment))
    assert registry.find_folder("jackal-jackass").parent == environment
    jackal(given, *LINES)
    assert registry.find_folder("jackal-jackass", given).parent == given
    # The dataset's own folder will do as well, and an empty one does not hide the next.
    assert registry.find_folder("jackal-jackass", given / "jackal-jackass").parent == given
    (alone / "other" / "jackal-jackass").mkdir(parents=True)
    assert registry.find_folder("jackal-jackass", alone / "other").parent == environment


def test_patterns_are_written_out(alone: Path) -> None:
    folder = alone / "optiodom" / "data"
    for run in ("diff/circular/1/01", "diff/circular/1/02", "diff/square/1/01", "omni3/free/1/01"):
        place = folder / run.rsplit("/", 1)[0]
        place.mkdir(parents=True, exist_ok=True)
        (place / f"1_run-{run[-2:]}.csv").touch()
    drives = registry.list_drives("optiodom", alone)
    assert registry.expand(["optiodom:all"], alone) == drives
    assert len(drives) == 4
    found = registry.expand(["optiodom:diff/circular/*", "x.npz", "sim:demo?seed=1"], alone)
    assert found == [*drives[:2], "x.npz", "sim:demo?seed=1"]
    assert registry.expand(["optiodom:*/01", drives[0]], alone) == [drives[0], *drives[2:]]
    with pytest.raises(FglocError, match="no run matches"):
        registry.expand(["optiodom:tricyc/*"], alone)


def test_a_path_with_a_colon_is_a_path(alone: Path) -> None:
    assert registry.is_dataset_id("sim:demo?seed=1")
    assert not registry.is_dataset_id("./logs/a:b.npz")
    (alone / "run:1").touch()
    assert not registry.is_dataset_id("run:1")
    assert registry.is_dataset_id("run:2")


def test_simulated_drives_are_handed_over() -> None:
    drive = registry.load_drive("sim:figure-eight?seed=3")
    assert drive.truth is not None
    assert drive.name.startswith("sim:figure-eight")


def test_simulated_drives_are_not_a_dataset_to_fetch() -> None:
    with pytest.raises(FglocError, match="nothing to fetch"):
        registry.dataset("sim")
