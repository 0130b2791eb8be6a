"""The map that the online engine leaves: walls and marks with what is uncertain of them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.lidar.walls import Map, Marks, Walls
from fgloc.online.engine import OnlineEngine
from fgloc.online.scans import ScanTable
from fgloc.online.sightings import MarkTable


def map_of(engine: OnlineEngine) -> Map | None:
    """Return walls and marks as they are known now; None where no sensor sees any.

    Those in use have the covariance of the newest keyframe's posterior. Those put aside have what
    followed when the window's first keyframe was all that was known: never too little.
    """
    tables = engine.spots.tables.values()
    lidars = [t for t in tables if isinstance(t, ScanTable)]
    cameras = [t for t in tables if isinstance(t, MarkTable)]
    if not (lidars or cameras):
        return None
    known = _landmarks(engine)
    walls = [_walls(table, known) for table in lidars]
    marks = [_marks(table, known) for table in cameras]
    # Of several lidars the first one's map stands for all: walls have no sensor's name.
    return Map(walls=walls[0] if walls else None, marks=marks[0] if marks else None)


def _landmarks(engine: OnlineEngine) -> dict[int, tuple[Floats, Floats]]:
    """Return value (2,) and covariance (2, 2) of every landmark."""
    window, smoother = engine.window, engine.map_smoother
    marks, posterior, b = window.landmarks, smoother.posterior, window.layout.width
    known = {}
    for number in marks.used:
        own = marks.columns(number)
        wide = slice(b + own.start, b + own.stop)
        known[number] = smoother.border[own], posterior.covariance[wide, wide]
    aside = marks.aside
    if aside.numbers:
        assert window.prior is not None
        inverse = np.linalg.inv(window.prior.sqrt_information[0])
        values = aside.values(window.states.view[0], smoother.border)
        covariances = aside.marginals(inverse @ inverse.T)
        known.update(
            {n: (v, c) for n, v, c in zip(aside.numbers, values, covariances, strict=True)}
        )
    return known


def _walls(table: ScanTable, known: dict[int, tuple[Floats, Floats]]) -> Walls:
    """Return the walls that a lidar has met."""
    walls = table.walls
    numbers = walls.numbers.view.tolist()
    lines = np.array([known[n][0] for n in numbers]).reshape(-1, 2)
    return Walls(
        normal=lines[:, 0],
        offset=lines[:, 1],
        anchor=walls.anchors.view.copy(),
        reach=walls.reach.view.copy(),
        covariance=np.array([known[n][1] for n in numbers]).reshape(-1, 2, 2),
        sightings=walls.sightings.view.copy(),
    )


def _marks(table: MarkTable, known: dict[int, tuple[Floats, Floats]]) -> Marks:
    """Return the marks that a sensor has seen, by their identities."""
    order = sorted(table.numbers)
    numbers = [table.numbers[mark] for mark in order]
    return Marks(
        landmark=np.array(order, dtype=np.int64),
        positions=np.array([known[n][0] for n in numbers]).reshape(-1, 2),
        covariance=np.array([known[n][1] for n in numbers]).reshape(-1, 2, 2),
        sightings=np.array([table.sightings[n] for n in numbers], dtype=np.int64),
    )


def map_notes(engine: OnlineEngine) -> Iterator[str]:
    """Yield what a user should know of how the map was made."""
    for table in engine.spots.tables.values():
        if not isinstance(table, ScanTable):
            continue
        if table.used:
            yield (
                f"{table.used} scans of {table.sensor} were used, {table.unused} came before the "
                f"robot had moved {table.way_m:g} m or {np.degrees(table.turn):.0f} deg on"
            )
        bearings = table.bearings
        if bearings.times_lost:
            yield (
                f"{bearings.times_lost} times the walls that {table.sensor} saw did not fit any "
                "more: the robot was moved, or its wheels hung in the air; "
                f"{bearings.times_found} times it found its place again at once"
            )
        if table.joined or table.forgotten:
            yield (
                f"{table.joined} walls of {table.sensor} were found to be parts of others, "
                f"{table.forgotten} were seen too seldom to be kept"
            )
