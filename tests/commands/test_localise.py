"""`fgloc localise` as it is typed: killed, stopped, resumed, in real time, twice the same."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from fgloc.cli import main
from fgloc.core.trajectory import Trajectory
from fgloc.core.trajectory_io import load_trajectory
from fgloc.errors import FglocError
from fgloc.online.checkpoint import labels_of
from fgloc.online.checkpoint_folder import POSES, STATE, CheckpointFolder
from fgloc.online.track import RECORD

ROOT = Path(__file__).resolve().parent.parent.parent
DRIVE = "sim:figure-eight?duration=60&fix_every=5"


def start(*arguments: str, seed: str = "random") -> subprocess.Popen[str]:
    """Start `fgloc localise` in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "fgloc", "localise", *arguments],
        env=os.environ | {"PYTHONPATH": str(ROOT), "PYTHONHASHSEED": seed},
        cwd=ROOT,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def wait_for_poses(folder: Path, count: int, process: subprocess.Popen[str]) -> None:
    """Return when a checkpoint in the folder counts so many poses."""
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline and process.poll() is None:
        if (folder / STATE).exists() and labels_of(folder / STATE)["poses"] >= count:
            return
        time.sleep(0.02)
    process.kill()
    pytest.fail(f"no checkpoint came: {process.communicate()}")


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> Trajectory:
    """Return the drive as it is localised without any interruption."""
    track = tmp_path_factory.mktemp("whole") / "track.npz"
    assert main(["localise", DRIVE, "--save", str(track)]) == 0
    return load_trajectory(track)


def resumed(folder: Path) -> Trajectory:
    """Go on from a folder; return all poses."""
    track = folder / "track.npz"
    arguments = ["--checkpoint", str(folder), "--resume", "--save", str(track)]
    assert main(["localise", DRIVE, *arguments]) == 0
    return load_trajectory(track)


def assert_same(a: Trajectory, b: Trajectory) -> None:
    assert a.stamps_ns.tobytes() == b.stamps_ns.tobytes()
    assert a.poses.tobytes() == b.poses.tobytes()
    assert a.covariances is not None
    assert b.covariances is not None
    assert a.covariances.tobytes() == b.covariances.tobytes()


