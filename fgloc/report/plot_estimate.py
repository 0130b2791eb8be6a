"""Figures of what an estimator thinks: its calibration, and its residuals sensor by sensor."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from fgloc.estimator import Result
from fgloc.report.calibration_table import state
from fgloc.report.cells import fixed
from fgloc.report.figures import TRUTH, colour, new_figure, save, style
from fgloc.report.outcomes import DriveOutcome

BELIEVED = 0.5
"""Residuals with a robust weight below this are marked as down-weighted."""

ROUNDING = 1e-6
"""Residuals below this [m, rad or σ] are drawn as zero."""


def plot_calibration(result: Result, path: Path) -> Path | None:
    """Draw each parameter's posterior against its prior; return the PNG's path.

    The axis is the shift from nominal in prior standard deviations: the prior is the same grey
    bar for all, and the bar of the estimate is as short as the data made it. Values in units
    stand at the side. None if no parameter is free.
    """
    free = [c for c in result.calibration if c.prior_sigma > 0.0 and math.isfinite(c.sigma)]
    if not free:
        return None
    figure = new_figure(10.0, 1.6 + 0.42 * len(free))
    axes = figure.add_subplot()
    rows = np.arange(len(free))[::-1]
    shift = np.array([(c.value - c.nominal) / c.prior_sigma for c in free])
    sigma = np.array([c.sigma / c.prior_sigma for c in free])
    axes.barh(rows, 2.0, left=-1.0, height=0.7, color="#DDDDDD", label="prior ±σ")
    axes.axvline(0.0, color="#888888", lw=0.8)
    seen = np.array([c.observed for c in free])
    for chosen, face, label in (
        (seen, colour(result.method), "estimate ±σ, observed"),
        (~seen, "white", "estimate ±σ, not observed"),
    ):
        if chosen.any():
            axes.errorbar(
                shift[chosen],
                rows[chosen],
                xerr=sigma[chosen],
                fmt="o",
                color=colour(result.method),
                mfc=face,
                capsize=4,
                lw=1.6,
                label=label,
            )
    axes.set_yticks(rows, [c.name for c in free])
    right = axes.secondary_yaxis("right")
    right.set_yticks(
        rows,
        [
            f"{fixed(c.nominal, 5)} → {fixed(c.value, 5)} ± {c.sigma:.5f} {c.unit}  {state(c)}"
            for c in free
        ],
        fontsize="small",
    )
    right.tick_params(length=0)
    limit = 1.15 * max(1.0, float(np.max(np.abs(shift) + sigma)))
    axes.set_xlim(-limit, limit)
    axes.set_ylim(-0.6, len(free) - 0.4)
    axes.set_xlabel("shift from nominal [prior σ]")
    axes.set_title(f"{result.drive}: calibration by {result.method}")
    axes.grid(axis="x", alpha=0.3)
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    return save(figure, path)


def plot_turning(outcome: DriveOutcome, path: Path) -> Path | None:
    """Draw the effective track over time ±2σ, method by method; return the PNG's path.

    A method that tells one value for the whole drive is a band; the true value, where the drive is
    simulated and keeps it, is a line. None if no method follows it.
    """
    histories = {m: o.result.turning for m, o in outcome.methods.items() if o.result.turning}
    if not histories:
        return None
    first = next(iter(histories.values()))
    figure = new_figure(9.0, 4.2)
    axes = figure.add_subplot()
    begin = int(first.stamps_ns[0])
    for method, history in histories.items():
        t = (history.stamps_ns - begin) * 1e-9
        low, high = history.values - 2 * history.sigmas, history.values + 2 * history.sigmas
        axes.fill_between(t, low, high, color=colour(method), alpha=0.2, lw=0)
        axes.plot(t, history.values, color=colour(method), ls=style(method), lw=1.3, label=method)
    for method, found in outcome.methods.items():
        for c in found.result.calibration:
            if method not in histories and c.name == first.name and math.isfinite(c.sigma):
                axes.axhspan(
                    c.value - 2 * c.sigma, c.value + 2 * c.sigma, color=colour(method), alpha=0.15
                )
                axes.axhline(c.value, color=colour(method), lw=1.0, label=f"{method}, whole drive")
    axes.axhline(first.nominal, color="0.5", lw=1.0, ls=":", label="nominal")
    true = (outcome.drive.true_calibration or {}).get(first.name)
    if true is not None:
        axes.axhline(true, color=TRUTH, lw=1.0, label="true at the start")
    settled = np.concatenate([h.values[h.values.size // 10 :] for h in histories.values()])
    spread = np.concatenate([h.sigmas[h.sigmas.size // 10 :] for h in histories.values()])
    edges = [float(np.nanmin(settled - 3 * spread)), float(np.nanmax(settled + 3 * spread))]
    edges += [v for v in (first.nominal, true) if v is not None]
    axes.set_ylim(0.98 * min(edges), 1.02 * max(edges))
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"{first.name} [{first.unit}]")
    axes.set_title(f"{outcome.drive.name}\n{first.name} over time, ±2σ", fontsize="medium")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=5, frameon=False)
    return save(figure, path)


def plot_residuals(result: Result, path: Path) -> Path | None:
    """Draw every sensor's residuals over time; return the PNG's path, None without residuals.

    Left in units, right divided by the noise model's standard deviation, where 95 % should lie
    within the grey ±2. Measurements that the robust loss does not believe are ringed.
    """
    # A single value, such as the prior on the start, is no course over time.
    shown = [r for r in result.residuals if r.stamps_ns.size > 1]
    panels = [(r, k) for r in shown for k in range(len(r.components))]
    if not panels:
        return None
    figure = new_figure(12.0, 1.2 + 1.55 * len(panels))
    grid = figure.subplots(len(panels), 2, sharex=True, squeeze=False)
    begin = min(int(r.stamps_ns[0]) for r in shown)
    for row, (r, k) in enumerate(panels):
        t = (r.stamps_ns - begin) * 1e-9
        weak = r.weights < BELIEVED
        for axes, values in zip(grid[row], (r.values[:, k], r.normalised[:, k]), strict=True):
            axes.plot(t, values, ".", ms=2.5, color=colour(result.method))
            axes.plot(t[weak], values[weak], "o", ms=6, mfc="none", mec="#000000", mew=1.0)
            axes.axhline(0.0, color="#000000", lw=0.6)
            axes.grid(alpha=0.3)
            # Rounding errors are not a course worth a scale of their own.
            if float(np.max(np.abs(values), initial=0.0)) < ROUNDING:
                axes.set_ylim(-ROUNDING, ROUNDING)
        grid[row, 1].axhspan(-2.0, 2.0, color="#888888", alpha=0.2, lw=0)
        grid[row, 0].set_ylabel(f"{r.sensor}\n{r.components[k]}", fontsize="small")
        grid[row, 1].set_ylabel("normalised", fontsize="small")
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    grid[0, 0].set_title("in units")
    grid[0, 1].set_title("normalised (grey: ±2σ)")
    down = sum(int((r.weights < BELIEVED).sum()) for r in shown)
    figure.suptitle(f"{result.drive}: residuals of {result.method} (ringed: {down} down-weighted)")
    return save(figure, path)
