"""Robust losses: what a large whitened residual costs and how much it still pulls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.errors import FglocError

LossName = Literal["none", "huber", "cauchy", "tukey"]

FAINT = 1e-6
"""Smallest weight: a wheel interval given up altogether would cut the chain in two."""


@dataclass(frozen=True)
class Loss:
    """A loss rho(s) of the whitened residual's norm s, quadratic near zero."""

    name: LossName = "none"
    """none: s²/2; huber: linear beyond k; cauchy: logarithmic; tukey: constant beyond k."""
    k: float = 3.0
    """Where the loss leaves the parabola [standard deviations]."""

    def __post_init__(self) -> None:
        if self.name not in ("none", "huber", "cauchy", "tukey"):
            raise FglocError(f"loss {self.name!r} must be none, huber, cauchy or tukey")
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
        return np.ones_like(squared)


PLAIN = Loss()
"""Least squares: every residual is believed alike."""
