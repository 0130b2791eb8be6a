"""`seed-d-nominal`: Table 42's nominal row, and fusion as in Table 67 with SEMI-REAL sensors.

Wheels and truth are the published recordings; camera and gyro are synthesised from the truth, as no
recording of them is published (see `fgloc.datasets.simulator.semi_real`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from fgloc.core.robot import Robot
from fgloc.experiments.experiment import Context, Experiment
from fgloc.experiments.seed_d.figures import bars_figure, paths_figure
from fgloc.experiments.seed_d.runs import (
    DATASET,
    ENTRANTS,
    Job,
    Noise,
    Score,
    Training,
    describe,
    describe_fit,
    describe_training,
    fit_job,
    own_stamps,
    repetition,
    run_job,
    train,
)
from fgloc.experiments.seed_d.tables import (
    fusion_table,
    motion_table,
    noise_table,
    nominal_table,
    totals_by_seed,
)
from fgloc.report.experiment_report import Report

SEEDS = 20
"""Seeds of the semi-real sensors."""
BUDGET = 60
"""Settings that are tried in tuning the EKF."""

NOTES = (
    "SEMI-REAL: wheels and truth are recorded; a T265-like camera and an MPU6050-like gyro are "
    "synthesised from the recorded truth. Any command takes such a drive as "
    "semi:vitko-swerve:RUN?seed=N.",
    "All methods start at the truth's first pose and are offered the same measurements. Filters "
    "and online are scored on the pose as emitted, batch on the smoothed one.",
)


def run(context: Context) -> Report:
    """Return the tables of whatever runs are on this machine. Raises FglocError if none is."""
    from fgloc.datasets.registry import list_drives

    runs = [drive.partition(":")[2] for drive in list_drives(DATASET, context.data)]
    calibrations = _calibrations(context, runs)
    noise = _tuned(context, runs, calibrations)
    seeds: list[int | None] = [None, *context.over(SEEDS)]
    first = set(_first_of_each(runs))
    jobs = [
        Job(
            name,
            seed,
            calibrations.get(repetition(name)),
            noise,
            context.data,
            keep=name in first and seed in (None, 1),
        )
        for seed in seeds
        for name in runs
    ]
    scores: dict[str, list[Score]] = {}
    for found in context.map(run_job, jobs, describe):
        for entrant, score in found.items():
            scores.setdefault(entrant, []).append(score)
    floor = [own_stamps(name, context.data) for name in runs]
    count = len(seeds) - 1
    tables = [
        nominal_table(scores),
        fusion_table(scores, floor, count),
        motion_table(scores),
        noise_table(noise, BUDGET),
    ]
    missing = () if calibrations else ("One repetition only: no calibrated robot.",)
    return Report(
        f"Seed D: nominal parameters and fusion, SEMI-REAL, {len(runs)} recorded drives",
        tuple(tables),
        (*NOTES, *missing, _times(scores)),
        (paths_figure(scores, context.data), bars_figure(scores)),
        {
            "runs": runs,
            "seeds": count,
            "methods": {e.id: e.title for e in ENTRANTS if e.id in scores},
            "budget": BUDGET,
            "noise": {name: dict(found) for name, found in noise.items()},
            "calibrations": {
                f"without repetition {k + 1}": {p.name: p.nominal for p in c.base.parameters}
                for k, c in calibrations.items()
            },
        },
        data={
            "totals": {name: totals_by_seed(found).tolist() for name, found in scores.items()},
            "e_max": {
                name: [[s.run, s.seed, *s.e_max] for s in found] for name, found in scores.items()
            },
        },
    )


def _calibrations(context: Context, runs: Sequence[str]) -> dict[int, Robot]:
    """Return for every repetition the robot fitted on the runs of all others."""
    repetitions = sorted({repetition(name) for name in runs})
    if len(repetitions) < 2:
        return {}
    jobs = [
        (tuple(name for name in runs if repetition(name) != k), context.data) for k in repetitions
    ]
    found = context.map(fit_job, jobs, describe_fit)
    return dict(zip(repetitions, found, strict=True))


def _tuned(
    context: Context, runs: Sequence[str], calibrations: Mapping[int, Robot]
) -> dict[str, Noise]:
    """Return the fitted noise of every tuned entrant."""
    chosen = [e for e in ENTRANTS if e.tuned and (calibrations or not e.calibrated)]
    jobs = [
        Training(e, tuple(_first_of_each(runs)), calibrations, BUDGET, context.data) for e in chosen
    ]
    found = context.map(train, jobs, describe_training)
    return {e.id: values for e, values in zip(chosen, found, strict=True)}


def _first_of_each(runs: Sequence[str]) -> list[str]:
    """Return the first run of each motion."""
    from fgloc.datasets.vitko_swerve import REPETITIONS

    first: dict[int, str] = {}
    for name in runs:
        first.setdefault((int(name) - 1) // REPETITIONS, name)
    return list(first.values())


def _times(scores: Mapping[str, Sequence[Score]]) -> str:
    """Return what the methods took."""
    found = {
        name: sum(s.seconds for s in values) / len(values)
        for name, values in scores.items()
        if name in ("pose-ekf", "batch", "online")
    }
    text = ", ".join(f"{name} {seconds:.2g} s" for name, seconds in found.items())
    return f"Time for a drive of about 74 s, mean: {text}."


EXPERIMENT = Experiment(
    "seed-d-nominal",
    "Tables 42 and 67 of seed D: nominal row, and fusion on recorded drives, SEMI-REAL sensors",
    (DATASET,),
    run,
)
