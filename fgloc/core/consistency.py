"""Is a covariance right? Chi-square gates for one error, bounds for the average over many runs.

For an error e with covariance P, the squared normalised error eᵀP⁻¹e of d components (NEES for
states, NIS for innovations) follows a chi-square distribution with d degrees of freedom if P is
right. It is never divided by d here. The sum over n independent runs then has n·d degrees of
freedom, which bounds the average (Bar-Shalom, Li, Kirubarajan: Estimation with Applications to
Tracking and Navigation, section 5.4).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.errors import FglocError

CONFIDENCE = 0.95
"""Probability that the average of a consistent estimator lies inside its bounds."""

Verdict = Literal["inside", "below", "above"]


@lru_cache(maxsize=256)
def gate_threshold(probability: float, dof: int) -> float:
    """Return the squared normalised error that a right one stays below with `probability`.

    The chi-square quantile with `dof` degrees of freedom, e.g. 7.815 for 0.95 and 3. A gate that
    rejects one good measurement of d components in a thousand is `gate_threshold(0.999, d)`.
    Raises FglocError for a probability outside 0..1 (exclusive) or fewer than one degree. The
    first call imports scipy; answers are remembered.
    """
    if not 0.0 < probability < 1.0:
        raise FglocError(f"a gate needs a probability between 0 and 1, got {probability}")
    if dof < 1:
        raise FglocError(f"a gate needs at least one degree of freedom, got {dof}")
    from scipy.special import gammaincinv

    return 2.0 * float(gammaincinv(0.5 * dof, probability))


def squared_normalised(error: Floats, covariance: Floats) -> float:
    """Return eᵀP⁻¹e of an error (d,) with covariance (d, d), undivided; NaN without a usable P."""
    return float(each_squared_normalised(error[None], covariance[None])[0])


def each_squared_normalised(errors: Floats, covariances: Floats) -> Floats:
    """Return (N,) eᵀP⁻¹e of errors (N, d) with covariances (N, d, d), undivided. O(N d³).

    NaN where P is not usable: not finite, zero on its diagonal, or singular. P is brought to
    correlations first, so that metres and radians do not decide what is singular.
    """
    out = np.full(errors.shape[0], np.nan)
    sigma = np.sqrt(np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 0.0))
    finite = np.isfinite(covariances).all(axis=(1, 2)) & np.isfinite(errors).all(axis=1)
    usable = np.flatnonzero(finite & (sigma > 1e-12).all(axis=1))
    scaled = errors[usable] / sigma[usable]
    outer = sigma[usable, :, None] * sigma[usable, None, :]
    correlation = covariances[usable] / outer
    regular = np.linalg.eigvalsh(correlation)[:, 0] > 1e-9
    scaled, correlation = scaled[regular], correlation[regular]
    solved = np.linalg.solve(correlation, scaled[:, :, None])[:, :, 0]
    out[usable[regular]] = np.sum(scaled * solved, axis=1)
    return out


@dataclass(frozen=True)
class Average:
    """The average squared normalised error over independent runs, with its bounds."""

    value: float
    """Average over the runs, undivided by the degrees of freedom."""
    lower: float
    """Lower bound of a consistent estimator."""
    upper: float
    """Upper bound of a consistent estimator."""
    dof: float
    """Degrees of freedom per run (their mean, where the runs differ): the ideal value."""
    runs: int
    """How many runs were averaged."""
    skipped: int = 0
    """Runs without a usable covariance, left out of the average."""

    @property
    def verdict(self) -> Verdict:
        """Return where the value lies: above means too confident, below too cautious."""
        if self.value < self.lower:
            return "below"
        return "above" if self.value > self.upper else "inside"


def average(
    values: Iterable[float], dof: int | Iterable[int], confidence: float = CONFIDENCE
) -> Average:
    """Return the average of independent squared normalised errors with its two-sided bounds.

    `dof` is that of every value, or one for each. Values that are not finite are skipped and
    counted. Raises FglocError if none is left, or as `gate_threshold` does.
    """
    squared = np.array(list(values), dtype=np.float64)
    each = np.full(squared.size, dof) if isinstance(dof, int) else np.array(list(dof))
    if each.size != squared.size:
        raise FglocError(f"{squared.size} values, but {each.size} degrees of freedom")
    usable = np.isfinite(squared)
    n = int(usable.sum())
    if n == 0:
        raise FglocError("there is no run with a usable covariance to average")
    total = int(each[usable].sum())
    tail = 0.5 * (1.0 - confidence)
    return Average(
        value=float(squared[usable].mean()),
        lower=gate_threshold(tail, total) / n,
        upper=gate_threshold(1.0 - tail, total) / n,
        dof=total / n,
        runs=n,
        skipped=squared.size - n,
    )


def correlations(covariance: Floats) -> Floats:
    """Return the (N, N) correlation matrix of a covariance; rows without a variance are NaN."""
    sigma = np.sqrt(np.diag(covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(covariance / np.outer(sigma, sigma))
