"""`seed-a-simulation`: Tables 3.1 to 3.6, and two scenarios that the seed left open.

The methods run as in the seed: Models 1 and 2 with the track of each case, Model 1 with its
midpoint step; whatever estimates the track starts from 0.48 m with the prior of a skid-steer base.
"""

from __future__ import annotations

from dataclasses import replace

from fgloc.experiments.experiment import Context, Experiment
from fgloc.experiments.seed_a.figures import (
    draws_figure,
    paths_figure,
    scan_figure,
    scenario5_figure,
    track_figure,
)
from fgloc.experiments.seed_a.published import HEADING, POSITION, TABLES
from fgloc.experiments.seed_a.runs import (
    Scenario,
    describe,
    entrants,
    gather,
    run_job,
    split,
)
from fgloc.experiments.seed_a.start_scan import TRACKS, scan
from fgloc.experiments.seed_a.tables import (
    comparison_table,
    failures,
    printed_table,
    track_table,
)
from fgloc.report.experiment_report import Report

SEEDS = 200
"""Seeds of scenario 2."""
CHUNK = 10
"""Seeds in one job."""

IDEAL = Scenario("ideal", "seed-a-{case}-ideal")
NOISE = Scenario("noise", "seed-a-{case}-noise", seeds=SEEDS)
SLIP20 = Scenario("slip20", "seed-a-{case}-slip20")
SLIP40 = Scenario("slip40ticks", "seed-a-{case}-slip40ticks")
BOTH = Scenario("bothleft", "seed-a-{case}-bothleft")
BOTH_CAMERA = Scenario("bothleft-camera", "seed-a-{case}-bothleft", "camera=on", seeds=20)
SLIP_NOISE = Scenario("slip20noise", "seed-a-{case}-slip20noise", seeds=SEEDS)
SELECTED20 = Scenario("slip20-selection", "seed-a-{case}-slip20", selection=True)
SELECTED40 = Scenario("slip40ticks-selection", "seed-a-{case}-slip40ticks", selection=True)
SELECTED_NOISE = Scenario(
    "slip20noise-selection", "seed-a-{case}-slip20noise", seeds=SEEDS, selection=True
)
SELECTED_ACC = Scenario(
    "slip20noise-selection-acc", "seed-a-{case}-slip20noise", "acc=on", seeds=SEEDS, selection=True
)


def run(context: Context) -> Report:
    """Return all tables; deterministic but for the seconds."""
    everyone = entrants("model1", "model2", "model3", "batch", "online")
    with_camera = entrants("model1", "model2", "model3", "pose-ekf", "batch", "online")
    plan = [
        (IDEAL, everyone),
        (SLIP20, everyone),
        (SLIP40, everyone),
        (BOTH, everyone),
        (BOTH_CAMERA, with_camera),
        (SELECTED20, everyone),
        (SELECTED40, everyone),
        (NOISE, everyone),
        (SLIP_NOISE, everyone),
        (SELECTED_NOISE, everyone),
        (SELECTED_ACC, everyone),
    ]
    if context.seeds is not None:
        plan = [(replace(s, seeds=context.seeds) if s.seeds > 1 else s, e) for s, e in plan]
    known = {scenario.key: scenario for scenario, _ in plan}
    jobs = [
        job
        for scenario, who in plan
        for case in ("straight", "spin", "circle")
        for job in split(scenario, case, range(1, scenario.seeds + 1), who, CHUNK)
    ]
    ends = gather(jobs, context.map(run_job, jobs, describe))

    smoothers = entrants("batch", "online")
    tables = []
    for printed in TABLES:
        keys = ("slip20", "slip40ticks") if printed.scenario == "slip" else ("noise",)
        who = (*entrants(printed.method), *smoothers)
        tables.append(printed_table(printed, [known[k] for k in keys], who, ends))
    tables += [
        comparison_table(
            "scenario-1",
            "Scenario 1: no noise, no slip",
            [(known["ideal"], "")],
            everyone,
            ends,
        ),
        comparison_table(
            "scenario-4",
            "Scenario 4: both left wheels slip 20 % from 3 s to 5 s",
            [(known["bothleft"], "yaw"), (known["bothleft-camera"], "yaw, camera")],
            with_camera,
            ends,
        ),
        comparison_table(
            "scenario-5",
            "Scenario 5: slip of 20 % with noise of encoders and yaw",
            [(known["slip20noise"], "")],
            everyone,
            ends,
        ),
        comparison_table(
            "encoder-selection",
            "Encoder selection (equations 3.3 to 3.6)",
            [
                (known["slip20-selection"], "20 %"),
                (known["slip40ticks-selection"], "+40 counts"),
                (known["slip20noise-selection"], "20 %, noise"),
                (known["slip20noise-selection-acc"], "20 %, noise, accelerometer"),
            ],
            everyone,
            ends,
            (POSITION, HEADING),
        ),
        track_table(
            [
                (known[k], k)
                for k in ("ideal", "noise", "slip20", "slip40ticks", "bothleft", "slip20noise")
            ],
            entrants("model3", "batch", "online"),
            ends,
        ),
    ]
    seconds: dict[str, float] = {}
    for (_, _, who_id), found in ends.items():
        seconds[who_id] = seconds.get(who_id, 0.0) + sum(e.seconds for e in found)
    starts = [s for found in context.map(scan, TRACKS, _scanned) for s in found]
    slips = [
        (known["slip20"], "20 %"),
        (known["slip40ticks"], "+40 counts"),
        (known["bothleft"], "both left"),
    ]
    figures = (
        draws_figure(known["noise"], everyone, ends),
        scenario5_figure(known["slip20noise"], everyone, ends),
        paths_figure(slips, everyone, ends),
        track_figure([(known["ideal"], "ideal"), (known["slip20"], "20 %")], ends),
        scan_figure(starts),
    )
    settings = {
        "seeds": {s.key: s.seeds for s, _ in plan},
        "seconds": {k: round(v, 1) for k, v in seconds.items()},
    }
    return Report(
        "Seed A, simulated cases",
        tuple(tables),
        tuple(failures(ends)),
        figures,
        settings,
    )


def _scanned(track: float) -> str:
    """Return what a piece of the scan was, for a line of progress."""
    return f"model3 from a track of {track:g} m"


EXPERIMENT = Experiment(
    "seed-a-simulation",
    "Tables 3.1 to 3.6 of seed A, and slip that it left open: three motions, five scenarios",
    (),
    run,
)
