"""`seed-d-calibration`: the published calibration problem, its four optimisers beside each other.

Twelve parameters within 5 % of nominal, the publication's kinematics and cost, on the recordings of
the nominal robot. The publication drove its calibrated robots anew; here every parameter set is
judged on the same recordings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fgloc.calibration.optimisers.genetic import genetic
from fgloc.calibration.optimisers.interior_point import interior_point
from fgloc.calibration.optimisers.least_squares import bounded_least_squares
from fgloc.calibration.optimisers.outcome import Outcome
from fgloc.calibration.optimisers.swarm import particle_swarm
from fgloc.calibration.optimisers.swerve_problem import (
    SwerveProblem,
    swerve_problem,
)
from fgloc.core.drive import Drive
from fgloc.errors import FglocError
from fgloc.experiments.experiment import Context, Experiment
from fgloc.experiments.seed_d.calibration_tables import (
    TITLES,
    cost_table,
    held_out_table,
    parameter_table,
    places_figure,
    printed_table,
)
from fgloc.experiments.seed_d.runs import DATASET, load, repetition
from fgloc.report.experiment_report import Report

SEED = 1
"""Seed of the two methods that draw random numbers."""


@dataclass(frozen=True)
class Job:
    """One optimiser on some runs."""

    id: str
    """Which one, a key of TITLES."""
    runs: tuple[str, ...]
    """Runs of the data set."""
    data: Path | None = None
    """Folder that is searched first."""


def optimise(job: Job) -> Outcome | None:
    """Return what an optimiser found, None where it is not installed. Compiles before it times."""
    problem = swerve_problem(_drives(job.runs, job.data))
    problem.cost(problem.nominal)
    problem.gradient(problem.nominal)
    if job.id == "nominal":
        return Outcome(problem.nominal, problem.cost(problem.nominal), 1, 0.0)
    methods: Mapping[str, Callable[[SwerveProblem], Outcome]] = {
        "interior-point": interior_point,
        "least-squares": bounded_least_squares,
        "genetic": lambda p: genetic(p, np.random.default_rng(SEED)),
        "swarm": lambda p: particle_swarm(p, SEED),
    }
    try:
        return methods[job.id](problem)
    except FglocError:
        return None


def describe(job: Job) -> str:
    """Return what a job was, for a line of progress."""
    return f"{TITLES[job.id]} on {len(job.runs)} runs"


def run(context: Context) -> Report:
    """Return the tables of whatever runs are on this machine. Raises FglocError if none is."""
    from fgloc.datasets.registry import list_drives

    runs = tuple(d.partition(":")[2] for d in list_drives(DATASET, context.data))
    last = max(repetition(r) for r in runs)
    fit = tuple(r for r in runs if repetition(r) != last)
    judged = tuple(r for r in runs if repetition(r) == last)
    # One after the other where time counts: the shorter ones would share the processor's cache.
    jobs = [Job(i, runs, context.data) for i in TITLES]
    jobs += [Job(i, fit, context.data) for i in TITLES] if fit else []
    outcomes = context.map(optimise, jobs, describe)
    whole = {j.id: o for j, o in zip(jobs, outcomes, strict=True) if j.runs == runs and o}
    part = {j.id: o for j, o in zip(jobs, outcomes, strict=True) if j.runs == fit and o}
    drives = _drives(runs, context.data)
    problem = swerve_problem(drives)
    tables = [
        cost_table(whole, problem, drives),
        parameter_table(whole, problem),
        printed_table(problem, drives),
    ]
    if fit:
        tables.append(
            held_out_table(part, _drives(fit, context.data), _drives(judged, context.data))
        )
    missing = (
        () if "swarm" in whole else ("Particle swarm needs pymoo: pip install fgloc[search].",)
    )
    return Report(
        f"Seed D: twelve parameters, four optimisers, {len(runs)} recorded drives",
        tuple(tables),
        (
            "The publication's kinematics, cost and bounds (±5 %), Euler steps. Times are without "
            "reading and compiling.",
            *missing,
        ),
        (places_figure(whole, problem),),
        {"runs": runs, "fit": fit, "judged": judged, "seed": SEED},
        data={
            name: {"cost": o.cost, "parameters": o.parameters.tolist(), "seconds": o.seconds}
            for name, o in whole.items()
        },
    )


def _drives(runs: Sequence[str], data: Path | None) -> list[Drive]:
    """Return the recorded drives of some runs."""
    return [load(r, None, data) for r in runs]


EXPERIMENT = Experiment(
    "seed-d-calibration",
    "Table 42 of seed D: twelve parameters by four optimisers on recorded drives",
    (DATASET,),
    run,
)
