"""The minimum of a window with landmarks, by damped steps: where the plain ones led too far."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.core.geometry import compose
from fgloc.core.measurements import Floats
from fgloc.factors.tables import FactorTable, Linearised, linearise
from fgloc.online.live_table import LiveTable
from fgloc.online.window import Window
from fgloc.smoothing.arrow import eliminate, stack

FIRST_DAMPING = 1e-4
LARGEST_DAMPING = 1e6
STEPS = 12
"""Steps at most: the robot does not stand still meanwhile."""
ROUGH = 1e-3
"""Relative decrease at which a minimum is found well enough."""


@dataclass(frozen=True)
class _Point:
    """One linearisation of the whole window."""

    states: Floats
    border: Floats
    linear: list[Linearised]
    weights: list[Floats]
    cost: float


def descend(window: Window, border: Floats) -> Floats:
    """Move the window's states to a minimum of its cost, beginning where they are.

    All factors get the robust weights of their residuals there. Returns the border (n,) there.
    O(steps·window).
    """
    tables, live, rows = _factors(window)
    at = _evaluate(window, tables, window.states.view.copy(), border)
    damping = FIRST_DAMPING
    for _ in range(STEPS):
        trial = _step(window, tables, at, damping)
        if trial is None or not trial.cost < at.cost:
            damping *= 10.0
            if damping > LARGEST_DAMPING:
                break
            continue
        drop, at = at.cost - trial.cost, trial
        damping = max(0.1 * damping, 1e-9)
        if drop < ROUGH * at.cost:
            break
    window.states.view[:] = at.states
    for table, some, weights in zip(live, rows, at.weights[1:], strict=True):
        table.weight.view[some] = weights
    return at.border


def _factors(window: Window) -> tuple[list[FactorTable], list[LiveTable], list[slice]]:
    """Return all factors, the prior first; and where those after it come from."""
    assert window.prior is not None
    live = [table for table in window.tables.values() if len(table.first)]
    rows = [table.rows(window.base, window.newest + 1) for table in live]
    views = [t.view(some, window.base) for t, some in zip(live, rows, strict=True)]
    return [window.prior, *views], live, rows


def _evaluate(window: Window, tables: list[FactorTable], states: Floats, border: Floats) -> _Point:
    """Linearise all factors somewhere."""
    marks = window.landmarks.positions(border)
    linear = [linearise(table, states, border, marks) for table in tables]
    weights = [t.loss.weight(lin.squared) for t, lin in zip(tables, linear, strict=True)]
    cost = sum(
        float(np.sum(t.loss.cost(lin.squared))) for t, lin in zip(tables, linear, strict=True)
    )
    return _Point(states, border, linear, weights, cost)


def _step(window: Window, tables: list[FactorTable], at: _Point, damping: float) -> _Point | None:
    """Take one damped step; None if the factors do not determine it."""
    system = stack(
        list(zip(tables, at.linear, at.weights, strict=True)),
        at.states.shape[0],
        window.layout.width,
        np.zeros((0, at.border.size + 1)),
        window.landmarks.parameters,
    )
    found = eliminate(system, damping, with_carries=False)
    if found is None:
        return None
    states = at.states + found.step
    states[:, :3] = compose(at.states[:, :3], found.step[:, :3])
    return _evaluate(window, tables, states, at.border + found.calibration_step)
