"""An experiment's report as text: on a terminal, in a pipe, and as Markdown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from fgloc.report.cells import new_table
from fgloc.report.experiment_report import (
    Cell,
    Report,
    Table,
    Verdict,
    footnotes,
    number,
    shown,
    verdict_text,
)
from fgloc.report.printing import plain, print_parts

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

VERDICT = "verdict"
"""Heading of the last column."""


def print_report(report: Report, console: Console | None = None) -> None:
    """Print the report on stdout (or `console`)."""
    print_parts(lambda fancy: _parts(report, fancy), console)


def plain_text(report: Report) -> str:
    """Return what a pipe gets."""
    return plain(lambda fancy: _parts(report, fancy))


def headings(table: Table) -> list[str]:
    """Return the headings of all columns as they are shown, the unit on a second line."""
    found = list(table.labels)
    for column in table.columns:
        unit = f"\n[{column.unit}]" if column.unit else ""
        if table.published(column):
            found.append(f"published{unit}")
        if table.targeted(column):
            found.append(f"at most{unit}")
        found.append(f"{column.title}{unit}")
    return [*found, VERDICT] if _judged(table) else found


def lines(table: Table) -> list[list[str]]:
    """Return the texts of all rows, in the order of `headings`."""
    marks = footnotes(table)
    found = []
    for row in table.rows:
        line = list(row.labels)
        for column in table.columns:
            cell = row.cells.get(column.key)
            if table.published(column):
                known = isinstance(cell, Cell) and cell.published is not None
                line.append(
                    number(cell.published, cell.decimals)
                    if isinstance(cell, Cell) and known
                    else ""
                )
            if table.targeted(column):
                wanted = cell.target if isinstance(cell, Cell) else None
                line.append("" if wanted is None else f"{wanted:g}")
            line.append(shown(cell))
        if _judged(table):
            line.append(verdict_text(table, row, marks))
        found.append(line)
    return found


def remarks(table: Table) -> list[str]:
    """Return the explanations with their marks, then the table's own notes."""
    return [*(f"{mark} {text}" for text, mark in footnotes(table).items()), *table.notes]


def summary(report: Report) -> str:
    """Return one sentence on how many published numbers and targets have which verdict."""
    cells = [cell for table in report.tables for _, _, cell in table.judged()]
    published = Counter(c.verdict for c in cells if c.published is not None)
    targets = Counter(c.verdict for c in cells if c.published is None)
    parts = [
        f"{total.total()} {what}: "
        + ", ".join(f"{total[verdict]} {verdict.value}" for verdict in Verdict if total[verdict])
        for what, total in (("published numbers", published), ("targets", targets))
        if total
    ]
    return "Of " + "; of ".join(parts) if parts else ""


def markdown(report: Report, figures: Sequence[tuple[str, str]]) -> str:
    """Return the report as Markdown; `figures` are (relative path, caption)."""
    parts = [f"# {report.title}", ""]
    parts += [f"- {note}" for note in report.notes]
    if summary(report):
        parts += ["", f"**{summary(report)}.**"]
    for table in report.tables:
        parts += ["", f"## {table.title}", ""]
        heads = [h.replace("\n", " ") for h in headings(table)]
        left = len(table.labels)
        marks = [":--" if k < left or h == VERDICT else "--:" for k, h in enumerate(heads)]
        parts += [_markdown_line(line) for line in (heads, marks, *lines(table))]
        for remark in remarks(table):
            parts += ["", remark]
    for path, caption in figures:
        parts += ["", f"![{caption}]({path})", "", f"*{caption}*"]
    return "\n".join(parts) + "\n"


def _markdown_line(cells: Sequence[str]) -> str:
    """Return one line of a table; a bar within a cell would end it."""
    return "| " + " | ".join(c.replace("|", "\\|") for c in cells) + " |"


def _judged(table: Table) -> bool:
    """Return True if the table has a published number or a target."""
    return any(True for _ in table.judged())


def _parts(report: Report, fancy: bool) -> Iterator[RenderableType]:
    """Yield everything that is printed, in order."""
    yield report.title
    yield ""
    for table in report.tables:
        yield table.title
        shown_table = new_table(fancy)
        heads = headings(table)
        for k, head in enumerate(heads):
            left = k < len(table.labels) or head == VERDICT
            shown_table.add_column(head, justify="left" if left else "right", no_wrap=True)
        before: list[str] = []
        for line in lines(table):
            # A label that repeats the one above it, with all labels before it, is left out.
            same = 0
            while same < len(table.labels) - 1 and line[: same + 1] == before[: same + 1]:
                same += 1
            shown_table.add_row(*([""] * same + line[same:]))
            before = line
        yield shown_table
        yield from remarks(table)
        yield ""
    yield from report.notes
    if summary(report):
        yield f"{summary(report)}."
