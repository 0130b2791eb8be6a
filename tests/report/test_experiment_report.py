"""Verdicts on hand-made cells, and the same table in all forms."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from fgloc.core.trajectory import Trajectory
from fgloc.report.experiment_files import write_experiment
from fgloc.report.experiment_html import html
from fgloc.report.experiment_json import report_json
from fgloc.report.experiment_report import (
    Cell,
    Column,
    Distribution,
    Figure,
    Report,
    Row,
    Table,
    Verdict,
    number,
)
from fgloc.report.experiment_text import markdown, plain_text
from fgloc.report.results_json import dumps

SPREAD = Distribution(0.010, 0.002, 0.020, 200)


@pytest.mark.parametrize(
    ("cell", "verdict"),
    [
        (Cell(0.379), None),
        (Cell(0.3794, 3, 0.379), Verdict.REPRODUCED),
        (Cell(0.378, 3, 0.379), Verdict.REPRODUCED),  # on the edge
        (Cell(0.3779, 3, 0.379), Verdict.FAILED),
        (Cell(0.3801, 3, 0.379), Verdict.FAILED),
        (Cell(0.3801, 3, 0.379, "a reason"), Verdict.EXPLAINED),
        (Cell(0.379, 3, 0.379, "a reason that is not needed"), Verdict.REPRODUCED),
        (Cell(12.64, 1, 12.6), Verdict.REPRODUCED),
        (Cell(SPREAD, 3, 0.013), Verdict.INSIDE),
        (Cell(SPREAD, 3, 0.021), Verdict.INSIDE),
        (Cell(SPREAD, 3, 0.022), Verdict.FAILED),
        (Cell(SPREAD, 4, 0.0008), Verdict.FAILED),
        # 0.00 stands for everything below 0.01.
        (Cell(SPREAD, 2, 0.00), Verdict.INSIDE),
        (Cell(SPREAD, 3, 0.160, "too much"), Verdict.EXPLAINED),
        (Cell(None, 3, 0.160), Verdict.MISSING),
        (Cell(float("nan"), 3, 0.160), Verdict.FAILED),
        (Cell(0.06, 3, target=0.06), Verdict.MET),
        (Cell(0.0604, 2, target=0.06), Verdict.MISSED),  # although it is shown as 0.06
        (Cell(SPREAD, 3, target=0.020), Verdict.MET),
        (Cell(SPREAD, 3, target=0.019), Verdict.MISSED),
        (Cell(float("nan"), 3, target=1.0), Verdict.MISSED),
        (Cell(None, 3, target=1.0), Verdict.MISSING),
    ],
)
def test_verdict(cell: Cell, verdict: Verdict | None) -> None:
    assert cell.verdict == verdict


def test_distribution_is_median_and_central_95_percent() -> None:
    # Quantiles of 0, 1, …, 200 by linear interpolation are 200 times the probability.
    assert Distribution.of([float(v) for v in range(201)]) == Distribution(100.0, 5.0, 195.0, 201)


@pytest.mark.parametrize(
    ("value", "decimals", "text"),
    [
        (6.749999999999999, 1, "6.8"),
        (6.74, 1, "6.7"),
        (-0.0004, 3, "0.000"),
        (-1.25, 1, "-1.3"),
        (2.0, 0, "2"),
        (float("nan"), 2, "-"),
        (None, 2, "-"),
    ],
)
def test_number(value: float | None, decimals: int, text: str) -> None:
    assert number(value, decimals) == text


def report() -> Report:
    table = Table(
        "t",
        "A table <with> signs & bars",
        ("case", "error"),
        (Column("m1", "Model 1", "m"), Column("batch", "batch", "m")),
        (
            Row(("one", "a|b"), {"m1": Cell(0.379, 3, 0.379), "batch": Cell(0.0012)}),
            Row(("one", "b"), {"m1": Cell(SPREAD, 3, 0.5, "half a metre is a misprint")}),
            Row(("two", "a"), {"m1": Cell(1.0, 1, 2.0), "batch": "no sensor"}),
        ),
        ("A note.",),
    )

    def draw(path: Path) -> None:
        path.write_bytes(b"png")

    import numpy as np

    track = Trajectory(np.array([0, 1], dtype=np.int64), np.zeros((2, 3)))
    return Report(
        "A title",
        (table,),
        ("A remark.",),
        (Figure("f", "A figure <1>.", draw),),
        {"seeds": [1, 2]},
        {"one/batch": track},
        {"raw": [float("nan")]},
    )


def test_plain_text() -> None:
    text = plain_text(report())
    assert re.search(r"one +a\|b +0\.379 +0\.379 +0\.001 +reproduced", text)
    assert re.search(r"\n +b +0\.500 +0\.010 \(0\.002…0\.020\) +explained \(a\)", text)
    assert re.search(r"two +a +2\.0 +1\.0 +no sensor +NOT reproduced", text)
    assert "(a) half a metre is a misprint" in text
    assert "Of 3 published numbers: 1 reproduced, 1 explained, 1 NOT reproduced." in text


def test_markdown_has_one_width() -> None:
    text = markdown(report(), [("figures/f.png", "A figure.")])
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert len(rows) == 5
    # An escaped bar does not end a cell.
    assert {len(re.findall(r"(?<!\\)\|", row)) for row in rows} == {7}
    assert "![A figure.](figures/f.png)" in text


def test_html_escapes_and_refers_to_nothing_elsewhere() -> None:
    text = html(report(), [("figures/f.png", "A figure <1>.")], "0")
    assert "A table &lt;with&gt; signs &amp; bars" in text
    assert 'alt="A figure &lt;1&gt;."' in text
    assert "http" not in text
    assert "<script" not in text
    assert text.count("<tr>") == 4
    for tag in ("table", "tr", "th", "td", "div", "ul", "li", "figure", "p", "h2"):
        assert len(re.findall(rf"<{tag}[ >]", text)) == text.count(f"</{tag}>")


def test_json() -> None:
    document = json.loads(dumps(report_json("x", report())))
    assert document["experiment"] == "x"
    assert document["verdicts"] == {"reproduced": 1, "explained": 1, "NOT reproduced": 1}
    rows = document["tables"][0]["rows"]
    assert rows[0]["cells"]["batch"] == {"value": 0.0012}
    assert rows[1]["cells"]["m1"] == {
        "value": 0.010,
        "low": 0.002,
        "high": 0.020,
        "n": 200,
        "published": 0.5,
        "tolerance": pytest.approx(0.001),
        "verdict": "explained",
        "explanation": "half a metre is a misprint",
    }
    assert rows[2]["cells"]["batch"] == {"text": "no sensor"}
    assert document["data"] == {"raw": [None]}


def test_targets_stand_beside_published_numbers() -> None:
    columns = (Column("ate", "position", "m"), Column("n", "number"))
    rows = (
        Row(("batch",), {"ate": Cell(0.05, 3, target=0.06), "n": Cell(2.0, 0, 2.0)}),
        Row(("filter",), {"ate": Cell(0.2, 3)}),
        Row(("online",), {"ate": Cell(0.2, 3, target=0.06)}),
    )
    found = Report("A title", (Table("t", "A table", ("method",), columns, rows),))
    text = plain_text(found)
    assert re.search(r"at most +position\nmethod +\[m\] +\[m\] +published +number +verdict", text)
    assert re.search(r"batch +0\.06 +0\.050 +2 +2 +position: target met; number: reproduced", text)
    assert re.search(r"filter +0\.200 *\n", text)
    assert re.search(r"online +0\.06 +0\.200 +target MISSED", text)
    assert (
        "Of 1 published numbers: 1 reproduced; of 2 targets: 1 target met, 1 target MISSED." in text
    )
    page = html(found, [], "0")
    assert '<td class="left bad">target MISSED</td>' in page
    assert '<td class="left good">position: target met; number: reproduced</td>' in page
    cells = report_json("x", found)["tables"][0]["rows"][2]["cells"]
    assert cells["ate"] == {"value": 0.2, "target": 0.06, "verdict": "target MISSED"}


def test_run_folder(tmp_path: Path) -> None:
    folder = write_experiment("x", report(), tmp_path, {"seeds": None})
    found = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
    assert found == {
        "settings.json",
        "README.txt",
        "report.json",
        "report.md",
        "report.html",
        "figures/f.png",
        "trajectories/one/batch.tum",
    }
    assert json.loads((folder / "settings.json").read_text())["settings"] == {"seeds": [1, 2]}
    assert (tmp_path / "latest").resolve() == folder.resolve()


def test_a_figure_that_fails_leaves_nothing(tmp_path: Path) -> None:
    def fail(path: Path) -> None:
        path.write_bytes(b"half")
        raise KeyboardInterrupt

    broken = Report("t", (), figures=(Figure("f", "", fail),))
    with pytest.raises(KeyboardInterrupt):
        write_experiment("x", broken, tmp_path, {})
    assert list(tmp_path.iterdir()) == []
