"""The robot file: a TOML file that says what is known of a robot better than a drive does.

[robot]
name = "Jaguar, new tyres"
kind = "full-linear"                # another model of the same wheels; parameters are then its own
models = ["rotation-scale"]         # what motion does beyond it (fgloc.core.motion_models)

[parameters."effective_track"]      # one table a parameter; both keys may be left out
value = 0.72                        # m, rad, s or 1, as `fgloc compare` prints it
sigma = 0.02                        # prior standard deviation; 0 keeps the value fixed

[noise]
rolling = 0.02                      # the fields of WheelNoise, in their units

[sensors."lidar"]                   # where a sensor or the reference sits, if a drive has it
x = -0.13                           # x, y [m], yaw [rad], and x_sigma, y_sigma, yaw_sigma
time_offset = 0.0                   # by how much its stamps are early [s]
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import msgspec

from fgloc.atomic import write_text
from fgloc.core.bases import full_linear
from fgloc.core.bounds import dimension_problem
from fgloc.core.kinematics import Parameter, WheeledBase
from fgloc.core.motion_models import MODELS, PARAMETERS, added
from fgloc.core.robot import Robot, WheelNoise
from fgloc.errors import FglocError
from fgloc.toml_file import SMALLEST, TomlFile, quoted, read_toml


class RobotTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The table [robot]."""

    name: str | None = None
    """Name in tables and reports; None keeps the drive's."""
    kind: str | None = None
    """Kinematic model: "full-linear", or None or the drive's own to keep that."""
    models: tuple[str, ...] = ()
    """Models beyond the geometry, each with a parameter of its own."""


class ParameterTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One table [parameters."NAME"]."""

    value: float | None = None
    """Value to start from, in the parameter's unit; None keeps the drive's."""
    sigma: float | None = None
    """Prior standard deviation in the same unit, 0 = fixed; None keeps the drive's."""


class SensorTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One table [sensors."NAME"]; everything may be left out."""

    x: float | None = None
    """Place on the robot, forward [m]."""
    y: float | None = None
    """Place on the robot, to the left [m]."""
    yaw: float | None = None
    """Direction on the robot [rad]."""
    x_sigma: float | None = None
    """Prior standard deviation of x [m], 0 = known exactly."""
    y_sigma: float | None = None
    """Prior standard deviation of y [m]."""
    yaw_sigma: float | None = None
    """Prior standard deviation of yaw [rad]."""
    time_offset: float | None = None
    """By how much its stamps are early [s]; they are put right."""


NoiseTable = msgspec.defstruct(
    "NoiseTable",
    [(f.name, float | None, None) for f in fields(WheelNoise)],
    frozen=True,
    forbid_unknown_fields=True,
)
"""The table [noise]: the fields of WheelNoise, each optional."""


@dataclass(frozen=True)
class RobotFile(TomlFile):
    """The checked content of a robot file; everything may be left out."""

    name: str | None = None
    """What the robot is called."""
    kind: str | None = None
    """Which kinematic model it has."""
    models: tuple[str, ...] = ()
    """Which models it has beyond that."""
    parameters: Mapping[str, ParameterTable] = field(default_factory=dict)
    """Calibration parameters by contract name."""
    noise: Mapping[str, float] = field(default_factory=dict)
    """Fields of WheelNoise by name, only those that were given."""
    sensors: Mapping[str, SensorTable] = field(default_factory=dict)
    """Where sensors sit, by their names."""


def load_robot(path: str | Path) -> RobotFile:
    """Return the content of a robot file, checked for everything that needs no robot.

    Raises FglocError naming file, line where it is known, and key: a missing file, bad TOML, an
    unknown key, a wrong type, a number that is not finite or has the wrong sign.
    """
    read = read_toml(Path(path), "--robot", "robot file")
    file = RobotFile(read.source, read.text)
    raw = file.parse("robot", "parameters", "noise", "sensors")
    parameters = raw.get("parameters", {})
    if not isinstance(parameters, dict):
        raise file.error("parameters must be a table", "parameters")
    tables = {n: file.table(t, ParameterTable, "parameters", n) for n, t in parameters.items()}
    for name, table in tables.items():
        file.check_number(table.value, -math.inf, "parameters", name, "value")
        file.check_number(table.sigma, 0.0, "parameters", name, "sigma")
    given = msgspec.structs.asdict(file.table(raw.get("noise", {}), NoiseTable, "noise"))
    noise = {n: float(v) for n, v in given.items() if v is not None}
    for name, value in noise.items():
        # Without a floor an interval of a standing robot would be certain, its weight infinite.
        lowest = SMALLEST if name.startswith("standing") else 0.0
        file.check_number(value, lowest, "noise", name)
    robot = file.table(raw.get("robot", {}), RobotTable, "robot")
    for model in robot.models:
        if model not in MODELS:
            known_models = ", ".join(MODELS)
            message = f"robot.models: unknown model {model!r}; known are {known_models}"
            raise file.error(message, "robot", "models")
    return replace(
        file,
        name=robot.name,
        kind=robot.kind,
        models=robot.models,
        parameters=tables,
        noise=noise,
        sensors=_sensors(file, raw.get("sensors", {})),
    )


def _sensors(file: RobotFile, raw: object) -> dict[str, SensorTable]:
    """Return the checked tables of sensors."""
    if not isinstance(raw, dict):
        raise file.error("sensors must be a table", "sensors")
    found = {n: file.table(t, SensorTable, "sensors", n) for n, t in raw.items()}
    for name, table in found.items():
        for key, value in msgspec.structs.asdict(table).items():
            file.check_number(
                value, 0.0 if key.endswith("_sigma") else -math.inf, "sensors", name, key
            )
            unit = "rad" if key.startswith("yaw") else "s" if key == "time_offset" else "m"
            problem = None if value is None else dimension_problem(key, unit, value)
            if problem is not None and key != "yaw_sigma":
                raise file.error(f"sensors.{name}.{key} {problem}", "sensors", name, key)
    return found


def apply_robot(robot: Robot, path: str | Path | RobotFile) -> Robot:
    """Return the robot with what a robot file, or the one at `path`, says instead of its own.

    A new value without a sigma keeps the prior: relative for radii and track, absolute for
    positions and angles. Raises FglocError as `load_robot` does, and for a parameter that this
    robot does not have, that must be positive or whose size tells of a wrong unit.
    """
    file = path if isinstance(path, RobotFile) else load_robot(path)
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
    lines = ["[robot]", f"name = {quoted(robot.name)}", f"kind = {quoted(robot.base.kind)}"]
    models = [m for m, name in PARAMETERS.items() if any(p.name == name for p in added(robot.base))]
    if models:
        lines.append(f"models = [{', '.join(quoted(m) for m in models)}]")
    for p in robot.base.parameters:
        lines += [
            "",
            f"[parameters.{quoted(p.name)}]",
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
    if file.kind is not None and file.kind != base.kind:
        base = _of_kind(file, base)
    for model in file.models:
        if PARAMETERS[model] in [p.name for p in added(base)]:
            continue
        try:
            base = MODELS[model](base)
        except FglocError as error:
            raise file.error(f"robot.models: {error}", "robot", "models") from error
    return base


def _of_kind(file: RobotFile, base: WheeledBase) -> WheeledBase:
    """Return the base as another kinematic model of the same wheels."""
    if file.kind != "full-linear":
        known = f'"{base.kind}" or "full-linear"'
        message = f"robot.kind must be {known}, got {quoted(file.kind or '')}"
        raise file.error(message, "robot", "kind")
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
