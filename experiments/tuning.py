"""One tuning procedure for all baselines: the same search, budget, drives and score for each.

A filter whose noise was never tuned is no baseline, and one that was tuned with more care than
another makes an unfair comparison. So every method's noise parameters are fitted by `tune`, on
training drives (or training seeds of a simulation), with the same budget of evaluations, and then
judged on other drives, with `mean_score` or a comparison.

The search, on the logarithms of the parameters scaled to a unit cube:

1. the defaults are scored;
2. a third of the budget goes to a scrambled Sobol sequence, which covers the cube evenly;
3. the rest goes to COBYQA, a trust region with a quadratic model and no derivatives (Ragonneau and
   Zhang, in SciPy): first from the best point so far, then, whenever it has settled, from the best
   of step 1 and 2 that is left. On test functions of 3 to 10 parameters it came closer to the
   minimum than Nelder-Mead, Powell and differential evolution with the same budget.

It is deterministic: the same drives, budget and seed give the same values. What is returned is the
best point ever scored, so it is never worse than the defaults on the training drives. One search
runs in one process; several (a method each) may run beside each other, for everything that goes in
and comes out can be pickled.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.evaluation import Evaluation, evaluate
from fgloc.core.measurements import Floats
from fgloc.errors import FglocError
from fgloc.estimator import Estimator
from fgloc.report.outcomes import calibrated_mount

Values = Mapping[str, float]
Objective = Callable[[Evaluation], float]

EXPLORED = 3
"""One part in so many of the budget explores the whole cube before anything descends."""
RADIUS = 0.1
"""Radius of the first trust region, in parts of each parameter's logarithmic range."""
SETTLED = 1e-3
"""A descent has settled when its trust region is as small as this."""
FEWEST = 10
"""Smallest budget that is of any use."""
AT_LIMIT = 0.02
"""A parameter within this part of its logarithmic range from an end of it is at its limit."""


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
class Tunable:
    """A method with what may be tuned about it."""

    method: str
    """Method id."""
    parameters: Mapping[str, Bounds]
    """Range by name, in the order of the search."""
    build: Callable[[Values], Estimator]
    """Make the estimator from a value for every parameter; a function of a module, so that it can
    be pickled."""

    @property
    def defaults(self) -> dict[str, float]:
        """Return the method's own values."""
        return {name: b.default for name, b in self.parameters.items()}


@dataclass(frozen=True)
class Trial:
    """One evaluation of the search."""

    values: Values
    """The parameters."""
    score: float
    """Their mean score on the training drives; infinite where the method failed on one."""


@dataclass(frozen=True)
class Tuned:
    """What a search found."""

    method: str
    """Method id."""
    values: Values
    """The best parameters."""
    score: float
    """Their mean score on the training drives."""
    default_score: float
    """That of the defaults."""
    evaluations: int
    """How many points were scored, the defaults included; the budget."""
    history: tuple[Trial, ...]
    """All of them in order."""
    at_limit: tuple[str, ...]
    """Parameters that ended at an end of their range: little depends on them, or the range is too
    narrow."""


def ate(evaluation: Evaluation) -> float:
    """Return the root mean square position error [m], not aligned."""
    return evaluation.ate_rmse_m


def end_position(evaluation: Evaluation) -> float:
    """Return the position error at the end [m]."""
    return evaluation.end_position_m


def e_max(evaluation: Evaluation) -> float:
    """Return the sum of the largest errors of x, y [m] and heading [rad], as totals are made of."""
    found = evaluation.e_max
    return found.x + found.y + found.theta


def tune(
    tunable: Tunable,
    drives: Sequence[Drive],
    budget: int,
    seed: int = 0,
    objective: Objective = ate,
) -> Tuned:
    """Return the parameters with the lowest mean of `objective` over the training drives.

    Exactly `budget` points are scored, each on all drives, in the time of so many estimates and
    evaluations. A point on which the method fails on a drive (FglocError) scores infinite. Raises
    FglocError if there is no drive, one has no truth, the budget is below 10, or the method fails
    with every point scored.
    """
    if budget < FEWEST:
        raise FglocError(f"a budget of {budget} evaluations is too small; give {FEWEST} or more")
    if not tunable.parameters:
        raise FglocError(f"{tunable.method} has no parameter to tune")
    _check(drives)
    search = _Search(tunable, drives, budget, objective)
    search.run(seed)
    best = min(search.trials, key=lambda t: t.score)
    if math.isinf(best.score):
        raise FglocError(f"{tunable.method} fails whatever its parameters: {search.failure}")
    ends = {n: b.part(best.values[n]) for n, b in tunable.parameters.items()}
    return Tuned(
        tunable.method,
        best.values,
        best.score,
        search.trials[0].score,
        len(search.trials),
        tuple(search.trials),
        tuple(n for n, u in ends.items() if not AT_LIMIT < u < 1.0 - AT_LIMIT),
    )


