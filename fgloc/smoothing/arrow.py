"""A chain of keyframes with shared calibration, eliminated row by row in linear time.

The whitened Jacobian of such a graph is block bidiagonal (keyframes, B columns each) with a dense
border (calibration, G columns). Householder QR walks along the chain: the rows that touch keyframe
k, and what is left of all earlier ones, are made triangular; B rows give keyframe k by the next
one and the calibration, the rest is carried on. Working on the rows and not on their sums of
squares keeps all digits: after an hour of dead reckoning the calibration's prior would drown in
the rounding of a Cholesky factor. O(K·(B+G)²·B) in time, O(K·B·(B+G)) in memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats, Stamps
from fgloc.errors import FglocError
from fgloc.factors.tables import FactorTable, Linearised

SINGULAR = 1e-13
"""A pivot this small beside its column is rounding, not information."""


@dataclass(frozen=True)
class ChainRows:
    """All whitened, weighted rows of a linearised graph, sorted along the chain."""

    rows: Floats
    """(N, 2 B + G + 1): by keyframe k, by k+1, by calibration, and the right side (-residual)."""
    bounds: Stamps
    """(K+1,) rows bounds[k] to bounds[k+1] belong to keyframe k."""
    width: int
    """B, the width of a keyframe's state."""
    prior: Floats
    """(P, G + 1) rows on the calibration alone, with their right side."""

    @property
    def calibration(self) -> int:
        """Return G, the number of calibration variables."""
        return int(self.prior.shape[1]) - 1

    def squared_norms(self) -> tuple[Floats, Floats]:
        """Return the squared column norms: (K, B) of the keyframes, (G,) of the calibration."""
        b, g = self.width, self.calibration
        keyframes = self.bounds.size - 1
        out = np.zeros((keyframes + 1, b))
        k = np.repeat(np.arange(keyframes), np.diff(self.bounds))
        squared = self.rows * self.rows
        np.add.at(out, k, squared[:, :b])
        np.add.at(out, k + 1, squared[:, b : 2 * b])
        shared = squared[:, 2 * b : 2 * b + g].sum(axis=0) + (self.prior[:, :g] ** 2).sum(axis=0)
        return out[:keyframes], shared


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
    landmark_step: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    """(L, 2) landmark steps; none in a chain."""
    landmark_covariance: Floats | None = None
    """(L, 2, 2) marginal covariances of the landmarks."""


def stack(
    linear: Sequence[tuple[FactorTable, Linearised, Floats]],
    keyframes: int,
    width: int,
    prior: Floats,
    landmarks: int = -1,
) -> ChainRows:
    """Return the rows of linearised tables with their robust weights (M,), sorted by keyframe.

    `prior` (P, G + 1) are rows on the calibration alone. Landmarks may be part of it, from column
    `landmarks` on, two columns each: few of them, since all are dense. Raises FglocError for
    factors that see landmarks without that, or join keyframes far apart: see `smoothing.network`
    and `smoothing.isam`. O(N).
    """
    for table, _, _ in linear:
        if table.links and not (table.sees_landmarks and landmarks >= 0):
            raise FglocError(f"{table.sensor}: landmarks and matches do not fit into a chain")
    g = prior.shape[1] - 1
    count = np.zeros(keyframes, dtype=np.int64)
    for table, _, _ in linear:
        count += table.dimension * np.bincount(table.first, minlength=keyframes)
    bounds = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    rows = np.zeros((int(bounds[-1]), 2 * width + g + 1))
    cursor = bounds[:-1].copy()
    nothing = np.zeros(0, np.int64)
    for table, lin, weight in linear:
        _place(
            table.first,
            table.pairwise,
            nothing if table.second is None else table.second,
            2 * width + landmarks,
            np.sqrt(weight),
            lin.residual,
            lin.by_first,
            lin.by_second,
            lin.by_calibration,
            2 * width + table.calibration.start,
            cursor,
            rows,
        )
    return ChainRows(rows, bounds, width, prior)


@compiled
def _place(
    first: Stamps,
    pairwise: bool,
    second: Stamps,
    landmarks: int,
    root: Floats,
    r: Floats,
    ji: Floats,
    jj: Floats,
    jg: Floats,
    offset: int,
    cursor: Stamps,
    rows: Floats,
) -> None:
    """Write the rows of one table at the cursors of their keyframes."""
    d, b, g = r.shape[1], ji.shape[2], jg.shape[2]
    last = rows.shape[1] - 1
    for k in range(first.size):
        for q in range(d):
            row = rows[cursor[first[k]]]
            cursor[first[k]] += 1
            for a in range(b):
                row[a] = root[k] * ji[k, q, a]
                if pairwise:
                    row[b + a] = root[k] * jj[k, q, a]
            for a in range(g):
                row[offset + a] = root[k] * jg[k, q, a]
            if second.size:
                for a in range(2):
                    row[landmarks + 2 * second[k] + a] = root[k] * jj[k, q, a]
            row[last] = -root[k] * r[k, q]


