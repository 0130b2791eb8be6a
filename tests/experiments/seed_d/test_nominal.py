"""Seed D's experiment on a few recorded drives, and its printed numbers against each other."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from fgloc.calibration.calibrate import calibrate
from fgloc.datasets.registry import load_drive
from fgloc.experiments.experiment import Context
from fgloc.experiments.registry import find
from fgloc.experiments.seed_d import nominal, published
from fgloc.experiments.seed_d.runs import DATASET, repetition
from fgloc.experiments.seed_d.tables import nominal_table, totals_by_seed
from fgloc.report.experiment_report import Cell, Report, Verdict

SPINS = ("21", "22")


@pytest.fixture(scope="module")
def spins(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a data folder with two repetitions of a spin."""
    import os

    if "FGLOC_DATA" not in os.environ:
        pytest.skip("FGLOC_DATA is not set: recorded drives are not available")
    source = Path(os.environ["FGLOC_DATA"]) / DATASET
    folder = tmp_path_factory.mktemp("data")
    (folder / DATASET).mkdir()
    for run in SPINS:
        for kind in ("odom", "abs"):
            shutil.copy(source / f"{kind}_{run}.csv", folder / DATASET)
    return folder


@pytest.fixture(scope="module")
def report(spins: Path) -> Report:
    patch = pytest.MonkeyPatch()
    patch.setattr(nominal, "BUDGET", 10)
    try:
        return find("seed-d-nominal").run(Context(spins, processes=1, seeds=1))
    finally:
        patch.undo()


def number(cell: Cell | str) -> float:
    assert isinstance(cell, Cell)
    assert isinstance(cell.value, float)
    return cell.value


def test_fewer_runs_than_published_are_said_so(report: Report) -> None:
    table = report.tables[0]
    assert "2 of 30 runs" in table.title
    verdicts = {cell.verdict for _, _, cell in table.judged()}
    assert verdicts == {Verdict.EXPLAINED}


def test_every_method_is_there_and_fusion_helps(report: Report) -> None:
    fusion = report.tables[1]
    assert "SEMI-REAL" in fusion.title
    totals = {row.labels[1]: number(row.cells["sum"]) for row in fusion.rows if row.labels[0]}
    # Nominal wheels turn 0.14 rad too little in a spin; the camera sees the turn.
    assert 0.14 < totals["wheels alone, nominal"] < 0.15
    for title, total in totals.items():
        if title.startswith(
            ("batch", "online", "addition", "calibrated +", "nominal + EKF, tuned")
        ):
            assert total < 0.05 or title in published.TOTALS, title
    assert totals["limit: late stamps of the truth"] < totals["wheels alone, calibrated"]


def test_the_report_draws(report: Report, tmp_path: Path) -> None:
    assert [f.name for f in report.figures] == ["paths", "motions"]
    for figure in report.figures:
        figure.draw(tmp_path / f"{figure.name}.png")
        assert (tmp_path / f"{figure.name}.png").stat().st_size > 20_000


def test_a_calibration_does_not_see_its_own_drive(report: Report, spins: Path) -> None:
    found = report.settings["calibrations"]
    others = [run for run in SPINS if repetition(run) != repetition("21")]
    drives = [load_drive(f"{DATASET}:{run}", spins) for run in others]
    robot = calibrate(drives).robot
    values = {p.name: p.nominal for p in robot.base.parameters}
    assert found["without repetition 1"] == pytest.approx(values, abs=1e-12)
    # On the spot only radius over distance is observable; the wheels do turn 2 % too much.
    turned = {
        which: base.displacements(drives[0].wheels.angles, drives[0].wheels.steering)[:, 2].sum()
        for which, base in (("nominal", drives[0].robot.base), ("calibrated", robot.base))
    }
    assert turned["calibrated"] / turned["nominal"] == pytest.approx(1.02, abs=0.005)
    for p in robot.base.parameters:
        assert p.prior_sigma <= next(
            q.prior_sigma for q in drives[0].robot.base.parameters if q.name == p.name
        ) * (1.0 + 1e-9)


def test_the_nominal_row_of_table_42(data_dir: Path) -> None:
    """On the 18 shared runs the sum is 1.2607; on all 30 it is 1.2740 (printed: 1.2738)."""
    from fgloc.datasets.registry import list_drives
    from fgloc.experiments.seed_d.runs import Job, run_job

    runs = [d.partition(":")[2] for d in list_drives(DATASET, data_dir)]
    if len(runs) not in (18, 30):
        pytest.skip(f"{len(runs)} runs are on this machine, neither 18 nor 30")
    jobs = [Job(run, None, None, {}, data_dir) for run in runs]
    scores = [run_job(job)["model1"] for job in jobs]
    expected = 1.2607 if len(runs) == 18 else 1.2740
    assert totals_by_seed(scores).sum() == pytest.approx(expected, abs=3e-4)
    table = nominal_table({"model1": scores})
    assert f"{len(runs)} of 30 runs" in table.title


def test_printed_tables_add_up() -> None:
    sums = {
        "nominal": np.sum(list(published.NOMINAL.values()), axis=0),
        "nominal + EKF": np.sum(list(published.NOMINAL_EKF.values()), axis=0),
        "genetic algorithm + EKF": np.sum(list(published.GENETIC_EKF.values()), axis=0),
    }
    for name, found in sums.items():
        np.testing.assert_allclose(found, published.TOTALS[name], atol=2e-6, err_msg=name)
    totals = {name: sum(axes) for name, axes in published.TOTALS.items()}
    assert totals["particle swarm + EKF"] == pytest.approx(0.350955, abs=1e-6)
    assert totals["nominal"] == pytest.approx(1.273813, abs=1e-6)
