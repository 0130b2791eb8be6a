"""Filters with their noise tuned: fitted on seeds that nothing here is judged on."""

from __future__ import annotations

from dataclasses import dataclass

from fgloc.experiments.seed_a.published import CASES
from fgloc.experiments.seed_a.runs import Entrant, Scenario, drive_id
from fgloc.experiments.tuning import Tuned
from fgloc.report.experiment_report import Cell, Column, Row, Table

FIRST_SEED = 10_001
"""First of the training seeds; those that are judged count from 1."""


@dataclass(frozen=True)
class Training:
    """What a method is tuned on and with which budget."""

    entrant: Entrant
    """The method with its own noise; one of `fgloc.experiments.tunables`."""
    scenarios: tuple[Scenario, ...]
    """Kinds of drive, each in all three cases."""
    budget: int
    """How many settings are tried."""
    seeds: int = 5
    """Seeds of each case."""


def train(training: Training) -> Tuned:
    """Return the tuned parameters; deterministic. Some seconds a method."""
    from fgloc.datasets.registry import load_drive
    from fgloc.experiments.tunables import tunable
    from fgloc.experiments.tuning import tune

    entrant = training.entrant
    drives = [
        load_drive(drive_id(scenario, case, seed, entrant.nominal_track))
        for scenario in training.scenarios
        for case in CASES
        for seed in range(FIRST_SEED, FIRST_SEED + training.seeds)
    ]
    return tune(tunable(entrant.method, drives), drives, training.budget)


def with_tuned(entrant: Entrant, tuned: Tuned) -> Entrant:
    """Return the tuned method as it takes part."""
    return Entrant(
        f"{entrant.id}-tuned",
        f"{entrant.title} tuned",
        entrant.method,
        entrant.nominal_track,
        tuple(tuned.values.items()),
    )


def noise_table(training: Training, tuned: Tuned) -> Table:
    """Return the method's own noise and the tuned one."""
    from fgloc.experiments.tunables import TUNABLE

    entrant = training.entrant
    own = TUNABLE[entrant.method][0]
    rows = [
        Row((name,), {"own": f"{own[name].bounds.default:.2g}", "tuned": f"{value:.2g}"})
        for name, value in tuned.values.items()
    ]
    scores = {"own": Cell(tuned.default_score, 4), "tuned": Cell(tuned.score, 4)}
    rows.append(Row(("mean position RMSE in training [m]",), scores))
    names = " and ".join(s.key for s in training.scenarios)
    drives = len(CASES) * len(training.scenarios) * training.seeds
    return Table(
        f"{entrant.method}-noise",
        f"{entrant.title}: its own noise and the tuned one",
        ("parameter",),
        (Column("own", "own"), Column("tuned", "tuned")),
        tuple(rows),
        (
            f"Tuned with {training.budget} trials on {drives} drives ({names}, seeds from "
            f"{FIRST_SEED}), by the procedure in docs/tuning.md; judged on other seeds.",
            *(f"{name} ended at the end of its range." for name in tuned.at_limit),
        ),
    )
