"""What a solution of the window is worth, by what fixes and cameras say of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.factors.tables import FactorTable
from fgloc.smoothing.minimise import Point
from fgloc.smoothing.trust import doubted, tells

FEWEST = 2
"""Fewer factors of fixes and cameras in the window do not tell whether it is right."""


@dataclass(frozen=True)
class Evidence:
    """What fixes and cameras say of a solution."""

    strain: float
    """Mean robust cost per residual component; 0 if there are too few factors. About 0.5 where the
    noise models are right."""
    doubted: float
    """Share of the factors that have lost half their weight."""


def evidence(
    tables: Sequence[FactorTable],
    squared: Sequence[Floats],
    weights: Sequence[Floats],
) -> Evidence:
    """Return what fixes and cameras say, from (M,) values of the factors of each table."""
    return Evidence(mean_cost(tables, squared), doubted(tables, weights))


@dataclass(frozen=True)
class Trial:
    """The window solved in another way."""

    point: Point
    """States, calibration, factors and weights."""

    @property
    def evidence(self) -> Evidence:
        """Return what fixes and cameras say of it."""
        squared = [rows.squared for rows in self.point.linear]
        return evidence(self.point.tables, squared, self.point.weights)


def mean_cost(tables: Sequence[FactorTable], squared: Sequence[Floats]) -> float:
    """Return the mean robust cost per residual component of fixes and cameras; 0 if too few.

    About 0.5 where the noise models are right.
    """
    cost, count, rows = 0.0, 0, 0
    for table, values in zip(tables, squared, strict=True):
        if tells(table.kind, table.sensor):
            cost += float(np.sum(table.loss.cost(values)))
            count += values.size * table.dimension
            rows += values.size
    return cost / count if rows >= FEWEST else 0.0


def before(table: FactorTable, number: int) -> FactorTable:
    """Return the factors of a table whose first keyframe is below `number`."""
    k = int(np.searchsorted(table.first, number))
    return replace(
        table,
        first=table.first[:k],
        measurements=table.measurements[:k],
        sqrt_information=table.sqrt_information[:k],
    )
