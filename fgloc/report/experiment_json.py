"""The JSON of `fgloc experiments run`; its keys are a contract (docs/json.md): additions only."""

from __future__ import annotations

from typing import Any

from fgloc import __version__
from fgloc.report.experiment_report import Cell, Distribution, Report, Table


def report_json(name: str, report: Report) -> dict[str, Any]:
    """Return the report as plain dicts, lists, numbers, strings and None."""
    return {
        "fgloc_version": __version__,
        "experiment": name,
        "title": report.title,
        "settings": dict(report.settings),
        "tables": [_table(table) for table in report.tables],
        "verdicts": {verdict.value: n for verdict, n in report.verdicts().items()},
        "notes": list(report.notes),
        "data": dict(report.data),
    }


def _table(table: Table) -> dict[str, Any]:
    """Return one entry of "tables"."""
    return {
        "id": table.id,
        "title": table.title,
        "labels": list(table.labels),
        "columns": [{"key": c.key, "title": c.title, "unit": c.unit} for c in table.columns],
        "rows": [
            {
                "labels": list(row.labels),
                "cells": {key: _cell(cell) for key, cell in row.cells.items()},
            }
            for row in table.rows
        ],
        "notes": list(table.notes),
    }


def _cell(cell: Cell | str) -> dict[str, Any]:
    """Return one cell; `value` is the median where there is a distribution."""
    if isinstance(cell, str):
        return {"text": cell}
    spread = cell.value if isinstance(cell.value, Distribution) else None
    document: dict[str, Any] = {"value": spread.median if spread is not None else cell.value}
    if spread is not None:
        document |= {"low": spread.low, "high": spread.high, "n": spread.n}
    if cell.published is not None:
        document |= {
            "published": cell.published,
            "tolerance": cell.tolerance,
            "verdict": None if cell.verdict is None else cell.verdict.value,
            "explanation": cell.explanation,
        }
    elif cell.target is not None:
        document |= {
            "target": cell.target,
            "verdict": None if cell.verdict is None else cell.verdict.value,
        }
    return document
