"""The rooms' experiments: scores of one drive, tables and targets, how far RANSAC sees."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from fgloc.experiments.experiment import Context
from fgloc.experiments.rooms import detection, report, runs
from fgloc.experiments.rooms.runs import ENTRANTS, Job, MapScore, Score
from fgloc.experiments.rooms.tables import association_table, map_table, pose_table
from fgloc.report.experiment_report import Cell, Verdict


def score(entrant: str, seed: int, ate: float, **errors: float) -> Score:
    long = MapScore(
        walls=3,
        unmatched=1,
        missing=0,
        overlap_m=(2.0, 0.5),
        middle_m=(errors.get("middle", 0.01), 0.05),
        end_m=(0.02, 0.06),
        direction_deg=(errors.get("direction", 0.1), 3.0),
        beyond_m=(0.0, 0.0),
        used=100,
        wrong=int(errors.get("wrong", 0)),
        spurious=1,
    )
    return Score(Job("w", seed, entrant), "", ate, 1.0, 0.1, 3.0, 2.0, 100.0, long)


def scores(**errors: float) -> dict[str, list[Score]]:
    found = {e.id: [score(e.id, s, 0.1) for s in (1, 2)] for e in ENTRANTS}
    ate = errors.pop("ate", 0.05)
    found["batch"] = [score("batch", s, ate, **errors) for s in (1, 2)]
    found["online"] = [Score(Job("w", s, "online"), "no landmarks") for s in (1, 2)]
    return found


def verdicts(found: dict[str, list[Score]]) -> dict[str, Verdict | None]:
    tables = (pose_table("w", found), map_table("w", found), association_table("w", found))
    judged = {}
    for table in tables:
        for row, column, cell in table.judged():
            assert row.labels == ("batch",)
            judged[column.key] = cell.verdict
    return judged


def test_batch_is_held_to_the_targets() -> None:
    met = dict.fromkeys(("ratio", "worst", "worst_direction", "wrong"), Verdict.MET)
    assert verdicts(scores()) == met
    assert verdicts(scores(ate=0.0501)) == {**met, "ratio": Verdict.MISSED}
    assert verdicts(scores(middle=0.021)) == {**met, "worst": Verdict.MISSED}
    assert verdicts(scores(direction=0.31)) == {**met, "worst_direction": Verdict.MISSED}
    assert verdicts(scores(wrong=1.0)) == {**met, "wrong": Verdict.MISSED}


def test_short_walls_have_columns_of_their_own() -> None:
    rows = {row.labels[0]: row.cells for row in map_table("w", scores()).rows}
    cells = rows["batch"]
    numbers = {k: c.value for k, c in cells.items() if isinstance(c, Cell)}
    # One wall of 2 m, 1 cm and 0.1° off; one of half a metre, 5 cm and 3° off.
    assert numbers["rms"] == pytest.approx(1.0)
    assert numbers["short"] == pytest.approx(5.0)
    assert numbers["direction"] == pytest.approx(0.1)
    assert numbers["short_direction"] == pytest.approx(3.0)
    assert numbers["within"] == 100.0
    assert "online" not in rows
    reasons = {row.labels[0]: row.cells for row in pose_table("w", scores()).rows}
    assert reasons["online"] == {"ate": "no landmarks"}


def test_one_drive_is_scored_against_the_worlds_own_walls(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # The first 25 s of the room: one side of it and the pillar.
    monkeypatch.setattr(Job, "drive", property(lambda job: f"sim:{job.world}?seed=1&duration=25"))
    found = runs.run_job(Job("seed-b-room", 1, "ekf-slam", keep=True))
    wheels = runs.run_job(Job("seed-b-room", 1, "model1"))
    assert found.reason == ""
    assert wheels.map is None
    assert wheels.walls is None
    assert found.ate_m < wheels.ate_m
    assert found.map is not None
    assert found.walls is not None
    assert found.map.walls == found.walls.normal.size
    assert len(found.map.middle_m) == found.map.walls - found.map.unmatched
    assert np.median(found.map.middle_m) < 0.1
    assert found.map.used > 0
    assert found.map.spurious < 0.01 * found.map.used
    # Scored with the walls 1 m away, every piece is on no wall.
    assert found.trajectory is not None
    from fgloc.datasets.registry import load_drive
    from fgloc.datasets.simulator.worlds import load_world

    drive = load_drive("sim:seed-b-room?seed=1&duration=25")
    result = runs.build(ENTRANTS[2]).estimate(drive)
    away = load_world("seed-b-room").walls + 10.0
    moved = runs.score_map(result, drive, away)
    assert moved.unmatched == moved.walls
    assert moved.spurious == moved.used
    assert moved.wrong == 0


def test_a_report_has_all_entrants_of_all_worlds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        report, "run_job", lambda job: replace(score(job.entrant, job.seed, 0.1), job=job)
    )
    made = report.rooms_report(Context(processes=1, seeds=3), "title", ("a", "b"))
    assert [t.id for t in made.tables] == [
        f"{w}-{t}" for w in ("a", "b") for t in ("pose", "map", "association")
    ]
    assert len(made.data["a"]["batch"]) == 3
    assert {n["seed"] for n in made.data["b"]["online"]} == {1, 2, 3}
    assert made.settings["seeds"] == 3


def test_how_likely_a_draw_of_ransac_is() -> None:
    # At no noise to speak of all 25 are within; at 1 m one beam is within 1.5 sigma with 0.8664.
    assert detection.accepted(0.01, 0.01, 25, 21, 0.015) == pytest.approx(1.0)
    one = math.erf(1.5 / math.sqrt(2.0))
    by_hand = sum(math.comb(25, k) * one**k * (1 - one) ** (25 - k) for k in range(21, 26))
    assert detection.accepted(1.0, 0.01, 25, 21, 0.015) == pytest.approx(by_hand)
    assert round(by_hand, 2) == 0.76


def test_the_detection_range_of_both_extractors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detection, "TRIALS", 300)
    table = detection.detection_table()
    cells = {row.labels[0]: row.cells for row in table.rows}

    def value(distance: str, key: str) -> float:
        cell = cells[distance][key]
        assert isinstance(cell, Cell)
        assert isinstance(cell.value, float)
        return cell.value

    assert {c.verdict for _, _, c in table.judged()} == {Verdict.REPRODUCED}
    # A fitted line lies nearer to its beams than the true wall.
    assert 0.76 < value("1 m", "draw") < 0.90
    assert value("0.5 m", "ransac") == 100.0
    assert value("3 m", "ransac") < 2.0
    assert value("3 m", "lines") > 95.0
