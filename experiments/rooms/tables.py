"""Tables of the simulated rooms: pose errors, map errors, associations, each over seeds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from fgloc.experiments.rooms.runs import ENTRANTS, LEAST_M, SHOWN, MapScore, Score
from fgloc.report.experiment_report import Cell, Column, Distribution, Row, Table

Scores = Mapping[str, Sequence[Score]]
"""What was found in one world, by entrant; one for each seed."""

JUDGED = ("batch",)
"""Who has targets."""
WALL_CM, WALL_DEG = 2.0, 0.3
"""Targets: how far a wall of batch may be off [cm, deg]."""
HALF = 0.5
"""Target: batch's position error is at most this share of EKF-SLAM's with the same extractor."""


def pose_table(world: str, scores: Scores) -> Table:
    """Return the pose errors of every entrant over seeds."""
    baseline = _ates(scores["ekf-slam"])
    rows = []
    for entrant in ENTRANTS:
        found = [s for s in scores[entrant.id] if not s.reason]
        if not found:
            rows.append(Row((entrant.title,), {"ate": _reason(scores[entrant.id])}))
            continue
        ates = _ates(scores[entrant.id])
        ratio = float(np.nanmedian(ates) / np.nanmedian(baseline))
        target = HALF if entrant.id in JUDGED else None
        cells: dict[str, Cell | str] = {
            "ate": _over(ates, 3),
            "heading": _over([s.heading_deg for s in found], 2),
            "end": _over([s.end_m for s in found], 3),
            "nees": _over([s.nees for s in found], 1),
            "seconds": Cell(float(np.median([s.seconds for s in found])), 2),
        }
        if math.isfinite(ratio):
            cells["ratio"] = Cell(ratio, 2, target=target)
        rows.append(Row((entrant.title,), cells))
    return Table(
        f"{world}-pose",
        f"{world}: errors of the pose, {_seeds(scores)}",
        ("method",),
        (
            Column("ate", "position RMSE", "m"),
            Column("heading", "heading RMSE", "deg"),
            Column("end", "end error", "m"),
            Column("nees", "NEES"),
            Column("ratio", "of EKF-SLAM's"),
            Column("seconds", "time", "s"),
        ),
        tuple(rows),
        (
            "Of EKF-SLAM's: the median position RMSE as a share of that of EKF-SLAM with the "
            "default extractor.",
        ),
    )


def map_table(world: str, scores: Scores) -> Table:
    """Return the errors of the maps over seeds: worst wall of each map, and all walls together."""
    rows = []
    for entrant in ENTRANTS:
        maps = [s.map for s in scores[entrant.id] if s.map is not None]
        if not maps:
            continue
        limits = (WALL_CM, WALL_DEG) if entrant.id in JUDGED else (None, None)
        cells: dict[str, Cell | str] = {
            "walls": _over([float(m.walls) for m in maps], 0),
            "missing": _over([float(m.missing) for m in maps], 0),
            "unmatched": _over([float(m.unmatched) for m in maps], 0),
            "rms": Cell(100.0 * _rms([v for m in maps for v in _of(m, m.middle_m)]), 2),
            "worst": _over([100.0 * _worst(_of(m, m.middle_m)) for m in maps], 1, limits[0]),
            "direction": Cell(_rms([v for m in maps for v in _of(m, m.direction_deg)]), 2),
            "worst_direction": _over([_worst(_of(m, m.direction_deg)) for m in maps], 2, limits[1]),
            "within": Cell(100.0 * _within(maps), 0),
            "short": Cell(100.0 * _rms([v for m in maps for v in _of(m, m.middle_m, True)]), 2),
            "short_direction": Cell(
                _rms([v for m in maps for v in _of(m, m.direction_deg, True)]), 2
            ),
        }
        rows.append(Row((entrant.title,), cells))
    return Table(
        f"{world}-map",
        f"{world}: errors of the walls, {_seeds(scores)}",
        ("method",),
        (
            Column("walls", "walls"),
            Column("missing", "missing"),
            Column("unmatched", "no wall"),
            Column("rms", "distance RMS", "cm"),
            Column("worst", "worst wall", "cm"),
            Column("direction", "direction RMS", "deg"),
            Column("worst_direction", "worst direction", "deg"),
            Column("within", f"within {WALL_CM:g} cm, {WALL_DEG:g}°", "%"),
            Column("short", "short ones: RMS", "cm"),
            Column("short_direction", "direction", "deg"),
        ),
        tuple(rows),
        (
            f"Walls that share at least {LEAST_M:g} m with a true one (short ones: less); distance "
            "at the middle of what both have, nothing aligned. Worst wall: of each map.",
            f"Missing: true lines that {SHOWN} scans or more show and the map lacks. No wall: "
            "walls of the map that lie on no true one.",
        ),
    )


def association_table(world: str, scores: Scores) -> Table:
    """Return how many pieces of wall were given to a wrong wall, in all seeds together."""
    rows = []
    for entrant in ENTRANTS:
        maps = [s.map for s in scores[entrant.id] if s.map is not None and s.map.used]
        if not maps:
            continue
        used, wrong = sum(m.used for m in maps), sum(m.wrong for m in maps)
        target = 0.0 if entrant.id in JUDGED else None
        rows.append(
            Row(
                (entrant.title,),
                {
                    "used": Cell(float(used), 0),
                    "wrong": Cell(float(wrong), 0, target=target),
                    "share": Cell(100.0 * wrong / used, 2),
                    "spurious": Cell(float(sum(m.spurious for m in maps)), 0),
                },
            )
        )
    return Table(
        f"{world}-association",
        f"{world}: which wall the pieces of scans were given to, all seeds",
        ("method",),
        (
            Column("used", "used"),
            Column("wrong", "wrong"),
            Column("share", "wrong", "%"),
            Column("spurious", "on no wall"),
        ),
        tuple(rows),
        (
            "Wrong: pieces of another true line than most pieces of their wall. Both sides of a "
            "thin wall are two lines; what is left and right of a door is one.",
        ),
    )


def _ates(scores: Sequence[Score]) -> list[float]:
    """Return the position errors of all seeds, NaN where the method could not run."""
    return [s.ate_m for s in scores]


def _over(values: Sequence[float], decimals: int, target: float | None = None) -> Cell:
    """Return a cell of numbers over seeds; one number where there is one seed.

    Seeds without a number (no such wall in the map) are left out, but never from what is judged.
    """
    known = [v for v in values if math.isfinite(v)] if target is None else values
    if len(known) <= 1:
        return Cell(known[0] if known else None, decimals, target=target)
    return Cell(Distribution.of(known), decimals, target=target)


def _of(one: MapScore, values: Sequence[float], short: bool = False) -> list[float]:
    """Return the values of a map's walls that are long enough to be judged, or of the others."""
    return [
        v for v, length in zip(values, one.overlap_m, strict=True) if (length < LEAST_M) == short
    ]


def _rms(values: Sequence[float]) -> float:
    """Return the root mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if values else math.nan


def _worst(values: Sequence[float]) -> float:
    """Return the largest of some numbers; NaN of nothing."""
    return max(values, default=math.nan)


def _within(maps: Sequence[MapScore]) -> float:
    """Return the share of judged walls within both targets."""
    found = [
        100.0 * middle <= WALL_CM and direction <= WALL_DEG
        for one in maps
        for middle, direction in zip(
            _of(one, one.middle_m), _of(one, one.direction_deg), strict=True
        )
    ]
    return float(np.mean(found)) if found else math.nan


def _seeds(scores: Scores) -> str:
    """Return how many seeds there are, in words."""
    count = len(next(iter(scores.values())))
    return f"{count} seed{'s' * (count != 1)}"


def _reason(scores: Sequence[Score]) -> str:
    """Return why nothing ran."""
    return scores[0].reason if scores else "not run"
