"""Small multiples of maps: walls and path of a method over the true ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.report.figures import TRUTH, colour, new_figure, save


@dataclass(frozen=True)
class Room:
    """One panel: what a method made of a room."""

    title: str
    """What was driven, by whom."""
    method: str
    """Method id, for the colour."""
    truth: Floats
    """(W, 4) true walls x1, y1, x2, y2 [m]."""
    driven: Floats
    """(M, 3) true poses."""
    path: Floats
    """(N, 3) estimated poses."""
    walls: Floats | None
    """(L, 2, 2) ends of the map's walls [m]; None for a method without a map."""


def plot_rooms(rows: Sequence[Sequence[Room]], title: str, path: Path) -> Path:
    """Draw maps over the true walls, a row of panels for each of `rows`; return the PNG's path."""
    from matplotlib.collections import LineCollection

    columns = max(len(row) for row in rows)
    figure = new_figure(3.6 * columns, 3.6 * len(rows) + 0.6)
    grid = figure.subplots(len(rows), columns, squeeze=False)
    for line, row in zip(grid, rows, strict=True):
        for k, axes in enumerate(line):
            if k >= len(row):
                axes.set_visible(False)
                continue
            room = row[k]
            shade = colour(room.method)
            axes.add_collection(
                LineCollection(list(room.truth.reshape(-1, 2, 2)), colors=TRUTH, lw=3.0, alpha=0.25)
            )
            axes.plot(*room.driven[:, :2].T, color=TRUTH, lw=2.5, alpha=0.25)
            if room.walls is not None:
                axes.add_collection(LineCollection(list(room.walls), colors=shade, lw=1.4))
            axes.plot(*room.path[:, :2].T, color=shade, lw=0.8, ls=(0, (4, 1)))
            corners = room.truth.reshape(-1, 2)
            low, high = corners.min(axis=0), corners.max(axis=0)
            margin = 0.08 * float(np.max(high - low))
            axes.set(xlim=(low[0] - margin, high[0] + margin))
            axes.set(ylim=(low[1] - margin, high[1] + margin))
            axes.set_aspect("equal", adjustable="box")
            axes.set_title(room.title, fontsize="small")
            axes.grid(alpha=0.3)
    for axes in grid[-1]:
        axes.set_xlabel("x [m]")
    for axes in grid[:, 0]:
        axes.set_ylabel("y [m]")
    figure.suptitle(title)
    return save(figure, path)
