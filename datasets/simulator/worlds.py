"""Worlds that a simulated lidar looks at: walls as straight pieces, and a course through them.

A world is a TOML file, one of `datasets/worlds` or the user's own:

    description = "…"
    [[walls]]                      # a line through points [m]
    points = [[0.0, 0.0], [6.0, 0.0]]
    closed = true                  # back to the first point; default false
    thickness = 0.12               # a wall with two sides about that line [m]; default 0
    [[arcs]]                       # a curved wall, cut into pieces that are 2 mm off at most
    centre = [0.0, 0.0]
    radius = 6.0
    start_deg = 90.0               # counter-clockwise from x
    end_deg = 270.0
    [course]
    waypoints = [[3.0, 1.0], …]    # corners of the robot's way [m], the first one its start
    closed = true                  # the way ends where it begins; default true
    speed = 0.5                    # cruising speed [m/s]; default 0.5
    laps = ["along", "sideways"]   # how often; sideways: without turning, if the base can do that
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np
import numpy.typing as npt

from fgloc.core.measurements import Floats
from fgloc.errors import FglocError
from fgloc.toml_file import TomlFile, read_toml

T = TypeVar("T")
NAMES = ("seed-b-room", "seed-c-1", "seed-c-2", "office", "hall")
"""Worlds that come with the package."""
SAGITTA_M = 0.002
"""How far the pieces of a curved wall are off it at most [m]."""
MOST_PIECES = 100_000
"""No world has more walls; cutting finer would only take time."""
FARTHEST_M, LONGEST_S = 1e4, 36_000.0
"""No way leads farther away [m], and no lap takes longer [s]: it would fill the memory."""
STYLES = ("along", "sideways")


class WallTable(msgspec.Struct, forbid_unknown_fields=True):
    """A `[[walls]]` table."""

    points: list[tuple[float, float]]
    """Corners [m]."""
    closed: bool = False
    """Whether a last piece goes back to the first corner."""
    thickness: float = 0.0
    """Distance between the two sides of the wall [m]."""


class ArcTable(msgspec.Struct, forbid_unknown_fields=True):
    """An `[[arcs]]` table."""

    centre: tuple[float, float]
    """Middle of the circle [m]."""
    radius: float
    """Radius of the circle [m]."""
    start_deg: float
    """Where the arc begins, counter-clockwise from x [deg]."""
    end_deg: float
    """Where it ends [deg]."""


class CourseTable(msgspec.Struct, forbid_unknown_fields=True):
    """The `[course]` table."""

    waypoints: list[tuple[float, float]]
    """Corners of the way [m]."""
    closed: bool = True
    """Whether the way ends at the first of them."""
    speed: float = 0.5
    """Cruising speed [m/s]."""
    laps: tuple[str, ...] = ("along",)
    """How it is driven, lap by lap."""


@dataclass(frozen=True)
class World:
    """Walls and a way between them; the map frame of drives in it is the world's."""

    name: str
    """Name or path."""
    description: str
    """What it is, in a few words."""
    walls: Floats
    """(W, 4) straight pieces x1, y1, x2, y2 [m], in no order; both sides are seen."""
    curved: npt.NDArray[np.bool_]
    """(W,) True for the pieces of a curved wall."""
    waypoints: Floats
    """(K, 2) corners of the robot's way [m]."""
    closed: bool = True
    """Whether the way ends where it begins."""
    speed: float = 0.5
    """Cruising speed [m/s]."""
    laps: tuple[str, ...] = ("along",)
    """How the way is driven, lap by lap: along it, or sideways (without turning)."""


def load_world(name: str | Path) -> World:
    """Return the world of a name, or of a TOML file where `name` is a path that ends in .toml.

    Raises FglocError for an unknown name, or for a file that cannot be read or is no world.
    """
    text = str(name)
    if text in NAMES:
        file = resources.files("fgloc.datasets") / "worlds" / f"{text}.toml"
        return parse_world(TomlFile(Path(f"{text}.toml"), file.read_text("utf-8")), text)
    if not text.endswith(".toml"):
        raise FglocError(f"there is no world {text!r}; use one of {', '.join(NAMES)}, or a .toml")
    return parse_world(read_toml(Path(text), "world=", "world"), text)


