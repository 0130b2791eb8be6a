"""Advice on what to drive, by cases whose answer is known."""

from __future__ import annotations

import numpy as np

from fgloc.calibration.advice import advice
from fgloc.core import bases
from fgloc.core.kinematics import WheeledBase, prior_covariance
from fgloc.core.robot import Robot
from fgloc.estimator import CalibrationEstimate, calibration_of


def nothing_known(base: WheeledBase) -> tuple[tuple[CalibrationEstimate, ...], np.ndarray]:
    """Return estimates and covariance of a base before anything was driven."""
    free = [p for p in base.parameters if p.prior_sigma > 0.0]
    estimates, covariance = calibration_of(free, np.zeros(len(free)), prior_covariance(free))
    assert covariance is not None
    return estimates, covariance


def told(base: WheeledBase, *, places: bool) -> str:
    """Return all advice on a base of which nothing is known, as one text."""
    estimates, covariance = nothing_known(base)
    return " ".join(advice(Robot("r", base), estimates, covariance, places=places))


def test_radii_show_on_straight_lines_the_track_on_spins() -> None:
    text = told(bases.differential(0.1, 0.1, 0.5), places=True)
    assert "wheel_radius.left and wheel_radius.right are not observed: drive 5 m straight." in text
    assert "effective_track is not observed: drive spins in both directions." in text


def test_a_gyro_alone_tells_no_distances() -> None:
    # Of three radii-and-track directions a heading tells the ratios: never the common scale.
    text = told(bases.differential(0.1, 0.1, 0.5), places=False)
    assert "this reference tells no distances" in text
    assert "wheel_radius.left" in text.partition("this reference")[0]
    skid = told(bases.skid_steer(("l",), ("r",), 0.1, 0.5), places=False)
    assert "effective_track is not observed: drive spins in both directions." in skid


def test_a_tricycle_cannot_spin() -> None:
    text = told(bases.tricycle(0.05, 0.3), places=True)
    assert "spins" not in text
    assert "wheel_x.front is not observed: drive circles of 1 m radius" in text


def test_what_is_observed_needs_no_advice() -> None:
    base = bases.differential(0.1, 0.1, 0.5)
    estimates, covariance = nothing_known(base)
    free = [p for p in base.parameters if p.prior_sigma > 0.0]
    known, small = calibration_of(free, np.zeros(3), 0.01 * prior_covariance(free))
    assert small is not None
    assert advice(Robot("r", base), known, small, places=True) == ()
    assert estimates[0].sigma > known[0].sigma
    assert covariance.shape == small.shape


def test_a_steered_and_a_linear_base_are_tried_out_too() -> None:
    swerve = bases.four_wheel_steer(
        ("a", "b", "c", "d"), [(0.1, 0.1), (-0.1, 0.1), (-0.1, -0.1), (0.1, -0.1)], [0.03] * 4
    )
    assert "wheel_radius" in told(swerve, places=True)
    omni = bases.full_linear(bases.omni3([0.05] * 3, 0.2, [-1.0, 1.0, 3.1]))
    assert "drive" in told(omni, places=True)
