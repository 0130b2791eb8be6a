"""What an experiment found: tables of published beside reproduced numbers, notes, figures.

Input of all renderers. A `Cell` judges its own published number or target, so that a verdict is the
same on the terminal, in Markdown, in HTML and in JSON.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import ROUND_HALF_UP, Decimal
from enum import StrEnum
from pathlib import Path
from typing import Any

from fgloc.core.trajectory import Trajectory


class Verdict(StrEnum):
    """What is to be said of one published number, or of one target."""

    REPRODUCED = "reproduced"
    """The number here is within one unit of the last printed digit."""
    INSIDE = "inside the central 95 %"
    """The printed number is one draw of a distribution, and lies in its central 95 %."""
    EXPLAINED = "explained"
    """It cannot follow from what is published; the cell's explanation gives the evidence."""
    FAILED = "NOT reproduced"
    """It differs, and nothing explains it."""
    MISSING = "not run"
    """There is no number here to compare with."""
    MET = "target met"
    """The number here is not above what it was to be at most."""
    MISSED = "target MISSED"
    """It is above."""


@dataclass(frozen=True)
class Distribution:
    """One number over many seeds."""

    median: float
    """Half of the seeds are below."""
    low: float
    """2.5 % of the seeds are below."""
    high: float
    """97.5 % of the seeds are below."""
    n: int
    """Number of seeds."""

    @classmethod
    def of(cls, values: Sequence[float]) -> Distribution:
        """Return median and central 95 % of some numbers (at least one), NaN where one is NaN."""
        import numpy as np

        low, median, high = np.quantile(np.asarray(values, float), (0.025, 0.5, 0.975)).tolist()
        return cls(median, low, high, len(values))


@dataclass(frozen=True)
class Cell:
    """One number of a table, and the published one where there is one."""

    value: float | Distribution | None
    """The number found here, or its distribution; None if there is none."""
    decimals: int = 3
    """Digits behind the point that are shown; those that were printed, if one is published."""
    published: float | None = None
    """The published number."""
    explanation: str = ""
    """Why the published number cannot follow from the published description, with evidence."""
    target: float | None = None
    """What this project's number is to be at most, where nothing is published."""

    @property
    def tolerance(self) -> float:
        """Return how far a number may be from the published one: a unit of its last digit.

        Half a unit would ask for the author's very arithmetic: 2.82 % is printed where 2.8251 %
        follows.
        """
        # A little more, so that a number on the edge is not decided by binary rounding.
        return 10.0**-self.decimals * (1.0 + 1e-9)

    @property
    def verdict(self) -> Verdict | None:
        """Return what is to be said of the published number or the target; None if there is none.

        One number must be within a unit of the published one's last digit, and so must the
        central 95 % of a distribution, at least at one of its ends. A target holds for all of the
        central 95 %, and for the number as it is, not as it is shown.
        """
        if self.published is None:
            return None if self.target is None else self._against_target(self.target)
        if self.value is None:
            return Verdict.MISSING
        if isinstance(self.value, Distribution):
            low, high, found = self.value.low, self.value.high, Verdict.INSIDE
        else:
            low = high = self.value
            found = Verdict.REPRODUCED
        if low - self.tolerance <= self.published <= high + self.tolerance:
            return found
        return Verdict.EXPLAINED if self.explanation else Verdict.FAILED

    def _against_target(self, target: float) -> Verdict:
        """Return whether the number is at most the target; NaN is not."""
        if self.value is None:
            return Verdict.MISSING
        highest = self.value.high if isinstance(self.value, Distribution) else self.value
        return Verdict.MET if highest <= target else Verdict.MISSED


@dataclass(frozen=True)
class Column:
    """One column of numbers."""

    key: str
    """Key of its cells, in rows and in JSON."""
    title: str
    """Heading, without the unit."""
    unit: str = ""
    """Unit of its numbers; empty for none, or where rows differ and say so in their labels."""


@dataclass(frozen=True)
class Row:
    """One line of a table."""

    labels: tuple[str, ...]
    """What the line is about, one text for each of the table's labels."""
    cells: Mapping[str, Cell | str]
    """Numbers (or words) by column key; a column that is missing stays empty."""


