"""Bars of errors by case and method, with the spread over seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.report.figures import colour, new_figure, save

WIDTH = 0.85
"""Width of the bars of one case."""
PALE = 0.45
"""Opacity of a method's second bar."""


@dataclass(frozen=True)
class Bars:
    """One panel of bars."""

    title: str
    """What is shown, with its unit."""
    values: Mapping[str, Sequence[Floats]]
    """By method, for every case the values over seeds."""


def plot_bars(
    panels: Sequence[Bars],
    cases: Sequence[str],
    shades: Mapping[str, tuple[str, bool, bool]],
    title: str,
    path: Path,
) -> Path:
    """Draw panels one below the other; return the PNG's path.

    A bar is the mean over seeds, its line holds the central 95 %. `shades` names for each method
    the method id whose colour it has, whether the bar is pale, and whether it is hatched.
    """
    figure = new_figure(11.0, 2.9 * len(panels) + 0.9)
    grid = figure.subplots(len(panels), 1, squeeze=False)[:, 0]
    for axes, panel in zip(grid, panels, strict=True):
        step = WIDTH / len(panel.values)
        for k, (name, values) in enumerate(panel.values.items()):
            own, pale, hatched = shades[name]
            at = np.arange(len(cases)) - 0.5 * WIDTH + (k + 0.5) * step
            means = np.array([np.mean(v) for v in values])
            low, high = np.array([np.quantile(v, (0.025, 0.975)) for v in values]).T
            axes.bar(
                at,
                means,
                0.9 * step,
                color=colour(own),
                alpha=PALE if pale else 1.0,
                hatch="///" if hatched else None,
                edgecolor="white",
                label=name,
            )
            several = np.array([v.size > 1 for v in values])
            axes.vlines(at[several], low[several], high[several], color="#333333", lw=1.0)
        axes.set_xticks(range(len(cases)), cases)
        axes.set_ylabel(panel.title)
        axes.grid(axis="y", alpha=0.3)
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", frameon=False, ncols=3)
    figure.suptitle(title)
    return save(figure, path)
