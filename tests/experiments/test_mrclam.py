"""The experiment on recorded landmarks: what is withheld, how it is scored, what is judged."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgloc.core.drive import Drive
from fgloc.core.evaluation import AxisErrors, Evaluation
from fgloc.core.measurements import LandmarkSightings, Survey
from fgloc.experiments import mrclam
from fgloc.experiments.experiment import Context
from fgloc.experiments.withheld import without_identity, without_survey
from fgloc.report.experiment_report import Verdict
from fgloc.report.experiment_text import plain_text
from tests.filters import landmark_world as world

DATA = Path(os.environ.get("FGLOC_DATA", "")) / "utias-mrclam"


def surveyed() -> Drive:
    drive = world.drive(world.circle_of_landmarks(12), seed=1, steps=40)
    (marks,) = drive.each(LandmarkSightings)
    survey = Survey(np.arange(12), world.circle_of_landmarks(12), np.full((12, 2), 1e-3))
    return replace(drive, sensors=(replace(marks, survey=survey),))


def test_what_is_withheld_is_gone_and_nothing_else() -> None:
    whole = surveyed()
    (marks,) = whole.each(LandmarkSightings)
    (blind,) = without_survey(whole).each(LandmarkSightings)
    assert blind.survey is None
    assert blind.landmark is marks.landmark
    assert blind.range_m is marks.range_m
    (unknown,) = without_identity(whole).each(LandmarkSightings)
    assert (unknown.landmark == -1).all()
    assert unknown.survey is marks.survey
    assert unknown.bearing is marks.bearing
    assert without_survey(whole).wheels is whole.wheels


def evaluation(ate: float, aligned: float) -> Evaluation:
    zero = AxisErrors(0.0, 0.0, 0.0)
    return Evaluation(ate, aligned, 1.0, 0.0, 0.0, zero, 3.0, None, None, 1.0, None, 10, 0, 0, 0)


def test_the_targets_are_those_of_batch_in_their_own_column(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = []

    def fake(job: mrclam.Job) -> mrclam.Score:
        asked.append((job.run, job.case, job.method))
        if job.method == "online":
            return mrclam.Score(job, "it needs another sensor")
        # Batch just meets the first target and just misses the second.
        return mrclam.Score(job, errors=evaluation(0.06, 0.1001), marks=15, marks_rms_m=0.02)

    monkeypatch.setattr(mrclam, "run_job", fake)
    monkeypatch.setattr("fgloc.datasets.registry.list_drives", lambda name, data: [f"{name}:6/1"])
    report = mrclam.run(Context(processes=1))
    # Wheels alone are driven once, all others in every case.
    assert len(asked) == len(set(asked)) == 3 * 3 + 1
    by_id = {table.id: table for table in report.tables}
    judged = {
        (table.id, row.labels[1], column.key): cell.verdict
        for table in report.tables
        for row, column, cell in table.judged()
    }
    assert judged == {
        ("surveyed", "batch", "ate"): Verdict.MET,
        ("identities", "batch", "aligned"): Verdict.MISSED,
    }
    assert by_id["nothing"].rows[3].cells["ate"] == "it needs another sensor"
    assert "of 2 targets: 1 target met, 1 target MISSED" in plain_text(report).replace("Of", "of")


@pytest.mark.skipif(not DATA.is_dir(), reason="utias-mrclam is not on this machine")
def test_a_recorded_drive_with_all_and_with_nothing_known() -> None:
    data = DATA.parent
    found = {
        case: mrclam.run_job(mrclam.Job("6/1", case, "ekf-slam", data))
        for case in ("surveyed", "nothing")
    }
    for score in found.values():
        assert score.reason == ""
        assert score.errors is not None
        # Wheels alone are 2.05 m off (`model1`).
        assert score.errors.ate_aligned_rmse_m < 2.0
    surveyed = found["surveyed"]
    assert surveyed.errors is not None
    # Ranges err by 0.12 m (root mean square); the filter is about as good as one of them.
    assert surveyed.errors.ate_rmse_m < 0.2
    assert surveyed.marks == 15
    # Landmarks that were surveyed to a millimetre stay there.
    assert surveyed.marks_rms_m is not None
    assert surveyed.marks_rms_m < 2e-3
    assert found["nothing"].marks_rms_m is None
