"""The state of an engine as one file, so that it can go on where it was, to the last bit.

What follows from robot, sensors and settings is not in the file: whoever restores gives them
again, and a fingerprint makes sure that they are the same. The file is an npz without pickles:
one array a dtype, and the structure as JSON.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fgloc import __version__
from fgloc.atomic import write_bytes
from fgloc.core.drive import Reference
from fgloc.core.measurements import Sensor
from fgloc.core.robot import Robot
from fgloc.errors import FglocError
from fgloc.online.engine import OnlineEngine
from fgloc.online.settings import OnlineSettings
from fgloc.online.snapshot import Reader, Writer

FORMAT = 1
"""Version of the file."""
Labels = Mapping[str, str | int | bool]
"""What a caller wants to find with the state again."""
DAMAGED = (
    EOFError,
    LookupError,
    TypeError,
    ValueError,
    AttributeError,
    ImportError,
    zipfile.BadZipFile,
)
"""What reading nonsense raises."""


def save(engine: OnlineEngine, path: str | Path, labels: Labels | None = None) -> None:
    """Write the whole state of an engine, atomically and flushed to disk.

    Raises FglocError if the file cannot be written, and for an engine that keeps its state inside
    iSAM2. About 10 ms for a window of 30 s with four sensors.
    """
    if engine.settings.engine != "chain":
        raise FglocError("the state of iSAM2 cannot be saved; checkpoints need the engine chain")
    writer = Writer(_given(engine))
    header = {
        "format": FORMAT,
        "fgloc_version": __version__,
        "made_for": _fingerprint(engine),
        "labels": dict(labels or {}),
        "engine": writer.node(engine),
    }
    text = np.frombuffer(json.dumps(header).encode(), np.uint8)
    stream = io.BytesIO()
    arrays: dict[str, Any] = {"header": text, **writer.arrays()}
    np.savez(stream, **arrays)
    write_bytes(path, stream.getvalue())


def restore(
    path: str | Path,
    robot: Robot,
    sensors: Sequence[Sensor],
    reference: Reference | None,
    settings: OnlineSettings,
    resolution: float = 0.0,
) -> OnlineEngine:
    """Return an engine that goes on exactly where the saved one was.

    The arguments are those of `OnlineEngine`; of the streams only noise and mounting count.
    Raises FglocError for a file that cannot be read, or that was written for another robot,
    other sensors or settings, or by another version.
    """
    header, arrays = _read(Path(path))
    fresh = OnlineEngine(robot, sensors, reference, settings, resolution)
    for what, mark in _fingerprint(fresh).items():
        if header["made_for"].get(what) != mark:
            raise FglocError(
                f"this checkpoint was written with {what}; go on with the same, or without it",
                file=path,
            )
    try:
        engine = Reader(_given(fresh), arrays).value(header["engine"])
    except DAMAGED as error:
        raise _damaged(path, error) from error
    if not isinstance(engine, OnlineEngine):
        raise _damaged(path, TypeError("no engine in it"))
    return engine


def labels_of(path: str | Path) -> dict[str, Any]:
    """Return the labels that a checkpoint was saved with; raises FglocError as `restore` does."""
    header, _ = _read(Path(path))
    labels: dict[str, Any] = header["labels"]
    return labels


def _read(path: Path) -> tuple[dict[str, Any], dict[str, npt.NDArray[Any]]]:
    """Return header and arrays of a checkpoint of this version."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        header = json.loads(arrays.pop("header").tobytes())
        version = (header["format"], header["fgloc_version"])
        if not {"made_for", "labels", "engine"} <= header.keys():
            raise ValueError("the header is not whole")
    except OSError as error:
        reason = error.strerror or str(error)
        raise FglocError(f"cannot be read: {reason}", file=path) from error
    except DAMAGED as error:
        raise _damaged(path, error) from error
    if version != (FORMAT, __version__):
        raise FglocError(
            f"this checkpoint was written by fgloc {version[1]} (format {version[0]}), which is "
            f"not {__version__} (format {FORMAT}); start the drive again",
            file=path,
        )
    return header, arrays


def _damaged(path: str | Path, error: Exception) -> FglocError:
    """Return the error for a file that is no checkpoint."""
    return FglocError(f"is no checkpoint, or damaged ({error}); start the drive again", file=path)


def _given(engine: OnlineEngine) -> dict[str, Any]:
    """Return what an engine was made from, by name: not part of its state."""
    robot = engine.layout.robot
    return {
        "settings": engine.settings,
        "layout": engine.layout,
        "robot": robot,
        "base": robot.base,
        "sensors": engine.sensors,
        **{f"sensor {sensor.sensor}": sensor for sensor in engine.sensors},
    }


def _fingerprint(engine: OnlineEngine) -> dict[str, str]:
    """Return a mark for everything an engine was made from, by what to say if it differs."""
    layout = engine.layout
    sensors = [
        [
            type(sensor).__name__,
            {k: v for k, v in vars(sensor).items() if not isinstance(v, np.ndarray)},
        ]
        for sensor in engine.sensors
    ]
    unknowns = [layout.parameters, layout.places, layout.width, layout.free]
    return {
        "another robot": mark([layout.robot, engine.window.resolution]),
        "other sensors": mark([sensors, unknowns]),
        "other settings": mark(engine.settings),
    }


def mark(value: Any) -> str:
    """Return a hash of everything that a value holds."""
    writer = Writer({})
    digest = hashlib.sha256(json.dumps(writer.node(value)).encode())
    for _, array in sorted(writer.arrays().items()):
        digest.update(array.tobytes())
    return digest.hexdigest()
