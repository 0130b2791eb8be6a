"""Drives so long that dead reckoning loses its heading: the first guess decides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgloc.core.drive import Drive
from fgloc.core.measurements import Floats
from fgloc.filters.model1 import Model1
from fgloc.smoothing.batch import BatchSmoother
from fgloc.smoothing.build import build_problem
from fgloc.smoothing.minimise import minimise
from fgloc.smoothing.optimise import optimise
from fgloc.smoothing.problem import Problem
from fgloc.smoothing.settings import Settings

from .drives import scores, simulated


def at_truth(drive: Drive, problem: Problem) -> tuple[Floats, Floats]:
    """Return the true states and calibration of a drive whose truth has every keyframe's stamp."""
    assert drive.truth is not None
    assert drive.true_calibration is not None
    truth = drive.truth.trajectory
    at = np.searchsorted(truth.stamps_ns, problem.keyframes_ns)
    np.testing.assert_array_equal(truth.stamps_ns[at], problem.keyframes_ns)
    u = [p.to_solver(drive.true_calibration[p.name]) for p in problem.parameters]
    return truth.poses[at], np.array(u)


@pytest.mark.parametrize("motion", ["figure-eight", "random"])
def test_the_best_minimum_is_found_from_a_lost_heading(motion: str) -> None:
    drive = simulated(
        f"{motion}?seed=21&keyframes=4000&nominal_track=0.48&effective_track=0.70"
        "&fix_every=10&fix_sigma=0.05"
    )
    assert drive.truth is not None
    heading = Model1().estimate(drive).trajectory.poses[:, 2]
    lost = np.abs(heading - drive.truth.trajectory.poses[:, 2]).max()
    assert lost > 2.0, "dead reckoning must have lost its heading by radians"

    settings = Settings(covariances=False)
    problem = build_problem(drive, settings)
    assert problem.states.shape[0] == 4001
    found = optimise(problem, settings)
    assert found.converged
    states, u = at_truth(drive, problem)
    best, _, _ = minimise(problem, settings, states, u, False)
    best, _, converged = minimise(problem, settings, best.states, best.u, True)
    assert converged
    assert found.point.cost == pytest.approx(best.cost, rel=1e-3)
    np.testing.assert_allclose(found.point.states, best.states, atol=0.02)
    np.testing.assert_allclose(found.point.u, best.u, atol=1e-3)


def test_the_first_guess_does_not_matter_where_there_is_one_minimum() -> None:
    drive = simulated("figure-eight?robot=differential&seed=22&duration=40&fix_every=4")
    settings = Settings(covariances=False)
    problem = build_problem(drive, settings)
    rng = np.random.default_rng(1)
    elsewhere = problem.states + np.array([0.5, 0.5, 0.1]) * rng.normal(size=(1, 3))
    one = optimise(problem, settings)
    two = optimise(replace(problem, states=elsewhere), settings)
    np.testing.assert_allclose(one.point.states, two.point.states, atol=1e-3)


@pytest.mark.parametrize("sensor", ["yaw=on", "gyro=on"])
def test_a_heading_that_drifts_by_turns_is_followed_by_the_fixes(sensor: str) -> None:
    # Over 2500 s the yaw drifts by half a turn, the gyro's bias makes several: dead reckoning by
    # them alone ends in a neighbouring minimum, a whole turn away.
    drive = simulated(f"random?seed=1&duration=2500&rate=5&fix_every=10&{sensor}")
    result = BatchSmoother().estimate(drive)
    assert set(result.sensors_used) == {"wheels", sensor[:-3], "fixes"}
    assert not result.notes
    after = scores(result, drive)
    assert after.ate_rmse_m < 0.1
    assert after.ate_heading_rmse_deg < 1.0
