"""Marginal covariances where GTSAM gives up: by a sparse factorisation of the information.

GTSAM takes a variable for indeterminate if two of its numbers are known 4096 times (2¹²) as well
as one another, once others are eliminated. A robot that cannot slip sideways, or landmarks that
are surveyed to a millimetre, are; QR still finds the step then, but its tree's marginals go by
Cholesky again. Scaled to unit columns the information is far from singular in double precision.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fgloc.core.measurements import Floats, Stamps

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

    from fgloc.smoothing.network import NetworkRows

AT_ONCE = 256
"""Columns of the inverse that are held at once."""


def sparse_marginals(system: NetworkRows) -> tuple[Floats, Floats, Floats] | None:
    """Return covariances of keyframes (K, B, B), landmarks (L, 2, 2) and calibration (G, G).

    None where the information is singular. One solve a variable: O(N²) for N of them at worst,
    about ten times what GTSAM takes.
    """
    from scipy.sparse import diags
    from scipy.sparse.linalg import splu

    chain, marks = system.chain, system.landmarks
    k, b, g = chain.bounds.size - 1, chain.width, chain.calibration
    jacobian = _jacobian(system)
    norms = np.sqrt(np.asarray(jacobian.multiply(jacobian).sum(axis=0)).ravel())
    if not (np.isfinite(norms).all() and (norms > 0.0).all()):
        return None
    scaled = (jacobian @ diags(1.0 / norms)).tocsc()
    try:
        # Symmetric and positive: no pivoting, as in Cholesky's.
        factor = splu(
            (scaled.T @ scaled).tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    except RuntimeError:
        return None
    sizes = [b] * k + [2] * marks + ([g] if g else [])
    starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    blocks = [np.zeros((size, size)) for size in sizes]
    owner = np.repeat(np.arange(len(sizes)), sizes)
    for first in range(0, owner.size, AT_ONCE):
        columns = np.arange(first, min(first + AT_ONCE, owner.size))
        right = np.zeros((owner.size, columns.size))
        right[columns, np.arange(columns.size)] = 1.0 / norms[columns]
        inverse = factor.solve(right) / norms[:, None]
        for at, column in enumerate(columns.tolist()):
            of = int(owner[column])
            begin, end = int(starts[of]), int(starts[of + 1])
            blocks[of][:, column - begin] = inverse[begin:end, at]
    blocks = [0.5 * (block + block.T) for block in blocks]
    if not all(np.isfinite(block).all() and (np.diag(block) > 0.0).all() for block in blocks):
        return None
    return (
        np.array(blocks[:k]),
        np.array(blocks[k : k + marks]).reshape(marks, 2, 2),
        blocks[-1] if g else np.zeros((0, 0)),
    )


def _jacobian(system: NetworkRows) -> csc_matrix:
    """Return all rows by keyframes, landmarks and calibration, in this order of columns."""
    from scipy.sparse import csc_matrix

    chain = system.chain
    k, b, g = chain.bounds.size - 1, chain.width, chain.calibration
    shared = k * b + 2 * system.landmarks
    rows: list[Stamps] = []
    columns: list[Stamps] = []
    values: list[Floats] = []
    total = 0

    def add(row: Stamps, start: Stamps, block: Floats) -> None:
        """Add one block (d, n) for each row (d,) of it and its first column."""
        n = block.shape[1]
        rows.append(np.repeat(row, n))
        columns.append((start[:, None] + np.arange(n)).ravel())
        values.append(block.ravel())

    row = np.arange(chain.rows.shape[0])
    of = np.repeat(np.arange(k), np.diff(chain.bounds))
    add(row, of * b, chain.rows[:, :b])
    pair = of < k - 1
    add(row[pair], (of[pair] + 1) * b, chain.rows[pair, b : 2 * b])
    add(row, np.full(row.size, shared), chain.rows[:, 2 * b : 2 * b + g])
    total += row.size
    prior = np.arange(chain.prior.shape[0])
    add(total + prior, np.full(prior.size, shared), chain.prior[:, :g])
    total += prior.size
    for link in system.links:
        m, d = link.right.shape
        row = total + np.arange(m * d)
        total += m * d
        second = np.where(link.second < k, link.second * b, k * b + 2 * (link.second - k))
        add(row, np.repeat(link.first * b, d), link.by_first.reshape(m * d, -1))
        add(row, np.repeat(second, d), link.by_second.reshape(m * d, -1))
        add(row, np.full(m * d, shared), link.by_calibration.reshape(m * d, -1))
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return csc_matrix(entries, shape=(total, shared + g))
