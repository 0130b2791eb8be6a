"""The search of `fgloc.experiments.tuning`: positive parameters on a logarithmic scale, a budget.

Its steps and why are described there.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.errors import FglocError

Values = Mapping[str, float]
Scorer = Callable[[Values], tuple[float, ...]]

EXPLORED = 3
"""One part in so many of the budget explores the whole cube before anything descends."""
RETURNING = 10
"""One part in so many of the budget goes back from the best point to the defaults."""
RADIUS = 0.1
"""Radius of the first trust region, in parts of each parameter's logarithmic range."""
SETTLED = 1e-3
"""A descent has settled when its trust region is as small as this."""


@dataclass(frozen=True)
class Bounds:
    """The range in which a positive parameter is searched, on a logarithmic scale."""

    low: float
    """Smallest value."""
    high: float
    """Largest value."""
    default: float
    """The method's own default; scored first."""

    def __post_init__(self) -> None:
        if not 0.0 < self.low <= self.default <= self.high < math.inf or self.low == self.high:
            raise FglocError(
                f"a range needs 0 < low <= default <= high, got {self.low} <= {self.default} <= "
                f"{self.high}"
            )

    def value(self, u: float) -> float:
        """Return the parameter at a part `u` in 0…1 of the range."""
        return float(self.low * (self.high / self.low) ** min(max(u, 0.0), 1.0))

    def part(self, value: float) -> float:
        """Return the part 0…1 of the range at which a value lies."""
        return math.log(value / self.low) / math.log(self.high / self.low)


@dataclass(frozen=True)
class Trial:
    """One evaluation of the search."""

    values: Values
    """The parameters."""
    score: float
    """Their mean score on the training drives; infinite where the method failed on one."""
    scores: tuple[float, ...] = ()
    """Score on every drive; empty where the method failed on one."""


class _SpentError(Exception):
    """This part of the budget is used up."""


class Search:
    """One search; keeps every trial in order."""

    def __init__(self, parameters: Mapping[str, Bounds], budget: int, score: Scorer) -> None:
        """`score` returns the scores of parameters drive by drive, or raises FglocError."""
        self.trials: list[Trial] = []
        self._points: list[Floats] = []
        self._names = list(parameters)
        self._bounds = list(parameters.values())
        self._score = score
        self._budget = budget
        self._limit = budget - max(1, budget // RETURNING)
        self._failure = ""

    @property
    def best(self) -> Trial:
        """Return the trial with the lowest score."""
        return min(self.trials, key=lambda t: t.score)

    def run(self, seed: int) -> None:
        """Score exactly as many points as the budget; FglocError if the method fails with all."""
        default = np.array([b.part(b.default) for b in self._bounds])
        try:
            self._explore(default, seed)
            self._descend()
        except _SpentError:
            self._limit = self._budget
        if math.isinf(self.best.score):
            raise FglocError(f"it fails whatever its parameters: {self._failure}")
        best = self._points[self.trials.index(self.best)]
        back = self._budget - len(self.trials)
        for k in range(back):
            self._try(best + (k + 1) / (back + 1) * (default - best))

    def chosen(self) -> Trial:
        """Return, of the trials that cannot be told from the best, the one nearest to the first.

        None that is worse than the first.
        """
        fine = [k for k, t in enumerate(self.trials) if t.score <= self.trials[0].score]
        alike = [k for k in fine if self.trials[k].score <= self.best.score + self._error(k)]
        return self.trials[
            min(alike, key=lambda k: float(np.linalg.norm(self._points[k] - self._points[0])))
        ]

    def _error(self, k: int) -> float:
        """Return the standard error of how much worse trial k is than the best; 0 for one drive."""
        scores = self.trials[k].scores
        if len(scores) < 2:
            return 0.0
        worse = np.array(scores) - np.array(self.best.scores)
        return float(np.std(worse, ddof=1)) / math.sqrt(len(scores))

    def _explore(self, default: Floats, seed: int) -> None:
        """Score the defaults and a Sobol sequence."""
        from scipy.stats import qmc

        self._try(default, {n: b.default for n, b in zip(self._names, self._bounds, strict=True)})
        sobol = qmc.Sobol(default.size, seed=np.random.default_rng(seed))
        # Drawn as a power of two, as the sequence is balanced by; its beginning is enough.
        wanted = self._budget // EXPLORED
        for point in sobol.random_base2(math.ceil(math.log2(wanted)))[:wanted]:
            self._try(point)

    def _descend(self) -> None:
        """Go down from the points so far, the best one first, until the budget is spent."""
        from scipy.optimize import minimize

        order = sorted(range(len(self.trials)), key=lambda k: self.trials[k].score)
        starts = [self._points[k] for k in order]
        for turn in itertools.count():
            minimize(
                self._try,
                starts[turn % len(starts)],
                method="COBYQA",
                bounds=[(0.0, 1.0)] * len(self._bounds),
                options={
                    # Smaller the second time round, or it would score the same points.
                    "initial_tr_radius": RADIUS / (1 + turn // len(starts)),
                    "final_tr_radius": SETTLED,
                    "maxfev": self._budget,
                },
            )

    def _try(self, point: Floats, values: Values | None = None) -> float:
        """Return the score of a point of the unit cube, finite even where the method fails.

        Raises _SpentError when this part of the budget is spent.
        """
        if len(self.trials) >= self._limit:
            raise _SpentError
        if values is None:
            parts = zip(self._names, self._bounds, point, strict=True)
            values = {name: b.value(float(u)) for name, b, u in parts}
        scores: tuple[float, ...] = ()
        try:
            scores = self._score(values)
            score = math.fsum(scores) / len(scores)
        except FglocError as error:
            self._failure, score = str(error), math.inf
        if not math.isfinite(score):
            score, scores = math.inf, ()
        self._points.append(np.array(point))
        self.trials.append(Trial(values, score, scores))
        if math.isfinite(score):
            return score
        # A model of infinite values is of no use: a failure is as bad as the worst point known.
        return max((t.score for t in self.trials if math.isfinite(t.score)), default=1.0)
