"""`seed-c`: the two situations of seed C by EKF-SLAM, batch and online, and how far RANSAC sees."""

from __future__ import annotations

from fgloc.experiments.experiment import Context, Experiment
from fgloc.experiments.rooms.detection import detection_table
from fgloc.experiments.rooms.report import rooms_report
from fgloc.report.experiment_report import Report


def run(context: Context) -> Report:
    """Return the report."""
    return rooms_report(
        context,
        "Seed C: RPLIDAR, walls as landmarks, SIMULATED",
        ("seed-c-1", "seed-c-2"),
        (detection_table(),),
    )


EXPERIMENT = Experiment(
    "seed-c",
    "Seed C: two situations, EKF-SLAM with RANSAC lines against batch and online, SIMULATED",
    (),
    run,
)
