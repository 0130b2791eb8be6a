"""One tuning procedure for all baselines: the same search, budget, drives and score for each.

A filter whose noise was never tuned is no baseline, and one that was tuned with more care than
another makes an unfair comparison. So every method's noise parameters are fitted by `tune`, on
training drives (or training seeds of a simulation), with the same budget of evaluations, and then
judged on other drives, with `mean_score` or a comparison.

The search, on the logarithms of the parameters scaled to a unit cube:

1. the defaults are scored;
2. a third of the budget goes to a scrambled Sobol sequence, which covers the cube evenly;
3. more than half goes to COBYQA, a trust region with a quadratic model and no derivatives
   (Ragonneau and Zhang, in SciPy): first from the best point so far, then, whenever it has settled,
   from the best of steps 1 and 2 that is left. On test functions of 3 to 10 parameters it came
   closer to the minimum than Nelder-Mead, Powell and differential evolution with the same budget;
4. a tenth goes back from the best point on the straight line to the defaults.

The lowest mean is not taken, but of all points that cannot be told from it the one nearest to the
defaults: those whose mean over the training drives is higher by no more than one standard error of
the difference, drive by drive (the one-standard-error rule of Breiman et al., Classification and
Regression Trees, 1984). Ten drives with their own biases and slips are easily fitted too well: the
plain minimum was at times worse than the defaults on other drives. A point worse than the defaults
on the training drives is never taken.

It is deterministic: the same drives, budget and seed give the same values. One search runs in one
process; several (a method each) may run beside each other, for everything that goes in and comes
out can be pickled.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from fgloc.core.drive import Drive
from fgloc.core.evaluation import Evaluation, evaluate
from fgloc.errors import FglocError
from fgloc.estimator import Estimator, calibrated_mount
from fgloc.experiments.tuning_search import Bounds, Search, Trial, Values

Objective = Callable[[Evaluation], float]

AT_LIMIT = 0.02
"""A parameter within this part of its logarithmic range from an end of it is at its limit."""
FEWEST = 10
"""Smallest budget that is of any use."""


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
class Tuned:
    """What a search found."""

    method: str
    """Method id."""
    values: Values
    """The parameters to use: of those as good as the best, the ones nearest to the defaults."""
    score: float
    """Their mean score on the training drives."""
    best_score: float
    """The lowest mean score of all points."""
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
    """Return the parameters with the lowest mean of `objective` over the training drives, or the
    ones nearest to the defaults that cannot be told from them.

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

    def score(values: Values) -> tuple[float, ...]:
        estimator = tunable.build(values)
        return tuple(_score(estimator, drive, objective) for drive in drives)

    search = Search(tunable.parameters, budget, score)
    try:
        search.run(seed)
    except FglocError as error:
        raise FglocError(f"{tunable.method} cannot be tuned: {error}") from None
    chosen = search.chosen()
    ends = {n: b.part(chosen.values[n]) for n, b in tunable.parameters.items()}
    return Tuned(
        tunable.method,
        chosen.values,
        chosen.score,
        search.best.score,
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
    mount = calibrated_mount(result.calibration, drive.truth)
    score = objective(evaluate(result.trajectory, drive.truth, mount))
    return score if math.isfinite(score) else math.inf
