"""A solver that breaks is counted, and never serves a wrong state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fgloc.core.drive import Drive
from fgloc.datasets.simulator import load_sim
from fgloc.online import passes, priors
from fgloc.online.online import notes
from fgloc.online.replay import packets
from fgloc.online.settings import OnlineSettings
from fgloc.smoothing.arrow import ChainRows, Elimination, eliminate

from .driving import counted, engine_for, run

Fault = Callable[[ChainRows], Elimination | None]


def nothing(system: ChainRows) -> None:
    """Say that the system is indeterminate."""


def singular(system: ChainRows) -> Elimination | None:
    """Raise what numpy raises."""
    raise np.linalg.LinAlgError("singular matrix")


def overflow(system: ChainRows) -> Elimination | None:
    """Raise what compiled arithmetic raises."""
    raise ZeroDivisionError


def vague(system: ChainRows) -> Elimination | None:
    """Return a solution whose covariance is none."""
    solution = eliminate(system)
    assert solution is not None
    triangular = solution.triangular.copy()
    triangular[-1] = np.nan
    return replace(solution, triangular=triangular)


@pytest.fixture(scope="module")
def drive() -> Drive:
    """Return half a minute with fixes."""
    return load_sim("random?robot=differential&duration=30&rate=10&gyro=on&fix_every=1&seed=2")


@pytest.mark.parametrize("fault", [nothing, singular, overflow, vague])
@pytest.mark.parametrize("broken", [range(90, 91), range(90, 120)])
def test_after_a_broken_solver_the_poses_are_right_again(
    drive: Drive, monkeypatch: pytest.MonkeyPatch, fault: Fault, broken: range
) -> None:
    """One failure is mended from the window; thirty in a row end in dead reckoning, then fixes."""
    calls = 0

    def eliminating(system: ChainRows) -> Any:
        nonlocal calls
        calls += 1
        return fault(system) if calls in broken else eliminate(system)

    sent = list(packets(drive))
    settings = OnlineSettings(lag_s=10.0)
    plain = engine_for(drive, settings)
    expected = run(plain, sent, every=100)
    monkeypatch.setattr(passes, "eliminate", eliminating)
    engine = engine_for(drive, settings)
    poses = run(engine, sent, every=5)
    assert calls > broken.stop
    if len(broken) > 1 or fault is not nothing:
        assert engine.rebuilds > 0
        assert any("rebuilt" in note for note in notes(engine))
    off = np.hypot(*(poses - expected)[:, :2].T)
    # Never further off than dead reckoning of a few seconds between fixes of 5 cm.
    assert off.max() < 0.5, off.max()
    assert off[-100:].max() < 0.1, off[-100:].max()
    monkeypatch.undo()
    counted(engine, sent)


def test_giving_up_goes_on_from_now_and_not_from_the_newest_keyframe(
    drive: Drive, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The wheels behind the newest keyframe must not be counted twice."""
    sent = [p for p in packets(drive) if not p.sensor]
    engine = engine_for(drive, OnlineSettings(keyframe_period_s=1.0, keyframe_turn=9.0))
    # Stop where some packets lie behind the newest keyframe.
    run(engine, sent[:105])
    assert engine.now_ns > engine.window.stamp(engine.window.newest)
    before, sure = engine.propagation.state, engine.propagation.covariance()
    monkeypatch.setattr(passes, "eliminate", singular)
    engine._settle(engine._rebuild())
    np.testing.assert_allclose(engine.propagation.state, before, atol=1e-12)
    np.testing.assert_allclose(engine.propagation.covariance(), sure, rtol=1e-6)
    assert engine.window.stamp(engine.window.newest) == engine.now_ns


def test_covariances_with_rounded_directions_have_a_root() -> None:
    rng = np.random.default_rng(1)
    half = rng.normal(size=(5, 3)) * np.array([[1e4], [1.0], [1e-3], [1e-6], [1.0]])
    rank_three = half @ half.T
    root, meant = priors.definite(rank_three)
    sigma = np.sqrt(np.diag(rank_three))
    np.testing.assert_allclose(
        meant / np.outer(sigma, sigma), rank_three / np.outer(sigma, sigma), atol=1e-12
    )
    full = rank_three + np.diag(sigma**2)
    root, meant = priors.definite(full)
    scale = np.outer(1.0 / sigma, sigma)
    np.testing.assert_allclose(root.T @ root @ full * scale.T, np.eye(5), atol=1e-9)
