"""The batch smoother on recordings of small robots under motion capture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fgloc.core.drive import Drive
from fgloc.datasets.registry import load_drive
from fgloc.experiments.fixes import with_fixes
from fgloc.filters.model1 import Model1
from fgloc.smoothing.batch import BatchSmoother

from .drives import parameters, scores

DRIVEN = (
    "circular/250620202251/01",
    "circular/231220200157/01",
    "circular/231220200141/02",
    "free/020120212354/01",
    "free/030120210006/01",
)


def load(run: str, data: Path) -> Drive:
    if not (data / "optiodom").is_dir():
        pytest.skip("the optiodom recordings are not in $FGLOC_DATA")
    return load_drive(f"optiodom:diff/{run}", data)


def test_sparse_fixes_beat_wheel_odometry(data_dir: Path) -> None:
    ratios = []
    for run in DRIVEN:
        drive = load(run, data_dir)
        nominal = scores(Model1().estimate(drive), drive)
        result = BatchSmoother().estimate(with_fixes(drive, 10.0, 0.002, seed=1))
        ratios.append(scores(result, drive).ate_rmse_m / nominal.ate_rmse_m)
    assert float(np.median(ratios)) < 1 / 3, ratios


@pytest.mark.parametrize("run", ["231220200057/02", "231220200104/01", "250620201618/03"])
def test_a_straight_tells_radii_but_not_the_track(data_dir: Path, run: str) -> None:
    drive = load(f"ivanjko/{run}", data_dir)
    found = parameters(BatchSmoother().estimate(with_fixes(drive, 1.5, 0.002, seed=1)))
    track = found["effective_track"]
    assert not track.observed
    assert track.sigma == pytest.approx(track.prior_sigma, rel=0.02)
    assert found["wheel_radius.left"].observed
    assert found["wheel_radius.right"].observed


@pytest.mark.parametrize("run", ["231220200057/05", "231220200104/03", "250620201618/06"])
def test_half_a_turn_on_the_spot_tells_no_length(data_dir: Path, run: str) -> None:
    # A spin tells radius over track alone, and position fixes do not even tell the angle.
    drive = load(f"ivanjko/{run}", data_dir)
    found = parameters(BatchSmoother().estimate(with_fixes(drive, 1.5, 0.002, seed=1)))
    assert {n for n, c in found.items() if c.observed} == set()
    track = found["effective_track"]
    assert track.sigma == pytest.approx(track.prior_sigma, rel=0.05)
