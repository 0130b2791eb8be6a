"""One Gauss–Newton step over the newest keyframes, and what it says of each measurement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.geometry import compose
from fgloc.core.measurements import Floats, Stamps
from fgloc.factors.robust import FAINT
from fgloc.factors.tables import FactorTable, Linearised, linearise
from fgloc.online.live_table import LiveTable
from fgloc.online.priors import Posterior
from fgloc.online.window import Window
from fgloc.smoothing.arrow import Elimination, eliminate, stack

BENT = 0.3
"""A step that turns a keyframe by more [rad] is beyond its linearisation."""
FAR = 0.5
"""So is one that changes a calibration variable (log-ratio or half tracks) by more."""
Judging = tuple[Floats, Floats, dict[int, float]]
"""Joint covariance of state and border, that of the last displacement, gates by dimension."""


@dataclass(frozen=True)
class Judged:
    """The innovations of one table's new measurements."""

    table: LiveTable
    """Where they are."""
    nis: Floats
    """(M,) normalised innovations squared."""
    dimension: int
    """d, the degrees of freedom of each."""


@dataclass(frozen=True)
class Pass:
    """One Gauss–Newton step over the keyframes from `begin` to the newest."""

    begin: int
    """First keyframe."""
    states: Floats
    """(K, B) states after the step."""
    border: Floats
    """(n,) calibration and landmarks after the step."""
    before: Floats
    """(K, B) states before the step."""
    elimination: Elimination
    """Carries and triangular rows, linearised at the states before the step."""
    tables: tuple[FactorTable, ...]
    """Factors, the prior first."""
    live: tuple[LiveTable, ...]
    """Where tables[1:] come from."""
    squared: tuple[Floats, ...]
    """(M,) squared whitened residuals of `tables` that the step predicts."""
    turned: float
    """Largest change of a heading [rad]."""


def judge(
    live: LiveTable,
    rows: slice,
    linear: Linearised,
    joint: Floats,
    moved: Floats,
    gate: float,
) -> Judged | None:
    """Give the new rows of a table their first weights, by what was expected of them.

    The innovation's covariance is that of the measurement plus that of the prediction: `joint`
    (B+n, B+n) of the newest state and the border for factors of one keyframe, `moved` (3, 3)
    of the wheels' last displacement for factors between two. A normalised innovation squared
    beyond `gate` is weighted as the loss would weight a residual of that size; a large residual
    that the prediction's own uncertainty explains is not.
    """
    weight = live.weight.view[rows]
    new = np.flatnonzero(np.isinf(weight))
    if new.size == 0:
        return None
    b = linear.by_first.shape[2]
    sides = joint if not live.pairwise else joint.copy()
    if live.pairwise:
        sides[:b, :] = 0.0
        sides[:, :b] = 0.0
        sides[:3, :3] = moved
    by_state = linear.by_second if live.pairwise else linear.by_first
    jacobian = np.concatenate([by_state[new], linear.by_calibration[new]], axis=2)
    block = live.calibration
    if live.sees_landmarks:
        jacobian = np.concatenate([jacobian, linear.by_second[new]], axis=2)
    own = np.tile([*range(b), *range(b + block.start, b + block.stop)], (new.size, 1))
    if live.sees_landmarks:
        own = np.append(own, b + live.border_columns(rows)[new], axis=1)
    known = sides[own[:, :, None], own[:, None, :]]
    innovation = jacobian @ known @ jacobian.swapaxes(1, 2)
    innovation += np.eye(jacobian.shape[1])
    r = linear.residual[new]
    nis = np.einsum("ka,ka->k", r, np.linalg.solve(innovation, r[:, :, None])[:, :, 0])
    doubtful = FAINT if live.strict else live.loss.weight(nis)
    weight[new] = np.where(nis > gate, doubtful, 1.0)
    return Judged(live, nis, r.shape[1])


