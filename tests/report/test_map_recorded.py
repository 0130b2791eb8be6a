"""A recorded building: its map from the published poses is sharp, from raw odometry it is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fgloc.core.measurements import Scans
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.registry import load_drive
from fgloc.experiments.methods import create
from fgloc.report.map_grid import occupancy_grid
from fgloc.report.map_points import PlacedScans, place_scans
from fgloc.report.map_thinning import thin


def sharpness(placed: PlacedScans) -> float:
    """Share of beams that end in a cell of 5 cm which all scans together found occupied."""
    grid = occupancy_grid([placed])
    points = placed.returned
    cells = np.floor((points - np.array(grid.origin)) / grid.resolution).astype(int)
    return float((grid.log_odds[cells[:, 1], cells[:, 0]] > 0.0).mean())


def test_csail(data_dir: Path) -> None:
    drive = load_drive("csail:0", data_dir)
    assert drive.truth is not None
    scans = drive.each(Scans)[0]

    def placed(trajectory: Trajectory) -> PlacedScans:
        return place_scans(scans, trajectory, scans.mount)

    good = placed(drive.truth.trajectory)
    raw = placed(create("model1").estimate(drive).trajectory)
    assert good.left_out == 0
    assert sharpness(good) > 0.8
    # The raw odometry ends 21 m off: corridors that were driven twice are there twice.
    assert sharpness(raw) < 0.5
    assert len(thin(good.returned)) < 0.5 * len(thin(raw.returned))
