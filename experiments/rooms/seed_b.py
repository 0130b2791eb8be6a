"""`seed-b`: a mecanum robot maps a room by EKF-SLAM, batch and online."""

from __future__ import annotations

from fgloc.experiments.experiment import Context, Experiment
from fgloc.experiments.rooms.report import rooms_report
from fgloc.report.experiment_report import Report


def run(context: Context) -> Report:
    """Return the report."""
    return rooms_report(
        context, "Seed B: a mecanum robot with a lidar in a room, SIMULATED", ("seed-b-room",)
    )


EXPERIMENT = Experiment(
    "seed-b",
    "Seed B: a mecanum robot maps a room; EKF-SLAM against batch and online, SIMULATED",
    (),
    run,
)
