"""Robust losses: what a large whitened residual costs and how much it still pulls."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.errors import FglocError

LossName = Literal["none", "huber", "cauchy", "tukey", "geman-mcclure", "truncated"]
LOSSES: tuple[LossName, ...] = get_args(LossName)
CONVEX = frozenset({"none", "huber"})
"""Losses with one minimum each: nothing to graduate."""

FAINT = 1e-6
"""Smallest weight: a wheel interval given up altogether would cut the chain in two."""


@dataclass(frozen=True)
class Loss:
    """A loss rho(s) of the whitened residual's norm s, quadratic near zero."""

    name: LossName = "none"
    """none: s²/2; huber: linear beyond k; cauchy: logarithmic; tukey: constant beyond k, smoothly;
    geman-mcclure: k²/2 in the limit; truncated: s²/2 up to k, then constant."""
    k: float = 3.0
    """Where the loss leaves the parabola [standard deviations]."""

    def __post_init__(self) -> None:
        if self.name not in LOSSES:
            known = f"{', '.join(LOSSES[:-1])} or {LOSSES[-1]}"
            raise FglocError(f"loss {self.name!r} must be {known}")
        if not self.k > 0.0:
            raise FglocError(f"the width of a robust loss must be positive, got {self.k}")

    def cost(self, squared: Floats) -> Floats:
        """Return rho for squared norms s² (any shape), with rho = s²/2 near zero."""
        k2 = self.k * self.k
        if self.name == "huber":
            s = np.sqrt(squared)
            return np.where(s <= self.k, 0.5 * squared, self.k * (s - 0.5 * self.k))
        if self.name == "cauchy":
            return 0.5 * k2 * np.log1p(squared / k2)
        if self.name == "tukey":
            inside = np.minimum(squared / k2, 1.0)
            return k2 / 6.0 * (1.0 - (1.0 - inside) ** 3)
        if self.name == "geman-mcclure":
            # Not k²s²/(k² + s²), which overflows early.
            return 0.5 * squared / (1.0 + squared / k2)
        if self.name == "truncated":
            return 0.5 * np.minimum(squared, k2)
        return 0.5 * squared

    def weight(self, squared: Floats) -> Floats:
        """Return rho'(s)/s for squared norms: 1 near zero, falling for outliers."""
        k2 = self.k * self.k
        if self.name == "huber":
            return np.minimum(1.0, self.k / np.sqrt(np.maximum(squared, 1e-300)))
        if self.name == "cauchy":
            return 1.0 / (1.0 + squared / k2)
        if self.name == "tukey":
            return np.maximum((1.0 - np.minimum(squared / k2, 1.0)) ** 2, FAINT)
        if self.name == "geman-mcclure":
            return np.maximum(1.0 / (1.0 + squared / k2) ** 2, FAINT)
        if self.name == "truncated":
            return np.where(squared <= k2, 1.0, FAINT)
        return np.ones_like(squared)


PLAIN = Loss()
"""Least squares: every residual is believed alike."""

PACE = 1.4
"""Factor on the control parameter from one round to the next (Yang et al. 2020, remark 5)."""
SHARP = 1e3
"""Control parameter at which a truncated parabola counts as sharp: bent for a thousandth of k²."""
CURVED: dict[LossName, float] = {"cauchy": 1.0, "geman-mcclure": 3.0, "tukey": 5.0}
"""k²/s² where a loss stops being convex: rho''(s) = 0."""


@dataclass(frozen=True)
class Graduated(Loss):
    """A loss made nearly convex, to be sharpened round by round into the loss itself.

    Yang, Antonante, Tzoumas, Carlone: Graduated non-convexity for robust spatial perception,
    RA-L 2020, eqs. 4 to 14, with half their cost. "truncated" has their surrogate; every other
    loss is made wider by the root of mu, which for "geman-mcclure" is their surrogate too.
    """

    mu: float = 1.0
    """Control parameter: "truncated" starts near 0 and is sharp at infinity; all others start
    high and are sharp at 1."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.mu > 0.0:
            raise FglocError(f"the control parameter mu must be positive, got {self.mu}")

    @property
    def sharp(self) -> Loss:
        """Return the loss that this one becomes."""
        return Loss(self.name, self.k)

    def cost(self, squared: Floats) -> Floats:
        """Return the surrogate's cost for squared norms s² (any shape), s²/2 near zero."""
        if self.name != "truncated":
            return self._wider.cost(squared)
        k2, mu = self.k * self.k, self.mu
        bent = self.k * np.sqrt(squared * mu * (mu + 1.0)) - 0.5 * mu * (k2 + squared)
        inner, outer = self._bend
        return np.where(squared <= inner, 0.5 * squared, np.where(squared >= outer, 0.5 * k2, bent))

    def weight(self, squared: Floats) -> Floats:
        """Return the surrogate's weight for squared norms: 1 near zero, FAINT at least."""
        if self.name != "truncated":
            return self._wider.weight(squared)
        inner, outer = self._bend
        mu, s = self.mu, np.sqrt(np.maximum(squared, 1e-300))
        bent = self.k / s * np.sqrt(mu * (mu + 1.0)) - mu
        ends = np.where(squared >= outer, FAINT, np.maximum(bent, FAINT))
        return np.where(squared <= inner, 1.0, ends)

    def sharper(self) -> Graduated:
        """Return the loss of the next round; its mu ends exactly at 1 where it falls."""
        if self.name == "truncated":
            return replace(self, mu=self.mu * PACE)
        return replace(self, mu=max(1.0, self.mu / PACE))

    def finished(self, squared: Floats) -> bool:
        """Return True if sharpening further would change no weight at these squared norms."""
        if self.name != "truncated":
            return self.mu <= 1.0
        inner, outer = self._bend
        return self.mu >= SHARP or not bool(((squared > inner) & (squared < outer)).any())

    @property
    def _wider(self) -> Loss:
        return Loss(self.name, self.k * float(np.sqrt(self.mu)))

    @property
    def _bend(self) -> tuple[float, float]:
        """Return the squared norms between which the truncated parabola is bent."""
        k2 = self.k * self.k
        return self.mu / (self.mu + 1.0) * k2, (self.mu + 1.0) / self.mu * k2


def graduated(loss: Loss, squared: Floats) -> Loss:
    """Return the loss with which to start graduation, given the squared norms at the start.

    Where there is nothing to graduate, because the loss is convex or every residual is well
    inside it, this is the loss itself; else a `Graduated`, convex at all of them ("truncated":
    with their start, hardly bent). Go on with `sharper()` after each solve until `finished`.
    """
    largest = float(np.max(squared, initial=0.0))
    k2 = loss.k * loss.k
    if loss.name in CONVEX:
        return loss
    if loss.name == "truncated":
        # Their mu = k²/(2 r² - k²); below r = k nothing is cut.
        return Graduated(loss.name, loss.k, k2 / (2.0 * largest - k2)) if largest > k2 else loss
    mu = max(1.0, CURVED[loss.name] * largest / k2)
    return Graduated(loss.name, loss.k, mu) if mu > 1.0 else loss
