"""The robot file: a TOML file that says what is known of a robot better than a drive does.

[robot]
name = "Jaguar, new tyres"
kind = "full-linear"                # another model of the same wheels; parameters are then its own

[parameters."effective_track"]      # one table a parameter; both keys may be left out
value = 0.72                        # m, rad, s or 1, as `fgloc compare` prints it
sigma = 0.02                        # prior standard deviation; 0 keeps the value fixed

[noise]
rolling = 0.02                      # the fields of WheelNoise, in their units
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TypeVar

import msgspec

from fgloc.atomic import write_text
from fgloc.core.bases import full_linear
from fgloc.core.bounds import dimension_problem
from fgloc.core.kinematics import Parameter, WheeledBase
from fgloc.core.robot import Robot, WheelNoise
from fgloc.errors import FglocError

T = TypeVar("T", bound=msgspec.Struct)
SMALLEST = sys.float_info.min
"""Lowest value of what must be positive."""
_KEY = re.compile(r"\"[^\"]*\"|'[^']*'|[\w-]+")
"""One key of a dotted path in TOML, with its quotes."""


class RobotTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The table [robot]."""

    name: str | None = None
    """Name in tables and reports; None keeps the drive's."""
    kind: str | None = None
    """Kinematic model: "full-linear", or None or the drive's own to keep that."""


class ParameterTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One table [parameters."NAME"]."""

    value: float | None = None
    """Value to start from, in the parameter's unit; None keeps the drive's."""
    sigma: float | None = None
    """Prior standard deviation in the same unit, 0 = fixed; None keeps the drive's."""


NoiseTable = msgspec.defstruct(
    "NoiseTable",
    [(f.name, float | None, None) for f in fields(WheelNoise)],
    frozen=True,
    forbid_unknown_fields=True,
)
"""The table [noise]: the fields of WheelNoise, each optional."""


@dataclass(frozen=True)
class RobotFile:
    """The checked content of a robot file; everything may be left out."""

    source: Path
    """Where it was read, for error messages."""
    text: str
    """What was read, for line numbers in error messages."""
    name: str | None = None
    """What the robot is called."""
    kind: str | None = None
    """Which kinematic model it has."""
    parameters: Mapping[str, ParameterTable] = field(default_factory=dict)
    """Calibration parameters by contract name."""
    noise: Mapping[str, float] = field(default_factory=dict)
    """Fields of WheelNoise by name, only those that were given."""

    def error(self, message: str, *key: str) -> FglocError:
        """Return an error about `key` (a path of keys), with file and, where found, line."""
        return FglocError(message, file=self.source, line=_line_of(self.text, key))


def load_robot(path: str | Path) -> RobotFile:
    """Return the content of a robot file, checked for everything that needs no robot.

    Raises FglocError naming file, line where it is known, and key: a missing file, bad TOML, an
    unknown key, a wrong type, a number that is not finite or has the wrong sign.
    """
    file = RobotFile(Path(path), _read(Path(path)))
    try:
        raw = msgspec.toml.decode(file.text)
    except msgspec.DecodeError as error:
        place = re.search(r"\s*\(at (?:line (\d+), column \d+|end of document)\)", str(error))
        line = int(place[1]) if place and place[1] else None
        reason = str(error)[: place.start()] if place else str(error)
        raise FglocError(f"is not TOML: {reason}", file=path, line=line) from error
    for name in raw:
        if name not in ("robot", "parameters", "noise"):
            known = "known are robot, parameters and noise"
            raise file.error(f"unknown key {name!r}; {known}", name)
    parameters = raw.get("parameters", {})
    if not isinstance(parameters, dict):
        raise file.error("parameters must be a table", "parameters")
    tables = {n: _table(file, t, ParameterTable, "parameters", n) for n, t in parameters.items()}
    for name, table in tables.items():
        _check_number(file, table.value, -math.inf, "parameters", name, "value")
        _check_number(file, table.sigma, 0.0, "parameters", name, "sigma")
    given = msgspec.structs.asdict(_table(file, raw.get("noise", {}), NoiseTable, "noise"))
    noise = {n: float(v) for n, v in given.items() if v is not None}
    for name, value in noise.items():
        # Without a floor an interval of a standing robot would be certain, its weight infinite.
        lowest = SMALLEST if name.startswith("standing") else 0.0
        _check_number(file, value, lowest, "noise", name)
    robot = _table(file, raw.get("robot", {}), RobotTable, "robot")
    return replace(file, name=robot.name, kind=robot.kind, parameters=tables, noise=noise)


def apply_robot(robot: Robot, path: str | Path) -> Robot:
    """Return the robot with what the robot file at `path` says instead of its own description.

    A new value without a sigma keeps the prior: relative for radii and track, absolute for
    positions and angles. Raises FglocError as `load_robot` does, and for a parameter that this
    robot does not have, that must be positive or whose size tells of a wrong unit.
    """
    file = load_robot(path)
    robot = replace(robot, base=_with_kind(file, robot.base))
    known = {p.name: p for p in robot.base.parameters}
    moved: dict[str, float] = {}
    for name, table in file.parameters.items():
        if name not in known:
            names = ", ".join(known) or "none"
            message = f"{robot.name} has no parameter {name!r}; it has {names}"
            raise file.error(message, "parameters", name)
        _check_dimensions(file, known[name], table)
        if table.value is None:
            continue
        if known[name].log and table.value <= 0.0:
            message = f"parameters.{name}.value must be positive, got {table.value!r}"
            raise file.error(message, "parameters", name, "value")
        if table.value != known[name].nominal:
            moved[name] = table.value
    base = robot.base.with_values(moved) if moved else robot.base
    sigmas = {n: t.sigma for n, t in file.parameters.items() if t.sigma is not None}
    return replace(
        robot,
        name=robot.name if file.name is None else file.name,
        base=_with_sigmas(base, sigmas),
        noise=replace(robot.noise, **file.noise),
    )


