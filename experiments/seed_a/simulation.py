"""`seed-a-simulation`: Tables 3.1 to 3.6, and two scenarios that the seed left open.

The methods run as in the seed: Models 1 and 2 with the track of each case, Model 1 with its
midpoint step; whatever estimates the track starts from 0.48 m with the prior of a skid-steer base.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
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
    End,
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
    failures,
    printed_table,
    track_table,
)
from fgloc.report.experiment_report import Report, Table

CHUNK = 10
"""Seeds in one job."""
WRONG_TRACK = 0.6
"""Nominal track [m] of the straight run that shows what yaw alone cannot tell."""

SCENARIOS = (
    Scenario("ideal", "seed-a-{case}-ideal"),
    Scenario("slip20", "seed-a-{case}-slip20"),
    Scenario("slip40ticks", "seed-a-{case}-slip40ticks"),
    Scenario("bothleft", "seed-a-{case}-bothleft"),
    Scenario("bothleft-camera", "seed-a-{case}-bothleft", "camera=on", seeds=20),
    Scenario("slip20-selection", "seed-a-{case}-slip20", selection=True),
    Scenario("slip40ticks-selection", "seed-a-{case}-slip40ticks", selection=True),
    Scenario("noise", "seed-a-{case}-noise", seeds=200),
    # Fewer than of scenario 2: finding slip in noise takes several times as long.
    Scenario("slip20noise", "seed-a-{case}-slip20noise", seeds=100),
    Scenario("slip20noise-selection", "seed-a-{case}-slip20noise", seeds=40, selection=True),
    Scenario(
        "slip20noise-selection-acc", "seed-a-{case}-slip20noise", "acc=on", seeds=40, selection=True
    ),
)
"""What is driven, in all three cases."""
UNKNOWN_TRACK = Scenario("bothleft-track", "seed-a-{case}-bothleft")

EVERYONE = ("model1", "model2", "model3", "batch", "online")
"""Methods of every scenario."""
WITH_CAMERA = ("model1", "model2", "model3", "pose-ekf", "batch", "online")
"""Methods where there is a camera."""


def run(context: Context) -> Report:
    """Return all tables. All numbers but the seconds depend on nothing but the seeds."""
    scenarios = {s.key: s for s in SCENARIOS}
    if context.seeds is not None:
        scenarios = {
            k: replace(s, seeds=context.seeds) if s.seeds > 1 else s for k, s in scenarios.items()
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
    wrong = Entrant("batch", "batch", "batch", nominal_track=WRONG_TRACK)
    jobs.append(Job(UNKNOWN_TRACK, "straight", (1,), (wrong,)))
    found = context.map(_work, [*TRACKS, *jobs], _describe)
    starts = [s for line in found[: len(TRACKS)] for s in line]
    ends = gather(jobs, found[len(TRACKS) :])
    return Report(
        "Seed A, simulated cases",
        tuple(_tables(scenarios, ends)),
        tuple(_notes(ends, starts)),
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
            "methods": [e.id for e in entrants(*WITH_CAMERA)],
        },
        {
            f"{scenario}-{case}/{entrant}": several[0].trajectory
            for (scenario, case, entrant), several in ends.items()
            if several[0].trajectory is not None
        },
        _data(ends),
    )


def _work(task: Job | float) -> Any:
    """Return the result of one piece of work: runs of all methods, or of Model 3 from a track."""
    return run_job(task) if isinstance(task, Job) else scan(task)


def _describe(task: Job | float) -> str:
    """Return what a piece of work was, for a line of progress."""
    return describe(task) if isinstance(task, Job) else f"model3 from a track of {task:g} m"


def _tables(scenarios: Mapping[str, Scenario], ends: Ends) -> Iterator[Table]:
    """Yield the printed tables, then what the seed did not print."""

    def named(**names: str) -> list[tuple[Scenario, str]]:
        return [(scenarios[key.replace("_", "-")], name) for key, name in names.items()]

    everyone = entrants(*EVERYONE)
    yield ideal_table()
    for printed in TABLES:
        keys = ("slip20", "slip40ticks") if printed.scenario == "slip" else ("noise",)
        who = entrants(printed.method, "batch", "online")
        yield printed_table(printed, [scenarios[k] for k in keys], who, ends)
    title = "Scenario 1: no noise, no slip"
    yield comparison_table("scenario-1", title, named(ideal=""), everyone, ends)
    yield comparison_table(
        "scenario-4",
        "Scenario 4: both left wheels slip 20 % from 3 s to 5 s",
        named(bothleft="yaw", bothleft_camera="yaw, camera"),
        entrants(*WITH_CAMERA),
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
        everyone,
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
        entrants("model3", "batch", "online"),
        ends,
    )


def _notes(ends: Ends, starts: list[Start]) -> Iterator[str]:
    """Yield the sentences below the tables."""
    smoothers = entrants("batch", "online")
    yield remarks.wrong_start(entrants(*EVERYONE))
    yield remarks.scenario_3(ends, entrants("model3", "batch", "online"))
    yield from remarks.scenario_4(ends, smoothers)
    yield remarks.unknown_track(ends, WRONG_TRACK)
    yield from remarks.selection(ends)
    yield remarks.start_of_model3(starts)
    yield from failures(ends)


def _data(ends: Ends) -> dict[str, Any]:
    """Return the end errors of every seed and the time that each method took in all."""
    seconds: dict[str, float] = {}
    errors: dict[str, Any] = {}
    for (scenario, case, entrant), found in ends.items():
        seconds[entrant] = seconds.get(entrant, 0.0) + sum(e.seconds for e in found)
        errors.setdefault(scenario, {}).setdefault(case, {})[entrant] = _columns(found)
    return {"end_errors": errors, "seconds": seconds}


def _columns(found: list[End]) -> dict[str, list[float | None]]:
    """Return the errors of one method on one case, seed after seed."""
    return {
        "x_m": [e.x_m for e in found],
        "y_m": [e.y_m for e in found],
        "heading_deg": [e.turned_deg for e in found],
        "effective_track_m": [e.track for e in found],
    }


EXPERIMENT = Experiment(
    "seed-a-simulation",
    "Tables 3.1 to 3.6 of seed A, and slip that it left open: three motions, five scenarios",
    (),
    run,
)
