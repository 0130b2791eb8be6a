"""A drive as one CSV file: easy to read, easy to write by hand or script, and without loss.

Whole numbers are exact to 2^53, stamps to 2^63; other numbers are written with all their digits.

    # fgloc-drive 1
    # {"robot": {"kind": "differential", "radius_left": 0.1, "radius_right": 0.1, "track": 0.5}}
    # stream,stamp_ns,values
    wheels,0
    wheels,100000000,0.52,0.55
    yaw,100000000,0.012
    fixes,100000000,0.05,0.0,0.02
    truth,100000000,0.0535,0.0003,0.006

Each row is a stream's name, an int64 stamp in nanoseconds and its values; rows of what a stream
owns beside its measurements, such as a survey of landmarks, have their number instead of a stamp.
Line 2 is JSON: either the full header of `fgloc.datasets.own_format`, which `write_csv` puts there
and which describes every stream, or the short form above: `robot` with the `kind` of a base and the
arguments of its constructor in `fgloc.core.bases`, optionally `motion`. In the
short form these streams are known:

- wheels: wheel angles [rad] since the wheels row before, forward positive, in the order of the
  base's driven wheels, then (steered bases) as many steering angles [rad]; the first row, without
  values, opens the first interval;
- yaw: heading [rad] (sigma `yaw_sigma`, 0.02 rad); gyro: yaw rate [rad/s] (density `gyro_density`,
  0.01 rad/s/sqrt(Hz));
- fixes: x, y [m] and one sigma or one each for x and y [m];
- truth: x, y [m], heading [rad].
"""

from __future__ import annotations

import io
import json
import re
from collections import Counter
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fgloc.atomic import write_text
from fgloc.core.drive import Drive, Reference
from fgloc.core.kinematics import WheeledBase
from fgloc.core.measurements import (
    Floats,
    PositionFixes,
    Sensor,
    Stamps,
    WheelIncrements,
    Yaw,
    YawRate,
)
from fgloc.core.named_bases import make_base
from fgloc.core.robot import Robot
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.intervals import usable_increments
from fgloc.datasets.own_format import FORMAT, VERSION, Arrays, decode, encode
from fgloc.datasets.text import (
    NOT_A_NUMBER,
    Integers,
    count,
    finite_rows,
    forward_stamps,
    numbered,
    parse_rows,
    read_lines,
    steady_stamps,
)
from fgloc.errors import FglocError

MAGIC = f"# {FORMAT} {VERSION}"
MOST_COLUMNS = 100_000
"""No array is wider; a number that large in a header is damage."""


@dataclass(frozen=True)
class Stream:
    """The rows of one stream as they stand in the file."""

    stamps: Stamps
    """(N,) stamps [ns], in file order."""
    texts: list[str]
    """Values of each row, not yet parsed."""
    numbers: Integers
    """(N,) line numbers."""


def write_csv(drive: Drive, path: Path) -> None:
    """Write a drive as CSV, without loss, complete or not at all. FglocError if it cannot."""
    header, arrays = encode(drive)
    out = io.StringIO()
    out.write(f"{MAGIC}\n# {json.dumps(header, ensure_ascii=False)}\n# stream,stamp_ns,values\n")
    for stream, members in _streams(arrays).items():
        columns = [
            value.reshape(value.shape[0], int(np.prod(value.shape[1:]))).tolist()
            for value in members.values()
        ]
        stamps = arrays.get(f"{stream}.stamps_ns", np.arange(len(columns[0]) if columns else 0))
        opening = stamps.size - len(columns[0])
        rows: list[list[Any]] = [[] for _ in range(opening)]
        rows += [list(chain.from_iterable(row)) for row in zip(*columns, strict=True)]
        for stamp, row in zip(stamps.tolist(), rows, strict=True):
            out.write(",".join([stream, str(stamp), *map(repr, row)]) + "\n")

    write_text(path, out.getvalue())


def read_csv(path: Path, name: str | None = None) -> Drive:
    """Return the drive in a CSV file, under another `name` if one is given.

    Rows that repeat a stamp, go back or hold no finite number are dropped and counted. Raises
    FglocError naming file and line for everything else.
    """
    lines = read_lines(path)
    if not lines.text or lines.text[0].strip() != MAGIC:
        raise FglocError(f"the first line is not {MAGIC!r}", file=path, line=1)
    try:
        header = json.loads(lines.text[1].lstrip("# ") if len(lines.text) > 1 else "")
    except ValueError:
        raise FglocError("this line must be '# ' and a JSON header", file=path, line=2) from None
    if not isinstance(header, dict):
        raise FglocError("the JSON header must be an object {…}", file=path, line=2)
    rejected: Counter[str] = Counter()
    body, numbers = numbered(lines, rejected, skip=2)
    streams = _split(body, numbers, path)
    if "drive" not in header:
        return _short(header, streams, path, name or str(path), rejected)
    arrays: Arrays = {}
    try:
        shapes = _shapes(header["drive"])
    except FglocError as error:
        raise FglocError(str(error), file=path, line=2) from None
    for stream, members in _streams(shapes).items():
        found = streams.pop(stream, None)
        if found is None:
            found = Stream(np.zeros(0, np.int64), [], np.zeros(0, np.int64))
        stamped = f"{stream}.stamps_ns" in shapes
        _fill(stream, members, found, path, arrays, rejected, stamped=stamped)
    _nothing_left(streams, path)
    drive = decode(header, arrays, path, name)
    if drive.truth is not None and not len(drive.truth.trajectory):
        # Cut off before its truth began; an empty truth would pass for one of another time.
        count(rejected, "truth without rows")
        drive = replace(drive, truth=None)
    total = Counter(drive.rejected)
    total.update(rejected)
    return replace(drive, rejected=dict(total))


