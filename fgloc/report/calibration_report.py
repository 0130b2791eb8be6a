"""What `calibrate` prints: parameters, models, residuals, advice, errors before and after."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from fgloc.calibration.result import CalibrationReport, DriveError
from fgloc.core.consistency import correlations
from fgloc.report.calibration_table import OBSERVED, calibration_table, far_from_prior
from fgloc.report.cells import NONE, new_table, stacked
from fgloc.report.printing import plain, print_parts

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.table import Table

FEW = 12
"""Up to this many drives are printed one by one."""
STRONG = 0.9
"""Correlations from which on two parameters are named together."""
WEAKENED = 0.999
"""Weights below this are worth showing."""


def print_calibration(report: CalibrationReport, console: Console | None = None) -> None:
    """Print a calibration on stdout (or `console`); see `print_parts`."""
    print_parts(lambda fancy: _parts(report, fancy), console)


def calibration_text(report: CalibrationReport) -> str:
    """Return what a pipe gets."""
    return plain(lambda fancy: _parts(report, fancy))


def _parts(report: CalibrationReport, fancy: bool) -> Iterator[RenderableType]:
    """Yield everything that is printed, in order."""
    robot = report.robot
    number = len(report.fit)
    yield (
        f"{robot.name} ({robot.base.kind}): {number} drive{'s' * (number != 1)} against "
        f"{report.reference}, model {report.model}, {report.seconds:.2f} s"
    )
    yield ""
    if report.candidates:
        yield "Models (error on drives left out in turn, as a share of nominal's)"
        yield _models(report, fancy)
        yield ""
    yield f"Parameters ({OBSERVED})"
    yield calibration_table(report.parameters, fancy)
    yield ""
    together = list(_correlated(report))
    if together:
        yield f"Determined together only (correlation above {STRONG:g}): {'; '.join(together)}."
        yield ""
    yield "What is left on the drives of the fit"
    yield _residuals(report, fancy)
    yield ""
    if report.clocks:
        yield "Clocks: wheels are late by offset + rate · time"
        yield _clocks(report, fancy)
        yield ""
    if report.evaluation:
        inside = all(e.drive in report.fit for e in report.evaluation)
        where = "the drives of the fit itself" if inside else "drives not used for the fit"
        yield f"Wheels alone, open loop from the true start, on {where}: nominal → calibrated"
        yield _errors(report.evaluation, fancy)
        if report.total_nominal is not None and report.total_value is not None:
            before, after = report.total_nominal.sum, report.total_value.sum
            change = f", {100.0 * (after / before - 1.0):+.1f} %" if before > 0.0 else ""
            yield f"Total error (m + rad): {before:.4f} → {after:.4f}{change}"
        yield ""
    yield from (_sentence(text) for text in (*report.advice, *report.notes))
    yield from far_from_prior("the calibration", report.parameters)


def _sentence(text: str) -> str:
    """Return a text with a capital, unless it begins with an id or a name, and a full stop."""
    word = text.partition(" ")[0]
    first = text[0] if any(mark in word for mark in ":_.") else text[0].upper()
    return f"{first}{text[1:]}{'' if text.endswith(('.', '?')) else '.'}"


def _models(report: CalibrationReport, fancy: bool) -> Table:
    """Return the models that were tried."""
    table = new_table(fancy)
    table.add_column("model", no_wrap=True)
    for name in ("parameters", "on the fit", "left out", "±"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    for c in report.candidates:
        state = "chosen" if c.chosen else "" if c.identified else "not identified by these drives"
        numbers = (f"{c.in_sample:.3f}", f"{c.held_out:.3f}", f"{c.spread:.3f}")
        table.add_row(c.id, str(c.parameters), *numbers, state)
    return table


def _correlated(report: CalibrationReport) -> Iterator[str]:
    """Yield pairs of parameters that are determined together only."""
    matrix = correlations(report.covariance)
    names = [p.name for p in report.parameters]
    for i, j in zip(*np.nonzero(np.triu(np.abs(matrix) > STRONG, 1)), strict=True):
        yield f"{names[i]} and {names[j]} {matrix[i, j]:+.3f}"


def _residuals(report: CalibrationReport, fancy: bool) -> Table:
    """Return what is left, drive by drive, of many drives their medians by sensor."""
    table = new_table(fancy)
    table.add_column("drive", no_wrap=True)
    table.add_column("sensor", no_wrap=True)
    table.add_column("rms", no_wrap=True)
    table.add_column("normalised", no_wrap=True)
    table.add_column("weight", justify="right", no_wrap=True)
    rows = report.residuals
    if len(rows) > FEW:
        shapes = list(dict.fromkeys((r.sensor, r.components) for r in rows))
        for sensor, components in shapes:
            same = [r for r in rows if (r.sensor, r.components) == (sensor, components)]
            rms = [statistics.median(r.rms[k] for r in same) for k in range(len(components))]
            normalised = [
                statistics.median(r.normalised[k] for r in same) for k in range(len(components))
            ]
            table.add_row(
                f"median of {len(same)}", sensor, _units(rms, components), _plain(normalised), ""
            )
        rows = tuple(r for r in rows if r.weight < WEAKENED)
    for r in rows:
        weight = "" if r.weight >= WEAKENED else f"{r.weight:.2f}"
        table.add_row(r.drive, r.sensor, _units(r.rms, r.components), _plain(r.normalised), weight)
    return table


def _units(values: Sequence[float], components: Sequence[str]) -> str:
    """Return numbers behind the names of their components."""
    found = []
    for value, component in zip(values, components, strict=True):
        name, _, unit = component.partition(" [")
        found.append(f"{name} {value:.4f} {unit.rstrip(']')}".rstrip())
    return ", ".join(found)


def _plain(values: Sequence[float]) -> str:
    """Return numbers without a unit."""
    return " ".join(f"{v:.2f}" for v in values)


def _clocks(report: CalibrationReport, fancy: bool) -> Table:
    """Return how clocks differ, drive by drive."""
    table = new_table(fancy)
    table.add_column("drive", no_wrap=True)
    for name in ("offset [s]", "±σ [s]", "rate [%]", "±σ [%]"):
        table.add_column(stacked(name), justify="right", no_wrap=True)
    for c in report.clocks:
        table.add_row(
            c.drive,
            f"{c.offset_s:.3f}",
            f"{c.offset_sigma_s:.3f}",
            f"{100.0 * c.rate:.2f}",
            f"{100.0 * c.rate_sigma:.2f}",
        )
    return table


def _errors(evaluation: Sequence[DriveError], fancy: bool) -> Table:
    """Return errors before and after: every drive's, of many the medians by motion."""
    table = new_table(fancy)
    table.add_column("drive", no_wrap=True)
    for name in ("position RMSE [m]", "", "ratio", "heading RMSE [deg]", " ", "max x, y [m]"):
        table.add_column(stacked(name) if "[" in name else name, justify="right", no_wrap=True)
    groups: dict[str, list[DriveError]] = {}
    for e in evaluation:
        groups.setdefault(e.drive if len(evaluation) <= FEW else e.motion or "", []).append(e)
    if len(evaluation) > 1:
        groups["median of all" if len(evaluation) <= FEW else f"all {len(evaluation)}"] = list(
            evaluation
        )
    for name, group in groups.items():
        single = len(evaluation) <= FEW or name.startswith("all ")
        label = name if single else f"{name or 'no label'}, median of {len(group)}"
        before = statistics.median(e.nominal.ate_rmse_m for e in group)
        after = statistics.median(e.value.ate_rmse_m for e in group)
        worst = statistics.median(max(e.value.e_max.x, e.value.e_max.y) for e in group)
        table.add_row(
            label,
            f"{before:.4f}",
            f"→ {after:.4f}",
            f"{after / before:.3f}" if before > 0.0 else NONE,
            f"{statistics.median(e.nominal.ate_heading_rmse_deg for e in group):.2f}",
            f"→ {statistics.median(e.value.ate_heading_rmse_deg for e in group):.2f}",
            f"{worst:.4f}",
        )
    return table
