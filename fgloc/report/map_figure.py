"""The map as a figure: walls with their uncertainty, scan points, landmarks, trajectory, truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.measurements import Floats
from fgloc.estimator import Result
from fgloc.lidar.walls import Marks, Walls
from fgloc.report.ellipses import draw_ellipses, enlarged, magnification, reduction
from fgloc.report.figures import TRUTH, colour, new_figure, save, save_svg
from fgloc.report.map_segments import PlacedSegments, seen_lines
from fgloc.report.map_truth import base_truth, surveyed, true_walls
from fgloc.report.map_walls import offset_sigma, wall_bands

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WALL = "#0072B2"
MARK = "#7F4FC9"
POINT = "#7A7A7A"
STRAY = 0.003
"""This share of the scan points at each side may lie outside the figure."""
BAND = 2.0
"""A wall's band reaches this many standard deviations to each side."""


def draw_map(
    result: Result,
    drive: Drive,
    points: Floats,
    png: Path,
    svg: Path | None = None,
    segments: PlacedSegments | None = None,
) -> None:
    """Draw the map in equal axes, in metres, as PNG and, where asked for, as SVG.

    `points` are (K, 2) scan points in map axes, thinned; in the SVG they are a picture, all else
    is lines. Of `segments` follows which parts of a wall were seen: those are drawn thick, what is
    between them (a door, perhaps) thin. Bands and ellipses too small to be seen are enlarged by a
    round number that the legend names, bands that would cover everything made smaller. Costs a
    second or two.
    """
    walls = None if result.map is None else result.map.walls
    marks = None if result.map is None else result.map.marks
    truth = base_truth(result, drive)
    path = result.trajectory.poses[:, :2]
    places = np.array([*surveyed(drive).values()]).reshape(-1, 2)
    true = true_walls(drive)
    everything = np.concatenate(
        [
            path,
            most_points(points),
            places,
            true.reshape(-1, 2),
            *([] if walls is None else [walls.ends.reshape(-1, 2)]),
            *([] if marks is None else [marks.positions]),
            *([] if truth is None else [truth.poses[:, :2]]),
        ]
    )
    low, high = everything.min(axis=0), everything.max(axis=0)
    extent = max(float((high - low).max()), 1e-3)
    # What is long and narrow gets room at its sides, or equal axes would squeeze it to a line.
    margin = np.maximum(0.04 * extent, 0.5 * (0.3 * extent - (high - low)))
    low, high = low - margin, high + margin
    size = (high - low) * min(11.0 / (high[0] - low[0]), 9.0 / (high[1] - low[1]))
    width = max(float(size[0]), 6.0) + 1.0
    figure = new_figure(width, float(size[1]) + 1.6)
    axes = figure.add_subplot()
    if points.shape[0]:
        # About as large as the distance between points, but neither invisible nor a blot.
        dot = float(np.clip(72.0 * float(size.max()) * 0.06 / extent, 1.3, 3.0))
        axes.plot(*points.T, ".", ms=dot, mew=0, color=POINT, rasterized=True, zorder=1)
        axes.plot([], [], ".", ms=6, color=POINT, label="scan points")
    if truth is not None:
        axes.plot(*truth.poses[:, :2].T, color=TRUTH, lw=3.0, alpha=0.3, label="truth", zorder=2)
    if true.shape[0]:
        _draw_true_walls(axes, true)
    axes.plot(*path.T, color=colour(result.method), lw=1.2, label=result.method, zorder=2.2)
    axes.plot(*path[0], "o", color=TRUTH, ms=6, mfc="white", mew=1.3, label="start", zorder=5)
    if walls is not None and walls.normal.size:
        _draw_walls(axes, walls, extent, segments)
    if marks is not None and marks.landmark.size:
        _draw_marks(axes, marks, extent)
    if places.shape[0]:
        axes.plot(*places.T, "+", color=TRUTH, ms=10, mew=1.2, label="surveyed", zorder=2.9)
    axes.set(title=drive.name, xlabel="x [m]", ylabel="y [m]")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.set_aspect("equal", adjustable="box")
    axes.grid(alpha=0.25)
    figure.legend(loc="outside lower center", frameon=False, ncols=max(2, int(width / 2.4)))
    save(figure, png)
    if svg is not None:
        save_svg(figure, svg)


def most_points(points: Floats) -> Floats:
    """Return (0, 2) or (2, 2) corners of a box around nearly all points.

    A beam that escapes through a window would shrink everything else.
    """
    if not points.shape[0]:
        return points
    return np.asarray(np.quantile(points, (STRAY, 1.0 - STRAY), axis=0))


def _draw_true_walls(axes: Axes, true: Floats) -> None:
    """Draw the walls (W, 2, 2) of a simulated world."""
    from matplotlib.collections import LineCollection

    axes.add_collection(LineCollection(list(true), colors=TRUTH, linewidths=0.6, zorder=2.4))
    axes.plot([], [], color=TRUTH, lw=0.6, label="true walls")


def _draw_walls(axes: Axes, walls: Walls, extent: float, segments: PlacedSegments | None) -> None:
    """Draw each wall from end to end, thick where it was seen, and its band."""
    from matplotlib.collections import LineCollection, PolyCollection

    thick = list(walls.ends)
    if segments is not None:
        axes.add_collection(LineCollection(thick, colors=WALL, linewidths=0.4, zorder=2.6))
        thick = seen_lines(walls, segments)
    axes.add_collection(LineCollection(thick, colors=WALL, linewidths=1.5, zorder=2.6))
    axes.plot([], [], color=WALL, lw=1.5, label=f"{walls.normal.size} walls")
    known = np.isfinite(walls.covariance).all(axis=(1, 2))
    if not known.any():
        return
    widths = 2.0 * BAND * offset_sigma(walls, walls.reach)[known]
    typical = float(np.median(widths))
    times, divisor = magnification(typical, 0.012 * extent), reduction(typical, 0.04 * extent)
    bands = wall_bands(walls, BAND * times / divisor)[known]
    axes.add_collection(
        PolyCollection(list(bands), facecolors=(WALL, 0.22), edgecolors="none", zorder=2.5)
    )
    label = enlarged("walls ±2σ", times, divisor)
    axes.plot([], [], "s", mfc=(WALL, 0.22), mec="none", ms=10, label=label)


def _draw_marks(axes: Axes, marks: Marks, extent: float) -> None:
    """Draw point landmarks with names and their ellipses."""
    axes.plot(*marks.positions.T, ".", color=MARK, ms=6, label="landmarks", zorder=3.1)
    for name, (x, y) in zip(marks.landmark, marks.positions, strict=True):
        axes.annotate(str(name), (x, y), (4, 4), textcoords="offset points", fontsize=7, color=MARK)
    sure = np.isfinite(marks.covariance).all(axis=(1, 2))
    if sure.any():
        draw_ellipses(
            axes,
            marks.positions[sure],
            marks.covariance[sure],
            0.03 * extent,
            MARK,
            "landmarks, 95 %",
        )
