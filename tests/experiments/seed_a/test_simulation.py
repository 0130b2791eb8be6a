"""The whole of both experiments with two seeds: every table, note, figure and key is there."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from fgloc.estimator import Estimator
from fgloc.experiments.experiment import Context
from fgloc.experiments.methods import available, create
from fgloc.experiments.seed_a import simulation, vehicle
from fgloc.experiments.seed_a.published import CASES, POSITION, SCALES
from fgloc.experiments.seed_a.runs import (
    Entrant,
    Scenario,
    describe,
    entrants,
    gather,
    run_job,
    split,
)
from fgloc.experiments.seed_a.tables import one, values
from fgloc.experiments.seed_a.tuned import FIRST_SEED
from fgloc.report.experiment_files import write_experiment
from fgloc.report.experiment_report import Cell, Distribution, Report

NOISE = Scenario("noise", "seed-a-{case}-noise", seeds=4)


@pytest.fixture(scope="module")
def simulated() -> Report:
    """Return the report, with Model 3 in the place of the smoothers: the rest is tested."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulation, "TRIALS", 10)
        patch.setattr(simulation, "TRACKS", (0.48, 0.9))
        patch.setattr("fgloc.experiments.seed_a.runs.build", stand_in)
        return simulation.run(Context(processes=1, seeds=2))


def stand_in(entrant: Entrant) -> Estimator:
    quick = entrant.method in ("model1", "model2")
    return create(entrant.method if quick else "model3", integrator="midpoint")


def test_all_tables_are_filled(simulated: Report) -> None:
    assert [t.id for t in simulated.tables] == [
        "text-3.4.1",
        *(f"table-3.{n}" for n in range(1, 7)),
        "scenario-1",
        "scenario-4",
        "scenario-4-camera",
        "scenario-5",
        "encoder-selection",
        "effective-track",
        "model3-noise",
        "pose-ekf-noise",
        "rl-ekf-noise",
    ]
    for table in simulated.tables:
        keys = {c.key for c in table.columns}
        for row in table.rows:
            assert set(row.cells) <= keys
            assert len(row.labels) == len(table.labels)
            values = [c.value for c in row.cells.values() if isinstance(c, Cell)]
            assert None not in values, (table.id, row.labels)


def test_a_printed_number_stands_beside_model_and_smoothers(simulated: Report) -> None:
    (table,) = (t for t in simulated.tables if t.id == "table-3.6")
    assert [c.key for c in table.columns] == ["model3", "model3-tuned", "batch", "online"]
    circle = next(r for r in table.rows if r.labels == ("circle", "20 %", "position [m]"))
    judged = circle.cells["model3"]
    assert isinstance(judged, Cell)
    assert judged.published == 0.532
    batch = circle.cells["batch"]
    assert isinstance(batch, Cell)
    assert batch.published is None


def test_batch_finds_the_slip_without_encoder_selection() -> None:
    slip = Scenario("slip20", "seed-a-{case}-slip20")
    (job,) = split(slip, "circle", entrants("model3", "batch"), 1)
    found = run_job(job)
    # Printed for Model 3: 0.532 m.
    assert found["batch"][0].position_m < 0.02 < found["model3"][0].position_m
    assert found["batch"][0].track == pytest.approx(0.9, abs=0.01)


def test_every_method_of_this_version_takes_part(simulated: Report) -> None:
    columns = {
        t.id: [c.key for c in t.columns]
        for t in simulated.tables
        if t.id in ("scenario-4", "scenario-4-camera")
    }
    tuned = {"model3-tuned", "pose-ekf-tuned", "rl-ekf-tuned"}
    assert {m for keys in columns.values() for m in keys} == {
        m for m in available() if m != "ekf-slam"
    } | tuned
    assert columns["scenario-4"][2:4] == ["model3", "model3-tuned"]
    assert columns["scenario-4-camera"][:2] == ["pose-ekf", "pose-ekf-tuned"]


def test_run_folder(simulated: Report, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fgloc.report.figures.DPI", 30)
    folder = write_experiment("seed-a-simulation", simulated, tmp_path, {})
    figures = sorted(p.name for p in (folder / "figures").iterdir())
    assert figures == [
        "effective-track.png",
        "model3-start.png",
        "noise-draws.png",
        "slip-noise-draws.png",
        "slip-paths.png",
    ]
    assert (folder / "trajectories/slip20-circle/batch.tum").exists()
    document = json.loads((folder / "report.json").read_text())
    errors = document["data"]["end_errors"]["noise"]["spin"]["model1"]
    assert set(errors) == {"x_m", "y_m", "heading_deg", "effective_track_m"}
    assert len(errors["x_m"]) == document["settings"]["seeds"]["noise"] == 2
    assert set(document["settings"]["tuned"]["model3"]) == {
        "heading_variance",
        "track_variance",
        "yaw_variance",
    }
    html = (folder / "report.html").read_text()
    assert 'src="figures/slip-paths.png"' in html


def test_training_seeds_are_others(simulated: Report) -> None:
    assert max(simulated.settings["seeds"].values()) < FIRST_SEED


def test_vehicle(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fgloc.experiments.seed_a.runs.build", stand_in)
    report = vehicle.run(Context(processes=1, seeds=2))
    assert [t.id for t in report.tables] == [
        "table-4.1",
        "table-4.2",
        "table-4.3",
        "text-4.2",
        "without-selection",
    ]
    assert "SIMULATED" in report.title
    assert all("SIMULATED" in t.title for t in report.tables)
    assert [f.name for f in report.figures] == ["vehicle-draws"]


def test_one_seed_is_a_distribution_too() -> None:
    (job,) = split(replace(NOISE, seeds=1), "spin", entrants("model1"), 5)
    ends = gather([job], [run_job(job)])
    numbers = values(ends["noise", "spin", "model1"], POSITION, SCALES["spin"])
    assert one(numbers, 1) == Distribution(numbers[0], numbers[0], numbers[0], 1)


def test_results_do_not_depend_on_the_number_of_processes() -> None:
    jobs = [j for case in CASES for j in split(NOISE, case, entrants("model1", "model3"), 2)]
    alone, shared = (Context(processes=n).map(run_job, jobs, describe) for n in (1, 2))

    def numbers(found: list[dict[str, list[object]]]) -> str:
        return str(
            [[{**vars(e), "seconds": 0.0} for e in ends] for r in found for ends in r.values()]
        )

    assert numbers(alone) == numbers(shared)  # type: ignore[arg-type]


def test_seeds_of_the_context() -> None:
    assert list(Context().over(3)) == [1, 2, 3]
    assert list(Context(seeds=2).over(3)) == [1, 2]
