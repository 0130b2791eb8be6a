"""`calibration`: recorded robots calibrated on some drives and judged on others."""

from __future__ import annotations

from collections.abc import Sequence

from fgloc.experiments.calibration.cases import (
    Outcome,
    describe,
    optiodom_cases,
    other_cases,
    run_case,
    sensor_cases,
    swerve_cases,
)
from fgloc.experiments.calibration.figures import paths_figure, residual_figure
from fgloc.experiments.calibration.tables import (
    censi_table,
    jackal_table,
    models_table,
    optiodom_table,
    polimi_table,
    surfaces_table,
    swerve_table,
)
from fgloc.experiments.experiment import Context, Experiment
from fgloc.report.experiment_report import Report

NEEDS = (
    "vitko-swerve",
    "optiodom",
    "jackal-jackass",
    "polimi-mecanum",
    "censi-calibration",
    "borealtc-husky",
    "penn-skidsteer",
)
"""Recordings with a truth, a matched laser, or a gyro."""


def run(context: Context) -> Report:
    """Return the tables of whatever runs of the recordings are on this machine."""
    cases = [
        *swerve_cases(context.data),
        *optiodom_cases(context.data),
        *other_cases(context.data),
        *sensor_cases(context.data),
    ]
    found = context.map(run_case, [(c, context.data) for c in cases], describe)
    chosen = [o for o in found if o.case.model is None]
    return Report(
        "Calibration of recorded robots, judged on drives that were not used for it",
        (
            swerve_table(_of("swerve", found)),
            optiodom_table(_of("optiodom", found)),
            jackal_table(_of("jackal", found)),
            polimi_table(_of("polimi", found)),
            censi_table(_of("censi", found)),
            surfaces_table(_of("surfaces", found)),
            models_table(chosen),
        ),
        (
            "Wheels alone, open loop from the true start; nominal values of the first drive of the "
            "fit. Everything is what `fgloc calibrate FIT --evaluate JUDGED` prints.",
        ),
        (paths_figure(found, context.data), residual_figure(found, context.data)),
        {"cases": [{"fit": c.fit, "judged": c.judged, "model": c.model} for c in cases]},
        data={
            f"{o.case.group}: {o.case.title}, {o.case.model or 'chosen'}": {
                p.name: [p.nominal, p.value, p.sigma] for p in o.report.parameters
            }
            for o in found
        },
    )


def _of(group: str, outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Return the outcomes of one table."""
    return [o for o in outcomes if o.case.group == group]


EXPERIMENT = Experiment(
    "calibration",
    "recorded robots calibrated on some drives and judged on others, models chosen between",
    NEEDS,
    run,
)
