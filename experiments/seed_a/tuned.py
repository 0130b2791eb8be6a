"""Model 3 with its noise tuned: fitted on seeds that nothing here is judged on."""

from __future__ import annotations

from dataclasses import dataclass

from fgloc.experiments.seed_a.published import CASES
from fgloc.experiments.seed_a.runs import SMOOTHED_TRACK, Entrant, Scenario, drive_id
from fgloc.experiments.tuning import Tuned
from fgloc.report.experiment_report import Cell, Column, Row, Table

FIRST_SEED = 10_001
"""First of the training seeds; those that are judged count from 1."""


@dataclass(frozen=True)
class Training:
    """What a method is tuned on and with which budget."""

    method: str
    """Method id; one of `fgloc.experiments.tunables`."""
    scenarios: tuple[Scenario, ...]
    """Kinds of drive, each in all three cases."""
    seeds: int = 5
    """Seeds of each case."""
    budget: int = 100
    """How many settings are tried."""


def train(training: Training) -> Tuned:
    """Return the tuned parameters; deterministic. Some 7 s of Model 3 with the defaults."""
    from fgloc.datasets.registry import load_drive
    from fgloc.experiments.tunables import tunable
    from fgloc.experiments.tuning import tune

    drives = [
        load_drive(drive_id(scenario, case, seed, SMOOTHED_TRACK))
        for scenario in training.scenarios
        for case in CASES
        for seed in range(FIRST_SEED, FIRST_SEED + training.seeds)
    ]
    return tune(tunable(training.method), drives, training.budget)


def entrant(tuned: Tuned, title: str) -> Entrant:
    """Return the tuned method as it takes part."""
    return Entrant(
        f"{tuned.method}-tuned",
        f"{title} tuned",
        tuned.method,
        tuned=tuple(tuned.values.items()),
    )


def noise_table(tuned: Tuned, training: Training) -> Table:
    """Return the printed and the tuned noise, in units of the printed."""
    from fgloc.experiments.tunables import tunable

    rows = [
        Row((name,), {"printed": f"{value:.1e}", "tuned": f"{tuned.values[name]:.1e}"})
        for name, value in tunable(tuned.method).defaults.items()
    ]
    scores = {"printed": Cell(tuned.default_score, 4), "tuned": Cell(tuned.score, 4)}
    rows.append(Row(("mean position RMSE in training [m]",), scores))
    names = " and ".join(s.key for s in training.scenarios)
    notes = (
        f"Tuned by {training.budget} trials on {len(CASES) * len(training.scenarios)} × "
        f"{training.seeds} drives ({names}, seeds from {FIRST_SEED}), by the procedure of "
        "fgloc.experiments.tuning; judged on other seeds.",
        *(f"{name} ended at the end of its range." for name in tuned.at_limit),
    )
    return Table(
        "model3-noise",
        "Model 3: variances as printed (Q and R, per packet) and tuned",
        ("variance",),
        (Column("printed", "printed"), Column("tuned", "tuned")),
        tuple(rows),
        notes,
    )
