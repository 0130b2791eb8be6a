"""A whole drive in one npz file, without loss: numbers as arrays, everything else as JSON.

The archive holds one array a field, named `<stream>.<field>` (e.g. `yaw.stamps_ns`; what a stream
owns beside its rows is `<stream>.<part>.<field>`, e.g. `marks.survey.positions`), and `header`:
UTF-8 JSON as bytes, `{"format": "fgloc-drive", "version": 1, "drive": …}`. In it an object is
`{"type": class, field: value, …}`, an array `{"array": name, "dtype": …, "shape": …}`, a mapping
`{"map": …}`. Nothing in a file is executed: classes come from a fixed list, pickles are refused.
`fgloc.datasets.own_csv` writes the same header above rows of text.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import types
import zipfile
import zlib
from collections import abc
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import IO, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt

from fgloc.atomic import atomic_path
from fgloc.core import drive as drive_module
from fgloc.core import kinematics, measurements, robot, trajectory
from fgloc.core.drive import Drive, Reference
from fgloc.datasets.text import read_bytes
from fgloc.errors import FglocError

Arrays = dict[str, npt.NDArray[Any]]

FORMAT = "fgloc-drive"
VERSION = 1
CLASSES: dict[str, Callable[..., Any]] = {
    name: cls
    for module in (drive_module, kinematics, measurements, robot, trajectory)
    for name, cls in vars(module).items()
    if isinstance(cls, type)
    and dataclasses.is_dataclass(cls)
    and getattr(cls, "__module__", "") == module.__name__
}
"""The classes that a file may name."""


def write_npz(drive: Drive, path: Path) -> None:
    """Write a drive to `path`, replacing it only when complete. Raises FglocError if it cannot."""
    header, arrays = encode(drive)
    text = np.frombuffer(json.dumps(header, ensure_ascii=False).encode(), dtype=np.uint8)

    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, allow_pickle=False, header=text, **arrays)


def read_npz(path: Path, name: str | None = None) -> Drive:
    """Return the drive in an npz file, under another `name` if one is given.

    Raises FglocError if the file is missing, cut off, damaged, or not a drive.
    """
    with path.open("rb") if path.is_file() else _missing(path) as file:
        try:
            with np.load(file, allow_pickle=False) as archive:
                arrays: Arrays = {key: archive[key] for key in archive.files}
        except (ValueError, OSError, EOFError, KeyError, zipfile.BadZipFile, zlib.error):
            raise FglocError(
                "not a complete npz file (cut off, damaged or another format); write it again",
                file=path,
            ) from None
    if "header" not in arrays:
        raise FglocError("this npz file holds no fgloc drive", file=path)
    try:
        header = json.loads(arrays.pop("header").tobytes().decode())
    except ValueError:
        raise FglocError("the header is damaged; write the file again", file=path) from None
    return decode(header, arrays, path, name)


def encode(drive: Drive) -> tuple[dict[str, Any], Arrays]:
    """Return a drive's JSON header and its arrays by name. Raises FglocError for a bad name."""
    arrays: Arrays = {}
    taken = {s.sensor for s in (drive.wheels, *drive.sensors)}
    if any(not n or set(n) & set(',\n\r#."') for n in taken):
        raise FglocError(f"sensor names must not hold , . # or quotes: {sorted(taken)}")
    node = _encode(drive, "reference" if "truth" in taken else "truth", arrays)
    return {"format": FORMAT, "version": VERSION, "drive": node}, arrays


def decode(header: Any, arrays: Arrays, path: Path, name: str | None = None) -> Drive:
    """Return the drive of a header and its arrays. Raises FglocError naming the file."""
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise FglocError("the header is not that of a fgloc drive", file=path)
    if header.get("version") != VERSION:
        raise FglocError(
            f"format version {header.get('version')} is not known, only {VERSION}; update fgloc",
            file=path,
        )
    try:
        drive = _decode(header.get("drive"), arrays)
    except (FglocError, TypeError, ValueError, KeyError, AttributeError) as error:
        raise FglocError(f"the drive in this file is not valid: {error}", file=path) from None
    if not isinstance(drive, Drive):
        raise FglocError("the header does not describe a drive", file=path)
    return replace(drive, name=name) if name is not None else drive


