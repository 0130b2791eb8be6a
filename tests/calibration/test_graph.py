"""One graph of many drives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgloc.calibration.calibrate import CalibrationSettings, calibrate
from fgloc.calibration.graph import fit_graph
from fgloc.core.drive import Drive
from fgloc.core.kinematics import prior_covariance
from fgloc.core.measurements import CameraPoses
from fgloc.datasets.registry import load_drive
from fgloc.errors import FglocError
from fgloc.smoothing.batch import BatchSmoother
from fgloc.smoothing.minimise import minimise
from fgloc.smoothing.settings import Settings
from fgloc.smoothing.trust import solve_with_trust

QUADRATIC = Settings(robust=False, slip=None)


def simulated(seed: int, options: str = "gyro=on&yaw=off&camera=off&slip=off") -> Drive:
    """Return half a minute of a simulated drive, without its truth."""
    drive = load_drive(f"cut:sim:random?seed={seed}&{options}?end=40")
    return replace(drive, truth=None)


def test_one_drive_jointly_is_that_drive() -> None:
    drive = simulated(1)
    alone = {p.name: p for p in BatchSmoother().estimate(drive).calibration}
    joint = fit_graph([drive])
    assert joint.converged
    for k, p in enumerate(joint.parameters):
        # Batch takes away the bias of rounded counts, a tenth of a sigma here; the graph does not.
        assert p.to_value(float(joint.u[k])) == pytest.approx(alone[p.name].value, rel=3e-3)
        sigma = float(np.sqrt(joint.covariance[k, k])) * p.derivative(float(joint.u[k]))
        assert sigma == pytest.approx(alone[p.name].sigma, rel=0.01)


def test_the_same_drive_twice_counts_twice_and_the_prior_once() -> None:
    drive = simulated(2)
    once, twice = fit_graph([drive], QUADRATIC), fit_graph([drive, drive], QUADRATIC)
    prior = np.linalg.inv(prior_covariance(once.parameters))
    gained = np.linalg.inv(once.covariance) - prior
    doubled = np.linalg.inv(twice.covariance) - prior
    scale = np.abs(gained).max()
    # Not quite: with twice the weight the calibration is elsewhere, and so is its linearisation.
    np.testing.assert_allclose(doubled / scale, 2.0 * gained / scale, atol=0.02)


def test_order_does_not_matter() -> None:
    drives = [simulated(k) for k in (3, 4, 5)]
    one, other = fit_graph(drives), fit_graph(drives[::-1])
    sigma = np.sqrt(np.diag(one.covariance))
    np.testing.assert_allclose(one.u / sigma, other.u / sigma, atol=0.02)


def test_sigmas_are_honest_against_what_is_simulated() -> None:
    squares = []
    for seed in range(10, 18):
        drive = load_drive(f"cut:sim:random?seed={seed}&gyro=on&yaw=off&camera=on&slip=off?end=60")
        assert drive.true_calibration is not None
        fit = fit_graph([replace(drive, truth=None)])
        for k, p in enumerate(fit.parameters):
            if p.name in ("effective_track", "wheel_radius.left"):
                off = p.to_value(float(fit.u[k])) - drive.true_calibration[p.name]
                sigma = np.sqrt(fit.covariance[k, k]) * p.derivative(float(fit.u[k]))
                squares.append(float((off / sigma) ** 2))
    # 16 squares of unit normals, the radii's correlated: their mean is within 0.2 and 2.5.
    assert 0.2 < float(np.mean(squares)) < 2.5


def test_three_drives_know_the_track_better_than_one() -> None:
    drives = [simulated(k) for k in (6, 6, 6)]
    report = calibrate(drives, (), CalibrationSettings("sensors"))
    single = calibrate(drives[:1], (), CalibrationSettings("sensors"))
    assert report.reference == "gyro"
    track, alone = (
        next(p for p in r.parameters if p.name == "effective_track") for r in (report, single)
    )
    assert track.sigma < alone.sigma
    assert {r.sensor for r in report.residuals} == {"wheels", "gyro"}


def test_a_drive_with_nothing_but_two_wheels_is_refused() -> None:
    drive = load_drive("sim:random?seed=1&gyro=off&yaw=off&camera=off")
    left = ("fl", "fr")
    keep = [drive.wheels.wheels.index(n) for n in left]
    from fgloc.core.bases import skid_steer

    base = skid_steer(("fl",), ("fr",), 0.135, 0.62)
    wheels = replace(
        drive.wheels,
        wheels=base.driven_names,
        angles=np.ascontiguousarray(drive.wheels.angles[:, keep]),
    )
    bare = Drive("bare", replace(drive.robot, base=base), wheels)
    with pytest.raises(FglocError, match="nothing to compare its wheels with"):
        calibrate([bare])


def test_drives_of_different_robots_are_refused() -> None:
    from fgloc.core.bases import differential

    drive = simulated(1)
    two = differential(0.1, 0.1, 0.5)
    wheels = replace(
        drive.wheels,
        wheels=two.driven_names,
        angles=np.ascontiguousarray(drive.wheels.angles[:, :2]),
    )
    other = Drive("other", replace(drive.robot, base=two), wheels)
    with pytest.raises(FglocError, match="other is of another robot than"):
        fit_graph([drive, other])
    with pytest.raises(FglocError, match="no drive"):
        fit_graph([])


@pytest.mark.parametrize("settings", [Settings(), QUADRATIC])
def test_one_drive_jointly_is_the_minimum_of_its_own_problem(settings: Settings) -> None:
    settings = replace(settings, tolerance=1e-13)
    drive = simulated(1)
    joint = fit_graph([drive], settings)
    problem, solution, _ = solve_with_trust(drive, settings)
    # From a minimum: the wheels' noise is weighed where a search begins.
    point = solution.point
    for _ in range(4):
        point, _, _ = minimise(problem, settings, point.states, point.u, settings.robust)
    names = [p.name for p in problem.parameters]
    alone = point.u[[names.index(p.name) for p in joint.parameters]]
    np.testing.assert_allclose(joint.u, alone, atol=1e-6)


@pytest.mark.parametrize("off", [2.0, 3.0, -3.1])
def test_a_mount_described_the_other_way_round_is_found_from_a_start(off: float) -> None:
    drive = simulated(3, "gyro=on&yaw=off&camera=on&slip=off")
    assert drive.true_calibration is not None
    start = {k: v for k, v in drive.true_calibration.items() if k.startswith("camera_")}
    sensors = tuple(
        replace(s, mount=(s.mount[0], s.mount[1], s.mount[2] + off), mount_sigma=(0.2, 0.2, 3.14))
        if isinstance(s, CameraPoses)
        else s
        for s in drive.sensors
    )
    fit = fit_graph([replace(drive, sensors=sensors)], start=start)
    k = [p.name for p in fit.parameters].index("camera_yaw")
    error = fit.parameters[k].to_value(float(fit.u[k])) - start["camera_yaw"]
    assert fit.converged
    assert abs(error) < 4.0 * float(np.sqrt(fit.covariance[k, k]))
