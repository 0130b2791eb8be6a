"""One linear step by GTSAM: the general elimination, and a check of the specialised solver.

Only linear factors cross the border, so none of the costs of Python callbacks arise. The ordering
is cyclic reduction: every other keyframe first, then every other one of those left, the
calibration last. Its tree is as shallow as METIS's and it costs nothing to find; COLAMD is
quadratic where one calibration block is shared by a chain, and its deep recursion overflows the
stack on long chains.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.smoothing.arrow import ArrowSolution, ChainRows

if TYPE_CHECKING:
    import gtsam


def solve_with_gtsam(system: ChainRows, damping: float = 0.0) -> ArrowSolution | None:
    """Return the least-squares step of all rows; None if GTSAM finds them indeterminate.

    `damping` adds damping·diag(JᵀJ), as Levenberg and Marquardt do. Cholesky first, QR if that
    fails. Time is dominated by making one JacobianFactor a keyframe (about 6 µs) and by the
    elimination (about 8 µs a keyframe).
    """
    import gtsam  # heavy: imported when a step is asked for

    b, g = system.width, system.calibration
    keyframes = system.bounds.size - 1
    shared = keyframes
    graph = gtsam.GaussianFactorGraph()
    add_chain(graph, system, shared)
    if damping > 0.0:
        by_keyframe, by_calibration = system.squared_norms()
        add_damping(graph, [*by_keyframe, by_calibration] if g else [*by_keyframe], damping)
    ordering = _cyclic_reduction(keyframes, g > 0)
    for function in ((), (gtsam.EliminateQR,)):  # GTSAM's default is Cholesky
        try:
            solution = graph.eliminateMultifrontal(ordering, *function).optimize()
        except RuntimeError:
            continue
        # VectorValues.vector() concatenates by ascending key: keyframes first, then the rest.
        flat = np.asarray(solution.vector(), dtype=np.float64)
        if np.isfinite(flat).all():
            return ArrowSolution(flat[: keyframes * b].reshape(keyframes, b), flat[keyframes * b :])
    return None


def add_damping(graph: gtsam.GaussianFactorGraph, squared: list[Floats], damping: float) -> None:
    """Add damping·diag(JᵀJ), given the squared column norms of every variable, by its key."""
    import gtsam

    for key, norms in enumerate(squared):
        unit = gtsam.noiseModel.Unit.Create(norms.size)
        extra = np.diag(np.sqrt(damping * norms))
        graph.add(gtsam.JacobianFactor(key, extra, np.zeros(norms.size), unit))


def add_chain(graph: gtsam.GaussianFactorGraph, system: ChainRows, shared: int) -> None:
    """Add one factor a keyframe, and the calibration's prior.

    A keyframe's factor holds all its rows, by itself, the next one and the calibration, whose key
    is `shared`; keyframes are keys from 0 on.
    """
    import gtsam

    b, g, last = system.width, system.calibration, system.bounds.size - 2
    if g:
        unit = gtsam.noiseModel.Unit.Create(system.prior.shape[0])
        prior = system.prior[:, :g], system.prior[:, g]
        graph.add(gtsam.JacobianFactor(shared, *prior, unit))
    first, second = system.rows[:, :b], system.rows[:, b : 2 * b]
    border, right = system.rows[:, 2 * b : -1], system.rows[:, -1]
    most = int(np.diff(system.bounds).max())
    units = [gtsam.noiseModel.Unit.Create(n) for n in range(most + 1)]
    ends = system.bounds.tolist()
    for k, (i, j) in enumerate(pairwise(ends)):
        if i == j:
            continue
        unit = units[j - i]
        # Spelled out: this loop is most of what a step costs.
        if k < last and border.size:
            c = border[i:j]
            graph.add(k, first[i:j], k + 1, second[i:j], shared, c, right[i:j], unit)
        elif k < last:
            graph.add(k, first[i:j], k + 1, second[i:j], right[i:j], unit)
        elif border.size:
            graph.add(k, first[i:j], shared, border[i:j], right[i:j], unit)
        else:
            graph.add(k, first[i:j], right[i:j], unit)


def _cyclic_reduction(keyframes: int, shared: bool) -> gtsam.Ordering:
    """Return keyframes by how often two divides their (one-based) number, then what they share."""
    import gtsam

    number = np.arange(1, keyframes + 1)
    order = np.argsort(number & -number, kind="stable").tolist()
    return gtsam.Ordering([*order, keyframes] if shared else order)
