"""Figures of where the robot was: the path with its uncertainty, and the errors over time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fgloc.core.evaluation import error_series, map_mount
from fgloc.core.measurements import Floats, PoseFixes, PositionFixes
from fgloc.report.ellipses import draw_ellipses
from fgloc.report.figures import FIX, TRUTH, colour, height, new_figure, save, style
from fgloc.report.outcomes import DriveOutcome

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ELLIPSES = 30
"""Covariance ellipses drawn along a path."""


def plot_trajectory(outcome: DriveOutcome, path: Path) -> Path:
    """Draw truth, methods, 95 % ellipses and fixes in the map plane; return the PNG's path.

    Paths are those of the truth's own frame (where it is mounted on the robot), since that is
    what errors are measured on; of the base where there is no truth. Ellipses too small to be
    seen are magnified by a round number that the legend names.
    """
    drive = outcome.drive
    mapped = {m: map_mount(f.result.trajectory, f.mount) for m, f in outcome.methods.items()}
    shown = [t.poses[:, :2] for t in mapped.values()]
    if drive.truth is not None:
        shown.insert(0, drive.truth.trajectory.poses[:, :2])
    everything = np.concatenate(shown)
    low, high = everything.min(axis=0), everything.max(axis=0)
    extent = max(float((high - low).max()), 1e-3)
    # A straight drive gets room at its sides, or equal axes would squeeze it to a line.
    margin = np.maximum(0.05 * extent, 0.5 * (0.3 * extent - (high - low)))
    low, high = low - margin, high + margin
    size = (high - low) * min(8.0 / (high[0] - low[0]), 7.0 / (high[1] - low[1]))
    figure = new_figure(max(float(size[0]), 6.0) + 1.0, float(size[1]) + 1.9)
    axes = figure.add_subplot()
    if drive.truth is not None:
        axes.plot(*shown[0].T, color=TRUTH, lw=3.5, alpha=0.35, label="truth")
    for method, trajectory in mapped.items():
        x, y = trajectory.poses[:, 0], trajectory.poses[:, 1]
        axes.plot(
            x,
            y,
            color=colour(method),
            ls=style(method),
            lw=1.4,
            label=method,
            zorder=height(method),
        )
        axes.plot(x[-1], y[-1], "s", color=colour(method), ms=6, mec="white", mew=0.8, zorder=4)
        if trajectory.covariances is not None:
            _ellipses(axes, trajectory.poses, trajectory.covariances, extent, method)
    places = [(f.sensor, f.positions) for f in drive.each(PositionFixes)]
    places += [(f.sensor, f.poses[:, :2]) for f in drive.each(PoseFixes)]
    for sensor, positions in places:
        axes.plot(*positions.T, "+", color=FIX, ms=9, mew=1.8, label=sensor)
    axes.plot(*everything[0], "o", color=TRUTH, ms=7, mfc="white", mew=1.5, label="start", zorder=5)
    axes.plot([], [], "s", color="#666666", ms=6, label="end")
    axes.set(title=drive.name, xlabel="x [m]", ylabel="y [m]")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.set_aspect("equal", adjustable="box")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", frameon=False, ncols=4)
    return save(figure, path)


def _ellipses(axes: Axes, poses: Floats, covariances: Floats, extent: float, method: str) -> None:
    """Draw 95 % ellipses of (x, y) at some poses, evenly spaced in time."""
    chosen = np.unique(np.linspace(0, len(poses) - 1, ELLIPSES).astype(np.int64))
    # The typical ellipse should span some 4 % of the figure.
    draw_ellipses(
        axes,
        poses[chosen, :2],
        covariances[chosen, :2, :2],
        0.04 * extent,
        colour(method),
        f"{method}, 95 %",
    )


def plot_errors(outcome: DriveOutcome, path: Path) -> Path | None:
    """Draw the errors of x, y and heading over time; return the PNG's path, None without truth.

    Where some methods know their covariance, a second column shows those alone with ±2σ, since a
    method that drifts would flatten them.
    """
    drive = outcome.drive
    if drive.truth is None:
        return None
    series = {
        method: error_series(found.result.trajectory, drive.truth, found.mount)
        for method, found in outcome.methods.items()
    }
    certain = {m: s for m, s in series.items() if s.covariances is not None}
    blocks = [series, certain] if certain and len(certain) < len(series) else [series]
    figure = new_figure(6.0 * len(blocks) + 1.0, 7.5)
    grid = figure.subplots(3, len(blocks), sharex=True, squeeze=False)
    begin = int(drive.wheels.stamps_ns[0])
    names = ("x error [m]", "y error [m]", "heading error [deg]")
    for column, block in enumerate(blocks):
        for row, name in enumerate(names):
            axes = grid[row, column]
            unit = 180.0 / np.pi if row == 2 else 1.0
            for method, s in block.items():
                t = (s.stamps_ns - begin) * 1e-9
                axes.plot(
                    t,
                    unit * s.errors[:, row],
                    color=colour(method),
                    ls=style(method),
                    lw=1.1,
                    zorder=height(method),
                    label=method if row == 0 else None,
                )
                if s.covariances is not None and block is blocks[-1]:
                    band = 2.0 * unit * np.sqrt(np.maximum(s.covariances[:, row, row], 0.0))
                    axes.fill_between(
                        t,
                        -band,
                        band,
                        color=colour(method),
                        alpha=0.2,
                        lw=0,
                        label=f"{method} ±2σ" if row == 0 else None,
                    )
            axes.axhline(0.0, color=TRUTH, lw=0.6)
            axes.grid(alpha=0.3)
            axes.set_ylabel(name)
        grid[0, column].legend(loc="best", fontsize="small")
        grid[2, column].set_xlabel("time [s]")
        if len(blocks) > 1:
            grid[0, column].set_title("all methods" if column == 0 else "with covariance")
    figure.suptitle(f"{drive.name}: errors against the recorded truth, not aligned")
    return save(figure, path)
