"""The tables of calibrations: one drive parameter by parameter, many drives by their medians."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from fgloc.estimator import CalibrationEstimate
from fgloc.report.cells import NONE, fixed, new_table
from fgloc.report.outcomes import Comparison, DriveOutcome

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

FAR = 3.0
"""A calibration this many prior sigmas from nominal is remarked on."""
OBSERVED = "observed: ±σ is less than half the prior's"
"""What the last column means; `CalibrationEstimate.observed` decides it."""
SINGLE = 1
"""Up to this many drives, the calibration of each is printed; a summary of more."""


def calibrations(comparison: Comparison, fancy: bool) -> Iterator[RenderableType]:
    """Yield the calibration of every method that estimates one."""
    for method in comparison.methods:
        found = [
            (d, d.methods[method].result.calibration)
            for d in comparison.drives
            if method in d.methods and d.methods[method].result.calibration
        ]
        if not found:
            continue
        if len(comparison.drives) <= SINGLE:
            for _, calibration in found:
                yield f"Calibration by {method} ({OBSERVED})"
                yield calibration_table(calibration, fancy)
        else:
            yield from _calibration_summaries(method, found, fancy)
        yield ""


def calibration_table(calibration: Sequence[CalibrationEstimate], fancy: bool) -> Table:
    """Return one calibration, parameter by parameter."""
    table = new_table(fancy)
    table.add_column("parameter", no_wrap=True)
    for name in ("nominal", "prior ±σ", "estimate", "±σ"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    table.add_column("", no_wrap=True)
    for c in calibration:
        table.add_row(
            c.name,
            fixed(c.nominal, 5),
            f"{c.prior_sigma:.5f}" if c.prior_sigma > 0.0 else "fixed",
            fixed(c.value, 5),
            f"{c.sigma:.5f}" if math.isfinite(c.sigma) else NONE,
            c.unit,
            state(c),
        )
    return table


def state(c: CalibrationEstimate) -> str:
    """Return "observed", "not observed" or "fixed"."""
    if not c.prior_sigma > 0.0:
        return "fixed"
    return "observed" if c.observed else "not observed"


def _calibration_summaries(
    method: str,
    found: Sequence[tuple[DriveOutcome, Sequence[CalibrationEstimate]]],
    fancy: bool,
) -> Iterator[RenderableType]:
    """Yield, for each robot, medians over its drives."""
    robots: dict[str, list[Sequence[CalibrationEstimate]]] = {}
    for outcome, calibration in found:
        robots.setdefault(outcome.drive.robot.name, []).append(calibration)
    for robot, calibrations in robots.items():
        number = len(calibrations)
        drives = f"medians over {number} drives, each on its own" if number > 1 else "one drive"
        yield f"Calibration by {method}, {robot}: {drives}"
        yield f"({OBSERVED})"
        table = new_table(fancy)
        table.add_column("parameter", no_wrap=True)
        for name in ("nominal", "estimate", "±σ"):
            table.add_column(name, justify="right", no_wrap=True)
        table.add_column("unit", no_wrap=True)
        table.add_column("observed in", no_wrap=True)
        names = dict.fromkeys(c.name for calibration in calibrations for c in calibration)
        for name in names:
            same = [c for calibration in calibrations for c in calibration if c.name == name]
            middle = [
                statistics.median(values)
                for values in (
                    [c.nominal for c in same],
                    [c.value for c in same],
                    [c.sigma for c in same],
                )
            ]
            seen = sum(c.observed for c in same)
            states = "fixed" if not same[0].prior_sigma > 0.0 else f"{seen} of {len(same)}"
            table.add_row(name, *(fixed(m, 5) for m in middle), same[0].unit, states)
        yield table
        if robot != list(robots)[-1]:
            yield ""


def far_from_prior(method: str, calibration: Sequence[CalibrationEstimate]) -> Iterator[str]:
    """Yield a remark on every parameter whose estimate the prior did not expect."""
    for c in calibration:
        if c.prior_sigma > 0.0 and abs(c.value - c.nominal) > FAR * c.prior_sigma:
            yield (
                f"{method} moves {c.name} by more than {FAR:g} prior σ: its nominal value, a unit "
                "or a sensor may be wrong."
            )
