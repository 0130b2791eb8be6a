"""The linear algebra of an extended Kalman filter's correction, without a single allocation.

For a state x (n,) with covariance P (n, n) and a measurement with innovation v (d,), Jacobian H
(d, n) and noise R (d, d): S = H P Hᵀ + R, K = P Hᵀ S⁻¹, x ← x + K v, and in Joseph's form
P ← (I − K H) P (I − K H)ᵀ + K R Kᵀ, which stays symmetric and positive definite, whatever is
rounded and whatever the gain.
"""

from __future__ import annotations

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats


@compiled
def whiten(p: Floats, h: Floats, r: Floats, v: Floats, d: int, s: Floats, white: Floats) -> float:
    """Return the squared Mahalanobis distance vᵀ S⁻¹ v of an innovation; NaN if S is not positive.

    The lower Cholesky factor of S goes into `s`, the whitened innovation into `white`; of all
    arrays the first `d` rows count (h: `d` rows and n columns, n being that of p).
    """
    n = p.shape[0]
    for a in range(d):
        for b in range(a + 1):
            total = r[a, b]
            for i in range(n):
                if h[a, i] != 0.0:
                    for j in range(n):
                        total += h[a, i] * p[i, j] * h[b, j]
            s[a, b] = total
    for a in range(d):
        for b in range(a + 1):
            total = s[a, b]
            for c in range(b):
                total -= s[a, c] * s[b, c]
            if a == b:
                if not total > 0.0:
                    return np.nan
                s[a, a] = np.sqrt(total)
            else:
                s[a, b] = total / s[b, b]
    squared = 0.0
    for a in range(d):
        total = v[a]
        for c in range(a):
            total -= s[a, c] * white[c]
        white[a] = total / s[a, a]
        squared += white[a] * white[a]
    return squared


@compiled
def correct(
    x: Floats,
    p: Floats,
    h: Floats,
    r: Floats,
    v: Floats,
    d: int,
    s: Floats,
    gain: Floats,
    left: Floats,
    work: Floats,
) -> None:
    """Correct x and P in place with a measurement whose `whiten` left its factor in `s`.

    `gain` (n, ≥d), `left` (n, n) and `work` (n, n) are scratch; the gain K stays in `gain`.
    O(n³ + n² d).
    """
    n = p.shape[0]
    for i in range(n):
        # Row i of P Hᵀ, then solved with S from the right: two triangular sweeps.
        for a in range(d):
            total = 0.0
            for j in range(n):
                total += p[i, j] * h[a, j]
            gain[i, a] = total
        for a in range(d):
            total = gain[i, a]
            for c in range(a):
                total -= s[a, c] * gain[i, c]
            gain[i, a] = total / s[a, a]
        for a in range(d - 1, -1, -1):
            total = gain[i, a]
            for c in range(a + 1, d):
                total -= s[c, a] * gain[i, c]
            gain[i, a] = total / s[a, a]
    for i in range(n):
        for a in range(d):
            x[i] += gain[i, a] * v[a]
        for j in range(n):
            total = 1.0 if i == j else 0.0
            for a in range(d):
                total -= gain[i, a] * h[a, j]
            left[i, j] = total
    for i in range(n):
        for j in range(n):
            total = 0.0
            for c in range(n):
                total += left[i, c] * p[c, j]
            work[i, j] = total
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for c in range(n):
                total += work[i, c] * left[j, c]
            for a in range(d):
                for b in range(d):
                    total += gain[i, a] * r[a, b] * gain[j, b]
            p[i, j] = total
            p[j, i] = total
