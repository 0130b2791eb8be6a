"""A first guess where landmarks tell the way: smoothing from the start, piece by piece.

Dead reckoning with a nominal calibration may be turned by radians after minutes, and landmarks
placed along it lie all over the map: no local optimiser repairs that. So each piece begins where
the one before ended, with the calibration and the landmarks known so far.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fgloc.core.geometry import between, compose
from fgloc.core.measurements import Floats, Stamps
from fgloc.factors.tables import FactorTable, Kind
from fgloc.smoothing.initial import dead_reckon
from fgloc.smoothing.minimise import CalibrationPrior, linear_system, minimise
from fgloc.smoothing.network import step_of
from fgloc.smoothing.problem import Problem
from fgloc.smoothing.settings import Settings

PIECE_S = 10.0
"""How much each piece adds [s]."""
ROUGH = 1e-2
"""Relative decrease at which a piece is good enough to go on."""
FEW = 4
"""Linearisations of each of its two stages at most."""
AGAIN = 4.0
"""What is handed on is inflated by this, since a part of it is counted twice."""
NEW_M = 100.0
"""Prior sigma of a landmark that was not seen before, about where its first sighting puts it [m].
With 1 km and a mounting to calibrate, marginals of a first piece are too poorly conditioned."""


@dataclass
class _Known:
    """What is known of the landmarks so far."""

    value: Floats
    """(L, 2)."""
    covariance: Floats
    """(L, 2, 2); NaN where a landmark was not seen yet."""


def forward(problem: Problem, settings: Settings) -> tuple[Floats, Floats, Floats, int]:
    """Return a first guess of states (K, B), calibration (G,), landmarks (L, 2), and iterations.

    Each piece overlaps half of the one before. All together cost about two full solutions.
    """
    seconds = (problem.keyframes_ns - problem.keyframes_ns[0]) * 1e-9
    total = seconds.size
    states, u = problem.states.copy(), np.zeros(len(problem.parameters))
    known = _surveyed(problem)
    prior, iterations = CalibrationPrior.of(problem), 0
    rough = replace(settings, tolerance=ROUGH, max_iterations=FEW)
    begin, done = 0, 1
    marginals = np.zeros((0, states.shape[1], states.shape[1]))
    offset = 0
    while done < total:
        end = int(np.searchsorted(seconds, seconds[done - 1] + PIECE_S, side="right"))
        end = min(max(end, done + 1), total)
        window = problem.window(begin, end)
        path = dead_reckon(window.displacement(u), window.turn)
        near = done - 1 - begin
        moved = between(path[near], path[near + 1 :])
        states[done:end, :3] = compose(states[done - 1, :3], moved)
        states[done:end, 3:] = states[done - 1, 3:]
        if begin > 0:
            window = window.with_state_prior(states[begin], AGAIN * marginals[begin - offset])
        window, seen = _with_landmarks(problem, window, states, known, begin, end)
        point, count, _ = minimise(window, rough, states[begin:end], u, False, prior)
        point, more, _ = minimise(
            window, rough, point.states, point.u, True, prior, point.landmarks
        )
        iterations += count + more
        solution = step_of(linear_system(prior, point), with_covariance=True)
        if solution is None or solution.covariance is None:
            break
        states[begin:end], u = point.states, point.u
        known.value[seen] = point.landmarks
        if solution.landmark_covariance is not None:
            known.covariance[seen] = solution.landmark_covariance
        marginals, offset = solution.covariance, begin
        prior = CalibrationPrior.gaussian(u, AGAIN * np.asarray(solution.calibration_covariance))
        begin = int(np.searchsorted(seconds, seconds[end - 1] - 0.5 * PIECE_S))
        begin, done = max(begin, offset), end
    return states, u, known.value, iterations


def placed(problem: Problem, states: Floats) -> Floats:
    """Return the landmarks (L, 2) where a survey or, seen from `states`, most sightings put them.

    `states` (K, B) must be right to a degree where nothing is surveyed. The median of both
    coordinates: up to half of the sightings may be wrong.
    """
    known = _surveyed(problem)
    values = known.value.copy()
    seen = [(t, t.second) for t in problem.tables if t.kind == Kind.RANGE_BEARING]
    if not seen:
        return values
    rows = [_where(t, np.arange(t.first.size), states) for t, _ in seen]
    where, which = np.concatenate(rows), np.concatenate([np.asarray(s) for _, s in seen])
    for k in np.unique(which[np.isnan(known.covariance[which, 0, 0])]).tolist():
        values[k] = np.median(where[which == k], axis=0)
    return values


def _surveyed(problem: Problem) -> _Known:
    """Return what is known of the landmarks before the drive."""
    n = problem.landmarks.shape[0]
    known = _Known(problem.landmarks.copy(), np.full((n, 2, 2), np.nan))
    for table in problem.tables:
        if table.kind == Kind.LANDMARK_PRIOR and table.second is not None:
            known.value[table.second] = table.measurements[:, :2]
            root = np.linalg.inv(table.sqrt_information)
            known.covariance[table.second] = root @ root.swapaxes(1, 2)
    return known


def _with_landmarks(
    problem: Problem, window: Problem, states: Floats, known: _Known, begin: int, end: int
) -> tuple[Problem, Stamps]:
    """Return the piece with what was seen in it, and which landmarks those are."""
    rows = []
    for table in problem.tables:
        if table.sees_landmarks and table.kind != Kind.LANDMARK_PRIOR:
            at = np.flatnonzero((table.first >= begin) & (table.first < end))
            rows.append((table, at))
    every = [np.asarray(t.second)[at] for t, at in rows]
    seen = np.unique(np.concatenate([np.zeros(0, np.int64), *every]))
    if not seen.size:
        return window, seen
    values = known.value[seen].copy()
    tables = []
    for (table, at), second in zip(rows, every, strict=True):
        if not at.size:
            continue
        place = np.searchsorted(seen, second)
        new = np.isnan(known.covariance[second, 0, 0])
        order = at[new][::-1]  # the first sighting has the last word
        values[place[new][::-1]] = _where(table, order, states)
        tables.append(
            replace(
                table,
                first=table.first[at] - begin,
                measurements=table.measurements[at],
                sqrt_information=table.sqrt_information[at],
                second=place,
            )
        )
    covariance = AGAIN * known.covariance[seen]
    covariance[np.isnan(covariance[:, 0, 0])] = NEW_M**2 * np.eye(2)
    roots = np.linalg.inv(np.linalg.cholesky(covariance))
    tables.append(
        FactorTable(
            Kind.LANDMARK_PRIOR,
            "so far",
            np.zeros(seen.size, np.int64),
            values,
            roots,
            slice(0, 0),
            second=np.arange(seen.size, dtype=np.int64),
        )
    )
    return replace(window, tables=(*window.tables, *tables), landmarks=values), seen


def _where(table: FactorTable, rows: Stamps, states: Floats) -> Floats:
    """Return the (R, 2) landmarks that sightings mean, seen from the states."""
    m = table.measurements[rows]
    sensor = compose(states[table.first[rows], :3], m[:, 2:5])
    direction = sensor[:, 2] + m[:, 1]
    return np.asarray(
        sensor[:, :2] + m[:, :1] * np.stack([np.cos(direction), np.sin(direction)], axis=1)
    )
