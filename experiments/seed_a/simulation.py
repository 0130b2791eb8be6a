"""`seed-a-simulation`: Tables 3.1 to 3.6, and two scenarios that the seed left open.

The methods run as in the seed: Models 1 and 2 with the track of each case, Model 1 with its
midpoint step; whatever estimates the track starts from 0.48 m with the prior of a skid-steer base.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from fgloc.experiments.experiment import Context, Experiment
from fgloc.experiments.seed_a import remarks
from fgloc.experiments.seed_a.figures import (
    draws_figure,
    paths_figure,
    scan_figure,
    scenario5_figure,
    track_figure,
)
from fgloc.experiments.seed_a.ideal_text import ideal_table
from fgloc.experiments.seed_a.published import CASES, TABLES
from fgloc.experiments.seed_a.runs import (
    Ends,
    Entrant,
    Job,
    Scenario,
    describe,
    entrants,
    gather,
    run_job,
    split,
)
from fgloc.experiments.seed_a.start_scan import TRACKS, Start, scan
from fgloc.experiments.seed_a.tables import (
    comparison_table,
    end_errors,
    failures,
    printed_table,
    track_table,
)
from fgloc.experiments.seed_a.tuned import Training, noise_table, train, with_tuned
from fgloc.experiments.tuning import Tuned
from fgloc.report.experiment_report import Report, Table

CHUNK = 5
"""Seeds in one job: a few seconds, so that both processes end at about the same time."""

SCENARIOS = (
    Scenario("ideal", "seed-a-{case}-ideal"),
    Scenario("slip20", "seed-a-{case}-slip20"),
    Scenario("slip40ticks", "seed-a-{case}-slip40ticks"),
    Scenario("slip40ticks96", "seed-a-{case}-slip40ticks96"),
    Scenario("bothleft", "seed-a-{case}-bothleft"),
    Scenario("allwheels", "seed-a-{case}-allwheels"),
    Scenario("bothleft-camera", "seed-a-{case}-bothleft", "camera=on", seeds=10),
    Scenario("slip20-selection", "seed-a-{case}-slip20", selection=True),
    Scenario("slip40ticks-selection", "seed-a-{case}-slip40ticks", selection=True),
    Scenario("noise", "seed-a-{case}-noise", seeds=200),
    # Fewer than of scenario 2: the smoothers look for slip, which takes several times as long.
    Scenario("slip20noise", "seed-a-{case}-slip20noise", seeds=30),
    Scenario("slip20noise-selection", "seed-a-{case}-slip20noise", seeds=20, selection=True),
    Scenario(
        "slip20noise-selection-acc", "seed-a-{case}-slip20noise", "acc=on", seeds=10, selection=True
    ),
)
"""What is driven, in all three cases."""
TRIALS = 100
"""Settings that tuning tries."""
TRAINED_ON = {
    "model3": ("noise", "slip20noise"),
    "pose-ekf": ("bothleft-camera",),
    "rl-ekf": ("bothleft-camera",),
}
"""Scenarios that the filters are tuned on, with other seeds."""
TUNED_IN = {
    **dict.fromkeys(
        ("ideal", "noise", "slip20", "slip40ticks", "bothleft", "allwheels", "slip20noise"),
        ("model3",),
    ),
    "bothleft-camera": ("pose-ekf", "rl-ekf"),
}
"""Filters that run with the tuned noise, by scenario."""

EVERYONE = ("model1", "model2", "model3", "batch", "online")
"""Methods of every scenario."""
WITH_CAMERA = ("pose-ekf", "rl-ekf", "batch", "online")
"""Methods that use a camera, where there is one."""


def run(context: Context) -> Report:
    """Return all tables. All numbers but the seconds depend on nothing but the seeds."""
    scenarios = {s.key: s for s in SCENARIOS}
    if context.seeds is not None:
        scenarios = {
            k: replace(s, seeds=context.seeds) if s.seeds else s for k, s in scenarios.items()
        }
    jobs = [
        job
        for scenario in scenarios.values()
        for case in CASES
        for job in split(
            scenario,
            case,
            entrants(*(WITH_CAMERA if "camera" in scenario.key else EVERYONE)),
            CHUNK,
        )
    ]
    trainings = [
        Training(one, tuple(scenarios[key] for key in keys), TRIALS)
        for method, keys in TRAINED_ON.items()
        for one in entrants(method)
    ]
    # The longest first, so that no process waits for it at the end.
    tasks: list[Task] = [*trainings, *TRACKS, *jobs]
    found = context.map(_work, tasks, _describe)
    tuned: list[Tuned] = found[: len(trainings)]
    starts = [s for line in found[len(trainings) : -len(jobs)] for s in line]
    ends = gather(jobs, found[-len(jobs) :])
    better = {t.entrant.id: with_tuned(t.entrant, r) for t, r in zip(trainings, tuned, strict=True)}
    # Filters alone take less time than starting processes for them.
    more = [
        Job(j.scenario, j.case, j.seeds, tuple(better[m] for m in TUNED_IN[j.scenario.key]))
        for j in jobs
        if j.scenario.key in TUNED_IN
    ]
    ends |= gather(more, [run_job(job) for job in more])
    noise = [noise_table(t, r) for t, r in zip(trainings, tuned, strict=True)]
    return Report(
        "Seed A, simulated cases",
        (*_tables(scenarios, ends, better), *noise),
        tuple(_notes(scenarios, ends, starts)),
        (
            draws_figure(scenarios["noise"], entrants(*EVERYONE), ends),
            paths_figure(
                [
                    (scenarios["slip20"], "20 %"),
                    (scenarios["slip40ticks"], "+40 counts"),
                    (scenarios["bothleft"], "both left"),
                ],
                entrants(*EVERYONE),
                ends,
            ),
            scenario5_figure(scenarios["slip20noise"], entrants(*EVERYONE), ends),
            track_figure([(scenarios["ideal"], "ideal"), (scenarios["slip20"], "20 %")], ends),
            scan_figure(starts),
        ),
        {
            "seeds": {key: s.seeds for key, s in scenarios.items()},
            "drives": {key: f"sim:{s.drive}" for key, s in scenarios.items()},
            "methods": [e.id for e in entrants(*EVERYONE, *WITH_CAMERA[:2])],
            "tuned": {t.method: dict(t.values) for t in tuned},
        },
        {
            f"{scenario}-{case}/{who}": several[0].trajectory
            for (scenario, case, who), several in ends.items()
            if several[0].trajectory is not None
        },
        end_errors(ends),
    )


Task = Job | Training | float
"""A piece of work: runs of all methods, tuning, or Model 3 from an initial track [m]."""


def _work(task: Task) -> Any:
    """Return the result of one piece of work."""
    if isinstance(task, Training):
        return train(task)
    return run_job(task) if isinstance(task, Job) else scan(task)


def _describe(task: Task) -> str:
    """Return what a piece of work was, for a line of progress."""
    if isinstance(task, Training):
        return f"{task.entrant.id} tuned"
    return describe(task) if isinstance(task, Job) else f"model3 from a track of {task:g} m"


def _tables(
    scenarios: Mapping[str, Scenario], ends: Ends, tuned: Mapping[str, Entrant]
) -> Iterator[Table]:
    """Yield the printed tables, then what the seed did not print."""

    def named(**names: str) -> list[tuple[Scenario, str]]:
        return [(scenarios[key.replace("_", "-")], name) for key, name in names.items()]

    everyone = _beside(entrants(*EVERYONE), tuned)
    yield ideal_table()
    for printed in TABLES:
        keys: tuple[str, ...] = ("noise",)
        if printed.scenario == "slip":
            keys = ("slip20", "slip40ticks")
        if printed.id == "table-3.4":
            keys = ("slip20", "slip40ticks", "slip40ticks96")
        who = _beside(entrants(printed.method, "batch", "online"), tuned)
        yield printed_table(printed, [scenarios[k] for k in keys], who, ends)
    title = "Scenario 1: no noise, no slip"
    yield comparison_table("scenario-1", title, named(ideal=""), everyone, ends)
    yield comparison_table(
        "scenario-4",
        "Scenario 4: both left wheels (and, for comparison, all four) slip 20 % from 3 s to 5 s",
        named(bothleft="left", allwheels="all four"),
        everyone,
        ends,
    )
    yield comparison_table(
        "scenario-4-camera",
        "Scenario 4 with camera odometry: both left wheels slip",
        named(bothleft_camera=""),
        _beside(entrants(*WITH_CAMERA), tuned),
        ends,
    )
    title = "Scenario 5: slip of 20 % with noise of encoders and yaw"
    yield comparison_table("scenario-5", title, named(slip20noise=""), everyone, ends)
    yield comparison_table(
        "encoder-selection",
        "Encoder selection (equations 3.3 to 3.6)",
        named(
            slip20_selection="20 %",
            slip40ticks_selection="+40 counts",
            slip20noise_selection="20 %, noise",
            slip20noise_selection_acc="20 %, noise, accelerometer",
        ),
        entrants(*EVERYONE),
        ends,
    )
    yield track_table(
        named(
            ideal="ideal",
            noise="noise",
            slip20="20 %",
            slip40ticks="+40 counts",
            bothleft="both left",
            slip20noise="20 %, noise",
        ),
        _beside(entrants("model3", "batch", "online"), tuned),
        ends,
    )


def _beside(who: Sequence[Entrant], tuned: Mapping[str, Entrant]) -> tuple[Entrant, ...]:
    """Return the entrants, each followed by itself with tuned noise where that exists."""
    return tuple(x for e in who for x in ((e, tuned[e.id]) if e.id in tuned else (e,)))


def _notes(scenarios: Mapping[str, Scenario], ends: Ends, starts: list[Start]) -> Iterator[str]:
    """Yield the sentences below the tables."""
    smoothers = entrants("batch", "online")
    yield remarks.how_they_start(entrants(*EVERYONE, *WITH_CAMERA[:2]))
    yield remarks.how_many(scenarios)
    yield remarks.scenario_3(ends, entrants("model3", "batch", "online"))
    yield from remarks.scenario_4(ends, smoothers)
    yield remarks.observability(ends, smoothers)
    yield from remarks.selection(ends)
    yield remarks.start_of_model3(starts)
    yield from failures(ends)


EXPERIMENT = Experiment(
    "seed-a-simulation",
    "Tables 3.1 to 3.6 of seed A, and slip that it left open: three motions, five scenarios",
    (),
    run,
)
