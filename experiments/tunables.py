"""What is tuned about each baseline: its noise parameters, their ranges, how it is built."""

from __future__ import annotations

from fgloc.errors import FglocError
from fgloc.estimator import Estimator
from fgloc.experiments.tuning import Bounds, Tunable, Values
from fgloc.filters.model3 import Model3, Model3Settings

WIDE = 1000.0
"""A noise variance is searched from a thousandth to the thousandfold of its default."""


def around(default: float, factor: float = WIDE) -> Bounds:
    """Return the range from a default divided by a factor to the default times it."""
    return Bounds(default / factor, default * factor, default)


def _model3(values: Values) -> Estimator:
    """Return Model 3 with these variances."""
    return Model3(Model3Settings(**values))


MODEL3 = Tunable(
    "model3",
    {
        name: around(getattr(Model3Settings(), name))
        for name in ("heading_variance", "track_variance", "yaw_variance")
    },
    _model3,
)
"""Q and R of Model 3. The process noise of x and y stays: no reading tells of the position, so it
changes the covariance and never the estimate."""

TUNABLES: dict[str, Tunable] = {t.method: t for t in (MODEL3,)}
"""All baselines that can be tuned, by method id."""


def tunable(method: str) -> Tunable:
    """Return what is tuned about a method; raises FglocError for one without noise parameters."""
    if method not in TUNABLES:
        raise FglocError(f"{method} cannot be tuned; choose from {', '.join(TUNABLES)}")
    return TUNABLES[method]
