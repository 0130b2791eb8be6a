"""Seed A's simulated cases: Models 1 to 3 as published, beside the smoothers."""

from __future__ import annotations

import math

from fgloc.experiments.experiment import Context, Experiment
from fgloc.report.experiment_report import Cell, Column, Report, Row, Table

TABLE_3_2 = {"straight": (0.379, 6.8), "spin": (0.025, 13.5), "circle": (0.539, 12.6)}
"""Model 1 with slip: end-point errors [m, deg]."""


def _end_errors(job: tuple[str, str]) -> tuple[float, float]:
    """Return the end-point error [m, deg] of a method on a drive."""
    from fgloc.datasets.registry import load_drive
    from fgloc.experiments.methods import create

    drive, method = job
    loaded = load_drive(drive)
    result = create(method, integrator="midpoint").estimate(loaded)
    assert loaded.truth is not None
    x, y, heading = (result.trajectory.poses[-1] - loaded.truth.trajectory.poses[-1]).tolist()
    return math.hypot(x, y), abs(math.degrees(heading))


def run(context: Context) -> Report:
    """Return Table 3.2."""
    jobs = [(f"sim:seed-a-{case}-slip20", m) for case in TABLE_3_2 for m in ("model1", "batch")]
    ends = dict(zip(jobs, context.map(_end_errors, jobs, " ".join), strict=True))
    columns = (Column("model1", "Model 1"), Column("batch", "batch"))
    rows = []
    for case, published in TABLE_3_2.items():
        for k, label in enumerate(("position [m]", "heading [deg]")):
            here = {m: ends[f"sim:seed-a-{case}-slip20", m][k] for m in ("model1", "batch")}
            digits = (3, 1)[k]
            rows.append(
                Row(
                    (case, label),
                    {
                        "model1": Cell(here["model1"], digits, published[k]),
                        "batch": Cell(here["batch"], digits),
                    },
                )
            )
    table = Table(
        "table-3.2", "Table 3.2: slip of 20 %", ("case", "end error"), columns, tuple(rows)
    )
    return Report("Seed A, simulated cases", (table,))


EXPERIMENT = Experiment(
    "seed-a-simulation", "Tables 3.1 to 3.6 of seed A: three motions, five scenarios", (), run
)