def run_pass(
    window: Window,
    begin: int,
    prior: FactorTable,
    border: Floats,
    after_begin: bool,
    judging: Judging | None,
) -> tuple[Pass | None, list[Judged]]:
    """Linearise the keyframes from `begin` on at their states and take one step.

    `border` (n,) are calibration and landmarks in use, which keyframes see in any order.
    `after_begin`: factors of keyframe `begin` alone are in the prior already. `judging` holds the
    joint covariance, that of the last displacement, and the gates by residual dimension.
    None if the system is indeterminate or its solution not finite. O(K) with a compiled core.
    """
    end = window.newest + 1
    states = window.states.view[begin - window.base :]
    tables: list[FactorTable] = []
    live: list[LiveTable] = []
    slices: list[slice] = []
    for table in window.tables.values():
        low = begin + 1 if after_begin and not table.pairwise else begin
        rows = table.rows(low, end)
        if rows.start < rows.stop:
            tables.append(table.view(rows, begin))
            live.append(table)
            slices.append(rows)
    everything = (prior, *tables)
    landmarks = window.landmarks.positions(border)
    linear = [linearise(t, states, border, landmarks) for t in everything]
    judged: list[Judged] = []
    weights = [np.ones(1)]
    for table, rows, lin in zip(live, slices, linear[1:], strict=True):
        if judging is not None:
            joint, moved, gates = judging
            found = judge(table, rows, lin, joint, moved, gates[lin.residual.shape[1]])
            if found is not None:
                judged.append(found)
        weight = table.weight.view[rows]
        weights.append(np.where(np.isinf(weight), 1.0, weight))
    width = window.layout.width
    system = stack(
        list(zip(everything, linear, weights, strict=True)),
        states.shape[0],
        width,
        np.zeros((0, border.size + 1)),
        window.landmarks.parameters,
    )
    elimination = eliminate(system)
    if elimination is None:
        return None, judged
    step, u = elimination.step, elimination.calibration_step
    moved_states = states + step
    moved_states[:, :3] = compose(states[:, :3], step[:, :3])
    by_landmark = window.landmarks.positions(u)
    squared = tuple(
        _predicted(t, lin, step, u, by_landmark) for t, lin in zip(everything, linear, strict=True)
    )
    return (
        Pass(
            begin,
            moved_states,
            border + u,
            states.copy(),
            elimination,
            everything,
            tuple(live),
            squared,
            float(np.abs(step[:, 2]).max()),
        ),
        judged,
    )


def _predicted(
    table: FactorTable, linear: Linearised, step: Floats, u: Floats, landmarks: Floats
) -> Floats:
    """Return the (M,) squared whitened residuals after a step, to first order.

    The step is `step` (K, B) of the states, `u` (n,) of the border, of which `landmarks` (A, 2) are
    the last columns.
    """
    squared = np.empty(table.first.size)
    seen = table.second is not None
    _add_up(
        table.first,
        table.first + 1 if table.second is None else table.second,
        table.pairwise or seen,
        linear.residual,
        linear.by_first,
        linear.by_second,
        linear.by_calibration,
        step,
        landmarks if seen else step,
        u[table.calibration],
        squared,
    )
    return squared


@compiled
def _add_up(
    first: Stamps,
    second: Stamps,
    joins: bool,
    residual: Floats,
    by_first: Floats,
    by_second: Floats,
    by_calibration: Floats,
    step: Floats,
    others: Floats,
    u: Floats,
    squared: Floats,
) -> None:
    """Write the squared norms of residual + Jacobian · step into `squared` (M,)."""
    d, b = by_first.shape[1], by_first.shape[2]
    joined = by_second.shape[2] if joins else 0
    for k in range(first.size):
        i = first[k]
        total = 0.0
        for a in range(d):
            r = residual[k, a]
            for c in range(b):
                r += by_first[k, a, c] * step[i, c]
            for c in range(joined):
                r += by_second[k, a, c] * others[second[k], c]
            for c in range(u.size):
                r += by_calibration[k, a, c] * u[c]
            total += r * r
        squared[k] = total


def trusted(step: Pass) -> bool:
    """Return True if a step stays where its linearisation holds."""
    change = np.abs(step.elimination.calibration_step).max(initial=0.0)
    return step.turned < BENT and bool(change < FAR)


def accept(window: Window, step: Pass) -> Posterior:
    """Write a step's states and carries into the window; return what is known at the newest."""
    row = step.begin - window.base
    window.states.view[row:] = step.states
    e = step.elimination
    window.carry.view[row + 1 :] = e.carries[1:]
    window.linear_states.view[row + 1 :] = step.before[1:]
    window.linear_border.view[row + 1 :] = step.border - e.calibration_step
    root = e.newest_root()
    inverse = np.linalg.inv(root)
    return Posterior(window.newest, step.border, root, inverse @ inverse.T)


def reweight(window: Window, step: Pass) -> float:
    """Give all factors of a whole-window pass the robust weights of its predicted residuals.

    Returns the largest change of a weight.
    """
    change = 0.0
    for live, table, squared in zip(step.live, step.tables[1:], step.squared[1:], strict=True):
        rows = live.rows(step.begin, window.newest + 1)
        weights = table.loss.weight(squared)
        change = max(change, float(np.abs(weights - live.weight.view[rows]).max(initial=0.0)))
        live.weight.view[rows] = weights
    return change
