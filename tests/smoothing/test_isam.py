"""The incremental smoother against batch solutions, and against what breaks iSAM2."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fgloc.core.measurements import Floats
from fgloc.errors import FglocError
from fgloc.factors.gtsam_factors import Bundle, rows_of
from fgloc.factors.robust import Loss
from fgloc.factors.tables import FactorTable, Kind
from fgloc.smoothing.isam import IncrementalGraph
from fgloc.smoothing.isam_settings import IncrementalSettings
from tests.smoothing.chains import NONE, Chain, in_map

SHORT = IncrementalSettings(lag_s=4.0, segment_keyframes=10)
"""A window of 40 keyframes."""


def graph(settings: IncrementalSettings | None = None) -> IncrementalGraph:
    return IncrementalGraph(3, np.zeros(3), settings)


def started(
    chain: Chain, settings: IncrementalSettings | None = None, keyframes: int = 0
) -> IncrementalGraph:
    made = graph(settings)
    chain.start(made)
    chain.run(made, keyframes)
    return made


def off(a: Floats, b: Floats) -> tuple[float, float]:
    """Return the distance [m] and the angle [deg] between two poses."""
    return float(np.hypot(*(a - b)[:2])), float(np.degrees(abs(a[2] - b[2])))


def mahalanobis(made: IncrementalGraph, truth: Floats) -> float:
    error = made.state(made.newest) - truth
    return float(np.sqrt(error @ np.linalg.solve(made.covariance(made.newest), error)))


def point(keyframe: int, landmark: int, pose: Floats, place: Floats) -> FactorTable:
    """Return an exact range and bearing from a pose (3,) to a place (2,)."""
    way = place - pose[:2]
    row = np.array([[np.hypot(*way), np.arctan2(way[1], way[0]) - pose[2], 0.0, 0.0, 0.0]])
    return FactorTable(
        Kind.RANGE_BEARING,
        "lidar",
        np.array([keyframe]),
        row,
        np.diag([50.0, 50.0])[None],
        NONE,
        second=np.array([landmark]),
    )


# -- agreement ---------------------------------------------------------------------------------


@pytest.mark.parametrize("lag", [30.0, None])
def test_the_newest_state_is_that_of_a_batch_solution(lag: float | None) -> None:
    chain = Chain(seed=1)
    made = started(chain, IncrementalSettings(lag_s=lag))
    for _ in range(4):
        chain.run(made, 105)
        states, u, solution = chain.batch()
        distance, angle = off(made.state(chain.newest), states[-1])
        assert distance < 2e-3
        assert angle < 0.1
        assert solution.covariance is not None
        assert solution.calibration_covariance is not None
        expected = in_map(solution.covariance[-1], states[-1, 2])
        np.testing.assert_allclose(
            np.sqrt(np.diag(made.covariance(chain.newest))), np.sqrt(np.diag(expected)), rtol=0.03
        )
        sigma = np.sqrt(np.diag(solution.calibration_covariance))
        np.testing.assert_allclose(made.calibration(), u, atol=0.1 * sigma.min())
        found = np.sqrt(np.diag(made.calibration_covariance()))
        np.testing.assert_allclose(found, sigma, rtol=0.02)
    assert made.rebuilds == 0
    assert made.oldest == (0 if lag is None else chain.newest - 300)
    recent = made.states(chain.newest - 50)
    assert max(off(a, b)[0] for a, b in zip(recent, states[-51:], strict=True)) < 2e-3


def test_a_late_fix_counts_where_it_belongs_at_once() -> None:
    # It moves the newest keyframe by decimetres: one linear step would be off by its sigma.
    chain = Chain(seed=2, fix_every=0)
    made = started(chain, keyframes=130)
    late, before = chain.fix(40), made.state(130)
    assert made.add_rows(rows_of(late)) == []
    made.update()
    chain.tables.append(late)
    states, _, _ = chain.batch()
    assert off(before, states[-1])[0] > 0.3
    distance, angle = off(made.state(130), states[-1])
    assert distance < 2e-3
    assert angle < 0.1


def test_what_comes_too_late_is_returned() -> None:
    chain = Chain(seed=2)
    made = started(chain, SHORT, 100)
    assert made.oldest == 60
    before, too_late = made.state(100), rows_of(chain.fix(59))
    assert made.add_rows(too_late) == too_late
    made.update()
    assert np.array_equal(made.state(100), before)


def test_the_same_rows_give_the_same_bytes() -> None:
    def run() -> tuple[bytes, bytes]:
        chain = Chain(seed=3)
        made = started(chain, SHORT, 120)
        return made.states(made.oldest).tobytes(), made.covariance(made.newest).tobytes()

    assert run() == run()


def test_an_outlier_that_came_in_at_full_weight_is_let_go() -> None:
    loss = Loss("cauchy", 2.0)
    plain, robust = Chain(seed=4), Chain(seed=4)
    clean, made = started(plain, keyframes=95), started(robust, keyframes=95)
    stray = replace(robust.fix(95, offset=3.0), loss=loss)
    made.add_rows(rows_of(stray))
    made.update()
    assert off(made.state(95), clean.state(95))[0] > 0.05
    # The draw that the stray fix took, so that both see the same noise.
    plain.fix(95)
    plain.run(clean, 15)
    robust.run(made, 15)
    assert off(made.state(110), clean.state(110))[0] < 0.01


def test_the_callbacks_get_the_values_that_are_held(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Any] = []
    plain = Bundle._callback

    def spying(self: Bundle, keys: list[int], g: int) -> Any:
        error = plain(self, keys, g)

        def spy(factor: Any, values: Any, jacobians: Any) -> Floats:
            seen.append(values)
            return np.asarray(error(factor, values, jacobians))

        return spy

    monkeypatch.setattr(Bundle, "_callback", spying)
    made = started(Chain(), SHORT, 60)
    assert len(seen) > 60
    assert all(values is made._solver.held for values in seen)


# -- bounded -----------------------------------------------------------------------------------


def test_nothing_grows_once_the_window_is_full() -> None:
    chain = Chain(seed=5)
    made = started(chain, SHORT, 100)

    def sizes() -> tuple[int, ...]:
        solver, window = made._solver, made._window
        isam = solver._isam
        return (
            isam.getFactorsUnsafe().size(),
            isam.getLinearizationPoint().size(),
            len(solver._smoother.timestamps()),
            len(window.keys()),
            len(window.bundles()),
        )

    before = sizes()
    assert before[1] == before[2] == before[3]
    chain.run(made, 200)
    after = sizes()
    # The number of segments in the window and of factors between two looks differ by a few.
    assert all(abs(a - b) <= 3 for a, b in zip(after, before, strict=True))
    assert made.oldest == made.newest - 40
    with pytest.raises(FglocError, match="not in the window"):
        made.state(made.oldest - 1)


def test_dead_reckoning_does_not_fail() -> None:
    # Cholesky fails on such a chain (fact 3).
    chain = Chain(seed=6, fix_every=0)
    made = started(chain, SHORT, 1000)
    assert made.rebuilds == 0
    # Nothing contradicts the wheels, so their sum at the nominal calibration stands.
    assert off(made.state(1000), chain.guesses[-1])[0] < 1e-6
    np.testing.assert_allclose(made.calibration(), 0.0, atol=1e-9)


def test_an_hour_of_silence_ends_the_window_and_nothing_else() -> None:
    chain = Chain(seed=7)
    made = started(chain, SHORT, 60)
    wheels, _ = chain.drive()
    guess = made.state(60) + 0.01
    made.add(3600.0, 61, guess, rows_of(wheels))
    made.update()
    assert made.oldest == made.newest == 61
    assert made.rebuilds == 0
    chain.guesses.append(guess)
    chain.tables.append(wheels)
    states, _, solution = chain.batch()
    assert off(made.state(61), states[-1])[0] < 2e-3
    assert solution.covariance is not None
    expected = np.diag(in_map(solution.covariance[-1], states[-1, 2]))
    found = np.diag(made.covariance(61))
    np.testing.assert_allclose(np.sqrt(found), np.sqrt(expected), rtol=0.03)


# -- failures ----------------------------------------------------------------------------------


def dangle(made: IncrementalGraph, chain: Chain) -> None:
    """Queue two variables that nothing ties to the rest."""
    for key in (1, 2):
        made._solver.insert(key, np.zeros(3), 9.0)
    made._solver.add_walk(1, 2, np.ones(3))


def overflow(made: IncrementalGraph, chain: Chain) -> None:
    """Add a fix whose weight is beyond all numbers."""
    fix = chain.fix(90)
    made.add_rows(rows_of(replace(fix, sqrt_information=np.full((1, 2, 2), 1e300))))


@pytest.mark.parametrize(
    ("provoke", "lost"), [(dangle, {}), (overflow, {"fix": 1})], ids=["dangling", "overflow"]
)
def test_an_indeterminate_system_is_rebuilt_without_a_wrong_state(
    provoke: Callable[[IncrementalGraph, Chain], None], lost: dict[str, int]
) -> None:
    chain, twin = Chain(seed=8), Chain(seed=8)
    made, healthy = started(chain, SHORT, 90), started(twin, SHORT, 90)
    provoke(made, chain)
    chain.rng = np.random.default_rng(1)
    twin.rng = np.random.default_rng(1)
    chain.step(made)
    twin.step(healthy)
    assert made.rebuilds == 1
    assert made.restarts == 0
    assert "ndeterminate" in made.last_fault
    # What the failed update brought is gone if need be, the wheels of its keyframe are not.
    assert made.dropped == lost
    assert off(made.state(91), healthy.state(91))[0] < 1e-3
    assert off(made.state(60), healthy.state(60))[0] < 1e-3
    np.testing.assert_allclose(made.covariance(91), healthy.covariance(91), rtol=0.02, atol=1e-7)
    np.testing.assert_allclose(made.calibration(), healthy.calibration(), atol=1e-4)
    chain.run(made, 50)
    twin.run(healthy, 50)
    assert made.rebuilds == 1
    assert off(made.state(141), healthy.state(141))[0] < 2e-3
    assert made.oldest == healthy.oldest


def test_a_failure_that_is_not_the_measurements_loses_none(monkeypatch: pytest.MonkeyPatch) -> None:
    chain, twin = Chain(seed=9), Chain(seed=9)
    made, healthy = started(chain, SHORT, 99), started(twin, SHORT, 99)
    twin.step(healthy)
    solver = made._solver

    def fail(*_: object) -> None:
        raise ValueError("provoked")

    monkeypatch.setattr(solver, "value", fail)
    chain.rng = np.random.default_rng(0)
    wheels, fix = twin.tables[-2:]
    made.add(10.0, 100, twin.guesses[-1], [*rows_of(wheels), *rows_of(fix)])
    made.update()
    assert made._solver is not solver
    assert (made.rebuilds, made.restarts, sum(made.dropped.values())) == (1, 0, 0)
    assert off(made.state(100), healthy.state(100))[0] < 1e-3
    np.testing.assert_allclose(made.covariance(100), healthy.covariance(100), rtol=0.01, atol=1e-9)


def test_what_cannot_be_saved_starts_anew_and_knows_how_little_it_knows() -> None:
    chain = Chain(seed=10)
    made = started(chain, SHORT, 95)
    healthy = made.covariance(95)
    wheels, jacobian = chain.drive()
    guess = made.state(95) + jacobian @ chain.u
    absurd = replace(wheels, sqrt_information=np.full((1, 3, 3), 1e300))
    made.add(9.6, 96, guess, rows_of(absurd))
    chain.guesses.append(guess)
    made.update()
    assert (made.rebuilds, made.restarts) == (1, 1)
    assert made.oldest == made.newest == 96
    assert made.dropped["wheels"] > 0
    np.testing.assert_allclose(made.state(96), guess, atol=1e-9)
    assert np.all(np.diag(made.covariance(96)) > np.diag(healthy))
    chain.run(made, 100)
    assert made.rebuilds == 1
    assert mahalanobis(made, chain.truth[-1]) < 4.0
    assert np.all(np.sqrt(np.diag(made.covariance(made.newest))) < 0.1)


def test_wrong_input_is_refused_before_anything_changes() -> None:
    chain = Chain(seed=11)
    made = started(chain, SHORT, 50)
    wheels, _ = chain.drive()
    guess, rows = made.state(50), rows_of(wheels)
    holed = replace(wheels, sqrt_information=np.full((1, 3, 3), np.nan))
    sighting = rows_of(point(51, 3, guess, np.zeros(2)))
    for call, message in (
        (lambda: made.add(5.1, 51, guess, rows_of(holed)), "wheels: a measurement is not finite"),
        (lambda: made.add(5.1, 52, guess, rows), "does not follow"),
        (lambda: made.add(5.0, 51, guess, rows), "not later"),
        (lambda: made.add(5.1, 51, guess[:2], rows), "3 finite numbers"),
        (lambda: made.add(5.1, 51, guess, []), "no measurement"),
        (lambda: made.add(5.1, 51, guess, [*rows, *sighting]), "landmark 3 is not known"),
        (lambda: made.add_rows(rows), "not in the window"),
        (lambda: made.landmark(3), "landmark 3 is not known"),
        (lambda: made.start(0.0, 0, guess, rows), "twice"),
        (lambda: made.add_landmark(3, np.full(2, np.inf)), "not finite"),
    ):
        with pytest.raises(FglocError, match=message):
            call()
    made.add(5.1, 51, guess, rows)
    made.update()
    assert made.rebuilds == 0
    assert off(made.state(51), chain.truth[51])[0] < 0.2


# -- landmarks ---------------------------------------------------------------------------------


def test_a_landmark_out_of_sight_is_archived_and_comes_back() -> None:
    chain = Chain(seed=12)
    settings = replace(SHORT, landmark_patience=5)
    made, place = started(chain, settings, 20), np.array([4.0, 2.0])
    made.add_landmark(5, place + 0.1)
    assert made.has_landmark(5)
    for _ in range(20):
        chain.step(made)
        made.add_rows(rows_of(point(chain.newest, 5, chain.truth[-1], place)))
    made.update()
    value, covariance = made.landmark(5)
    error = value - place
    assert error @ np.linalg.solve(covariance, error) < 16.0
    assert np.sqrt(np.diag(covariance)).max() < 0.05
    chain.run(made, 60)
    assert list(made.archive) == [5]
    archived, spread = made.landmark(5)
    error = archived - place
    assert error @ np.linalg.solve(spread, error) < 16.0
    assert np.sqrt(np.diag(spread)).max() < 0.05
    made.add_rows(rows_of(point(chain.newest, 5, chain.truth[-1], place)))
    made.update()
    assert not made.archive
    assert made.rebuilds == 0
    back, known = made.landmark(5)
    error = back - place
    assert error @ np.linalg.solve(known, error) < 16.0
    assert np.linalg.det(known) < np.linalg.det(settings.reentry_inflation * spread)


def test_a_loop_closed_from_the_last_keyframe_to_the_first_does_not_crash() -> None:
    # Deep recursion is what kills the process here (fact 4), hence the thread with its stack.
    found: list[float] = []

    def close() -> None:
        chain = Chain(seed=13, fix_every=0, calibration_sigma=1e-5)
        made, place = started(chain, IncrementalSettings(lag_s=None)), np.array([1.0, 1.0])
        made.add_landmark(0, place)
        made.add_rows(rows_of(point(0, 0, chain.truth[0], place)))
        for _ in range(3000):
            chain.step(made, update=False)
            if chain.newest % 300 == 0:
                made.update()
        before = off(made.state(3000), chain.truth[-1])[0]
        made.add_rows(rows_of(point(3000, 0, chain.truth[-1], place)))
        made.update()
        # Large steps need to be linearised again.
        for _ in range(10):
            made.add_rows(rows_of(point(chain.newest, 0, chain.truth[-1], place)))
            chain.step(made)
        # One point says how far the robot is from it, not where on the circle.
        end, truth = made.state(3010)[:2] - place, chain.truth[-1][:2] - place
        off_circle = float(abs(np.hypot(*end) - np.hypot(*truth)))
        found.extend([before, off_circle, float(made.rebuilds)])

    previous = threading.stack_size(512 << 20)
    try:
        thread = threading.Thread(target=close)
        thread.start()
        thread.join()
    finally:
        threading.stack_size(previous)
    before, after, rebuilds = found
    assert rebuilds == 0
    assert before > 0.5
    assert after < 0.1
