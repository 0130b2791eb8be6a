"""The tables and sentences that a comparison prints, for a terminal, a pipe and the report."""

from __future__ import annotations

import io
import math
import statistics
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

from fgloc.estimator import CalibrationEstimate, SensorCount
from fgloc.report.outcomes import Comparison, DriveOutcome, MethodOutcome

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.table import Table

NONE = "-"
"""What stands for a number that does not exist."""
COLUMNS = (
    "position RMSE [m]",
    "aligned RMSE [m]",
    "heading RMSE [deg]",
    "end error [m]",
    "end error [deg]",
    "max x [m]",
    "max y [m]",
    "max heading [deg]",
    "NEES (ideal 3)",
    "time [s]",
)
"""Numbers of one method on one drive, with units."""
SINGLE = 1
"""Up to this many drives, the calibration of each is printed; a summary of more."""


def print_comparison(comparison: Comparison, console: Console | None = None) -> None:
    """Print all tables of a comparison on stdout (or `console`).

    On a terminal with rich's lines; in a pipe as plain columns without lines or cut numbers.
    """
    from rich.console import Console
    from rich.measure import Measurement

    console = Console() if console is None else console
    if not console.is_terminal:
        console.print(plain_text(comparison), end="", markup=False, highlight=False, soft_wrap=True)
        return
    for part in _parts(comparison, fancy=True):
        if isinstance(part, str):
            console.print(part, markup=False, highlight=False)
            continue
        wide = console.options.update(max_width=1000)
        width = Measurement.get(console, wide, part).maximum
        # Too narrow a terminal breaks lines, which is better than numbers that are cut short.
        target = console
        if width > console.width:
            target = Console(file=console.file, width=width, force_terminal=True)
        target.print(part, markup=False, highlight=False)


def plain_text(comparison: Comparison) -> str:
    """Return what a pipe gets: columns set apart by spaces, no lines, nothing cut, no colours."""
    from rich.console import Console

    buffer = io.StringIO()
    console = Console(file=buffer, width=1000, color_system=None, legacy_windows=False)
    for part in _parts(comparison, fancy=False):
        console.print(part, markup=False, highlight=False, soft_wrap=isinstance(part, str))
    return "\n".join(line.rstrip() for line in buffer.getvalue().splitlines()) + "\n"


def _parts(comparison: Comparison, *, fancy: bool) -> Iterator[RenderableType]:
    """Yield everything that is printed, in order."""
    yield from _heading(comparison)
    yield from _scores(comparison, fancy)
    if len(comparison.drives) > 1 and comparison.total:
        yield f"Total: {comparison.total_is}"
        yield _totals(comparison, fancy)
        yield ""
    yield from _calibrations(comparison, fancy)
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
    yield f"Offered{'' if single else ' to every method'}: {', '.join(offered)}."
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
        yield "Without a recorded truth a drive starts at the origin and has no errors to show."
    yield ""


def _scores(comparison: Comparison, fancy: bool) -> Iterator[RenderableType]:
    """Yield the errors in two tables of at most 80 columns, and why methods were skipped."""
    blocks = (COLUMNS[:5], COLUMNS[5:])
    many = len(comparison.drives) > 1
    for number, names in enumerate(blocks):
        table = _table(fancy)
        if many:
            table.add_column("drive", no_wrap=True)
        table.add_column("method", no_wrap=True)
        for name in names:
            table.add_column(_stacked(name), justify="right", no_wrap=True)
        if number == 1:
            table.add_column("sensors used", no_wrap=True)
        for outcome in comparison.drives:
            for k, (method, found) in enumerate(outcome.methods.items()):
                cells = _score_cells(found)
                row = [method, *(cells[5:] if number else cells[:5])]
                row += [", ".join(found.result.sensors_used)] if number else []
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


