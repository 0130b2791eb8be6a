"""Figures of a calibration: parameters in prior sigmas, correlations, paths and errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fgloc.calibration.evaluate import before_and_after
from fgloc.calibration.result import CalibrationReport
from fgloc.core.consistency import correlations
from fgloc.core.drive import Drive
from fgloc.core.evaluation import error_series, map_mount
from fgloc.report.figures import colour, new_figure, save, style
from fgloc.report.plot_experiment import Paths, plot_paths

ACROSS = 3
"""Panels in a row."""
MOST = 12
"""Drives that are drawn, evenly over those evaluated."""


def plot_parameters(report: CalibrationReport, path: Path) -> Path:
    """Draw every parameter with ±2σ, before and after, in sigmas of its prior around nominal."""
    free = [p for p in report.parameters if p.prior_sigma > 0.0]
    figure = new_figure(8.0, 0.9 + 0.3 * len(free))
    axes = figure.subplots()
    for k, p in enumerate(free):
        axes.plot([-2, 2], [k, k], color="0.8", lw=7, solid_capstyle="butt")
        middle, spread = (p.value - p.nominal) / p.prior_sigma, 2.0 * p.sigma / p.prior_sigma
        axes.errorbar(middle, k, xerr=spread, fmt="o", ms=4, lw=1.6, color=colour("calibrated"))
        text = f"{p.value:.5g} ± {p.sigma:.1g} {p.unit if p.unit != '1' else ''}"
        axes.annotate(text, (1.01, k), xycoords=("axes fraction", "data"), va="center", fontsize=8)
    axes.axvline(0.0, color="0.4", lw=0.8)
    axes.set_yticks(range(len(free)), [p.name for p in free], fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("prior standard deviations from nominal (grey: prior ±2σ; points: found ±2σ)")
    axes.set_title(f"{report.robot.name}: {report.model}")
    return save(figure, path)


def plot_correlations(report: CalibrationReport, path: Path) -> Path:
    """Draw the correlation matrix of the parameters."""
    names = [p.name for p in report.parameters]
    size = 2.5 + 0.32 * len(names)
    figure = new_figure(size + 1.0, size)
    axes = figure.subplots()
    shown = axes.imshow(correlations(report.covariance), cmap="RdBu_r", vmin=-1, vmax=1)
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=7)
    axes.set_yticks(range(len(names)), names, fontsize=7)
    figure.colorbar(shown, ax=axes, shrink=0.8, label="correlation")
    axes.set_title("Correlation of what was found")
    return save(figure, path)


def open_loop_panel(drive: Drive, report: CalibrationReport, title: str) -> Paths:
    """Return the wheels' paths before and after on a drive with a truth, to be drawn."""
    found = before_and_after(drive, report)
    truth = found["nominal"].truth.trajectory
    paths = {name: map_mount(o.trajectory, o.mount).poses for name, o in found.items()}
    return Paths(title, paths, truth.poses)


def plot_panels(panels: Sequence[Paths], path: Path) -> Path:
    """Draw open-loop paths, three panels in a row."""
    rows = [panels[k : k + ACROSS] for k in range(0, len(panels), ACROSS)]
    return plot_paths(rows, "Wheels alone, open loop from the true start", path)


def plot_open_loop(drives: Sequence[Drive], report: CalibrationReport, path: Path) -> Path:
    """Draw the wheels' paths before and after against the truth, on at most twelve drives."""
    return plot_panels([open_loop_panel(d, report, d.name) for d in _some(drives)], path)


def plot_open_loop_errors(drives: Sequence[Drive], report: CalibrationReport, path: Path) -> Path:
    """Draw position and heading errors over time, before and after, on at most twelve drives."""
    shown = _some(drives)
    figure = new_figure(9.0, 5.0)
    top, bottom = figure.subplots(2, 1, sharex=True)
    for drive in shown:
        for name, found in before_and_after(drive, report).items():
            series = error_series(found.trajectory, found.truth, found.mount)
            seconds = (series.stamps_ns - series.stamps_ns[0]) * 1e-9
            look = {"color": colour(name), "ls": style(name), "lw": 1.0, "alpha": 0.8}
            label = name if drive is shown[0] else None
            top.plot(seconds, np.hypot(*series.errors[:, :2].T), label=label, **look)
            bottom.plot(seconds, np.degrees(series.errors[:, 2]), **look)
    top.set_ylabel("position error [m]")
    bottom.set_ylabel("heading error [deg]")
    bottom.set_xlabel("time [s]")
    top.legend(frameon=False)
    top.set_title("Wheels alone, open loop from the true start")
    for axes in (top, bottom):
        axes.grid(alpha=0.3)
    return save(figure, path)


def _some(drives: Sequence[Drive]) -> list[Drive]:
    """Return at most `MOST` of the drives with a truth, evenly over all."""
    known = [d for d in drives if d.truth is not None]
    step = max(1, math.ceil(len(known) / MOST))
    return known[::step]
