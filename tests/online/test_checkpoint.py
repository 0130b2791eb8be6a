"""A restored engine goes on to the last bit, and what does not fit is refused."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import is_dataclass, replace
from pathlib import Path
from types import MethodType
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import fgloc
from fgloc.core.drive import Drive
from fgloc.core.measurements import Floats, Yaw
from fgloc.core.start import trim_to_truth
from fgloc.datasets.simulator import load_sim
from fgloc.errors import FglocError
from fgloc.factors.robust import Loss
from fgloc.factors.tables import Kind
from fgloc.online import checkpoint
from fgloc.online.checkpoint import labels_of, restore, save
from fgloc.online.engine import OnlineEngine
from fgloc.online.online import start_of
from fgloc.online.replay import Packet, packets
from fgloc.online.settings import OnlineSettings

SHORT_LAG = OnlineSettings(lag_s=5.0)
EVERYTHING = "sim:square?robot=differential&duration=20&yaw_walk=0.001&gyro=on&gyro_bias_walk=1e-4"
ALL_SENSORS = EVERYTHING + "&camera=on&fix_every=2"


def drive_of(name: str) -> Drive:
    return trim_to_truth(load_sim(name.removeprefix("sim:")))


@pytest.fixture(scope="module")
def drive() -> Drive:
    """Return a drive with drifting zeros, a camera, and fixes between the wheels' stamps."""
    made = drive_of(ALL_SENSORS)
    late = tuple(
        replace(s, stamps_ns=s.stamps_ns + 7_000_001) if s.sensor == "fixes" else s
        for s in made.sensors
    )
    return replace(made, sensors=late)


def engine_for(drive: Drive, settings: OnlineSettings = SHORT_LAG) -> OnlineEngine:
    engine = OnlineEngine(
        drive.robot, drive.sensors, drive.truth, settings, drive.wheels.resolution
    )
    engine.begin(int(drive.wheels.stamps_ns[0]), start_of(drive))
    return engine


def hand_over(engine: OnlineEngine, some: Sequence[Packet]) -> npt.NDArray[Any]:
    """Return pose and covariance (N, 12) after every wheel packet."""
    rows = [np.zeros((0, 12))]
    for packet in some:
        if packet.sensor:
            engine.reading(packet.sensor, packet.stamp_ns, packet.values, packet.extra)
        else:
            engine.wheels(packet.stamp_ns, packet.values, packet.extra)
            covariance = engine.propagation.covariance().ravel()
            rows.append(np.concatenate([engine.propagation.state[:3], covariance])[None])
    return np.concatenate(rows)


def saved_and_restored(engine: OnlineEngine, drive: Drive, path: Path) -> OnlineEngine:
    save(engine, path)
    return restore(
        path, drive.robot, drive.sensors, drive.truth, engine.settings, drive.wheels.resolution
    )


def assert_goes_on(
    drive: Drive, settings: OnlineSettings, places: Sequence[int], path: Path
) -> OnlineEngine:
    """Assert that checkpoints after so many packets change no byte; return the last engine."""
    everything = list(packets(drive))
    whole = hand_over(engine_for(drive, settings), everything)
    engine, done, parts = engine_for(drive, settings), 0, []
    for place in (*places, len(everything)):
        parts.append(hand_over(engine, everything[done:place]))
        engine, done = saved_and_restored(engine, drive, path), place
    assert np.concatenate(parts).tobytes() == whole.tobytes()
    return engine


def test_goes_on_to_the_last_bit_wherever_it_was_saved(drive: Drive, tmp_path: Path) -> None:
    number = len(list(packets(drive)))
    places = [0, 1, 2, 5, 38, *range(101, number, 307), number - 1]
    engine = assert_goes_on(drive, SHORT_LAG, places, tmp_path / "state.npz")
    assert engine.window.base > 0  # the window has slid
    assert all(engine.tally[s.sensor].used for s in drive.sensors)


