"""Errors over many drives: seed D's statistics over repetitions of a motion, and the totals.

A motion is driven several times. Each drive has an e_max, the largest absolute error of x, y and
heading. Over the repetitions the seed prints their maximum (`e_max`), mean (`e_sr`, equation
3.15) and standard deviation (`sigma`). Sigma is the sample standard deviation, divided by n - 1:
the printed tables and the published recordings agree with that and not with n.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass

import numpy as np

from fgloc.core.evaluation import AxisErrors, Evaluation
from fgloc.core.measurements import Floats
from fgloc.errors import FglocError


@dataclass(frozen=True)
class MotionStatistics:
    """Seed D's three numbers for one motion."""

    repetitions: int
    """How many drives the numbers come from."""
    e_max: AxisErrors
    """Largest absolute error of all repetitions."""
    e_sr: AxisErrors
    """Mean over the repetitions of each one's largest absolute error."""
    sigma: AxisErrors | None
    """Sample standard deviation of each repetition's largest error; None for one repetition."""


@dataclass(frozen=True)
class Totals:
    """One number a variable for a set of drives, and their sum. Keys of the command's JSON."""

    x: float
    """Map x [m]."""
    y: float
    """Map y [m]."""
    theta: float
    """Heading [rad]."""
    sum: float
    """x + y + theta, metres and radians added as the seed does."""

    def to_json(self) -> dict[str, float]:
        """Return {"x", "y", "theta", "sum"}."""
        return asdict(self)


Labelled = tuple[str | None, Evaluation]
"""A drive's motion label (`Drive.motion`) and its evaluation."""


def seed_statistics(evaluations: Iterable[Labelled]) -> dict[str, MotionStatistics]:
    """Return seed D's statistics of each motion, in order of first appearance.

    Drives without a label are left out; {} if none has one.
    """
    groups: dict[str, list[Evaluation]] = {}
    for motion, evaluation in evaluations:
        if motion is not None:
            groups.setdefault(motion, []).append(evaluation)
    result = {}
    for motion, group in groups.items():
        worst = _worst(group)
        result[motion] = MotionStatistics(
            repetitions=len(group),
            e_max=_axes(worst.max(axis=0)),
            e_sr=_axes(worst.mean(axis=0)),
            sigma=_axes(worst.std(axis=0, ddof=1)) if len(group) > 1 else None,
        )
    return result


def totals(evaluations: Iterable[Labelled]) -> Totals:
    """Return the sum of e_sr over motions if every drive has a label, else the mean of e_max.

    A mean over drives and a sum over motions cannot be added, so one drive without a label makes
    it the mean over all of them. Raises FglocError for no drives at all.
    """
    rows = list(evaluations)
    if not rows:
        raise FglocError("no drive was evaluated, so there is no total")
    if all(motion is not None for motion, _ in rows):
        means = [[s.e_sr.x, s.e_sr.y, s.e_sr.theta] for s in seed_statistics(rows).values()]
        axes = np.sum(np.array(means), axis=0)
    else:
        axes = _worst([evaluation for _, evaluation in rows]).mean(axis=0)
    return Totals(float(axes[0]), float(axes[1]), float(axes[2]), float(axes.sum()))


def _worst(group: list[Evaluation]) -> Floats:
    """Return (n, 3) e_max of n drives."""
    return np.array([[e.e_max.x, e.e_max.y, e.e_max.theta] for e in group])


def _axes(values: Floats) -> AxisErrors:
    """Return three numbers as axis errors."""
    return AxisErrors(float(values[0]), float(values[1]), float(values[2]))