def _score_cells(found: MethodOutcome) -> list[str]:
    """Return the numbers of one method on one drive."""
    seconds = f"{found.result.seconds:.2f}"
    e = found.evaluation
    if e is None:
        return [NONE] * 9 + [seconds]
    return [
        f"{e.ate_rmse_m:.4f}",
        f"{e.ate_aligned_rmse_m:.4f}",
        f"{e.ate_heading_rmse_deg:.2f}",
        f"{e.end_position_m:.4f}",
        f"{e.end_heading_deg:.2f}",
        f"{e.e_max.x:.4f}",
        f"{e.e_max.y:.4f}",
        f"{math.degrees(e.e_max.theta):.2f}",
        NONE if e.nees is None else f"{e.nees:.2f}",
        seconds,
    ]


def _totals(comparison: Comparison, fancy: bool) -> Table:
    """Return the table of totals."""
    table = _table(fancy)
    table.add_column("method", no_wrap=True)
    for name in ("x [m]", "y [m]", "heading [rad]", "sum", "drives", "median RMSE [m]"):
        table.add_column(name, justify="right", no_wrap=True)
    for method, total in comparison.total.items():
        found = [d.methods[method].evaluation for d in comparison.drives if method in d.methods]
        errors = [e.ate_rmse_m for e in found if e is not None]
        numbers = [f"{v:.4f}" for v in (total.x, total.y, total.theta, total.sum)]
        table.add_row(method, *numbers, str(len(errors)), f"{statistics.median(errors):.4f}")
    return table


def _calibrations(comparison: Comparison, fancy: bool) -> Iterator[RenderableType]:
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
                yield f"Calibration by {method}"
                yield _calibration(calibration, fancy)
        else:
            yield from _calibration_summaries(method, found, fancy)
        yield ""


def _calibration(calibration: Sequence[CalibrationEstimate], fancy: bool) -> Table:
    """Return one calibration, parameter by parameter."""
    table = _table(fancy)
    table.add_column("parameter", no_wrap=True)
    for name in ("nominal", "prior ±σ", "estimate", "±σ"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    table.add_column("", no_wrap=True)
    for c in calibration:
        table.add_row(
            c.name,
            f"{c.nominal:.5f}",
            f"{c.prior_sigma:.5f}" if c.prior_sigma > 0.0 else "fixed",
            f"{c.value:.5f}",
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
        yield f"Calibration by {method}, {robot}: medians over {number} drives, each on its own"
        table = _table(fancy)
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
            table.add_row(name, *(f"{m:.5f}" for m in middle), same[0].unit, states)
        yield table


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
    table = _table(fancy)
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
        rejected = [f"{n} {reason}" for reason, n in drive.rejected.items() if n]
        lines = [f"Rejected on reading: {', '.join(rejected)}."] if rejected else []
        lines += drive.notes
        for method, found in outcome.methods.items():
            if found.result.convergence and len(comparison.drives) <= SINGLE:
                lines.append(f"{method}: {found.result.convergence}.")
            elif "NOT" in found.result.convergence:
                lines.append(f"{method} did not converge.")
            lines += (f"{method}: {note}." for note in found.result.notes)
        for line in lines:
            remarks.setdefault(line, []).append(drive.name)
    for line, names in remarks.items():
        yield line if len(names) == len(comparison.drives) else f"{line} ({_short(names)})"


def _short(names: Sequence[str], most: int = 3) -> str:
    """Return some names and how many there are."""
    return ", ".join(names) if len(names) <= most else f"{names[0]} and {len(names) - 1} more"


def _stacked(name: str) -> str:
    """Return a column name on two lines, the unit below, to keep columns narrow."""
    head, _, unit = name.rpartition(" [")
    if head:
        return f"{head}\n[{unit}"
    return name.replace(" (", "\n(")


def _table(fancy: bool) -> Table:
    """Return an empty table in the style of a terminal or of a pipe."""
    from rich import box
    from rich.table import Table

    return Table(
        box=box.SIMPLE_HEAD if fancy else None,
        pad_edge=False,
        padding=(0, 1) if fancy else (0, 2, 0, 0),
        show_edge=False,
        header_style="bold" if fancy else "",
    )


def markdown(comparison: Comparison, title: str, figures: Iterable[str]) -> str:
    """Return the report as Markdown: the printed text, then the figures by relative path."""
    parts = [f"# {title}", "", "```text", plain_text(comparison).rstrip(), "```", ""]
    for figure in figures:
        parts += [f"![{figure}]({figure})", ""]
    return "\n".join(parts)