def _shapes(node: Any) -> dict[str, dict[str, Any]]:
    """Return every array description in a header, by the array's name."""
    if isinstance(node, dict):
        if isinstance(node.get("array"), str):
            shape, dtype = node.get("shape"), node.get("dtype")
            if (
                dtype not in ("float64", "int64")
                or not isinstance(shape, list)
                or not all(isinstance(n, int) and 0 <= n < MOST_COLUMNS for n in shape[1:])
            ):
                raise FglocError(f"{node['array']} has no usable shape or dtype")
            return {node["array"]: node}
        node = list(node.values())
    if not isinstance(node, list):
        return {}
    return {key: shape for item in node for key, shape in _shapes(item).items()}


def _streams(arrays: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the arrays other than stamps of each stream, in order."""
    streams: dict[str, dict[str, Any]] = {}
    for key, value in arrays.items():
        stream, _, field = key.rpartition(".")
        members = streams.setdefault(stream, {})
        if field != "stamps_ns":
            members[key] = value
    return {s: dict(m) for s, m in streams.items()}


def _split(body: list[str], numbers: Integers, path: Path) -> dict[str, Stream]:
    """Return the rows of each stream. Raises FglocError for a row without an integer stamp."""
    rows: dict[str, tuple[list[str], list[str], list[int]]] = {}
    for line, number in zip(body, numbers.tolist(), strict=True):
        if line.startswith("#"):
            continue
        stream, _, rest = line.partition(",")
        stamp, _, values = rest.partition(",")
        texts, stamps, places = rows.setdefault(stream.strip(), ([], [], []))
        texts.append(values)
        stamps.append(stamp)
        places.append(number)
    streams = {}
    for name, (texts, stamps, places) in rows.items():
        bad = next((k for k, s in enumerate(stamps) if not _is_stamp(s)), None)
        if bad is not None:
            raise FglocError(
                f"{stamps[bad]!r} is not a stamp in whole nanoseconds", file=path, line=places[bad]
            )
        parsed = np.array([int(s) for s in stamps], dtype=np.int64)
        streams[name] = Stream(parsed, texts, np.array(places, dtype=np.int64))
    return streams


def _is_stamp(text: str) -> bool:
    """Return True if a text is a 64-bit integer."""
    return re.fullmatch(r"\s*-?\d{1,19}\s*", text, re.ASCII) is not None and (
        abs(int(text)) < 2**63
    )


def _fill(
    name: str,
    members: dict[str, dict[str, Any]],
    stream: Stream,
    path: Path,
    arrays: Arrays,
    rejected: Counter[str],
    *,
    stamped: bool = True,
) -> None:
    """Parse a stream into its arrays as the header describes them, dropping unusable rows.

    Rows that are not `stamped` are numbered, and in no order of time.
    """
    widths = [int(np.prod(shape["shape"][1:])) for shape in members.values()]
    width = sum(widths)
    interval = any(key.endswith(".angles") for key in members)
    repeats = any(key.endswith(".landmark") for key in members)
    values = _values(stream, width, interval, path)
    if interval:
        opened = bool(stream.texts) and bool(stream.texts[0].strip())
        count(rejected, "increment before the first stamp", int(opened))
        stamps, values, stretch = usable_increments(stream.stamps, values, rejected)
        steering = [c for c, key in enumerate(members) if key.endswith(".steering")]
        for column in steering:
            start = sum(widths[:column])
            values[:, start : start + widths[column]] /= stretch[:, None]
    else:
        good = finite_rows(values, rejected, f"{name} {NOT_A_NUMBER}")
        stamps, values = stream.stamps[good], values[good]
        if stamped:
            check = steady_stamps if repeats else forward_stamps
            later = check(stamps, rejected, f"{name} ")
            stamps, values = stamps[later], values[later]
    arrays[f"{name}.stamps_ns"] = stamps
    for (key, shape), part in zip(
        members.items(), np.split(values, np.cumsum(widths)[:-1], axis=1), strict=True
    ):
        whole: npt.NDArray[Any] = part.reshape(part.shape[0], *shape["shape"][1:])
        arrays[key] = whole.astype(shape["dtype"])


def _values(stream: Stream, width: int, interval: bool, path: Path) -> Floats:
    """Return (N, width) values; of increments the first row is not read and is zero."""
    texts, numbers = stream.texts, stream.numbers
    if interval:
        texts, numbers = texts[1:], numbers[1:]
    empty = next((k for k, text in enumerate(texts) if not text.strip()), None)
    if empty is not None:
        raise FglocError(f"{width} values are expected", file=path, line=int(numbers[empty]))
    table = np.zeros((0, width))
    if texts:
        table = parse_rows(texts, numbers, path, widths=(width,), rejected=None).columns(width)
    return np.concatenate([np.zeros((1, width)), table]) if interval and stream.texts else table


def _nothing_left(streams: dict[str, Stream], path: Path) -> None:
    """Raise FglocError for a stream that nothing describes."""
    for name, stream in streams.items():
        raise FglocError(
            f"the stream {name!r} is not known; remove it or describe it in the header",
            file=path,
            line=int(stream.numbers[0]),
        )


def _base(header: dict[str, Any], path: Path) -> WheeledBase:
    """Return the base that a short header describes."""
    robot = header["robot"] if isinstance(header.get("robot"), dict) else {}
    try:
        return make_base(robot, "robot")
    except FglocError as error:
        raise FglocError(str(error), file=path, line=2) from None


def _short(
    header: dict[str, Any],
    streams: dict[str, Stream],
    path: Path,
    name: str,
    rejected: Counter[str],
) -> Drive:
    """Return the drive of a file with the short header."""
    base = _base(header, path)
    _check_header(header, path)
    driven = len(base.driven_names)
    if "wheels" not in streams:
        raise FglocError("there are no rows 'wheels,stamp_ns,angles…'", file=path)
    fields = streams["wheels"].texts[-1].count(",") + 1
    steered = fields == 2 * driven
    shapes: dict[str, dict[str, Any]] = {
        key: {"shape": (0, columns), "dtype": "float64"}
        for key, columns in (
            ("wheels.angles", driven),
            *((("wheels.steering", driven),) if steered else ()),
            ("yaw.yaw", 1),
            ("gyro.rate", 1),
            ("fixes.xys", 4 if "fixes" in streams and _commas(streams["fixes"]) == 3 else 3),
            ("truth.poses", 3),
        )
    }
    arrays: Arrays = {}
    for stream, members in _streams(shapes).items():
        if stream in streams:
            _fill(stream, members, streams.pop(stream), path, arrays, rejected)
    _nothing_left(streams, path)
    try:
        return Drive(
            name,
            Robot.typical(str(header["robot"].get("name", base.kind)), base),
            WheelIncrements(
                "wheels",
                arrays["wheels.stamps_ns"],
                arrays["wheels.angles"],
                base.driven_names,
                steering=arrays.get("wheels.steering"),
            ),
            _short_sensors(header, arrays),
            truth=_short_truth(arrays),
            motion=header.get("motion"),
            rejected=dict(rejected),
        )
    except FglocError as error:
        raise FglocError(str(error), file=path) from None


def _check_header(header: dict[str, Any], path: Path) -> None:
    """Raise FglocError for an optional key of the short header that is not what it must be."""
    for key in ("yaw_sigma", "gyro_density"):
        value = header.get(key, 1.0)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise FglocError(f"{key} is {value!r}, a number is needed", file=path, line=2)
    if not isinstance(header.get("motion"), str | None):
        raise FglocError("motion must be a text", file=path, line=2)


def _commas(stream: Stream) -> int:
    """Return the number of commas in the first row's values."""
    return stream.texts[0].count(",")


def _short_sensors(header: dict[str, Any], arrays: Arrays) -> tuple[Sensor, ...]:
    """Return the sensors of a file with the short header."""
    sensors: list[Sensor] = []
    if "yaw.yaw" in arrays:
        sigma = float(header.get("yaw_sigma", 0.02))
        sensors.append(Yaw("yaw", arrays["yaw.stamps_ns"], arrays["yaw.yaw"][:, 0], sigma))
    if "gyro.rate" in arrays:
        density = float(header.get("gyro_density", 0.01))
        rate = arrays["gyro.rate"][:, 0]
        sensors.append(YawRate("gyro", arrays["gyro.stamps_ns"], rate, density))
    if "fixes.xys" in arrays:
        fixes = arrays["fixes.xys"]
        sigmas = fixes[:, [2, -1]]
        sensors.append(PositionFixes("fixes", arrays["fixes.stamps_ns"], fixes[:, :2], sigmas))
    return tuple(sensors)


def _short_truth(arrays: Arrays) -> Reference | None:
    """Return the truth of a file with the short header, the heading unwrapped."""
    if "truth.poses" not in arrays:
        return None
    poses = arrays["truth.poses"].copy()
    poses[:, 2] = np.unwrap(poses[:, 2])
    return Reference(Trajectory(arrays["truth.stamps_ns"], poses))
