"""The tables and sentences that a comparison prints, for a terminal, a pipe and the report."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

from fgloc.estimator import SensorCount
from fgloc.report.calibration_table import SINGLE, calibrations, far_from_prior
from fgloc.report.cells import COLUMNS, END_COLUMNS, end_cells, new_table, score_cells, stacked
from fgloc.report.outcomes import Comparison
from fgloc.report.printing import plain, print_parts

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.table import Table


def print_comparison(comparison: Comparison, console: Console | None = None) -> None:
    """Print all tables of a comparison on stdout (or `console`); see `print_parts`."""
    print_parts(lambda fancy: _parts(comparison, fancy=fancy), console)


def plain_text(comparison: Comparison) -> str:
    """Return what a pipe gets: columns set apart by spaces, no lines, nothing cut, no colours."""
    return plain(lambda fancy: _parts(comparison, fancy=fancy))


def _parts(comparison: Comparison, *, fancy: bool) -> Iterator[RenderableType]:
    """Yield everything that is printed, in order."""
    yield from _heading(comparison)
    yield from _scores(comparison, fancy)
    if len(comparison.drives) > 1 and comparison.total:
        yield f"Total: {comparison.total_is}"
        yield _totals(comparison, fancy)
        yield ""
    yield from calibrations(comparison, fancy)
    counts = _counts(comparison, fancy)
    if counts is not None:
        yield "Measurements used"
        yield counts
        yield ""
    yield from _remarks(comparison)


def _heading(comparison: Comparison) -> Iterator[str]:
    """Yield what was driven and how errors are meant."""
    drives = comparison.drives
    if len(drives) == 1:
        drive = drives[0].drive
        robot = drive.robot
        yield f"{drive.name}: {robot.name} ({robot.base.kind}), {drive.duration_s:.1f} s"
    else:
        seconds = sum(d.drive.duration_s for d in drives)
        yield f"{len(drives)} drives, {seconds:.0f} s in all"
    offered = dict.fromkeys(
        s for d in drives for s in (d.drive.wheels.sensor, *(s.sensor for s in d.drive.sensors))
    )
    single = len(comparison.methods) == 1
    mixed = any(len(d.drive.sensors) + 1 < len(offered) for d in drives)
    where = ", where a drive has it" if mixed else ""
    yield f"Offered{'' if single else ' to every method'}{where}: {', '.join(offered)}."
    if comparison.settings.fixes is not None:
        every_s, sigma_m = comparison.settings.fixes
        yield (
            f"Fixes are the recorded truth every {every_s:g} s with noise of {sigma_m:g} m "
            f"(seed {comparison.settings.seed})."
        )
    if any(d.drive.truth is not None for d in drives):
        who = "The estimate starts" if single else "All methods start"
        yield (
            f"{who} at the truth's first pose. Errors are not aligned, except in the column that "
            "says so."
        )
    if any(d.drive.truth is None for d in drives):
        yield (
            "Without a recorded truth there are no errors to show; a drive starts at the origin, "
            "unless fixes tell where it is."
        )
    yield ""


def _scores(comparison: Comparison, fancy: bool) -> Iterator[RenderableType]:
    """Yield the errors in two tables of at most 80 columns, and why methods were skipped.

    Without any truth there are no errors, so it is one table of where the drives end.
    """
    blocks: tuple[Sequence[str], ...] = (COLUMNS[:5], COLUMNS[5:])
    many = len(comparison.drives) > 1
    unscored = all(
        m.evaluation is None for outcome in comparison.drives for m in outcome.methods.values()
    )
    if unscored:
        blocks = (END_COLUMNS,)
    for number, names in enumerate(blocks):
        table = new_table(fancy)
        if many:
            table.add_column("drive", no_wrap=True)
        table.add_column("method", no_wrap=True)
        for name in names:
            table.add_column(stacked(name), justify="right", no_wrap=True)
        last = number == len(blocks) - 1
        if last:
            table.add_column("sensors used", no_wrap=True)
        for outcome in comparison.drives:
            for k, (method, found) in enumerate(outcome.methods.items()):
                cells = end_cells(found) if unscored else score_cells(found)
                row = [method, *(cells[5:] if number else cells[: len(names)])]
                row += [", ".join(found.result.sensors_used)] if last else []
                table.add_row(*([outcome.drive.name if k == 0 else "", *row] if many else row))
        yield table
        yield ""
    skipped: dict[str, list[str]] = {}
    for outcome in comparison.drives:
        for method, reason in outcome.skipped.items():
            # Reasons name the drive; without it, the same reason is the same text.
            key = f"{method}: {reason.replace(outcome.drive.name, '')}"
            skipped.setdefault(key, []).append(f"{method} is skipped: {reason}")
    for lines in skipped.values():
        more = f" (so on {len(lines)} drives)" if len(lines) > 1 else ""
        yield f"{lines[0]}.{more}"
    if skipped:
        yield ""


def _totals(comparison: Comparison, fancy: bool) -> Table:
    """Return the table of totals."""
    table = new_table(fancy)
    table.add_column("method", no_wrap=True)
    for name in ("x [m]", "y [m]", "heading [rad]", "sum", "drives", "median RMSE [m]"):
        table.add_column(name, justify="right", no_wrap=True)
    for method, total in comparison.total.items():
        found = [d.methods[method].evaluation for d in comparison.drives if method in d.methods]
        errors = [e.ate_rmse_m for e in found if e is not None]
        numbers = [f"{v:.4f}" for v in (total.x, total.y, total.theta, total.sum)]
        table.add_row(method, *numbers, str(len(errors)), f"{statistics.median(errors):.4f}")
    return table


def _counts(comparison: Comparison, fancy: bool) -> Table | None:
    """Return how measurements were used, summed over drives; None if no method says."""
    sums: dict[tuple[str, str], SensorCount] = {}
    for outcome in comparison.drives:
        for method, found in outcome.methods.items():
            for sensor, c in found.result.counts.items():
                before = sums.get((method, sensor), SensorCount(0))
                sums[method, sensor] = SensorCount(
                    before.accepted + c.accepted,
                    before.down_weighted + c.down_weighted,
                    before.rejected + c.rejected,
                )
    if not sums:
        return None
    table = new_table(fancy)
    table.add_column("method", no_wrap=True)
    table.add_column("sensor", no_wrap=True)
    for name in ("accepted", "down-weighted", "rejected"):
        table.add_column(name, justify="right", no_wrap=True)
    last = ""
    for (method, sensor), c in sums.items():
        numbers = (str(n) for n in (c.accepted, c.down_weighted, c.rejected))
        table.add_row(method if method != last else "", sensor, *numbers)
        last = method
    return table


def _remarks(comparison: Comparison) -> Iterator[str]:
    """Yield convergence, notes and what readers rejected, each once with the drives it concerns."""
    remarks: dict[str, list[str]] = {}
    for outcome in comparison.drives:
        drive = outcome.drive
        rejected = [f"{n} × {reason}" for reason, n in drive.rejected.items() if n]
        lines = [f"Rejected on reading: {', '.join(rejected)}."] if rejected else []
        lines += drive.notes
        for method, found in outcome.methods.items():
            if found.result.convergence and len(comparison.drives) <= SINGLE:
                lines.append(f"{method}: {found.result.convergence}.")
            elif "NOT" in found.result.convergence:
                lines.append(f"{method} did not converge.")
            lines += (f"{method}: {note}." for note in found.result.notes)
            lines += far_from_prior(method, found.result.calibration)
        for line in lines:
            remarks.setdefault(line, []).append(drive.name)
    for line, names in remarks.items():
        yield line if len(names) == len(comparison.drives) else f"{line} ({_short(names)})"


def _short(names: Sequence[str], most: int = 3) -> str:
    """Return some names and how many there are."""
    return ", ".join(names) if len(names) <= most else f"{names[0]} and {len(names) - 1} more"


def markdown(comparison: Comparison, title: str, figures: Iterable[str]) -> str:
    """Return the report as Markdown: the printed text, then the figures by relative path."""
    parts = [f"# {title}", "", "```text", plain_text(comparison).rstrip(), "```", ""]
    for figure in figures:
        parts += [f"![{figure}]({figure})", ""]
    return "\n".join(parts)
