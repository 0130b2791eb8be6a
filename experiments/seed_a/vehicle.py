"""`seed-a-vehicle`: the three laboratory runs, SIMULATED from what is printed of them.

The raw logs are not published. `fgloc.datasets.simulator.seed_a_vehicle` says what is printed, what
follows by construction and what is assumed.
"""

from __future__ import annotations

from dataclasses import replace

from fgloc.experiments.experiment import Context, Experiment
from fgloc.experiments.seed_a.published import CASES
from fgloc.experiments.seed_a.published_vehicle import SCALES, TABLES
from fgloc.experiments.seed_a.runs import Scenario, describe, entrants, gather, run_job, split
from fgloc.experiments.seed_a.tables import comparison_table, failures, printed_table
from fgloc.report.experiment_report import Report

SEEDS = 100
CHUNK = 10
SELECTED = Scenario("vehicle", "seed-a-vehicle-{case}", seeds=SEEDS, selection=True)
UNSELECTED = Scenario("unselected", "seed-a-vehicle-{case}", seeds=SEEDS)


def run(context: Context) -> Report:
    """Return the tables of the laboratory runs, simulated."""
    everyone = entrants("model1", "model2", "model3", "batch", "online")
    seeds = SEEDS if context.seeds is None else context.seeds
    scenarios = {s.key: replace(s, seeds=seeds) for s in (SELECTED, UNSELECTED)}
    jobs = [
        job
        for scenario in scenarios.values()
        for case in CASES
        for job in split(scenario, case, everyone, CHUNK)
    ]
    ends = gather(jobs, context.map(run_job, jobs, describe))
    tables = [
        printed_table(
            printed,
            [scenarios[printed.scenario]],
            (*entrants(printed.method), *entrants("batch", "online")),
            ends,
            SCALES,
        )
        for printed in TABLES
    ]
    tables.append(
        comparison_table(
            "without-selection",
            "All methods without encoder selection, SIMULATED",
            [(scenarios["unselected"], "")],
            everyone,
            ends,
            scales=SCALES,
        )
    )
    return Report("Seed A, laboratory runs, SIMULATED", tuple(tables), tuple(failures(ends)))


EXPERIMENT = Experiment(
    "seed-a-vehicle",
    "Tables 4.1 to 4.3 of seed A: its laboratory runs, simulated (the logs are not published)",
    (),
    run,
)
