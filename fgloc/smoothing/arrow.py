"""Normal equations of a chain of keyframes with shared calibration, solved in linear time.

The matrix is block tridiagonal (keyframes, B×B) with a dense border (calibration, G columns): an
arrow. Block Cholesky along the chain, then the border's Schur complement; the same factors give
the marginal covariance of every keyframe and of the calibration in one backward sweep. Everything
is O(K·(B³ + B²·G + B·G²)) in time and O(K·B·(B + G)) in memory.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats, Stamps


@dataclass(frozen=True)
class NormalEquations:
    """H d = -b in blocks, as sums over all factors."""

    diagonal: Floats
    """(K, B, B) keyframe blocks."""
    upper: Floats
    """(K-1, B, B) blocks between keyframe k and k+1."""
    border: Floats
    """(K, B, G) blocks between keyframes and calibration."""
    corner: Floats
    """(G, G) calibration block."""
    gradient: Floats
    """(K, B) gradient by the keyframes."""
    gradient_corner: Floats
    """(G,) gradient by the calibration."""

    @staticmethod
    def zeros(keyframes: int, width: int, calibration: int) -> NormalEquations:
        """Return empty sums for K keyframes of width B and G calibration variables."""
        return NormalEquations(
            np.zeros((keyframes, width, width)),
            np.zeros((max(keyframes - 1, 0), width, width)),
            np.zeros((keyframes, width, calibration)),
            np.zeros((calibration, calibration)),
            np.zeros((keyframes, width)),
            np.zeros(calibration),
        )


@dataclass(frozen=True)
class ArrowSolution:
    """A step and, where asked for, marginal covariances."""

    step: Floats
    """(K, B) keyframe steps."""
    calibration_step: Floats
    """(G,) calibration step."""
    covariance: Floats | None = None
    """(K, B, B) marginal covariances of the keyframes in their own axes."""
    calibration_covariance: Floats | None = None
    """(G, G) marginal covariance of the calibration."""


@compiled
def accumulate(
    first: Stamps,
    pairwise: bool,
    weight: Floats,
    r: Floats,
    ji: Floats,
    jj: Floats,
    jg: Floats,
    offset: int,
    diagonal: Floats,
    upper: Floats,
    border: Floats,
    corner: Floats,
    gradient: Floats,
    gradient_corner: Floats,
) -> None:
    """Add weighted JᵀJ and Jᵀr of one table; its calibration block starts at column `offset`."""
    d, b, g = r.shape[1], ji.shape[2], jg.shape[2]
    for k in range(first.size):
        w = weight[k]
        if w == 0.0:
            continue
        i = first[k]
        for q in range(d):
            rq = w * r[k, q]
            for a in range(b):
                va = ji[k, q, a]
                if va != 0.0:
                    gradient[i, a] += va * rq
                    va *= w
                    for c in range(b):
                        diagonal[i, a, c] += va * ji[k, q, c]
                    for c in range(g):
                        border[i, a, offset + c] += va * jg[k, q, c]
                    if pairwise:
                        for c in range(b):
                            upper[i, a, c] += va * jj[k, q, c]
                if pairwise:
                    va = jj[k, q, a]
                    if va != 0.0:
                        gradient[i + 1, a] += va * rq
                        va *= w
                        for c in range(b):
                            diagonal[i + 1, a, c] += va * jj[k, q, c]
                        for c in range(g):
                            border[i + 1, a, offset + c] += va * jg[k, q, c]
            for a in range(g):
                va = jg[k, q, a]
                if va != 0.0:
                    gradient_corner[offset + a] += va * rq
                    va *= w
                    for c in range(g):
                        corner[offset + a, offset + c] += va * jg[k, q, c]


@compiled
def _cholesky(a: Floats) -> bool:
    """Overwrite the lower triangle of `a` by its Cholesky factor; False if not positive."""
    n = a.shape[0]
    for j in range(n):
        for k in range(j):
            for i in range(j, n):
                a[i, j] -= a[i, k] * a[j, k]
        if not a[j, j] > 0.0:
            return False
        pivot = np.sqrt(a[j, j])
        for i in range(j, n):
            a[i, j] /= pivot
    return True


@compiled
def _solve_lower(factor: Floats, x: Floats) -> None:
    """Overwrite the columns of x by L⁻¹ x."""
    n = factor.shape[0]
    for c in range(x.shape[1]):
        for i in range(n):
            v = x[i, c]
            for k in range(i):
                v -= factor[i, k] * x[k, c]
            x[i, c] = v / factor[i, i]


@compiled
def _solve_upper(factor: Floats, x: Floats) -> None:
    """Overwrite the columns of x by L⁻ᵀ x."""
    n = factor.shape[0]
    for c in range(x.shape[1]):
        for i in range(n - 1, -1, -1):
            v = x[i, c]
            for k in range(i + 1, n):
                v -= factor[k, i] * x[k, c]
            x[i, c] = v / factor[i, i]


@compiled
def _forward(factor: Floats, upper: Floats, right: Floats) -> int:
    """Factor the chain in place and reduce the right sides (K, B, R); K on success, else where.

    Afterwards `factor[k]` holds the Cholesky factor L_k of the reduced diagonal block, `upper[k]`
    holds L_k⁻¹ U_k and `right[k]` holds L_k⁻¹ of its reduced rows.
    """
    n: int = right.shape[0]
    b, m = right.shape[1], right.shape[2]
    for k in range(n):
        if not _cholesky(factor[k]):
            return k
        _solve_lower(factor[k], right[k])
        if k + 1 < n:
            u = upper[k]
            _solve_lower(factor[k], u)
            for a in range(b):
                for c in range(b):
                    v = 0.0
                    for q in range(b):
                        v += u[q, a] * u[q, c]
                    factor[k + 1, a, c] -= v
                for c in range(m):
                    v = 0.0
                    for q in range(b):
                        v += u[q, a] * right[k, q, c]
                    right[k + 1, a, c] -= v
    return n


@compiled
def _gram(right: Floats, out: Floats) -> None:
    """Write the sum over keyframes of rightᵀ right into `out` (R, R)."""
    n, b, m = right.shape
    out[:] = 0.0
    for k in range(n):
        for q in range(b):
            for a in range(m):
                va = right[k, q, a]
                for c in range(m):
                    out[a, c] += va * right[k, q, c]


@compiled
def _backward(factor: Floats, upper: Floats, right: Floats) -> None:
    """Solve the reduced system in place: right becomes H_chain⁻¹ of the original right sides."""
    n, b, m = right.shape
    for k in range(n - 1, -1, -1):
        if k + 1 < n:
            for a in range(b):
                for c in range(m):
                    v = 0.0
                    for q in range(b):
                        v += upper[k, a, q] * right[k + 1, q, c]
                    right[k, a, c] -= v
        _solve_upper(factor[k], right[k])


@compiled
def _marginals(factor: Floats, upper: Floats, solved: Floats, corner: Floats, out: Floats) -> None:
    """Write the keyframe marginals: the chain's own plus what the calibration adds.

    P_k = L_k⁻ᵀ (1 + W_k P_{k+1} W_kᵀ) L_k⁻¹ with W_k = L_k⁻¹ U_k, from the last keyframe back;
    then E_k Σ E_kᵀ with E_k = (H_chain⁻¹ border)_k and Σ the calibration covariance.
    """
    n, b, m = solved.shape
    chain = np.zeros((b, b))
    inner = np.empty((b, b))
    for k in range(n - 1, -1, -1):
        for a in range(b):
            for c in range(b):
                inner[a, c] = 1.0 if a == c else 0.0
                if k + 1 < n:
                    v = 0.0
                    for p in range(b):
                        for q in range(b):
                            v += upper[k, a, p] * chain[p, q] * upper[k, c, q]
                    inner[a, c] += v
        _solve_upper(factor[k], inner)
        for a in range(b):
            for c in range(b):
                chain[a, c] = inner[c, a]
        _solve_upper(factor[k], chain)
        for a in range(b):
            for c in range(b):
                v = chain[a, c]
                for p in range(m):
                    for q in range(m):
                        v += solved[k, a, p] * corner[p, q] * solved[k, c, q]
                out[k, a, c] = v


def solve(
    system: NormalEquations, damping: float = 0.0, with_covariance: bool = False
) -> ArrowSolution | None:
    """Solve (H + damping·diag H) d = -b; None if the matrix is not positive definite.

    `with_covariance` adds the marginals of keyframes and calibration (of the undamped H).
    """
    width, g = system.diagonal.shape[1], system.corner.shape[0]
    factor = system.diagonal.copy()
    corner = system.corner.copy()
    if damping > 0.0:
        index = np.arange(width)
        factor[:, index, index] *= 1.0 + damping
        corner[np.arange(g), np.arange(g)] *= 1.0 + damping
    upper = system.upper.copy()
    right = np.concatenate([system.border, system.gradient[:, :, None]], axis=2)
    if _forward(factor, upper, right) != factor.shape[0]:
        return None
    gram = np.empty((g + 1, g + 1))
    _gram(right, gram)
    schur = corner - gram[:g, :g]
    try:
        lower = np.linalg.cholesky(schur)
    except np.linalg.LinAlgError:
        return None
    inverse = np.linalg.inv(lower)
    sigma = inverse.T @ inverse
    calibration_step = -sigma @ (system.gradient_corner - gram[:g, g])
    _backward(factor, upper, right)
    solved = np.ascontiguousarray(right[:, :, :g])
    step = -right[:, :, g] - solved @ calibration_step
    if not (np.isfinite(step).all() and np.isfinite(calibration_step).all()):
        return None
    if not with_covariance:
        return ArrowSolution(step, calibration_step)
    covariance = np.empty_like(system.diagonal)
    _marginals(factor, upper, solved, sigma, covariance)
    return ArrowSolution(step, calibration_step, covariance, sigma)
