"""Calibration against truth: simulated robots whose parameters are known, recorded ones."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgloc.calibration.calibrate import CalibrationSettings, calibrate
from fgloc.calibration.closed_form import closed_form, intervals
from fgloc.calibration.models import choices, mounting, same_robot
from fgloc.calibration.path_fit import Model, fit_paths
from fgloc.calibration.paths import all_data
from fgloc.core import bases
from fgloc.core.drive import Drive, Reference
from fgloc.core.geometry import EXACT, compose, integrate
from fgloc.core.kinematics import WheeledBase
from fgloc.core.measurements import Floats, WheelIncrements
from fgloc.core.motion_models import rotation_scale
from fgloc.core.robot import Robot
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.registry import load_drive
from fgloc.errors import FglocError

DATA = Path(os.environ.get("FGLOC_DATA", "/nowhere"))
recorded = pytest.mark.skipif(not (DATA / "optiodom").is_dir(), reason="no recorded drives here")
NOMINAL = bases.differential(0.1, 0.1, 0.5)
TRUE = {"wheel_radius.left": 0.101, "wheel_radius.right": 0.1005, "effective_track": 0.52}


def drive_of(
    true: WheeledBase,
    nominal: WheeledBase,
    seed: int,
    *,
    noise: float = 1e-3,
    late_s: float = 0.0,
    spin: bool = False,
) -> Drive:
    """Return a drive of a robot that is not as described: 60 s at 20 Hz, truth at 10 Hz.

    Wheels have noise that accumulates as their way grows, the truth's stamps are early by `late_s`.
    """
    rng = np.random.default_rng(seed)
    count, columns = 1200, len(true.driven)
    knots = rng.uniform(-0.1 if spin else 0.05, 0.35, (15, columns))
    if spin:
        knots[:, 0] = -knots[:, -1]
    at = np.linspace(0, 14, count)
    turned = np.stack([np.interp(at, np.arange(15), knots[:, c]) for c in range(columns)], axis=1)
    poses = integrate(true.displacements(turned), np.array([0.0, 0.0, 0.4]), EXACT)
    told = turned + noise * np.sqrt(np.abs(turned)) * rng.normal(size=turned.shape)
    stamps = 50_000_000 * np.arange(count + 1, dtype=np.int64)
    mocap = Trajectory(stamps[::2] - round(late_s * 1e9), compose(poses[::2], np.zeros(3)))
    wheels = WheelIncrements("wheels", stamps, told, nominal.driven_names)
    truth = Reference(mocap, "mocap")
    return Drive(f"seed {seed}", Robot("r", nominal), wheels, truth=truth)


def drives(count: int, base: WheeledBase = NOMINAL, first: int = 0) -> list[Drive]:
    """Return drives of the robot with `TRUE` values."""
    return [drive_of(base.with_values(TRUE), base, first + k) for k in range(count)]


def test_true_values_are_found_within_their_sigmas() -> None:
    report = calibrate(drives(6), drives(2, first=100), CalibrationSettings(model="geometry"))
    found = {p.name: p for p in report.parameters}
    for name, value in TRUE.items():
        assert found[name].observed
        assert abs(found[name].value - value) < 4.0 * found[name].sigma, name
        assert found[name].sigma < 0.01 * value
    for e in report.evaluation:
        assert e.value.ate_rmse_m < 0.1 * e.nominal.ate_rmse_m
    assert report.total_value is not None
    assert report.total_nominal is not None
    assert report.total_value.sum < 0.1 * report.total_nominal.sum


def test_sigmas_are_honest_over_many_robots() -> None:
    squares = []
    for k in range(15):
        fit = fit_paths(all_data(drives(5, first=50 * k)), Model(Robot("r", NOMINAL)))
        off = fit.model.values(fit.u) - np.array([TRUE[p.name] for p in fit.model.parameters])
        scale = [p.derivative(float(v)) for p, v in zip(fit.model.parameters, fit.u, strict=True)]
        squares.append((off / (np.sqrt(np.diag(fit.covariance)) * scale)) ** 2)
    # 45 squared normalised errors, correlated within a robot: their mean is 1 where sigmas are
    # right. Sigmas allow for paths that are worth few independent poses, so they may be wide.
    assert 0.1 < float(np.mean(squares)) < 2.0


def test_the_fit_is_that_of_another_optimiser() -> None:
    from scipy.optimize import least_squares

    from fgloc.calibration.path_fit import EFFECTIVE, rows_of
    from fgloc.core.kinematics import prior_covariance

    data = all_data(drives(3))
    model = Model(Robot("r", NOMINAL))
    fit = fit_paths(data, model)
    root = np.linalg.inv(np.linalg.cholesky(prior_covariance(model.parameters)))

    def residual(u: Floats) -> Floats:
        parts = [
            (rows_of(d, model, u, np.zeros(0)).residual / fit.size).ravel()
            * np.sqrt(w * EFFECTIVE / d.seconds.size)
            for d, w in zip(data, fit.weights, strict=True)
        ]
        return np.concatenate([*parts, root @ u])

    other = least_squares(residual, np.zeros(3), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(fit.u, other.x, atol=1e-6)


def test_a_robot_that_spins_otherwise_chooses_the_rotation_scale() -> None:
    true = rotation_scale(NOMINAL).with_values({**TRUE, "rotation_scale": 1.04})
    fit = [drive_of(true, NOMINAL, k, spin=k % 2 == 0) for k in range(8)]
    report = calibrate(fit)
    assert "rotation-scale" in report.model
    scale = next(p for p in report.parameters if p.name == "rotation_scale")
    assert abs(scale.value - 1.04) < 4.0 * scale.sigma < 0.04
    assert sum(c.chosen for c in report.candidates) == 1


def test_a_robot_as_described_keeps_the_simple_model() -> None:
    report = calibrate([drive_of(NOMINAL.with_values(TRUE), NOMINAL, k) for k in range(6)])
    assert report.model == "geometry"
    assert not report.clocks


def test_a_common_delay_of_the_wheels_is_found() -> None:
    true = NOMINAL.with_values(TRUE)
    report = calibrate([drive_of(true, NOMINAL, k, late_s=0.12) for k in range(8)])
    late = next(p for p in report.parameters if p.name == "time_offset")
    assert abs(late.value - 0.12) < 4.0 * late.sigma < 0.12
    assert any("late against those of the reference" in n for n in report.notes)


def test_one_bad_drive_is_weighted_down() -> None:
    bad = drive_of(NOMINAL.with_values({**TRUE, "effective_track": 0.7}), NOMINAL, 99)
    report = calibrate([*drives(7), bad], (), CalibrationSettings(model="geometry"))
    weights = {r.drive: r.weight for r in report.residuals}
    assert weights["seed 99"] < 0.5
    assert all(w == 1.0 for name, w in weights.items() if name != "seed 99")


def test_the_closed_form_finds_swapped_signs_and_wrong_units() -> None:
    found = closed_form(intervals(all_data(drives(2))), Model(Robot("r", NOMINAL)))
    assert found is not None
    assert found.condition < 10.0
    assert not found.notes
    # Displacement a radian: forward r/2, turn ∓r/track; noise 1e-3 and arcs of 1 s.
    expected = [[0.0505, 0.05025], [0.0, 0.0], [-0.101 / 0.52, 0.1005 / 0.52]]
    np.testing.assert_allclose(found.jacobian, expected, atol=2e-3)
    model = Model(Robot("r", NOMINAL))
    np.testing.assert_allclose(model.values(found.u), list(TRUE.values()), rtol=0.02)
    backwards = [
        replace(d, wheels=replace(d.wheels, angles=d.wheels.angles * [-1.0, 1.0]))
        for d in drives(2)
    ]
    told = closed_form(intervals(all_data(backwards)), model)
    assert told is not None
    assert "left seems to count backwards" in " ".join(told.notes)
    double = [replace(d, wheels=replace(d.wheels, angles=d.wheels.angles / 3)) for d in drives(2)]
    told = closed_form(intervals(all_data(double)), model)
    assert told is not None
    assert "times as much as described" in " ".join(told.notes)


def test_straight_drives_tell_that_the_track_is_not_observed() -> None:
    straight = []
    for d in drives(4):
        angles = np.repeat(np.abs(d.wheels.angles[:, :1]), 2, axis=1)
        poses = integrate(NOMINAL.displacements(angles), np.zeros(3), EXACT)
        truth = Reference(Trajectory(d.wheels.stamps_ns, poses), "mocap")
        straight.append(replace(d, wheels=replace(d.wheels, angles=angles), truth=truth))
    report = calibrate(straight)
    found = {p.name: p for p in report.parameters}
    assert not found["effective_track"].observed
    assert report.condition is not None
    assert report.condition > 100.0
    assert any("hardly moved against each other" in n for n in report.notes)


def test_a_steered_base_has_no_closed_form() -> None:
    assert choices(Robot("r", bases.tricycle(0.05, 0.3)))[0].id == "geometry"


def test_models_on_offer() -> None:
    mecanum = bases.mecanum(0.05, 0.2, 0.15, ("fl", "fr", "rl", "rr"))
    ids = {c.id for c in choices(Robot("r", mecanum))}
    assert ids == {
        "geometry",
        "geometry+rotation-scale",
        "geometry+lateral-scale",
        "geometry+lateral-scale+rotation-scale",
        "full-linear",
        "full-linear+rotation-scale",
    }
    with pytest.raises(FglocError, match="unknown model"):
        calibrate(drives(1), (), CalibrationSettings(model="magic"))


def test_drives_of_two_robots_are_refused_and_two_nominals_noted() -> None:
    other = replace(drives(1)[0], robot=Robot("s", bases.differential(0.11, 0.11, 0.5)))
    found, notes = same_robot([*drives(1), other])
    assert found[1].robot == found[0].robot
    assert "state other nominal values" in notes[0]
    skid = replace(drives(1)[0], robot=Robot("s", bases.skid_steer(("left",), ("right",), 0.1, 1)))
    with pytest.raises(FglocError, match="of another robot"):
        calibrate([*drives(1), skid])


def test_a_mounting_known_exactly_is_still_free() -> None:
    truth = drives(1)[0].truth
    assert truth is not None
    assert [p.name for p in mounting([truth])] == ["mocap_x", "mocap_y", "mocap_yaw"]
    wide = replace(truth, mount_sigma=(0.2, 0.0, 0.1))
    assert [p.prior_sigma for p in mounting([wide])] == [0.2, 0.1]


@recorded
def test_a_recorded_robot_calibrated_on_squares_drives_circles_better() -> None:
    def load(*runs: str) -> list[Drive]:
        return [load_drive(f"optiodom:diff/{run}", DATA) for run in runs]

    fit = load(*(f"square/230620202042/0{k}" for k in (1, 3, 4, 5)))
    report = calibrate(fit, load("circular/250620202251/01", "circular/250620202251/04"))
    for e in report.evaluation:
        assert e.value.ate_rmse_m < 0.8 * e.nominal.ate_rmse_m
    track = next(p for p in report.parameters if p.name == "effective_track")
    assert 0.1995 < track.value < 0.2035