def test_fixes_that_wait_for_the_wheels_and_open_intervals_are_kept(
    drive: Drive, tmp_path: Path
) -> None:
    engine, waited, between = engine_for(drive), 0, 0
    everything = list(packets(drive))
    for k, packet in enumerate(everything[:1500]):
        hand_over(engine, [packet])
        is_open = engine.now_ns > engine.window.stamp(engine.window.newest)
        if engine.spots.waiting or (is_open and between < 3):
            waited += bool(engine.spots.waiting)
            between += is_open
            other = saved_and_restored(engine, drive, tmp_path / "state.npz")
            assert len(other.spots.waiting) == len(engine.spots.waiting)
            # A copy of the engine goes on, since the original is still needed here.
            first = saved_and_restored(engine, drive, tmp_path / "state.npz")
            few = everything[k + 1 : k + 60]
            assert hand_over(other, few).tobytes() == hand_over(first, few).tobytes()
            assert other.spots.waiting == []
    assert waited > 0
    assert between > 0


def lying(drive: Drive, change: Callable[[Floats, Floats], Floats]) -> Drive:
    """Return the drive with a yaw sensor that tells a function of time [s] and true reading."""
    (yaw,) = drive.each(Yaw)
    seconds = (yaw.stamps_ns - yaw.stamps_ns[0]) * 1e-9
    false = replace(yaw, yaw=change(seconds, np.unwrap(yaw.yaw)))
    return replace(drive, sensors=tuple(false if s is yaw else s for s in drive.sensors))