def _missing(path: Path) -> IO[bytes]:
    """Raise the error of a file that cannot be opened."""
    read_bytes(path)
    raise FglocError("this is not a file", file=path)


def _encode(value: Any, prefix: str, arrays: Arrays) -> Any:
    """Return the JSON form of a value, putting arrays aside as `<prefix>.<field>`."""
    if isinstance(value, np.ndarray):
        arrays[prefix] = value
        return {"array": prefix, "dtype": value.dtype.name, "shape": list(value.shape)}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        node: dict[str, Any] = {"type": type(value).__name__}
        for field in dataclasses.fields(value):
            item = getattr(value, field.name)
            # A stream's arrays carry the stream's name; those of a trajectory the reference's.
            place = getattr(item, "sensor", None)
            if isinstance(item, Reference) or place is None:
                place = prefix
            if _is_part(value, item):
                place = f"{place}.{field.name}"
            flat = isinstance(item, np.ndarray)
            node[field.name] = _encode(item, f"{place}.{field.name}" if flat else place, arrays)
        return node
    if isinstance(value, Mapping):
        return {"map": {str(k): _encode(v, prefix, arrays) for k, v in value.items()}}
    if isinstance(value, tuple | list):
        return [_encode(v, getattr(v, "sensor", prefix), arrays) for v in value]
    return value.item() if isinstance(value, np.generic) else value


def _is_part(owner: Any, item: Any) -> bool:
    """Return True for what a stream owns beside its rows, e.g. the survey of its landmarks.

    Its arrays have rows of their own, and may be called as the stream's are.
    """
    owns = hasattr(owner, "sensor") and not isinstance(owner, Reference)
    return owns and dataclasses.is_dataclass(item)


def _decode(node: Any, arrays: Arrays) -> Any:
    """Return the value of a JSON form; sequences become tuples."""
    if isinstance(node, list):
        return tuple(_decode(v, arrays) for v in node)
    if not isinstance(node, dict):
        return node
    if "map" in node:
        return {k: _decode(v, arrays) for k, v in node["map"].items()}
    if "array" in node:
        if node["array"] not in arrays:
            raise FglocError(f"the array {node['array']} is missing")
        return arrays[node["array"]]
    if node.get("type") not in CLASSES:
        raise FglocError(f"there is no class {node.get('type')!r}")
    fields = {k: _decode(v, arrays) for k, v in node.items() if k != "type"}
    hints = _hints(node["type"])
    for key, value in fields.items():
        if not _fits(value, hints.get(key, object)):
            raise FglocError(f"{node['type']}: {key} cannot be {str(value)[:40]!r}")
    return CLASSES[node["type"]](**fields)


@functools.cache
def _hints(name: str) -> dict[str, Any]:
    """Return the types of a class's fields."""
    return get_type_hints(CLASSES[name])


def _fits(value: Any, hint: Any) -> bool:
    """Return True if a decoded value is of a field's type; numbers must be finite."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return any(_fits(value, one) for one in inner)
    if origin is Literal:
        return value in inner
    if origin is np.ndarray:
        return isinstance(value, np.ndarray) and value.dtype == get_args(inner[1])[0]
    if origin is tuple:
        if not isinstance(value, tuple):
            return False
        if inner[-1] is Ellipsis:
            inner = inner[:1] * len(value)
        return len(value) == len(inner) and all(map(_fits, value, inner))
    if origin is abc.Mapping:
        return isinstance(value, dict) and all(_fits(v, inner[1]) for v in value.values())
    if hint is float:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        return number and math.isfinite(value)
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool)
    return not isinstance(hint, type) or isinstance(value, hint)