def parse_world(file: TomlFile, name: str) -> World:
    """Return the world in a TOML file; FglocError naming file and line for what is wrong in it."""
    raw = file.parse("description", "walls", "arcs", "course")
    description = raw.get("description", "")
    if not isinstance(description, str):
        raise file.error("description must be a text", "description")
    if "course" not in raw:
        raise file.error("there is no [course]; state the robot's way by its waypoints")
    course = file.table(raw["course"], CourseTable, "course")
    pieces: list[Floats] = [np.zeros((0, 4))]
    curved: list[bool] = []
    for k, entry in enumerate(_entries(file, raw, "walls")):
        table = file.table(entry, WallTable, "walls")
        pieces.append(_named(file, "walls", k, _straight, table))
        curved += [False] * pieces[-1].shape[0]
    for k, entry in enumerate(_entries(file, raw, "arcs")):
        pieces.append(_named(file, "arcs", k, _arc, file.table(entry, ArcTable, "arcs")))
        curved += [True] * pieces[-1].shape[0]
    if len(curved) > MOST_PIECES:
        raise file.error(f"{len(curved)} pieces of wall are more than {MOST_PIECES}", "walls")
    waypoints = np.array(course.waypoints, dtype=np.float64).reshape(-1, 2)
    file.check_number(course.speed, 1e-3, "course", "speed")
    apart = np.hypot(*np.diff(waypoints, axis=0, append=waypoints[:1]).T)
    if not bool(np.all(np.abs(waypoints) <= FARTHEST_M)):
        raise file.error(f"waypoints must lie within {FARTHEST_M:g} m of the origin", "course")
    if float(apart.sum()) > LONGEST_S * course.speed:
        raise file.error(f"a lap would take more than {LONGEST_S:g} s at this speed", "course")
    if waypoints.shape[0] < 2 or not np.all(apart[: None if course.closed else -1] > 0.0):
        raise file.error("at least two waypoints, each another than the one before", "course")
    if not course.laps or not set(course.laps) <= set(STYLES):
        raise file.error(f"course.laps must be a list of {' and '.join(STYLES)}", "course", "laps")
    return World(
        name,
        description,
        np.concatenate(pieces),
        np.array(curved, dtype=np.bool_),
        waypoints,
        course.closed,
        course.speed,
        course.laps,
    )


def _entries(file: TomlFile, raw: dict[str, Any], key: str) -> list[Any]:
    """Return the tables of `[[key]]`; FglocError if it is something else."""
    entries = raw.get(key, [])
    if not isinstance(entries, list):
        raise file.error(f"{key} must be written as [[{key}]], one table each", key)
    return entries


def _named(file: TomlFile, key: str, k: int, make: Callable[[T], Floats], table: T) -> Floats:
    """Return the pieces that `make` makes of table `k`; its ValueError becomes one of the file."""
    try:
        return make(table)
    except ValueError as error:
        raise file.error(f"{key}, table {k + 1}: {error}", key) from None


def _straight(table: WallTable) -> Floats:
    """Return the pieces (N, 4) of a wall; ValueError for one that is none."""
    points = np.array(table.points, dtype=np.float64).reshape(-1, 2)
    if table.closed:
        points = np.concatenate([points, points[:1]])
    if points.shape[0] < 2 or not bool(np.all(np.isfinite(points))):
        raise ValueError("at least two points are needed, with finite coordinates")
    ends = np.concatenate([points[:-1], points[1:]], axis=1)
    length = np.hypot(ends[:, 2] - ends[:, 0], ends[:, 3] - ends[:, 1])
    if not bool(np.all(length > 0.0)):
        raise ValueError("two points in a row are the same")
    if not 0.0 <= table.thickness < math.inf:
        raise ValueError("thickness must be finite and not negative")
    if table.thickness == 0.0:
        return ends
    # Each piece becomes a rectangle; where two of them overlap, nothing of that is seen.
    half = 0.5 * table.thickness * (ends[:, 2:] - ends[:, :2]) / length[:, None]
    side = np.stack([-half[:, 1], half[:, 0]], axis=1)
    corners = [ends[:, :2] + side, ends[:, 2:] + side, ends[:, 2:] - side, ends[:, :2] - side]
    sides = [
        np.concatenate([a, b], axis=1)
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True)
    ]
    return np.concatenate(sides)


def _arc(table: ArcTable) -> Floats:
    """Return the pieces (N, 4) of a curved wall; ValueError for one that is none."""
    start, end = math.radians(table.start_deg), math.radians(table.end_deg)
    if not (all(map(math.isfinite, (*table.centre, start, end))) and 0 < table.radius < math.inf):
        raise ValueError("centre and angles must be finite, the radius positive")
    if not 0.0 < abs(end - start) <= 2.0 * math.pi + 1e-9:
        raise ValueError("an arc is up to 360 degrees long")
    # The middle of a chord over an angle a is r·(1 - cos(a/2)), at most r·a²/8, inside the circle.
    largest = min(math.sqrt(8.0 * SAGITTA_M / table.radius), math.pi / 4.0)
    count = math.ceil(abs(end - start) / largest)
    if count > MOST_PIECES:
        raise ValueError("the radius is too large for an arc; write a straight wall")
    angle = np.linspace(start, end, count + 1)
    x = table.centre[0] + table.radius * np.cos(angle)
    y = table.centre[1] + table.radius * np.sin(angle)
    return np.stack([x[:-1], y[:-1], x[1:], y[1:]], axis=1)