@dataclass(frozen=True)
class Table:
    """Published numbers or targets beside those found here.

    A column in which a cell has a published number is shown as two, published and here, and one in
    which a cell has a target likewise. The verdicts of a row stand in a last column.
    """

    id: str
    """Key in JSON, e.g. "table-3.2"."""
    title: str
    """What it shows, one line."""
    labels: tuple[str, ...]
    """Headings of the columns that say what a row is about."""
    columns: tuple[Column, ...]
    """Columns of numbers, in order."""
    rows: tuple[Row, ...]
    """Lines, in order."""
    notes: tuple[str, ...] = ()
    """Sentences that belong to this table."""

    def published(self, column: Column) -> bool:
        """Return True if some cell of the column has a published number."""
        cells = (row.cells.get(column.key) for row in self.rows)
        return any(isinstance(c, Cell) and c.published is not None for c in cells)

    def targeted(self, column: Column) -> bool:
        """Return True if some cell of the column has a target."""
        cells = (row.cells.get(column.key) for row in self.rows)
        return any(isinstance(c, Cell) and c.target is not None for c in cells)

    def judged(self) -> Iterator[tuple[Row, Column, Cell]]:
        """Yield every cell that has a published number or a target."""
        for row in self.rows:
            for column in self.columns:
                cell = row.cells.get(column.key)
                if isinstance(cell, Cell) and cell.verdict is not None:
                    yield row, column, cell


@dataclass(frozen=True)
class Figure:
    """A figure that is drawn when it is asked for."""

    name: str
    """File name without suffix."""
    caption: str
    """What it shows, one sentence."""
    draw: Callable[[Path], object]
    """Writes the PNG to a path."""


@dataclass(frozen=True)
class Report:
    """Everything an experiment found."""

    title: str
    """Heading."""
    tables: tuple[Table, ...]
    """Tables in order."""
    notes: tuple[str, ...] = ()
    """Sentences about the whole: what is simulated, what falls short and why."""
    figures: tuple[Figure, ...] = ()
    """Figures in order, not drawn yet."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Everything that determines the numbers: methods, seeds, drives."""
    trajectories: Mapping[str, Trajectory] = field(default_factory=dict)
    """Trajectories worth keeping, by file name without suffix ("circle-slip20/batch")."""
    data: Mapping[str, Any] = field(default_factory=dict)
    """Further numbers for JSON, e.g. every seed's."""

    def verdicts(self) -> dict[Verdict, int]:
        """Return how many numbers have each verdict, in the order of `Verdict`."""
        found = Counter(c.verdict for table in self.tables for _, _, c in table.judged())
        return {v: found[v] for v in Verdict if found[v]}


def number(value: float | None, decimals: int) -> str:
    """Return a number with so many decimals, "-" for one that does not exist."""
    if value is None or not math.isfinite(value):
        return "-"
    # Twelve digits first: 6.75 that arithmetic made 6.749999999999999 is printed as 6.8.
    exact = Decimal(f"{value:.12g}").quantize(Decimal(1).scaleb(-decimals), ROUND_HALF_UP)
    return f"{abs(exact) if exact == 0 else exact:f}"


def shown(cell: Cell | str | None) -> str:
    """Return the number here as text: one number, or the median with the central 95 %."""
    if cell is None or isinstance(cell, str):
        return cell or ""
    if isinstance(cell.value, Distribution):
        middle, low, high = (
            number(v, cell.decimals) for v in (cell.value.median, cell.value.low, cell.value.high)
        )
        return f"{middle} ({low}…{high})"
    return number(cell.value, cell.decimals)


def footnotes(table: Table) -> dict[str, str]:
    """Return the mark of each explanation that a verdict of the table needs: (a), (b), …"""
    needed = dict.fromkeys(
        cell.explanation for _, _, cell in table.judged() if cell.verdict is Verdict.EXPLAINED
    )
    return {text: f"({chr(ord('a') + k)})" for k, text in enumerate(needed)}


def verdict_text(table: Table, row: Row, marks: Mapping[str, str]) -> str:
    """Return the verdicts of a row; columns are named where they differ."""
    found: dict[str, str] = {}
    for judged, column, cell in table.judged():
        if judged is row and cell.verdict is not None:
            mark = marks[cell.explanation] if cell.verdict is Verdict.EXPLAINED else ""
            found[column.title] = f"{cell.verdict.value} {mark}".strip()
    if len(set(found.values())) <= 1:
        return next(iter(found.values()), "")
    return "; ".join(f"{title}: {text}" for title, text in found.items())