def test_goes_on_after_a_sensor_was_left_out(tmp_path: Path) -> None:
    drive = drive_of("sim:square?robot=differential&duration=30&fix_every=1")
    drive = lying(drive, lambda t, yaw: yaw + 0.6 * np.sin(0.5 * t))
    number = len(list(packets(drive)))
    engine = assert_goes_on(drive, SHORT_LAG, [number // 2, number - 101], tmp_path / "s.npz")
    assert list(engine.left_out) == ["yaw"]


def test_goes_on_while_a_sensor_is_not_believed(tmp_path: Path) -> None:
    drive = drive_of("sim:square?robot=differential&duration=30&gyro=on")
    drive = lying(drive, lambda t, yaw: yaw + 0.6 * np.sin(0.5 * t))
    number = len(list(packets(drive)))
    engine = assert_goes_on(drive, SHORT_LAG, [number // 2, number - 101], tmp_path / "s.npz")
    assert [p.sensor for p in engine.pauses] == ["yaw"] * len(engine.pauses)
    assert engine.pauses


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("sim:square?robot=swerve&duration=10&fix_every=2", OnlineSettings(lag_s=np.inf)),
        ("sim:square?robot=mecanum&duration=10&gyro=on&yaw=off", SHORT_LAG),
        ("sim:seed-a-circle-slip20", OnlineSettings(robust=False)),
    ],
)
def test_goes_on_with_any_robot(name: str, settings: OnlineSettings, tmp_path: Path) -> None:
    drive = drive_of(name)
    number = len(list(packets(drive)))
    assert_goes_on(drive, settings, [number // 3, number // 2 + 1], tmp_path / "state.npz")


def test_goes_on_while_the_start_is_not_known_yet(tmp_path: Path) -> None:
    drive = replace(drive_of("sim:square?duration=20&fix_every=4"), truth=None)
    assert start_of(drive) is None
    everything = list(packets(drive))
    first_fix = next(k for k, p in enumerate(everything) if p.sensor == "fixes")
    places = [first_fix - 3, first_fix + 20, len(everything) * 3 // 4]
    engine = assert_goes_on(drive, SHORT_LAG, places, tmp_path / "state.npz")
    assert engine.spots.aligner is None  # it was found in the end


def same(a: Any, b: Any, where: str, seen: dict[int, int]) -> Iterator[str]:
    """Yield where two values differ, attribute by attribute, and where sharing does.

    By its own rules and not by those of the code under test.
    """
    if type(a) is not type(b):
        yield f"{where}: {type(a)} became {type(b)}"
    elif id(a) in seen:
        if seen[id(a)] != id(b):
            yield f"{where}: is not shared any more"
    elif isinstance(a, np.ndarray):
        if a.dtype != b.dtype or a.shape != b.shape or a.tobytes() != b.tobytes():
            yield f"{where}: another array"
    elif isinstance(a, dict):
        seen[id(a)] = id(b)
        if list(a) != list(b):
            yield f"{where}: other keys"
        for key in a.keys() & b.keys():
            yield from same(a[key], b[key], f"{where}[{key!r}]", seen)
    elif isinstance(a, list | tuple | deque):
        if isinstance(a, deque) and a.maxlen != b.maxlen:
            yield f"{where}: another length to keep"
        if not isinstance(a, tuple):
            seen[id(a)] = id(b)
        if len(a) != len(b):
            yield f"{where}: another length"
        for k, (x, y) in enumerate(zip(a, b, strict=False)):
            yield from same(x, y, f"{where}[{k}]", seen)
    elif isinstance(a, MethodType):
        yield from same(a.__self__, b.__self__, f"{where}.__self__", seen)
    elif type(a).__name__ == "GrowingArray":
        # The room around the rows is no state.
        yield from same(a.view.copy(), b.view.copy(), f"{where}.view", seen)
    elif hasattr(a, "__dict__") and not isinstance(a, type | slice):
        # A frozen object may be a copy; what changes in it is looked at by itself.
        if not (is_dataclass(a) and a.__dataclass_params__.frozen):  # type: ignore[attr-defined]
            seen[id(a)] = id(b)
        if list(vars(a)) != list(vars(b)):
            yield f"{where}: other attributes"
        for name in vars(a).keys() & vars(b).keys():
            yield from same(vars(a)[name], vars(b)[name], f"{where}.{name}", seen)
    elif a is not b and a != b and not (a != a and b != b):
        yield f"{where}: {a!r} became {b!r}"


def test_every_attribute_of_every_object_is_there_again(drive: Drive, tmp_path: Path) -> None:
    engine = engine_for(drive)
    everything = list(packets(drive))
    hand_over(engine, everything[:1700])
    other = saved_and_restored(engine, drive, tmp_path / "state.npz")
    assert list(same(engine, other, "engine", {})) == []
    # The comparison does see a difference, deep down.
    other.window.tables["yaw", Kind.YAW].weight.view[3] += 1e-9
    assert list(same(engine, other, "engine", {})) != []


def test_a_new_attribute_is_saved_or_refused_but_never_forgotten(
    drive: Drive, tmp_path: Path
) -> None:
    engine = engine_for(drive)
    engine.window.added_tomorrow = {"k": [np.arange(3), 1.5, None]}  # type: ignore[attr-defined]
    other = saved_and_restored(engine, drive, tmp_path / "state.npz")
    assert list(same(engine, other, "engine", {})) == []
    engine.window.added_tomorrow = object()  # type: ignore[attr-defined]
    with pytest.raises(TypeError, match="cannot be saved"):
        save(engine, tmp_path / "state.npz")


def test_isam2_is_refused_in_one_line(drive: Drive, tmp_path: Path) -> None:
    engine = engine_for(drive, OnlineSettings(engine="isam2"))
    with pytest.raises(FglocError, match="checkpoints need the engine chain"):
        save(engine, tmp_path / "state.npz")


def test_numbers_come_back_exactly(drive: Drive, tmp_path: Path) -> None:
    engine = engine_for(drive)
    values = [0.1, float("nan"), -0.0, float("inf"), 2**62 + 1, np.float64(1 / 3), np.int64(5)]
    fortran = np.asfortranarray(np.arange(6.0).reshape(2, 3))
    engine.odd = [values, [1.0, -0.0], [2**62 + 1, 3], fortran, True, slice(1, None), (1, "σ")]  # type: ignore[attr-defined]
    other = saved_and_restored(engine, drive, tmp_path / "state.npz")
    odd = other.odd  # type: ignore[attr-defined]
    assert repr(odd[:3]) == repr(engine.odd[:3])  # type: ignore[attr-defined]
    assert [type(v) for v in odd[0]] == [type(v) for v in values]
    assert odd[3].flags.f_contiguous
    assert np.array_equal(odd[3], fortran)
    assert odd[4:] == [True, slice(1, None), (1, "σ")]


def test_a_checkpoint_of_something_else_is_refused(drive: Drive, tmp_path: Path) -> None:
    path = tmp_path / "state.npz"
    save(engine_for(drive), path, {"packets": 7})
    assert labels_of(path) == {"packets": 7}
    noise = replace(drive.robot, noise=replace(drive.robot.noise, rolling=0.5))
    (yaw,) = drive.each(Yaw)
    doubled = [replace(yaw, sigma=2 * yaw.sigma) if s is yaw else s for s in drive.sensors]
    loss = replace(SHORT_LAG, fix_loss=Loss("huber", 1.5))
    cases = [
        ("another robot", noise, drive.sensors, SHORT_LAG),
        ("other sensors", drive.robot, doubled, SHORT_LAG),
        ("other sensors", drive.robot, drive.sensors[1:], SHORT_LAG),
        ("other settings", drive.robot, drive.sensors, loss),
    ]
    for what, robot, sensors, settings in cases:
        with pytest.raises(FglocError, match=what) as caught:
            restore(path, robot, sensors, drive.truth, settings, drive.wheels.resolution)
        assert str(path) in str(caught.value)
    # Streams are known by their noise, not by what was recorded: a live robot has no recording.
    empty = replace(yaw, stamps_ns=yaw.stamps_ns[:0], yaw=yaw.yaw[:0])
    silent = [empty if s is yaw else s for s in drive.sensors]
    restore(path, drive.robot, silent, drive.truth, SHORT_LAG, drive.wheels.resolution)


def test_another_version_is_refused(
    drive: Drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = engine_for(drive)
    monkeypatch.setattr(checkpoint, "__version__", "0.0.9")
    save(engine, tmp_path / "old.npz")
    monkeypatch.undo()
    with pytest.raises(FglocError, match=rf"by fgloc 0\.0\.9 .* not {fgloc.__version__}"):
        labels_of(tmp_path / "old.npz")


def test_what_is_no_checkpoint_is_said_in_one_line(drive: Drive, tmp_path: Path) -> None:
    good = tmp_path / "good.npz"
    engine = engine_for(drive)
    hand_over(engine, list(packets(drive))[:300])
    save(engine, good)
    with np.load(good) as file:
        parts = {name: file[name] for name in file.files}
    header = json.loads(parts["header"].tobytes())
    for name in [n for n in parts if n != "header"]:
        parts[name] = parts[name][:-1]

    def written(file: str, header: dict[str, Any], arrays: dict[str, Any]) -> Path:
        text = np.frombuffer(json.dumps(header).encode(), np.uint8)
        np.savez(tmp_path / file, **{**arrays, "header": text})
        return tmp_path / file

    bad = [tmp_path / "missing.npz", tmp_path / "empty.npz", tmp_path / "half.npz"]
    bad[1].write_bytes(b"")
    bad[2].write_bytes(good.read_bytes()[:5000])
    bad.append(written("arrays.npz", header, parts))
    foreign = {**header, "engine": ["object", "subprocess:Popen", []]}
    bad.append(written("foreign.npz", foreign, {}))
    bad.append(written("number.npz", {**header, "engine": 5}, {}))
    bad.append(written("function.npz", {**header, "engine": ["object", "fgloc.cli:main", []]}, {}))
    pickled = tmp_path / "pickled.npz"
    np.savez(pickled, header=np.array([{}], dtype=object))
    for path in [*bad, pickled]:
        with pytest.raises(FglocError, match=str(path)):
            restore(path, drive.robot, drive.sensors, drive.truth, SHORT_LAG, 0.0)


def test_saving_keeps_the_old_file_until_the_new_one_is_whole(
    drive: Drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "state.npz"
    engine = engine_for(drive)
    save(engine, path, {"packets": 1})

    def fails(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", fails)
    with pytest.raises(FglocError, match="No space left"):
        save(engine, path, {"packets": 2})
    monkeypatch.undo()
    assert labels_of(path) == {"packets": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["state.npz"]