def mean_score(estimator: Estimator, drives: Sequence[Drive], objective: Objective = ate) -> float:
    """Return the mean of the objective over drives, as `tune` scores a point.

    Infinite if an error is not finite. Raises FglocError as the estimator does, or if there is no
    drive or one has no truth.
    """
    _check(drives)
    return math.fsum(_score(estimator, drive, objective) for drive in drives) / len(drives)


def _check(drives: Sequence[Drive]) -> None:
    """Raise FglocError unless there are drives and all have a truth."""
    if not drives:
        raise FglocError("there is no drive to tune on")
    for drive in drives:
        if drive.truth is None:
            raise FglocError(f"{drive.name} has no recorded truth to tune by; leave it out")


def _score(estimator: Estimator, drive: Drive, objective: Objective) -> float:
    """Return the objective on one drive, scored as a comparison does."""
    assert drive.truth is not None
    result = estimator.estimate(drive)
    mount = calibrated_mount(result, drive.truth)
    score = objective(evaluate(result.trajectory, drive.truth, mount))
    return score if math.isfinite(score) else math.inf


class _SpentError(Exception):
    """The budget is used up."""


class _Search:
    """The search of one method; keeps every trial."""

    def __init__(
        self,
        tunable: Tunable,
        drives: Sequence[Drive],
        budget: int,
        objective: Objective,
    ) -> None:
        self.trials: list[Trial] = []
        self.failure = ""
        self._points: list[Floats] = []
        self._tunable = tunable
        self._drives = drives
        self._bounds = list(tunable.parameters.values())
        self._budget = budget
        self._objective = objective

    def run(self, seed: int) -> None:
        """Score points until the budget is spent."""
        from scipy.optimize import minimize
        from scipy.stats import qmc

        try:
            self._try(np.array([b.part(b.default) for b in self._bounds]), self._tunable.defaults)
            sobol = qmc.Sobol(len(self._bounds), seed=np.random.default_rng(seed))
            # Drawn as a power of two, as the sequence is balanced by; its beginning is enough.
            wanted = self._budget // EXPLORED
            for point in sobol.random_base2(math.ceil(math.log2(wanted)))[:wanted]:
                self._try(point)
            order = sorted(range(len(self.trials)), key=lambda k: self.trials[k].score)
            starts = [self._points[k] for k in order]
            turn = 0
            while True:
                start = starts[turn % len(starts)]
                minimize(
                    self._try,
                    start,
                    method="COBYQA",
                    bounds=[(0.0, 1.0)] * start.size,
                    options={
                        # Smaller the second time round, or it would score the same points.
                        "initial_tr_radius": RADIUS / (1 + turn // len(starts)),
                        "final_tr_radius": SETTLED,
                        "maxfev": self._budget,
                    },
                )
                turn += 1
        except _SpentError:
            return

    def _try(self, point: Floats, values: Values | None = None) -> float:
        """Return the score of a point of the unit cube, finite even where the method fails.

        Raises _SpentError beyond the budget.
        """
        if len(self.trials) >= self._budget:
            raise _SpentError
        if values is None:
            names = zip(self._tunable.parameters.items(), point, strict=True)
            values = {name: b.value(float(u)) for (name, b), u in names}
        try:
            score = mean_score(self._tunable.build(values), self._drives, self._objective)
        except FglocError as error:
            self.failure, score = str(error), math.inf
        self._points.append(np.array(point))
        self.trials.append(Trial(values, score))
        if math.isfinite(score):
            return score
        # A model of infinite values is of no use: a failure is as bad as the worst point known.
        return max((t.score for t in self.trials if math.isfinite(t.score)), default=1.0)
