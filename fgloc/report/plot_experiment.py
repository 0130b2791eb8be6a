"""Small multiples of an experiment: draws with the published one, paths, curves over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.report.figures import TRUTH, colour, height, new_figure, save, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

P = TypeVar("P")
FLAT = 6.0
"""Paths more than this many times as long as wide, or as wide as long, are stretched."""
PUBLISHED = "#B00020"
"""Colour of published numbers."""


@dataclass(frozen=True)
class Draws:
    """One panel of distributions over seeds."""

    title: str
    """What was driven."""
    values: Mapping[str, Sequence[float]]
    """Numbers over seeds by method id."""
    published: float | None = None
    """The published number, if any."""
    published_by: str = ""
    """Method that it was published for."""


@dataclass(frozen=True)
class Paths:
    """One panel of paths in the plane."""

    title: str
    """What was driven."""
    paths: Mapping[str, Floats]
    """(N, 3) poses by method id."""
    truth: Floats
    """(M, 3) true poses."""


@dataclass(frozen=True)
class Curves:
    """One panel of a quantity over time."""

    title: str
    """What was driven."""
    seconds: Floats
    """(N,) time."""
    values: Mapping[str, Floats]
    """(N,) values by method id; one value is drawn over all time."""
    sigmas: Mapping[str, Floats] = field(default_factory=dict)
    """(N,) standard deviations by method id, drawn as ±2σ; one value holds for all time."""
    truth: float | None = None
    """The true value."""


def plot_draws(rows: Sequence[Sequence[Draws]], unit: str, title: str, path: Path) -> Path:
    """Draw distributions, a row of panels for each of `rows`; return the PNG's path.

    Each seed is a tick, the box holds half of them, the line 95 %, the dot is the median.
    """
    figure, grid = _grid(rows, 4.2, 1.0 + 0.42 * max(len(p.values) for r in rows for p in r))
    for axes, panel in _panels(grid, rows):
        names = list(panel.values)
        for k, name in enumerate(reversed(names)):
            values = np.asarray(panel.values[name], dtype=float)
            low, first, middle, third, high = np.quantile(values, (0.025, 0.25, 0.5, 0.75, 0.975))
            shade = colour(name)
            axes.plot(values, np.full(values.size, k - 0.3), "|", color=shade, ms=5, alpha=0.35)
            axes.plot([low, high], [k, k], color=shade, lw=1.6)
            axes.barh(k, third - first, left=first, height=0.32, color=shade, alpha=0.45)
            axes.plot(middle, k, "o", color=shade, ms=5)
        most = panel.published or 0.0
        if panel.published is not None:
            row = len(names) - 1 - names.index(panel.published_by)
            axes.plot([panel.published] * 2, [row - 0.45, row + 0.45], color=PUBLISHED, lw=2.2)
            axes.annotate(
                f"{panel.published:g}",
                (panel.published, row + 0.45),
                xytext=(0, 1),
                textcoords="offset points",
                ha="center",
                va="bottom",
                color=PUBLISHED,
                fontsize="small",
            )
        axes.set_yticks(range(len(names)), list(reversed(names)))
        axes.set_ylim(-0.6, len(names) - 0.2)
        # Room at the right, so that a published number at the edge keeps its label.
        axes.set_xlim(0.0, 1.08 * max(*(max(v) for v in panel.values.values()), most))
        axes.locator_params(axis="x", nbins=5)
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.set_title(panel.title, fontsize="medium")
        axes.grid(axis="x", alpha=0.3)
    for axes in grid[-1]:
        axes.set_xlabel(f"error at the end [{unit}]")
    figure.suptitle(title)
    if any(p.published is not None for r in rows for p in r):
        grid[0, 0].plot([], [], color=PUBLISHED, lw=2.2, label="published")
        figure.legend(loc="outside lower center", frameon=False)
    return save(figure, path)


def plot_paths(rows: Sequence[Sequence[Paths]], title: str, path: Path) -> Path:
    """Draw paths with their ends, a row of panels for each of `rows`; return the PNG's path.

    Axes have equal scales unless the paths are much longer than wide; the panel then says so.
    """
    figure, grid = _grid(rows, 4.4, 3.6)
    for axes, panel in _panels(grid, rows):
        axes.plot(*panel.truth[:, :2].T, color=TRUTH, lw=3.5, alpha=0.35, label="truth")
        axes.plot(*panel.truth[-1, :2], "o", color=TRUTH, ms=8, mfc="none", mew=1.4, zorder=5)
        for name, poses in panel.paths.items():
            axes.plot(
                *poses[:, :2].T,
                color=colour(name),
                ls=style(name),
                lw=1.3,
                label=name,
                zorder=height(name),
            )
            axes.plot(*poses[-1, :2], "s", color=colour(name), ms=5, mec="white", mew=0.6, zorder=4)
        _scale(axes, [panel.truth, *panel.paths.values()], panel.title)
        axes.grid(alpha=0.3)
    _label_edges(grid, "x [m]", "y [m]")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    handles += grid[0, 0].plot([], [], "o", color=TRUTH, ms=8, mfc="none", mew=1.4)
    handles += grid[0, 0].plot([], [], "s", color="#666666", ms=5)
    figure.legend(
        handles,
        [*labels, "true end", "estimated end"],
        loc="outside lower center",
        frameon=False,
        ncols=len(handles),
    )
    figure.suptitle(title)
    return save(figure, path)


def plot_curves(rows: Sequence[Sequence[Curves]], name: str, title: str, path: Path) -> Path:
    """Draw a quantity over time with ±2σ, a row of panels for each of `rows`."""
    figure, grid = _grid(rows, 4.2, 2.7)
    for axes, panel in _panels(grid, rows):
        for method, values in panel.values.items():
            line = np.broadcast_to(values, panel.seconds.shape)
            axes.plot(
                panel.seconds, line, color=colour(method), ls=style(method), lw=1.5, label=method
            )
            if method in panel.sigmas:
                band = 2.0 * np.broadcast_to(panel.sigmas[method], panel.seconds.shape)
                axes.fill_between(
                    panel.seconds, line - band, line + band, color=colour(method), alpha=0.18, lw=0
                )
        if panel.truth is not None:
            axes.axhline(panel.truth, color=TRUTH, lw=1.0, ls=(0, (6, 3)), label="truth")
        axes.set_title(panel.title, fontsize="medium")
        axes.grid(alpha=0.3)
    _label_edges(grid, "time [s]", name)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", frameon=False, ncols=len(labels))
    figure.suptitle(title)
    return save(figure, path)


def _grid(rows: Sequence[Sequence[object]], width: float, high: float) -> tuple[Figure, Floats]:
    """Return a figure and its (R, C) array of axes."""
    columns = max(len(row) for row in rows)
    figure = new_figure(width * columns, high * len(rows) + 0.9)
    return figure, figure.subplots(len(rows), columns, squeeze=False)


def _panels(grid: Floats, rows: Sequence[Sequence[P]]) -> list[tuple[Axes, P]]:
    """Return each panel with its axes; axes without a panel are hidden."""
    found = []
    for line, row in zip(grid, rows, strict=True):
        for k, axes in enumerate(line):
            if k < len(row):
                found.append((axes, row[k]))
            else:
                axes.set_visible(False)
    return found


def _label_edges(grid: Floats, x: str, y: str) -> None:
    """Write axis names at the outer edges only."""
    for axes in grid[-1]:
        axes.set_xlabel(x)
    for axes in grid[:, 0]:
        axes.set_ylabel(y)


def _scale(axes: Axes, paths: Sequence[Floats], title: str) -> None:
    """Set limits that hold all paths, with equal scales where that leaves something to see."""
    points = np.concatenate([p[:, :2] for p in paths])
    low, high = points.min(axis=0), points.max(axis=0)
    wide, tall = np.maximum(high - low, 1e-6)
    margin = 0.06 * max(wide, tall)
    if wide > FLAT * tall:
        axes.set_title(f"{title} (y not to scale)", fontsize="medium")
        axes.set(xlim=(low[0] - margin, high[0] + margin))
        axes.set(ylim=(low[1] - 0.15 * tall, high[1] + 0.15 * tall))
        return
    if tall > FLAT * wide:
        axes.set_title(f"{title} (x not to scale)", fontsize="medium")
        axes.set(xlim=(low[0] - 0.15 * wide, high[0] + 0.15 * wide))
        axes.set(ylim=(low[1] - margin, high[1] + margin))
        return
    axes.set_title(title, fontsize="medium")
    axes.set_aspect("equal", adjustable="box")
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
