"""What `seed-b` and `seed-c` have in common: all entrants in some worlds, over seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from fgloc.experiments.experiment import Context
from fgloc.experiments.rooms.figures import Found, maps_figure
from fgloc.experiments.rooms.runs import ENTRANTS, Job, Score, describe, run_job
from fgloc.experiments.rooms.tables import association_table, map_table, pose_table
from fgloc.report.experiment_report import Report, Table

SEEDS = 50
"""Seeds of each world."""

NOTES = (
    "SIMULATED: walls, an RPLIDAR with 0.9° between beams, 10 turns a second, range noise of 1 %, "
    "noise of the beams' directions and missing returns; every beam is sent from where the lidar "
    "is at its own time. The robot's radii, track and the lidar's mounting differ from the nominal "
    "ones in every seed.",
    "All methods start at the true pose and see the same wheels and scans. Filters and online are "
    "scored on the pose as emitted, batch on the smoothed one.",
    "EKF-SLAM takes a wall as the foot of the perpendicular from the map's origin and associates "
    "by the nearest, as the seeds do. Its noise was chosen on seeds 1 to 4 of these worlds.",
)


def rooms_report(
    context: Context, title: str, worlds: Sequence[str], extra: Sequence[Table] = ()
) -> Report:
    """Return the report of all entrants in some worlds."""
    seeds = context.over(SEEDS)
    jobs = [
        Job(world, seed, entrant.id, keep=seed == seeds[0])
        for seed in seeds
        for world in worlds
        # The slowest first, so that no process is left alone with one of them at the end.
        for entrant in reversed(ENTRANTS)
    ]
    found: dict[str, dict[str, list[Score]]] = {w: {e.id: [] for e in ENTRANTS} for w in worlds}
    for score in context.map(run_job, jobs, describe):
        found[score.job.world][score.job.entrant].append(score)
    tables = [
        make(world, found[world])
        for world in worlds
        for make in (pose_table, map_table, association_table)
    ]
    return Report(
        title,
        (*tables, *extra),
        (*NOTES, _times(found)),
        (maps_figure(found),),
        {
            "worlds": list(worlds),
            "seeds": len(seeds),
            "methods": {e.id: e.title for e in ENTRANTS},
        },
        trajectories={
            f"{world}/{entrant}": scores[0].trajectory
            for world, entrants in found.items()
            for entrant, scores in entrants.items()
            if scores and scores[0].trajectory is not None
        },
        data={
            world: {entrant: [_numbers(s) for s in scores] for entrant, scores in entrants.items()}
            for world, entrants in found.items()
        },
    )


def _numbers(score: Score) -> dict[str, Any]:
    """Return the numbers of one seed."""
    plain = ("reason", "ate_m", "heading_deg", "end_m", "nees", "seconds")
    found: dict[str, Any] = {"seed": score.job.seed}
    found |= {name: getattr(score, name) for name in plain}
    found["map"] = None if score.map is None else asdict(score.map)
    return found


def _times(found: Found) -> str:
    """Return how much faster than the drive the methods are."""
    parts = []
    for entrant in ENTRANTS:
        scores = [s for by in found.values() for s in by[entrant.id] if not s.reason]
        if scores and entrant.id != "model1":
            ratio = sum(s.duration_s for s in scores) / sum(s.seconds for s in scores)
            parts.append(f"{entrant.title} {ratio:.3g}")
    return f"Seconds of driving that a second of computing takes in: {', '.join(parts)}."
