"""Seed A's tables: printed numbers beside those found, and what the seed did not print."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from fgloc.experiments.seed_a.published import (
    CASES,
    HEADING,
    POSITION,
    QUANTITIES,
    RELATIVE,
    SCALES,
    TABLE_3_4_CIRCLE,
    TABLE_3_4_SLIP,
    TRACK,
    TURN,
    Printed,
    Scale,
)
from fgloc.experiments.seed_a.runs import End, Ends, Entrant, Scenario
from fgloc.report.experiment_report import Cell, Column, Distribution, Row, Table

DECIMALS = {POSITION: 3, RELATIVE: 2, HEADING: 1, TURN: 2, TRACK: 3}
"""Digits of numbers that are not printed by the seed; others have as many as the printed one."""
SLIPS = {
    "slip20": "20 %",
    "slip40ticks": "+40 counts",
    "slip40ticks96": "+40 counts, 9 and 6 packets",
}
"""Scenarios of slip and how they are called."""
WHAT = {
    "noise": "noise of encoders and yaw",
    "slip": "slip of two wheels",
    "vehicle": "laboratory runs, SIMULATED, encoders selected",
    "unselected": "laboratory run, SIMULATED, encoders not selected",
}
"""What a printed table is about, by its scenario."""
TRUE_TRACK = {"straight": 0.48, "spin": 0.72, "circle": 0.9}
"""True effective track of each case [m]."""


def values(ends: Sequence[End], quantity: str, scale: Scale) -> list[float]:
    """Return a quantity of every seed; failures are left out, and methods without a track."""
    found = []
    for end in ends:
        number: float | None = {
            POSITION: end.position_m,
            RELATIVE: 100.0 * end.position_m / scale.path_m,
            HEADING: end.heading_deg,
            TURN: 100.0 * end.heading_deg / scale.turn_deg,
            TRACK: end.track,
        }[quantity]
        if number is not None and not end.failure:
            found.append(number)
    return found


def one(numbers: Sequence[float], seeds: int) -> float | Distribution | None:
    """Return the distribution of numbers over seeds, the number itself of none; None of nothing."""
    if not numbers:
        return None
    return Distribution.of(numbers) if seeds else numbers[0]


def decimals(text: str) -> int:
    """Return how many digits stand behind the point of a printed number."""
    return len(text.partition(".")[2])


def printed_table(
    printed: Printed,
    scenarios: Sequence[Scenario],
    entrants: Sequence[Entrant],
    ends: Ends,
    scales: Mapping[str, Scale] = SCALES,
) -> Table:
    """Return a printed table beside the same method here and all that are not printed.

    `entrants` begin with those that the table is about (Model 3 may be there twice); the first is
    judged. A table of slip has a row for each kind of slip.
    """
    judged = entrants[0]
    rows = []
    for case in CASES:
        for scenario in scenarios:
            for quantity in (*QUANTITIES, TRACK):
                text = printed.cells.get((case, quantity))
                if text is None:
                    continue
                cells = {
                    e.id: Cell(
                        one(
                            values(ends[scenario.key, case, e.id], quantity, SCALES[case]),
                            scenario.seeds,
                        ),
                        decimals(text),
                    )
                    for e in entrants
                }
                reason = _explanation(printed, scenario, case, quantity)
                if reason is not None:
                    cells[judged.id] = Cell(
                        cells[judged.id].value, decimals(text), float(text), reason
                    )
                slip = (SLIPS[scenario.key],) if scenario.key in SLIPS else ()
                rows.append(Row((case, *slip, quantity), cells))
    slip = ("slip",) if printed.scenario == "slip" else ()
    kind, _, number = printed.id.partition("-")
    name = f"Table {number}" if kind == "table" else f"Text of section {number}"
    return Table(
        printed.id,
        f"{name}: {judged.title}, {WHAT[printed.scenario]}",
        ("case", *slip, "at the end"),
        tuple(Column(e.id, e.title) for e in entrants),
        tuple(rows),
    )


def _explanation(printed: Printed, scenario: Scenario, case: str, quantity: str) -> str | None:
    """Return why a printed number may differ ("" for no reason); None if it is not compared.

    The text describes a slip of 20 %; 40 counts are compared with Table 3.4 only, which follows
    from them.
    """
    if printed.id == "table-3.4":
        if scenario.key == "slip20":
            return TABLE_3_4_SLIP
        return TABLE_3_4_CIRCLE if (case, scenario.key) == ("circle", "slip40ticks") else ""
    if scenario.key in SLIPS and scenario.key != "slip20":
        return None
    return printed.explanations.get((case, quantity), "")


def comparison_table(
    key: str,
    title: str,
    scenarios: Sequence[tuple[Scenario, str]],
    entrants: Sequence[Entrant],
    ends: Ends,
    quantities: Sequence[str] = (POSITION, HEADING),
    notes: tuple[str, ...] = (),
    scales: Mapping[str, Scale] = SCALES,
) -> Table:
    """Return a table of what the seed did not print: methods side by side, rows by scenario."""
    rows = []
    for case in CASES:
        for scenario, name in scenarios:
            for quantity in quantities:
                cells = {}
                for e in entrants:
                    found = ends.get((scenario.key, case, e.id))
                    if found is not None:
                        numbers = values(found, quantity, scales[case])
                        cells[e.id] = Cell(one(numbers, scenario.seeds), DECIMALS[quantity])
                labels = (case, name, quantity) if len(scenarios) > 1 else (case, quantity)
                rows.append(Row(labels, cells))
    return Table(
        key,
        title,
        ("case", "drive", "error at the end")
        if len(scenarios) > 1
        else ("case", "error at the end"),
        tuple(Column(e.id, e.title) for e in entrants),
        tuple(rows),
        notes,
    )


def track_table(
    scenarios: Sequence[tuple[Scenario, str]], entrants: Sequence[Entrant], ends: Ends
) -> Table:
    """Return the effective tracks that methods found, with the sigma they state."""
    rows = []
    for case in CASES:
        for scenario, name in scenarios:
            cells: dict[str, Cell | str] = {"true": Cell(TRUE_TRACK[case])}
            for e in entrants:
                found = [x for x in ends.get((scenario.key, case, e.id), []) if x.track is not None]
                if not found:
                    continue
                tracks = [x.track for x in found if x.track is not None]
                sigmas = [x.track_sigma for x in found if x.track_sigma is not None]
                cells[e.id] = Cell(one(tracks, scenario.seeds))
                cells[f"{e.id}-sigma"] = Cell(sorted(sigmas)[len(sigmas) // 2])
            rows.append(Row((case, name), cells))
    columns = [Column("true", "true", "m")]
    for e in entrants:
        columns += [Column(e.id, e.title, "m"), Column(f"{e.id}-sigma", "±σ", "m")]
    return Table(
        "effective-track",
        "Effective track found, from 0.48 m ± 0.168 m",
        ("case", "drive"),
        tuple(columns),
        tuple(rows),
        ("A straight run does not turn, so it says nothing about the track.",),
    )


def failures(ends: Ends) -> Iterator[str]:
    """Yield a sentence for every method that failed on some drives."""
    for (scenario, case, entrant), found in ends.items():
        failed = [e.failure for e in found if e.failure]
        if failed:
            where = f"{len(failed)} of {len(found)} drives {scenario} {case}"
            yield f"{entrant} failed on {where}: {failed[0]}"


def end_errors(ends: Ends) -> dict[str, Any]:
    """Return the end errors of every seed, and the time that each method took in all [s]."""
    seconds: dict[str, float] = {}
    errors: dict[str, Any] = {}
    for (scenario, case, who), found in ends.items():
        seconds[who] = seconds.get(who, 0.0) + sum(e.seconds for e in found)
        errors.setdefault(scenario, {}).setdefault(case, {})[who] = {
            "x_m": [e.x_m for e in found],
            "y_m": [e.y_m for e in found],
            "heading_deg": [e.turned_deg for e in found],
            "effective_track_m": [e.track for e in found],
        }
    return {"end_errors": errors, "seconds": seconds}
