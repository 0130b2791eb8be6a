"""The Monte-Carlo of covariances: what it simulates, what it measures, what it says."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from fgloc.core.drive import Drive
from fgloc.core.kinematics import prior_correlation
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.simulator import load_sim
from fgloc.datasets.simulator.drives import NAMED, true_values
from fgloc.datasets.simulator.robots import build
from fgloc.datasets.simulator.spec import parse
from fgloc.estimator import CalibrationEstimate, Result
from fgloc.experiments import consistency as experiment
from fgloc.experiments.consistency import (
    SCENARIOS,
    START_SIGMA,
    RunErrors,
    calibration_nees,
    consistency,
    final_pose_nees,
    last_nis,
    simulate,
    summarise,
)

PLAIN = SCENARIOS[0]


def one(seed: int = 0) -> tuple[Drive, Drive]:
    return simulate(PLAIN, seed, "random", 20.0)


def told(drive: Drive, values: dict[str, float], sigma: dict[str, float]) -> Result:
    """Return a result that states this calibration, in reverse order, and no more."""
    names = [p.name for p in drive.robot.base.parameters][::-1]
    known = tuple(CalibrationEstimate(n, 1.0, values[n], sigma[n], 1.0) for n in names)
    covariance = np.diag([sigma[n] ** 2 for n in names])
    assert drive.truth is not None
    return Result(
        "told",
        drive.name,
        drive.truth.trajectory,
        (),
        calibration=known,
        calibration_covariance=covariance,
    )


def test_the_start_is_drawn_as_it_is_told() -> None:
    off = []
    for seed in range(60):
        true, offered = one(seed)
        assert true.truth is not None
        assert offered.truth is not None
        assert offered.truth.sigma == START_SIGMA
        clean, wrong = true.truth.trajectory.poses, offered.truth.trajectory.poses
        np.testing.assert_array_equal(wrong[1:], clean[1:])
        off.append((wrong[0] - clean[0]) / START_SIGMA)
    # 180 draws: a mean square of 1 has sigma sqrt(2/180) = 0.105.
    assert np.mean(np.square(off)) == pytest.approx(1.0, abs=0.4)
    assert len({tuple(o) for o in off}) == 60


def test_the_true_calibration_is_drawn_from_the_whole_prior() -> None:
    model = build("skid")
    priors = model.robot.base.parameters
    drawn = []
    for seed in range(600):
        spec = parse(f"random?seed={seed}&calibration=prior", NAMED)
        values = true_values(model, spec)
        drawn.append(
            [
                p.to_solver(float(v)) / p.solver_sigma
                for p, v in zip(priors, values, strict=True)
                if p.prior_sigma
            ]
        )
    z = np.array(drawn)
    wanted = prior_correlation([p for p in priors if p.prior_sigma])
    assert wanted[0, 1] == pytest.approx(0.9)
    # 600 draws: variances are known to 0.058, correlations to 0.041.
    np.testing.assert_allclose(z.T @ z / 600, wanted, atol=0.2)
    # Of 1800 draws 22 lie beyond 2.5 sigma; the other way to draw has none.
    assert np.count_nonzero(np.abs(z) > 2.5) >= 8


@pytest.mark.parametrize("scenario", SCENARIOS[::2], ids=lambda s: s.base)
def test_simulated_wheels_slip_as_the_estimator_is_told(scenario: experiment.Scenario) -> None:
    from fgloc.core.geometry import between
    from fgloc.core.preintegration import preintegrate, split_at

    squared, intervals = np.zeros(3), 0
    for seed in range(6):
        drive = load_sim(
            f"random?robot={scenario.base}&seed={seed}&duration=200&encoder_ticks=0"
            "&yaw=off&truth_rate=1"
        )
        assert drive.truth is not None
        truth = drive.truth.trajectory
        values = np.array(
            [(drive.true_calibration or {})[p.name] for p in drive.robot.base.parameters]
        )
        pre = preintegrate(split_at(drive.wheels, truth.stamps_ns), drive.robot, values)
        moved = between(truth.poses[:-1], truth.poses[1:])
        off = moved - pre.displacement
        off[:, 2] = (off[:, 2] + np.pi) % (2 * np.pi) - np.pi
        white = np.linalg.solve(np.linalg.cholesky(pre.covariance), off[:, :, None])[:, :, 0]
        squared += np.sum(white**2, axis=0)
        intervals += white.shape[0]
    # 1200 intervals: a variance of 1 is known to 0.041, and knots of the slip leave 5 % out.
    np.testing.assert_allclose(squared / intervals, 1.0, atol=0.17)


def test_calibration_nees_by_hand() -> None:
    drive, _ = one()
    truth = dict(drive.true_calibration or {})
    # Each logarithm one sigma of 1 % off, whatever the parameter's size: three squares of one.
    off = {n: v * math.exp(0.01) for n, v in truth.items()}
    result = told(drive, off, {n: 0.01 * v for n, v in off.items()})
    assert calibration_nees(result, drive) == (pytest.approx(3.0), 3)
    # A correlation that explains the common part makes the same error likelier.
    assert result.calibration_covariance is not None
    joint = result.calibration_covariance.copy()
    root = np.sqrt(np.diag(joint))
    joint = np.outer(root, root) * (0.5 + 0.5 * np.eye(3))
    squared, _ = calibration_nees(replace(result, calibration_covariance=joint), drive)
    # inv(1/2 + 1/2 I) sums up to 3 / (1 + 2/2).
    assert squared == pytest.approx(1.5)


def test_a_method_without_covariance_says_nothing() -> None:
    drive, _ = one()
    truth = dict(drive.true_calibration or {})
    result = replace(told(drive, truth, truth), calibration_covariance=None)
    squared, dof = calibration_nees(result, drive)
    assert math.isnan(squared)
    assert dof == 0
    assert math.isnan(final_pose_nees(result, drive))
    row = summarise("told", PLAIN, [RunErrors(math.nan, math.nan, 0, math.nan)] * 3)
    assert (row.pose, row.calibration, row.nis) == (None, None, None)


def test_final_pose_nees_by_hand() -> None:
    drive, _ = one()
    assert drive.truth is not None
    truth = drive.truth.trajectory
    poses = truth.poses + np.array([0.1, -0.2, 0.03])
    covariances = np.tile(np.diag([0.1, 0.1, 0.03]) ** 2, (len(truth), 1, 1))
    result = Result("told", drive.name, Trajectory(truth.stamps_ns, poses, covariances), ())
    assert final_pose_nees(result, drive) == pytest.approx(1.0 + 4.0 + 1.0)


class _Told:
    """An estimator that knows the truth, up to an offset and a sigma of 0.12 m."""

    method = "told"

    def __init__(self) -> None:
        self.offered: list[Drive] = []

    def estimate(self, drive: Drive) -> Result:
        self.offered.append(drive)
        assert drive.truth is not None
        truth = drive.truth.trajectory
        poses = truth.poses + np.array([0.13, 0.0, 0.0])
        covariances = np.tile(np.diag([0.12, 0.12, 0.01]) ** 2, (len(truth), 1, 1))
        return Result("told", drive.name, Trajectory(truth.stamps_ns, poses, covariances), ())


def test_nis_is_that_of_a_fix_the_method_has_not_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    teller = _Told()
    monkeypatch.setattr(experiment, "create", lambda _: teller)
    drive, _ = one()
    assert drive.truth is not None
    (fixes,) = (s for s in drive.sensors if s.sensor == "fixes")
    last = drive.truth.trajectory.poses[
        np.searchsorted(drive.truth.trajectory.stamps_ns, fixes.stamps_ns[-1])
    ]
    exact = fixes.positions.copy()
    exact[-1] = last[:2]
    drive = replace(drive, sensors=(replace(fixes, positions=exact),))
    # 0.13 m off, and 0.12² + 0.05² = 0.13².
    assert last_nis("told", drive) == pytest.approx(1.0)
    (seen,) = teller.offered
    assert seen.sensors[0].stamps_ns.tolist() == fixes.stamps_ns[:-1].tolist()


def test_batch_is_consistent_in_a_few_drives() -> None:
    (row,) = consistency(["batch"], range(10), duration_s=40.0, scenarios=[PLAIN])
    # Ten drives give wide bounds, but twice too small a sigma would be four times the average.
    for found in (row.pose, row.calibration, row.nis):
        assert found is not None
        assert found.runs == 10
        assert found.verdict == "inside"


def test_the_command_prints_a_verdict(capsys: pytest.CaptureFixture[str]) -> None:
    assert experiment.main(["--methods", "nothing"]) == 1
    assert "unknown method" in capsys.readouterr().err
    experiment.main(["--seeds", "2", "--methods", "model1", "--duration", "12"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("random, 12 s, 2 seeds")
    assert sum(line.startswith("model1") for line in lines) == len(SCENARIOS)
