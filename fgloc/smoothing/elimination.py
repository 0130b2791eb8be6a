"""One linear step by GTSAM: for graphs of any shape, and to check the specialised solver.

Only linear factors cross the border, so none of the costs of Python callbacks arise. The ordering
is METIS: COLAMD is quadratic where one calibration block is shared by a chain, and its deep
recursion overflows the stack on long chains.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.factors.tables import FactorTable, Linearised
from fgloc.smoothing.arrow import ArrowSolution


def solve_with_gtsam(
    linear: Sequence[tuple[FactorTable, Linearised, Floats]],
    keyframes: int,
    width: int,
    prior: tuple[Floats, Floats],
    damping: Floats | None = None,
) -> ArrowSolution | None:
    """Return the Gauss–Newton step; None if GTSAM finds the system indeterminate.

    `linear` holds each table with its linearisation and robust weights (M,); `prior` the square
    root information (G, G), without terms between blocks, and the whitened residual (G,) of the
    calibration prior; `damping` (K·width
    + G,) square-root rows added for Levenberg–Marquardt. Cholesky first, QR if that fails.
    Time is dominated by making one JacobianFactor a measurement: about 10 µs each.
    """
    import gtsam  # heavy: imported when a step is asked for

    graph = gtsam.GaussianFactorGraph()
    blocks: list[tuple[int, int]] = sorted(
        {(t.calibration.start, t.calibration.stop) for t, _, _ in linear if _size(t)}
    )
    keys = {block: keyframes + k for k, block in enumerate(blocks)}
    noise = {d: gtsam.noiseModel.Unit.Create(d) for d in range(1, 8)}
    for table, rows, weight in linear:
        root = np.sqrt(weight)
        b = -rows.residual * root[:, None]
        ji = rows.by_first * root[:, None, None]
        jj = rows.by_second * root[:, None, None]
        jg = rows.by_calibration * root[:, None, None]
        model = noise[table.dimension]
        first = table.first.tolist()
        key = keys.get((table.calibration.start, table.calibration.stop)) if _size(table) else None
        factor = gtsam.JacobianFactor
        if table.pairwise and key is not None:
            for k, i in enumerate(first):
                graph.add(factor(i, ji[k], i + 1, jj[k], key, jg[k], b[k], model))
        elif table.pairwise:
            for k, i in enumerate(first):
                graph.add(factor(i, ji[k], i + 1, jj[k], b[k], model))
        elif key is not None:
            for k, i in enumerate(first):
                graph.add(factor(i, ji[k], key, jg[k], b[k], model))
        else:
            for k, i in enumerate(first):
                graph.add(factor(i, ji[k], b[k], model))
    information, offset = prior
    for (begin, end), key in keys.items():
        n = end - begin
        model = gtsam.noiseModel.Unit.Create(n)
        rows_g = information[begin:end, begin:end]
        graph.add(gtsam.JacobianFactor(key, rows_g, -offset[begin:end], model))
        if damping is not None:
            extra = np.diag(damping[keyframes * width + begin : keyframes * width + end])
            graph.add(gtsam.JacobianFactor(key, extra, np.zeros(n), model))
    if damping is not None:
        model = gtsam.noiseModel.Unit.Create(width)
        lead = damping[: keyframes * width].reshape(keyframes, width)
        for i in range(keyframes):
            graph.add(gtsam.JacobianFactor(i, np.diag(lead[i]), np.zeros(width), model))
    ordering = gtsam.Ordering.MetisGaussianFactorGraph(graph)
    solution = None
    for function in ((), (gtsam.EliminateQR,)):  # GTSAM's default is Cholesky
        try:
            solution = graph.eliminateMultifrontal(ordering, *function).optimize()
            break
        except RuntimeError:
            continue
    if solution is None:
        return None
    # VectorValues.vector() concatenates by ascending key: keyframes first, then the blocks.
    flat = np.asarray(solution.vector())
    step = flat[: keyframes * width].reshape(keyframes, width)
    calibration = np.asarray(-np.linalg.solve(information, offset), dtype=np.float64)
    at = keyframes * width
    for begin, end in blocks:
        calibration[begin:end] = flat[at : at + end - begin]
        at += end - begin
    return ArrowSolution(step, calibration)


def _size(table: FactorTable) -> int:
    """Return the number of calibration variables of a table."""
    return int(table.calibration.stop - table.calibration.start)