@compiled
def _triangularise(a: Floats, rows: int, cols: int, active: Stamps) -> None:
    """Make the first `cols` columns of a[:rows] upper triangular by Householder reflections.

    Rows with a zero in the column stay out of its reflection, so what is carried along the chain,
    triangular already, costs next to nothing. Row by row, since rows lie in one piece in memory.
    """
    width = a.shape[1]
    t = np.empty(width)
    for j in range(min(rows, cols)):
        active[0] = j
        m = 1
        norm = a[j, j] * a[j, j]
        for i in range(j + 1, rows):
            if a[i, j] != 0.0:
                active[m] = i
                m += 1
                norm += a[i, j] * a[i, j]
        if m == 1:
            continue
        alpha = -np.sqrt(norm) if a[j, j] > 0.0 else np.sqrt(norm)
        lead = a[j, j] - alpha
        scale = 2.0 / (norm - a[j, j] * a[j, j] + lead * lead)
        for c in range(j + 1, width):
            t[c] = lead * a[j, c]
        for q in range(1, m):
            row = a[active[q]]
            v = row[j]
            for c in range(j + 1, width):
                t[c] += v * row[c]
        for c in range(j + 1, width):
            t[c] *= scale
            a[j, c] -= t[c] * lead
        for q in range(1, m):
            row = a[active[q]]
            v = row[j]
            for c in range(j + 1, width):
                row[c] -= t[c] * v
        a[j, j] = alpha
        for q in range(1, m):
            a[active[q], j] = 0.0


@compiled
def _eliminate(
    rows: Floats,
    bounds: Stamps,
    damping: Floats,
    b: int,
    g: int,
    carry: Floats,
    r: Floats,
    carries: Floats,
) -> bool:
    """Eliminate all keyframes; False if one is not determined.

    `damping` (K, B) are diagonal rows added to each keyframe (zeros for none); `carry`
    (b + g, b + g + 1) holds the rows on the calibration at first, and what is left of them at
    last; `r` (K, B, 2 B + G + 1) receives the triangular rows of every keyframe, and `carries`
    (K, B + G, B + G + 1), unless it is empty, what was carried to every keyframe from the ones
    before: the square-root information filter of the chain.
    """
    keyframes = bounds.size - 1
    keep = carries.shape[0] == keyframes
    width = 2 * b + g + 1
    most = 0
    for k in range(keyframes):
        most = max(most, bounds[k + 1] - bounds[k])
    work = np.zeros((most + 2 * b + g, width))
    active = np.empty(most + 2 * b + g, np.int64)
    held = b + g
    for k in range(keyframes):
        n = 0
        if keep:
            carries[k] = carry
        for i in range(held):
            for c in range(b):
                work[n, c] = carry[i, c]
                work[n, b + c] = 0.0
            for c in range(g + 1):
                work[n, 2 * b + c] = carry[i, b + c]
            n += 1
        for i in range(bounds[k], bounds[k + 1]):
            for c in range(width):
                work[n, c] = rows[i, c]
            n += 1
        for i in range(b):
            if damping[k, i] > 0.0:
                for c in range(width):
                    work[n, c] = 0.0
                work[n, i] = damping[k, i]
                n += 1
        if n < b:
            return False
        for i in range(b):
            largest = 0.0
            for q in range(n):
                largest = max(largest, abs(work[q, i]))
            r[k, i, 0] = largest
        _triangularise(work, n, 2 * b + g, active)
        for i in range(b):
            if not abs(work[i, i]) > SINGULAR * r[k, i, 0]:
                return False
        for i in range(b):
            for c in range(width):
                r[k, i, c] = work[i, c]
        held = min(n - b, b + g)
        for i in range(b + g):
            for c in range(b):
                carry[i, c] = work[b + i, b + c] if i < held else 0.0
            for c in range(g + 1):
                carry[i, b + c] = work[b + i, 2 * b + c] if i < held else 0.0
    return True


@compiled
def _substitute(r: Floats, b: int, calibration: Floats, step: Floats) -> None:
    """Fill the keyframe steps (K, B) from the last one back."""
    keyframes, g = r.shape[0], calibration.size
    for k in range(keyframes - 1, -1, -1):
        for i in range(b - 1, -1, -1):
            v = r[k, i, 2 * b + g]
            for c in range(i + 1, b):
                v -= r[k, i, c] * step[k, c]
            if k + 1 < keyframes:
                for c in range(b):
                    v -= r[k, i, b + c] * step[k + 1, c]
            for c in range(g):
                v -= r[k, i, 2 * b + c] * calibration[c]
            step[k, i] = v / r[k, i, i]