def test_a_killed_drive_is_resumed_as_if_nothing_had_been(
    uninterrupted: Trajectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # 8 times real time: the process is in the middle of the drive for seconds.
    process = start(DRIVE, "--realtime", "8", "--checkpoint", str(tmp_path))
    wait_for_poses(tmp_path, 40, process)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    labels = labels_of(tmp_path / STATE)
    assert 40 <= labels["poses"] < len(uninterrupted)
    assert not labels["finished"]
    # Fixes lie behind, so that the checkpoint had something to remember.
    begin = int(uninterrupted.stamps_ns[0])
    assert int(uninterrupted.stamps_ns[labels["poses"] - 1]) - begin > 5_000_000_000
    assert_same(resumed(tmp_path), uninterrupted)
    shown = capsys.readouterr()
    assert f"going on after {labels['poses']} poses" in shown.err
    assert f"{labels['poses']} poses are from before the interruption" in shown.out
    # The file holds what the result holds.
    rows = np.fromfile(tmp_path / POSES, RECORD)
    assert RECORD.itemsize == 120
    assert rows["stamp_ns"].tolist() == uninterrupted.stamps_ns.tolist()
    assert np.array_equal(rows["pose"], uninterrupted.poses)
    # A finished drive is resumed in no time, with the same result, and may be begun anew.
    assert_same(resumed(tmp_path), uninterrupted)
    assert main(["localise", DRIVE, "--checkpoint", str(tmp_path)]) == 0


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_stopped_drive_saves_its_state(
    number: signal.Signals, status: int, uninterrupted: Trajectory, tmp_path: Path
) -> None:
    # Checkpoints so rare that only the one of the stop can hold the poses.
    arguments = [DRIVE, "--realtime", "10", "--checkpoint", str(tmp_path), "--every", "1000"]
    process = start(*arguments)
    wait_for_poses(tmp_path, 1, process)
    time.sleep(0.7)
    process.send_signal(number)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == status
    assert "Traceback" not in errors
    assert 1 < labels_of(tmp_path / STATE)["poses"] < len(uninterrupted)
    assert_same(resumed(tmp_path), uninterrupted)


def test_no_more_than_a_second_of_the_drive_is_ever_unsaved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    saved: list[int] = []
    save = CheckpointFolder.save

    def noted(folder: CheckpointFolder, engine, track, packets, finished) -> None:  # type: ignore[no-untyped-def] # noqa: ANN001
        saved.append(engine.now_ns)
        save(folder, engine, track, packets, finished)

    monkeypatch.setattr(CheckpointFolder, "save", noted)
    drive = "sim:square?robot=differential&duration=10"
    assert main(["localise", drive, "--checkpoint", str(tmp_path)]) == 0
    gaps = np.diff(saved) * 1e-9
    assert gaps.max() <= 1.05  # one wheel packet more than a second
    assert len(gaps) >= 9


def test_poses_behind_the_state_are_cut_off_and_missing_ones_are_an_error(
    uninterrupted: Trajectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["localise", DRIVE, "--checkpoint", str(tmp_path), "--every", "30"]) == 0
    poses = tmp_path / POSES
    whole = poses.read_bytes()
    # Killed after the poses were written and before the state was, in the middle of a pose.
    poses.write_bytes(whole + b"\x01" * 150)
    assert_same(resumed(tmp_path), uninterrupted)
    assert poses.read_bytes() == whole
    for wrong in (whole[:-1], b"\x00" * len(whole)):
        poses.write_bytes(wrong)
        assert main(["localise", DRIVE, "--checkpoint", str(tmp_path), "--resume"]) == 1
        (line,) = [x for x in capsys.readouterr().err.splitlines() if x.startswith("fgloc:")]
        assert f"{poses}: does not hold the {len(uninterrupted)} poses" in line


def test_a_checkpoint_of_another_drive_is_refused_and_none_is_thrown_away(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = "sim:square?robot=differential&duration=6"
    here = ["--checkpoint", str(tmp_path)]
    assert main(["localise", drive, *here]) == 0
    for other in ([drive + "&seed=2"], [drive, "--lag", "7"], [drive, "--fixes", "2"]):
        assert main(["localise", *other, *here, "--resume"]) == 1
        line = capsys.readouterr().err.splitlines()[-1]
        assert line.startswith(f"fgloc: error: {tmp_path / STATE}: this checkpoint was written ")
    # A drive that was interrupted: as a folder looks after a kill.
    assert main(["localise", drive, *here]) == 0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fgloc.online.engine.OnlineEngine.wheels", _breaks)
        assert main(["localise", drive, *here]) == 1
    capsys.readouterr()
    assert main(["localise", drive, *here]) == 1
    assert "add --resume to go on with it" in capsys.readouterr().err
    assert main(["localise", drive, *here, "--resume"]) == 0


def _breaks(*_: object) -> bool:
    raise FglocError("the power went")


def test_resume_without_a_checkpoint_begins_at_the_start(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "new" / "folder"
    drive = "sim:square?robot=differential&duration=6"
    assert main(["localise", drive, "--checkpoint", str(folder), "--resume"]) == 0
    assert f"no checkpoint in {folder}: beginning at the start" in capsys.readouterr().err
    assert sorted(p.name for p in folder.iterdir()) == [POSES, STATE]


def test_errors_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "file"
    file.write_text("")
    drive = "sim:square?robot=differential&duration=6"
    (tmp_path / STATE).write_bytes(b"not a checkpoint")
    cases = [
        (["--resume"], "--resume needs --checkpoint"),
        (["--checkpoint", str(file)], f"{file} is not a folder"),
        (["--checkpoint", str(tmp_path), "--resume"], f"{tmp_path / STATE}: is no checkpoint"),
        (["--checkpoint", str(tmp_path)], f"{tmp_path / STATE}: is no checkpoint"),
    ]
    for options, expected in cases:
        assert main(["localise", drive, *options]) == 1
        line = capsys.readouterr().err.splitlines()[-1]
        assert line.startswith("fgloc: error: ")
        assert expected in line


@pytest.mark.parametrize(
    "options",
    [
        ["--lag", "0"],
        ["--lag", "all"],
        ["--realtime", "0"],
        ["--realtime", "fast"],
        ["--every", "-1"],
        ["--save", "poses.txt"],
    ],
)
def test_wrong_usage_exits_2(options: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["localise", "sim:demo", *options])
    assert caught.value.code == 2
    assert options[0] in capsys.readouterr().err


def test_stamps_are_respected_in_real_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    numbers = tmp_path / "numbers.json"
    drive = "sim:square?robot=differential&duration=12"
    begin = time.perf_counter()
    assert main(["localise", drive, "--realtime", "10", "--json", str(numbers)]) == 0
    assert time.perf_counter() - begin > 1.15  # 12 s of the drive, but for its first packet
    assert "Packets waited for the engine for" in capsys.readouterr().out
    online = json.loads(numbers.read_text())["drives"][0]["methods"]["online"]["online"]
    assert online["updates"] > 100
    for name in ("update_ms", "late_ms"):
        assert 0.0 <= online[name]["median"] <= online[name]["p99"] <= online[name]["max"]
    assert online["checkpoint_ms"] is None


def test_an_engine_that_cannot_keep_up_says_so(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fgloc.online.pacing.BEHIND_S", 0.01)
    drive = "sim:square?robot=differential&duration=6"
    assert main(["localise", drive, "--realtime", "100000"]) == 0
    shown = capsys.readouterr()
    assert "s behind" in shown.err
    # Each time it has doubled, not at every packet.
    assert shown.err.count("s behind") < 12
    assert "could not keep up with 100000 times real time" in shown.out


def test_json_keeps_the_contract_of_compare(tmp_path: Path) -> None:
    localised, compared = tmp_path / "a.json", tmp_path / "b.json"
    drive = "sim:square?robot=differential&duration=6&fix_every=2"
    assert main(["localise", drive, "--json", str(localised)]) == 0
    assert main(["compare", drive, "--methods", "online", "--json", str(compared)]) == 0
    a, b = json.loads(localised.read_text()), json.loads(compared.read_text())
    timed = ("seconds", "online")
    for document in (a, b):
        for name in timed:
            document["drives"][0]["methods"]["online"].pop(name)
    assert a == b


def test_lag_changes_the_estimate_and_is_in_the_run_folder(tmp_path: Path) -> None:
    drive = "sim:square?robot=differential&duration=10&fix_every=2"
    tracks = {}
    for lag in ("1", "full"):
        out = tmp_path / lag
        assert main(["localise", drive, "--lag", lag, "--out", str(out)]) == 0
        (folder,) = (p for p in out.iterdir() if not p.is_symlink())
        settings = json.loads((folder / "settings.json").read_text())
        assert settings["lag"] == lag
        # JSON has no infinity.
        assert settings["settings"]["online"]["lag_s"] == (1.0 if lag == "1" else None)
        (track,) = folder.rglob("online.tum")
        tracks[lag] = track.read_text()
    assert tracks["1"] != tracks["full"]


def test_the_same_drive_gives_the_same_bytes_in_two_processes(tmp_path: Path) -> None:
    tracks = [tmp_path / "a.npz", tmp_path / "b.npz"]
    drive = "sim:square?duration=30&gyro=on&camera=on&fix_every=2"
    # Different hash seeds: the order of a set would show.
    for seed, track in zip("12", tracks, strict=True):
        process = start(drive, "--save", str(track), seed=seed)
        output = process.communicate(timeout=60)
        assert process.returncode == 0, output
    assert_same(load_trajectory(tracks[0]), load_trajectory(tracks[1]))


def test_localise_takes_one_drive(data_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if not (data_dir / "vitko-swerve").is_dir():
        pytest.skip("vitko-swerve is not in FGLOC_DATA")
    assert main(["localise", "vitko-swerve:all", "--data", str(data_dir)]) == 1
    assert "fgloc compare vitko-swerve:all --methods online" in capsys.readouterr().err
