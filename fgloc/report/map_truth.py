"""What is known of the truth of a map: the path, surveyed landmarks, a simulated world's walls."""

from __future__ import annotations

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.evaluation import map_mount
from fgloc.core.geometry import inverse
from fgloc.core.measurements import Floats, LandmarkSightings
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.registry import world_of
from fgloc.estimator import Result, calibrated_mount


def base_truth(result: Result, drive: Drive) -> Trajectory | None:
    """Return the recorded truth as poses of base_link, by the reference's calibrated mounting."""
    if drive.truth is None:
        return None
    x, y, yaw = inverse(np.array(calibrated_mount(result.calibration, drive.truth)))
    reference = drive.truth.trajectory
    return map_mount(reference, (float(x), float(y), float(yaw)))


def surveyed(drive: Drive) -> dict[int, tuple[float, float]]:
    """Return where landmarks are known to be, by identity [m]; empty where nobody surveyed them."""
    return {
        int(landmark): (float(x), float(y))
        for sightings in drive.each(LandmarkSightings)
        if sightings.survey is not None
        for landmark, (x, y) in zip(
            sightings.survey.landmark, sightings.survey.positions, strict=True
        )
    }


def true_walls(drive: Drive) -> Floats:
    """Return (W, 2, 2) the ends [m] of the walls of the world that a drive was simulated in.

    Empty for other drives. Curved walls come in short straight pieces.
    """
    world = world_of(drive.name)
    return np.zeros((0, 2, 2)) if world is None else world.walls.reshape(-1, 2, 2)
