"""Gates and bounds against printed chi-square tables, scipy's distribution and drawn errors."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest
from scipy.stats import chi2

from fgloc.core.consistency import average, gate_threshold, squared_normalised
from fgloc.errors import FglocError


@pytest.mark.parametrize(
    ("probability", "dof", "printed"),
    [
        (0.95, 1, 3.841),
        (0.95, 2, 5.991),
        (0.95, 3, 7.815),
        (0.99, 3, 11.345),
        (0.999, 1, 10.828),
        (0.999, 2, 13.816),
        (0.999, 3, 16.266),
        (0.025, 10, 3.247),
        (0.975, 100, 129.561),
    ],
)
def test_gates_are_those_of_printed_tables(probability: float, dof: int, printed: float) -> None:
    assert gate_threshold(probability, dof) == pytest.approx(printed, abs=6e-4)


@pytest.mark.parametrize("dof", [1, 2, 3, 7, 300, 1500, 100_000])
def test_gates_agree_with_scipy_in_both_tails(dof: int) -> None:
    for probability in (1e-6, 0.025, 0.5, 0.975, 1 - 1e-6):
        assert gate_threshold(probability, dof) == pytest.approx(chi2.ppf(probability, dof))


@pytest.mark.parametrize(("probability", "dof"), [(0.0, 1), (1.0, 1), (math.nan, 2), (0.5, 0)])
def test_gates_that_make_no_sense(probability: float, dof: int) -> None:
    with pytest.raises(FglocError, match="a gate needs"):
        gate_threshold(probability, dof)


def test_importing_gates_does_not_import_scipy() -> None:
    code = "import sys, fgloc.core.consistency; sys.exit('scipy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_squared_normalised_by_hand() -> None:
    # inv([[4, 2], [2, 2]]) = [[0.5, -0.5], [-0.5, 1]], so (2, 1) gives 2 - 2 + 1 = 1.
    covariance = np.array([[4.0, 2.0], [2.0, 2.0]])
    assert squared_normalised(np.array([2.0, 1.0]), covariance) == pytest.approx(1.0)
    # Units do not matter: millimetres beside kilometres.
    units = np.diag([1e3, 1e-6])
    scaled = squared_normalised(units @ np.array([2.0, 1.0]), units @ covariance @ units)
    assert scaled == pytest.approx(1.0)


@pytest.mark.parametrize(
    "covariance",
    [
        np.array([[1.0, 1.0], [1.0, 1.0]]),
        np.diag([1.0, 0.0]),
        np.diag([1.0, -1.0]),
        np.diag([1.0, np.nan]),
    ],
)
def test_squared_normalised_without_a_usable_covariance(covariance: np.ndarray) -> None:
    assert math.isnan(squared_normalised(np.ones(2), covariance))


def test_bounds_of_an_average_by_the_table() -> None:
    # 50 runs of 2 components: 100 degrees, 74.22 and 129.56 in Bar-Shalom's table.
    found = average([2.0] * 50, 2)
    assert (found.value, found.dof, found.runs, found.skipped) == (2.0, 2.0, 50, 0)
    assert found.lower == pytest.approx(74.222 / 50, abs=1e-5)
    assert found.upper == pytest.approx(129.561 / 50, abs=1e-5)
    assert found.verdict == "inside"
    assert average([2.6] * 50, 2).verdict == "above"
    assert average([1.4] * 50, 2).verdict == "below"


def test_bounds_hold_as_often_as_they_say() -> None:
    rng = np.random.default_rng(1)
    root = rng.standard_normal((3, 3))
    covariance = root @ root.T
    inside = 0
    for _ in range(400):
        errors = rng.standard_normal((20, 3)) @ root.T
        squared = [squared_normalised(e, covariance) for e in errors]
        inside += average(squared, 3).verdict == "inside"
    # 380 expected, sigma 4.4.
    assert 363 <= inside <= 397


def test_runs_with_unlike_components_and_without_covariance() -> None:
    found = average([1.0, math.nan, 5.0], [2, 2, 4])
    assert (found.value, found.dof, found.runs, found.skipped) == (3.0, 3.0, 2, 1)
    assert found.upper == pytest.approx(chi2.ppf(0.975, 6) / 2)


def test_averages_that_cannot_be() -> None:
    with pytest.raises(FglocError, match="no run"):
        average([math.nan], 3)
    with pytest.raises(FglocError, match="degrees of freedom"):
        average([1.0, 2.0], [3])