@compiled
def _marginals(r: Floats, b: int, sigma: Floats, out: Floats) -> None:
    """Write the keyframe marginals (K, B, B), from the last one back.

    Keyframe k is R⁻¹(e - T y) with y = (x_{k+1}, calibration) and unit noise e, so that its
    covariance is R⁻¹R⁻ᵀ + F P_y Fᵀ with F = -R⁻¹T; P_y is carried along.
    """
    keyframes, g = r.shape[0], sigma.shape[0]
    n = b + g
    inverse = np.zeros((b, b))
    f, cross = np.zeros((b, n)), np.zeros((b, n))
    after = np.zeros((n, n))
    for i in range(g):
        for j in range(g):
            after[b + i, b + j] = sigma[i, j]
    for k in range(keyframes - 1, -1, -1):
        for j in range(b):
            for i in range(b - 1, -1, -1):
                v = 1.0 if i == j else 0.0
                for c in range(i + 1, b):
                    v -= r[k, i, c] * inverse[c, j]
                inverse[i, j] = v / r[k, i, i]
        for i in range(b):
            for j in range(n):
                v = 0.0
                for c in range(i, b):
                    v -= inverse[i, c] * r[k, c, b + j]
                f[i, j] = v
        for i in range(b):
            for j in range(n):
                v = 0.0
                for c in range(n):
                    v += f[i, c] * after[c, j]
                cross[i, j] = v
        for i in range(b):
            for j in range(b):
                v = 0.0
                for c in range(b):
                    v += inverse[i, c] * inverse[j, c]
                for c in range(n):
                    v += cross[i, c] * f[j, c]
                out[k, i, j] = v
        for i in range(b):
            for j in range(b):
                after[i, j] = out[k, i, j]
            for j in range(g):
                after[i, b + j] = after[b + j, i] = cross[i, b + j]


def triangle(rows: Floats) -> Floats:
    """Return the triangular factor of the rows' QR decomposition."""
    return np.asarray(np.linalg.qr(rows, mode="r"), dtype=np.float64)


@dataclass(frozen=True)
class Elimination:
    """A chain eliminated from its first keyframe on, with what was carried along."""

    step: Floats
    """(K, B) keyframe steps."""
    calibration_step: Floats
    """(G,) calibration step."""
    carries: Floats
    """(K, B + G, B + G + 1) rows on keyframe k and the calibration by all keyframes before it."""
    triangular: Floats
    """(K, B, 2 B + G + 1) triangular rows of every keyframe."""
    left: Floats
    """(G, G + 1) what is left for the calibration."""

    def newest_root(self) -> Floats:
        """Return the (B+G, B+G) square-root information of the last keyframe and calibration."""
        b, g = self.step.shape[1], self.calibration_step.size
        root = np.zeros((b + g, b + g))
        root[:b, :b] = self.triangular[-1, :, :b]
        root[:b, b:] = self.triangular[-1, :, 2 * b : 2 * b + g]
        root[b:, b:] = self.left[:, :g]
        return root


def eliminate(
    system: ChainRows, damping: float = 0.0, with_carries: bool = True
) -> Elimination | None:
    """Return the least-squares step of all rows; None if they do not determine it.

    `damping` adds damping·diag(JᵀJ), as Levenberg and Marquardt do; `with_carries` keeps what a
    sliding window goes on from, else `carries` is empty.
    """
    keyframes, b, g = system.bounds.size - 1, system.width, system.calibration
    prior, extra = system.prior, np.zeros((keyframes, b))
    if damping > 0.0:
        by_keyframe, by_calibration = system.squared_norms()
        extra = np.sqrt(damping * by_keyframe)
        diagonal = np.diag(np.sqrt(damping * by_calibration))
        prior = np.concatenate([prior, np.append(diagonal, np.zeros((g, 1)), axis=1)])
    carry = np.zeros((b + g, b + g + 1))
    if g and prior.shape[0]:
        rows = triangle(prior)[:g]
        carry[: rows.shape[0], b:] = rows
    carries = np.empty((keyframes if with_carries else 0, b + g, b + g + 1))
    triangular = np.empty((keyframes, b, 2 * b + g + 1))
    if not _eliminate(system.rows, system.bounds, extra, b, g, carry, triangular, carries):
        return None
    left = triangle(carry[:, b:])[:g]
    pivots = np.abs(np.diag(left))
    if g and not np.all(pivots > SINGULAR * np.abs(left[:, :g]).max()):
        return None
    calibration = np.zeros(g)
    if g:
        calibration[:] = np.linalg.solve(left[:, :g], left[:, g])
    step = np.zeros((keyframes, b))
    _substitute(triangular, b, calibration, step)
    if not (np.isfinite(step).all() and np.isfinite(calibration).all()):
        return None
    return Elimination(step, calibration, carries, triangular, left)


def solve(
    system: ChainRows, damping: float = 0.0, with_covariance: bool = False
) -> ArrowSolution | None:
    """Return the least-squares step of all rows; None if they do not determine it.

    `damping` as in `eliminate`; `with_covariance` adds the marginals of keyframes and calibration.
    """
    found = eliminate(system, damping, with_carries=False)
    if found is None:
        return None
    if not with_covariance:
        return ArrowSolution(found.step, found.calibration_step)
    g = system.calibration
    inverse = np.linalg.inv(found.left[:, :g]) if g else np.zeros((0, 0))
    sigma = inverse @ inverse.T
    covariance = np.empty((*found.step.shape, system.width))
    _marginals(found.triangular, system.width, sigma, covariance)
    return ArrowSolution(found.step, found.calibration_step, covariance, sigma)
