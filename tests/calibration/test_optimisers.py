"""The published calibration problem and its optimisers, on a slice of the recorded drives."""

from __future__ import annotations

import os
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from fgloc.calibration.optimisers.genetic import genetic
from fgloc.calibration.optimisers.interior_point import interior_point
from fgloc.calibration.optimisers.least_squares import bounded_least_squares
from fgloc.calibration.optimisers.swerve_problem import (
    PARAMETERS,
    SwerveProblem,
    SwerveRun,
    seed_path,
    swerve_problem,
)
from fgloc.datasets.registry import load_drive
from fgloc.errors import FglocError
from fgloc.experiments.seed_d.calibration_tables import total_error

DATA = Path(os.environ.get("FGLOC_DATA", "/nowhere"))
recorded = pytest.mark.skipif(
    not (DATA / "vitko-swerve").is_dir(), reason="the swerve recordings are not here"
)
SLICE = ("1", "11", "21")
"""A line, a circle, a spin."""


@lru_cache
def problem() -> SwerveProblem:
    """Return three runs, every tenth interval of them merged, so that tests are quick."""
    return swerve_problem([load_drive(f"vitko-swerve:{r}", DATA) for r in SLICE]).merged(10)


def test_the_kinematics_by_hand() -> None:
    # All wheels straight, 1 rad each of 0.1 m: 0.1 m ahead. Then the left ones (b > 0) back and
    # the right ones ahead: W = -b / (8·0.5²) = ∓0.25, four wheels: 0.1·0.25·4 = 0.1 rad.
    run = SwerveRun(
        np.array([[1.0, 1, 1, 1], [-1.0, -1, 1, 1], [1, 1, 1, 1]]),
        np.zeros((3, 4)),
        np.array([0.0, 0.0, 0.0]),
        np.zeros((3, 3)),
    )
    half = 0.5
    values = np.array([half, -half, -half, half, half, half, -half, -half, *[0.1] * 4])
    path = seed_path(run, values)
    expected = [[0, 0, 0], [0.1, 0, 0], [0.1, 0, 0.1]]
    np.testing.assert_allclose(path[:3], expected, atol=1e-15)
    # The Euler step takes the heading before it.
    np.testing.assert_allclose(path[3], [0.1 + 0.1 * np.cos(0.1), 0.1 * np.sin(0.1), 0.1])


@recorded
def test_derivatives_agree_with_finite_differences() -> None:
    p = problem()
    at = p.nominal + 0.3 * p.width * np.random.default_rng(0).uniform(-1, 1, 12)
    cost, gradient = p.gradient(at)
    assert cost == pytest.approx(p.cost(at), rel=1e-12)
    steps = 1e-7 * np.eye(12)
    numeric = [(p.cost(at + e) - p.cost(at - e)) / 2e-7 for e in steps]
    np.testing.assert_allclose(gradient, numeric, rtol=1e-4, atol=1e-6 * np.abs(gradient).max())
    # J is the sum of squares over all paths, and its gradient 2 Jᵀr, from the paths themselves.
    run = p.runs[0]
    one = replace(p, runs=(run,))
    residual = (seed_path(run, at)[1:] - run.truth).ravel()
    assert one.cost(at) == pytest.approx(float(residual @ residual), rel=1e-12)
    columns = [
        ((seed_path(run, at + e) - seed_path(run, at - e)) / 2e-7)[1:].ravel() for e in steps
    ]
    expected = 2.0 * np.array(columns) @ residual
    np.testing.assert_allclose(
        one.gradient(at)[1], expected, rtol=1e-4, atol=1e-6 * np.abs(expected).max()
    )
    # Second derivatives: four costs for each pair, with steps that rounding allows.
    wide = 1e-4 * np.eye(12)
    second = [
        [
            (p.cost(at + d + e) - p.cost(at + d - e) - p.cost(at - d + e) + p.cost(at - d - e))
            / 4e-8
            for e in wide
        ]
        for d in wide
    ]
    np.testing.assert_allclose(
        p.second_derivatives(at), second, rtol=1e-3, atol=1e-4 * np.abs(second).max()
    )


@recorded
def test_the_published_nominal_total() -> None:
    runs = [str(5 * motion + k) for motion in range(6) for k in (1, 2, 3)]
    drives = [load_drive(f"vitko-swerve:{r}", DATA) for r in runs]
    whole = swerve_problem(drives)
    # Computed independently from the 18 recordings: 1.2607.
    assert float(np.sum(total_error(whole, drives, whole.nominal))) == pytest.approx(
        1.2607, abs=5e-4
    )


@recorded
def test_least_squares_and_interior_point_agree() -> None:
    p = problem()
    one, other = bounded_least_squares(p), interior_point(p)
    assert one.cost == pytest.approx(other.cost, rel=1e-6)
    assert one.cost <= other.cost * (1.0 + 1e-6)
    assert one.cost < 0.2 * p.cost(p.nominal)
    for found in (one, other):
        assert np.all(found.parameters >= p.low)
        assert np.all(found.parameters <= p.high)
    assert p.active(one.parameters, 1e-6)
    # At a bound the gradient pushes outwards, elsewhere there is none.
    gradient = p.gradient(one.parameters)[1] * p.width
    held = {text.split()[0] for text in p.active(one.parameters, 1e-6)}
    rest = [k for k, name in enumerate(PARAMETERS) if name not in held]
    assert np.abs(gradient[rest]).max() < 2e-3 * np.abs(p.gradient(p.nominal)[1] * p.width).max()


@recorded
def test_the_genetic_algorithm_repeats_itself_and_never_gets_worse() -> None:
    p = problem()
    few = genetic(p, np.random.default_rng(3), 5)
    again = genetic(p, np.random.default_rng(3), 5)
    more = genetic(p, np.random.default_rng(3), 40)
    np.testing.assert_array_equal(few.parameters, again.parameters)
    assert more.cost <= few.cost
    assert few.evaluations == 12 + 5 * 11
    assert np.all((more.parameters >= p.low) & (more.parameters <= p.high))


@recorded
def test_the_swarm_stays_within_bounds() -> None:
    pytest.importorskip("pymoo", reason="pymoo, the extra search, is not installed")
    from fgloc.calibration.optimisers.swarm import particle_swarm

    p = problem()
    found = particle_swarm(p, 1, 5)
    assert found.cost < p.cost(p.nominal)
    assert np.all((found.parameters >= p.low) & (found.parameters <= p.high))


def test_another_robot_is_refused() -> None:
    with pytest.raises(FglocError, match="four steered wheels"):
        swerve_problem([load_drive("sim:demo")])
