"""Seed D's statistics on the numbers that its tables print."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgloc.core.drive import Reference
from fgloc.core.evaluation import AxisErrors, Evaluation, evaluate
from fgloc.core.totals import seed_statistics, totals
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError


def worst(x: float, y: float, theta: float) -> Evaluation:
    still = Trajectory(np.array([0, 1]), np.zeros((2, 3)))
    return replace(evaluate(still, Reference(still)), e_max=AxisErrors(x, y, theta))


def test_statistics_are_those_of_the_seeds_table_4() -> None:
    # Circle counter-clockwise, nominal parameters. The seed's kinematics on the published
    # recordings of repetitions 1-3 give the first three rows. The table's maximum is none of
    # them, so it is repetition 4 or 5; its mean then leaves the other one.
    three = np.array(
        [
            [0.059537, 0.038285, 0.109336],
            [0.057425, 0.040581, 0.110418],
            [0.058908, 0.040525, 0.101327],
        ]
    )
    printed_max = np.array([0.065202, 0.043992, 0.116320])
    printed_mean = np.array([0.059866, 0.040622, 0.108808])
    printed_sigma = np.array([0.003078, 0.002096, 0.005477])
    five = np.vstack([three, printed_max, 5 * printed_mean - three.sum(axis=0) - printed_max])
    motion = seed_statistics(("circle", worst(*row)) for row in five.tolist())["circle"]
    assert motion.repetitions == 5
    for ours, printed in (
        (motion.e_max, printed_max),
        (motion.e_sr, printed_mean),
        (motion.sigma, printed_sigma),
    ):
        assert ours is not None
        np.testing.assert_allclose([ours.x, ours.y, ours.theta], printed, atol=1e-5)


def test_total_is_the_sum_over_motions_of_the_mean_over_repetitions() -> None:
    # a: (1 + 3)/2 = 2, b: 10 in x; sums 12, 2·1 = 2 in y, 0.5 in theta.
    rows = [("a", worst(1, 1, 0.5)), ("b", worst(10, 1, 0)), ("a", worst(3, 1, 0.5))]
    assert totals(rows).to_json() == {"x": 12.0, "y": 2.0, "theta": 0.5, "sum": 14.5}
    assert list(seed_statistics(rows)) == ["a", "b"]
    assert seed_statistics(rows)["b"].sigma is None


def test_total_is_the_mean_over_drives_unless_all_have_a_label() -> None:
    rows = [("a", worst(1, 0, 0)), (None, worst(2, 0, 0)), ("b", worst(6, 3, 0))]
    assert totals(rows).to_json() == {"x": 3.0, "y": 1.0, "theta": 0.0, "sum": 4.0}
    assert set(seed_statistics(rows)) == {"a", "b"}


def test_no_drives_have_no_total() -> None:
    with pytest.raises(FglocError, match="no drive was evaluated"):
        totals([])