def robot_toml(robot: Robot) -> str:
    """Return a robot file that says everything `apply_robot` can set, without losing a digit."""
    lines = ["[robot]", f"name = {_quoted(robot.name)}", f"kind = {_quoted(robot.base.kind)}"]
    for p in robot.base.parameters:
        lines += [
            "",
            f"[parameters.{_quoted(p.name)}]",
            f"value = {float(p.nominal)!r}  # {p.unit}",
            f"sigma = {float(p.prior_sigma)!r}",
        ]
    lines += ["", "[noise]"]
    lines += [f"{f.name} = {float(getattr(robot.noise, f.name))!r}" for f in fields(WheelNoise)]
    return "\n".join(lines) + "\n"


def dump_robot(robot: Robot, path: str | Path) -> None:
    """Write `robot_toml` to `path`, whole or not at all; raises FglocError if it cannot."""
    write_text(path, robot_toml(robot))


def _with_kind(file: RobotFile, base: WheeledBase) -> WheeledBase:
    """Return the base as the kinematic model that the file wants."""
    if file.kind is None or file.kind == base.kind:
        return base
    if file.kind != "full-linear":
        known = f'"{base.kind}" or "full-linear"'
        raise file.error(f"robot.kind must be {known}, got {_quoted(file.kind)}", "robot", "kind")
    try:
        return full_linear(base)
    except FglocError as error:
        raise file.error(f"robot.kind: {error}", "robot", "kind") from error


def _with_sigmas(base: WheeledBase, sigmas: dict[str, float]) -> WheeledBase:
    """Return the base with other prior standard deviations, by parameter name."""

    def changed(p: Parameter) -> Parameter:
        return replace(p, prior_sigma=float(sigmas.get(p.name, p.prior_sigma)))

    return replace(base, parameters=tuple(changed(p) for p in base.parameters))


def _check_dimensions(file: RobotFile, known: Parameter, table: ParameterTable) -> None:
    """Raise FglocError for a value or sigma that must be in another unit."""
    for key, value in (("value", table.value), ("sigma", table.sigma)):
        # An angle may be unknown altogether, so its sigma may be anything.
        if value is None or (key == "sigma" and known.unit == "rad"):
            continue
        problem = dimension_problem(known.name, known.unit, value)
        if problem is not None:
            name = known.name
            raise file.error(f"parameters.{name}.{key} {problem}", "parameters", name, key)


def _read(path: Path) -> str:
    """Return the file's text; FglocError if it is missing or not UTF-8."""
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise FglocError("no such robot file; --robot wants a TOML file", file=path) from None
    except OSError as error:
        raise FglocError(f"cannot be read: {error.strerror}", file=path) from error
    except UnicodeDecodeError as error:
        raise FglocError("is not UTF-8 text; --robot wants a TOML file", file=path) from error


def _table(file: RobotFile, raw: object, kind: type[T], *key: str) -> T:
    """Return one table of the file as `kind`; FglocError for an unknown key or a wrong type."""
    try:
        return msgspec.convert(raw, kind)
    except msgspec.ValidationError as error:
        message, _, place = str(error).partition(" - at `$.")
        reason = message.replace("`", "").replace("object", "a table").replace(" | null", "")
    unknown = re.search(r"unknown field (.*)", reason)
    if unknown is None:
        path = (*key, place.rstrip("`")) if place else key
        raise file.error(f"{'.'.join(path)}: {reason[0].lower()}{reason[1:]}", *path)
    name = unknown[1]
    if key[0] == "parameters" and isinstance(raw, dict) and isinstance(raw[name], dict):
        # TOML takes [parameters.wheel_radius.left] for a table "left" inside "wheel_radius".
        hint = f'quote a name that has a dot: [parameters."{key[1]}.{name}"]'
    else:
        hint = f"known are {', '.join(kind.__struct_fields__)}"
    raise file.error(f"unknown key {name!r} in {'.'.join(key)}; {hint}", *key, name)


def _check_number(file: RobotFile, value: float | None, lowest: float, *key: str) -> None:
    """Raise FglocError unless `value` is None or finite and at least `lowest`."""
    if value is not None and not (math.isfinite(value) and value >= lowest):
        want = {-math.inf: "a finite number", 0.0: "finite and not negative"}.get(lowest)
        want = want or "finite and positive"
        raise file.error(f"{'.'.join(key)} must be {want}, got {value!r}", *key)


def _line_of(text: str, key: tuple[str, ...]) -> int | None:
    """Return the line number that names the most of a path of keys; None if none is named.

    A search by words, since the parsed content knows no lines: a table's header names the
    beginning of the path, a line in that table the rest.
    """
    best: tuple[int, int | None] = (0, None)
    header: list[str] = []
    for number, line in enumerate(text.splitlines(), 1):
        body = line.partition("#")[0].strip()
        if body.startswith("["):
            header = _KEY.findall(body)
            names = header
        else:
            names = header + _KEY.findall(body.partition("=")[0])
        names = [n.strip("\"'") for n in names]
        common = 0
        while common < min(len(names), len(key)) and names[common] == key[common]:
            common += 1
        if common > best[0]:
            best = (common, number)
    return best[1]


def _quoted(text: str) -> str:
    """Return a TOML basic string."""
    escapes = {'"': '\\"', "\\": "\\\\", "\n": "\\n", "\r": "\\r", "\t": "\\t"}
    body = "".join(
        escapes.get(c) or (f"\\u{ord(c):04x}" if ord(c) < 0x20 or ord(c) == 0x7F else c)
        for c in text
    )
    return f'"{body}"'
