"""Rounded counts: errors drawn like those of a real encoder, and a track that they do not widen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgloc.core.measurements import Floats
from fgloc.core.preintegration import SplitIncrements
from fgloc.datasets.simulator import load_sim
from fgloc.smoothing import optimise as optimising
from fgloc.smoothing.build import build_problem
from fgloc.smoothing.optimise import optimise
from fgloc.smoothing.problem import Problem
from fgloc.smoothing.rounding import (
    NEGLIGIBLE,
    attenuation,
    draw_errors,
    without_rounding_bias,
)
from fgloc.smoothing.settings import Settings

COUNT = 0.1
FAST = Settings(covariances=False)


def split(angles: Floats, share: list[float] | None = None) -> SplitIncrements:
    pieces = angles.shape[0]
    return SplitIncrements(
        angles=angles,
        steering=np.zeros_like(angles),
        seconds=np.ones(pieces),
        bounds=np.arange(pieces + 1),
        resolution=COUNT,
        share=None if share is None else np.array(share),
    )


def covariance(increments: SplitIncrements, n: int = 4000) -> Floats:
    """Return the covariance of one wheel's drawn errors in units of count²/12."""
    rng = np.random.default_rng(2)
    drawn = np.stack([draw_errors(increments, rng)[:, 0] for _ in range(n)])
    assert np.abs(drawn.mean(axis=0)).max() < 4 * COUNT / np.sqrt(6 * n)
    return np.asarray(drawn.T @ drawn / n / (COUNT**2 / 12))


def test_errors_are_drawn_like_those_of_a_real_encoder() -> None:
    rng = np.random.default_rng(1)
    true = 3.0 + rng.random((4000, 4))  # no two drives by the same fraction of a count
    total = np.concatenate([np.zeros((4000, 1)), np.cumsum(true, axis=1)], axis=1)
    counted = np.diff(np.floor(total / COUNT + rng.random((4000, 1))), axis=1) * COUNT
    real = np.cov((counted - true).T) / (COUNT**2 / 12)
    # 4000 draws: 2 is known to 0.045.
    np.testing.assert_allclose(covariance(split(np.ones((4, 1)))), real, atol=0.2)


def test_a_standing_wheel_keeps_its_error() -> None:
    increments = split(np.array([[1.0, 1.0], [0.0, 1.0], [0.0, 1.0], [1.0, 1.0]]))
    drawn = draw_errors(increments, np.random.default_rng(3))
    assert not drawn[1:3, 0].any()
    np.testing.assert_allclose(
        covariance(increments)[np.ix_([0, 3], [0, 3])], [[2, -1], [-1, 2]], atol=0.2
    )


def test_where_a_keyframe_cuts_an_interval_the_error_is_shared() -> None:
    whole, cut = split(np.ones((2, 2))), split(np.ones((3, 2)), [1.0, 0.3, 0.7])
    a = draw_errors(whole, np.random.default_rng(4))
    b = draw_errors(cut, np.random.default_rng(4))
    np.testing.assert_allclose(b, [a[0], 0.3 * a[1], 0.7 * a[1]], atol=1e-15)


def tracks(problem: Problem) -> float:
    """Return the logarithm of the effective track that the smoother finds."""
    names = [p.name for p in problem.parameters]
    return float(optimise(problem, FAST).point.u[names.index("effective_track")])


def test_coarse_counts_do_not_widen_the_track(monkeypatch: pytest.MonkeyPatch) -> None:
    biased, corrected = [], []
    for seed in range(4):
        query = f"random?seed={seed}&duration=120&fix_every=10&rate=10"
        coarse = build_problem(load_sim(query + "&encoder_ticks=150"), FAST)
        exact = tracks(build_problem(load_sim(query + "&encoder_ticks=0"), FAST))
        corrected.append(tracks(coarse) - exact)
        with monkeypatch.context() as patch:
            patch.setattr(optimising, "without_rounding_bias", lambda _, __, point: (point, 0))
            biased.append(tracks(coarse) - exact)
    # The same drives with and without rounding: what they differ by is the rounding's doing.
    assert np.mean(biased) > 0.01
    assert abs(np.mean(corrected)) < 0.3 * np.mean(biased)


def test_fine_or_lonely_wheels_are_left_alone() -> None:
    query = "figure-eight?seed=1&duration=20&fix_every=4"
    fine = build_problem(load_sim(query + "&robot=differential&yaw=off"), FAST)
    assert 0.0 < attenuation(fine) < NEGLIGIBLE
    exact = build_problem(load_sim(query + "&encoder_ticks=0"), FAST)
    assert attenuation(exact) == 0.0
    coarse = build_problem(load_sim(query), FAST)
    assert attenuation(coarse) > NEGLIGIBLE
    alone = replace(coarse, tables=tuple(t for t in coarse.tables if t.sensor == "start"))
    for problem in (fine, exact, alone):
        point = optimise(problem, FAST).point
        assert without_rounding_bias(problem, FAST, point)[0] is point


def test_attenuation_by_hand() -> None:
    drive = load_sim("figure-eight?seed=1&duration=20&calibration=nominal")
    problem = build_problem(drive, FAST)
    count = 2 * np.pi / 300 * 0.135
    # Two wheels a side: the difference of two means of two, each with the errors of two counts.
    heading = 2 * (count**2 / 12) * (1 / 2 + 1 / 2) / 0.48**2
    turned = np.mean(problem.displacement(np.zeros(len(problem.parameters)))[:, 2] ** 2)
    assert attenuation(problem) == pytest.approx(heading / turned, rel=1e-6)
