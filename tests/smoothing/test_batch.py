"""The batch smoother on small simulated drives whose trajectory and calibration are known."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from fgloc.core.drive import Drive, Reference
from fgloc.core.geometry import compose, rotate_covariance
from fgloc.core.measurements import PoseFixes, PositionFixes, YawRate
from fgloc.core.trajectory import Trajectory
from fgloc.estimator import Result
from fgloc.filters.model1 import Model1
from fgloc.smoothing.batch import BatchSmoother
from fgloc.smoothing.build import build_problem
from fgloc.smoothing.optimise import optimise
from fgloc.smoothing.settings import Settings

from .drives import (
    assert_recovered,
    parameters,
    scores,
    sigmas_off,
    simulated,
    with_sensor,
)

Mount = tuple[float, float, float]
ROBOTS = ("skid", "differential", "mecanum", "omni3", "tricycle", "swerve")


def smooth(drive: Drive, **settings: object) -> Result:
    return BatchSmoother(Settings(**settings)).estimate(drive)  # type: ignore[arg-type]


@pytest.mark.parametrize("robot", ROBOTS)
def test_calibration_and_track_are_recovered(robot: str) -> None:
    drive = simulated(f"figure-eight?robot={robot}&seed=5&duration=40&fix_every=4&fix_sigma=0.01")
    result = smooth(drive)
    assert result.method == "batch"
    assert result.convergence.startswith("converged")
    assert set(result.sensors_used) == {"wheels", "fixes"}
    assert_recovered(result, drive)
    after, before = scores(result, drive), scores(Model1().estimate(drive), drive)
    assert after.ate_rmse_m < 0.03
    assert after.ate_rmse_m < before.ate_rmse_m / 3
    # A drive that told nothing would prove nothing. (Of the swerve base's sixteen parameters
    # only sums are told, so each of them keeps much of its prior.)
    assert min(c.sigma / c.prior_sigma for c in result.calibration) < 0.75


def test_both_linear_solvers_give_the_same_result() -> None:
    drive = simulated(
        "figure-eight?robot=differential&seed=2&duration=30&fix_every=3&yaw=on&gyro=on&camera=on"
    )
    arrow, gtsam = smooth(drive), smooth(drive, solver="gtsam")
    # All but the last digits of the next step, which is rounding.
    assert arrow.convergence.split(":")[0] == gtsam.convergence.split(":")[0]
    np.testing.assert_allclose(arrow.trajectory.poses, gtsam.trajectory.poses, atol=1e-6)
    for ours, theirs in zip(arrow.calibration, gtsam.calibration, strict=True):
        assert ours.name == theirs.name
        assert abs(ours.value - theirs.value) < 1e-6 * max(ours.prior_sigma, 1e-3)
        assert ours.sigma == pytest.approx(theirs.sigma, rel=1e-6)


@pytest.mark.parametrize("robust", [True, False])
def test_the_convergence_report_says_why_and_what_is_left(robust: bool) -> None:
    drive = simulated("figure-eight?seed=2&duration=30&fix_every=3")
    report = smooth(drive, robust=robust).convergence
    assert report.startswith("converged after ")
    assert "the cost falls no further" in report
    left = re.search(r"the next step is (\S+) sigma at most", report)
    assert left is not None
    assert float(left[1]) < 0.01
    short = smooth(drive, robust=robust, max_iterations=1, tolerance=1e-12).convergence
    assert short.startswith("did NOT converge after ")
    assert "iteration limit" in short
    assert "next step" not in smooth(drive, robust=robust, covariances=False).convergence


def strayed(drive: Drive, share: float, distance: float) -> tuple[Drive, int]:
    """Return the drive with a share of its fixes moved by a distance [m], and how many."""
    (fixes,) = drive.each(PositionFixes)
    rng = np.random.default_rng(4)
    count = max(1, round(share * fixes.stamps_ns.size))
    # Not the first ones: they would be believed, being all there is.
    wild = rng.choice(np.arange(3, fixes.stamps_ns.size), count, replace=False)
    direction = rng.uniform(0.0, 2 * np.pi, count)
    positions = fixes.positions.copy()
    positions[wild] += distance * np.column_stack([np.cos(direction), np.sin(direction)])
    return with_sensor(drive, replace(fixes, positions=positions)), count


def test_wild_fixes_are_given_up() -> None:
    clean = simulated("figure-eight?seed=3&duration=60&fix_every=1&fix_sigma=0.02")
    drive, wild = strayed(clean, 0.05, 10.0)
    assert wild == 3
    robust, plain = smooth(drive), smooth(drive, robust=False)
    undisturbed = scores(smooth(clean), drive).ate_rmse_m
    assert scores(robust, drive).ate_rmse_m < 1.5 * undisturbed
    assert scores(plain, drive).ate_rmse_m > 5 * undisturbed
    assert_recovered(robust, drive)
    assert robust.counts["fixes"].down_weighted == wild
    assert plain.counts["fixes"].down_weighted == 0
    (residuals,) = [r for r in robust.residuals if r.sensor == "fixes"]
    far = np.hypot(*residuals.values.T) > 5.0
    assert int(far.sum()) == wild
    assert residuals.weights[far].max() < 0.1
    assert residuals.weights[~far].min() > 0.5


def test_without_truth_the_map_is_where_the_fixes_are() -> None:
    known = simulated("figure-eight?seed=6&duration=40&fix_every=2&fix_sigma=0.02")
    assert known.truth is not None
    # Elsewhere and turned: nothing about the map may be assumed.
    moved = np.array([120.0, -45.0, 2.5])
    (fixes,) = known.each(PositionFixes)
    there = compose(moved, np.column_stack([fixes.positions, np.zeros(fixes.stamps_ns.size)]))
    drive = replace(
        with_sensor(known, replace(fixes, positions=there[:, :2])),
        truth=None,
    )
    result = smooth(drive)
    assert any("aligning dead reckoning to the fixes" in note for note in result.notes)
    truth = known.truth.trajectory
    reference = replace(
        known.truth, trajectory=Trajectory(truth.stamps_ns, compose(moved, truth.poses))
    )
    found = scores(result, replace(known, truth=reference))
    assert found.ate_rmse_m < 0.05
    assert found.ate_heading_rmse_deg < 2.0
    assert_recovered(result, known)


@pytest.mark.parametrize("robot", ROBOTS)
def test_wheels_alone_are_model_1_and_tell_nothing(robot: str) -> None:
    drive = simulated(f"random?robot={robot}&seed=2&duration=30")
    result, model1 = smooth(drive), Model1().estimate(drive)
    at = np.searchsorted(model1.trajectory.stamps_ns, result.trajectory.stamps_ns)
    np.testing.assert_array_equal(model1.trajectory.stamps_ns[at], result.trajectory.stamps_ns)
    np.testing.assert_allclose(result.trajectory.poses, model1.trajectory.poses[at], atol=1e-6)
    assert result.sensors_used == ("wheels",)
    for c in result.calibration:
        assert not c.observed
        assert c.value == pytest.approx(c.nominal, abs=1e-6 * c.prior_sigma)
        assert c.sigma == pytest.approx(c.prior_sigma, rel=1e-3)


def test_without_truth_or_fixes_the_map_begins_at_the_robot() -> None:
    drive = replace(simulated("random?seed=2&duration=10"), truth=None)
    result = smooth(drive)
    np.testing.assert_allclose(result.trajectory.poses[0], 0.0, atol=1e-9)
    assert result.trajectory.covariances is not None
    sigma = np.sqrt(np.diagonal(result.trajectory.covariances, axis1=1, axis2=2))
    assert sigma[0].max() < 1e-3
    assert (sigma[-1] > 10 * sigma[0]).all()


def test_a_drifting_yaw_sensor_still_gives_the_heading() -> None:
    # 0.01 rad in 7 s is 0.17 rad in two minutes; its zero is 0.8 rad off from the map.
    drive = simulated(
        "figure-eight?seed=7&duration=120&fix_every=10&fix_sigma=0.02&yaw=on&yaw_zero=0.8"
    )
    blind = replace(drive, sensors=drive.each(PositionFixes))
    with_yaw, without = scores(smooth(drive), drive), scores(smooth(blind), drive)
    assert with_yaw.ate_heading_rmse_deg < 0.7 * without.ate_heading_rmse_deg
    assert with_yaw.ate_rmse_m < without.ate_rmse_m
    assert_recovered(smooth(drive), drive)


def test_a_constant_zero_of_yaw_is_calibrated() -> None:
    drive = simulated(
        "figure-eight?seed=8&duration=30&fix_every=3&yaw=on&yaw_zero=-2.0&yaw_drift=0&yaw_walk=0"
    )
    zero = parameters(smooth(drive))["yaw_zero"]
    assert zero.value == pytest.approx(-2.0, abs=4 * zero.sigma)
    assert zero.sigma < 0.01
    assert zero.observed


@pytest.mark.parametrize("walk", [0.0, 1e-4])
def test_the_bias_of_a_gyro_is_estimated(walk: float) -> None:
    drive = simulated(
        f"figure-eight?seed=9&duration=60&fix_every=5&fix_sigma=0.02&gyro=on&gyro_bias_walk={walk}"
    )
    (gyro,) = drive.each(YawRate)
    biased = with_sensor(drive, replace(gyro, rate=gyro.rate + 0.04, bias_sigma=0.05))
    assert drive.truth is not None
    result = smooth(biased)
    # 0.04 rad/s would be 2.4 rad after a minute.
    assert scores(result, drive).ate_heading_rmse_deg < 1.0
    assert_recovered(result, drive)
    if walk == 0.0:
        heading = drive.truth.trajectory.poses[:, 2]
        seconds = np.diff(gyro.stamps_ns) * 1e-9
        counted = float(np.sum(0.5 * (gyro.rate[1:] + gyro.rate[:-1]) * seconds))
        mean = (counted - (heading[-1] - heading[0])) / float(seconds.sum()) + 0.04
        bias = parameters(result)["gyro_bias"]
        # White noise of the mean: density / sqrt(60 s) = 6.5e-5 rad/s.
        assert bias.value == pytest.approx(mean, abs=4 * np.hypot(bias.sigma, 6.5e-5))
        assert bias.observed
        assert bias.unit == "rad/s"


def test_mount_and_scale_of_a_camera_are_calibrated() -> None:
    drive = simulated(
        "figure-eight?robot=differential&seed=10&duration=60&fix_every=5&fix_sigma=0.01"
        "&camera=on&camera_mount_sigma=0.05&camera_yaw_sigma=0.1&camera_scale_sigma=0.05"
    )
    assert drive.true_calibration is not None
    result = smooth(drive)
    assert_recovered(result, drive)
    found = parameters(result)
    for name in ("camera_x", "camera_y", "camera_yaw", "camera_scale"):
        assert found[name].observed, name
    # The drawn mount is far from the nominal one, so that the nominal would have failed.
    away = sigmas_off(result, {n: found[n].nominal for n in ("camera_yaw", "camera_scale")})
    assert max(away.values()) > 4.0
    assert scores(result, drive).ate_rmse_m < 0.02


def pose_fixes(drive: Drive, true_mount: Mount, period: int) -> PoseFixes:
    """Return noisy fixes of a body on the robot, made from every `period`-th pose of the truth."""
    assert drive.truth is not None
    rng = np.random.default_rng(12)
    truth = drive.truth.trajectory
    sigma = np.array([0.01, 0.01, 0.01])
    poses = compose(truth.poses[period::period], np.array(true_mount))
    poses = poses + sigma * rng.normal(size=poses.shape)
    stamps = truth.stamps_ns[period::period]
    return PoseFixes("mocap", stamps, poses, np.tile(sigma, (poses.shape[0], 1)))


def test_pose_fixes_with_a_known_mount() -> None:
    drive = simulated("figure-eight?seed=11&duration=40")
    mount = (0.3, -0.1, 0.4)
    result = smooth(with_sensor(drive, replace(pose_fixes(drive, mount, 20), mount=mount)))
    assert_recovered(result, drive)
    assert scores(result, drive).ate_rmse_m < 0.02
    assert not any(c.name.startswith("mocap") for c in result.calibration)


def test_pose_fixes_with_an_unknown_mount() -> None:
    drive = simulated("figure-eight?seed=11&duration=40")
    true, guess = (0.3, -0.1, 0.4), (0.25, -0.05, 0.2)
    fixes = replace(pose_fixes(drive, true, 20), mount=guess, mount_sigma=(0.1, 0.1, 0.3))
    result = smooth(with_sensor(drive, fixes))
    assert_recovered(result, drive)
    names = ("mocap_x", "mocap_y", "mocap_yaw")
    for name, off in sigmas_off(result, dict(zip(names, true, strict=True))).items():
        assert off < 4.0, name
        assert parameters(result)[name].observed
    assert scores(result, drive).ate_rmse_m < 0.03


def test_the_lever_arm_of_an_antenna_is_calibrated() -> None:
    drive = simulated(
        "figure-eight?seed=12&duration=60&fix_every=1&fix_sigma=0.01&fix_x=0.2&fix_mount_sigma=0.1"
    )
    assert drive.true_calibration is not None
    assert max(abs(drive.true_calibration[n]) for n in ("fixes_x", "fixes_y")) > 0.05
    result = smooth(drive)
    assert_recovered(result, drive)
    assert parameters(result)["fixes_x"].observed
    assert parameters(result)["fixes_y"].observed
    assert scores(result, drive).ate_rmse_m < 0.02


def test_the_start_is_mapped_through_an_unknown_reference_mount() -> None:
    # The marker body sits elsewhere than its nominal place; truth and fixes are both its.
    drive = simulated("figure-eight?seed=13&duration=40")
    assert drive.truth is not None
    base, true = drive.truth.trajectory, (0.12, -0.07, 0.25)
    body = Trajectory(base.stamps_ns, compose(base.poses, np.array(true)))
    sigma = (0.15, 0.15, 0.3)
    reference = Reference(body, "marker", (1e-3, 1e-3, 2e-3), (0.0, 0.0, 0.0), sigma)
    fixes = replace(pose_fixes(drive, true, 15), mount_sigma=sigma, mount_name="marker")
    result = smooth(with_sensor(replace(drive, truth=reference), fixes))
    assert_recovered(result, drive)
    names = ("marker_x", "marker_y", "marker_yaw")
    truth = dict(zip(names, true, strict=True))
    assert max(sigmas_off(result, truth).values()) < 4.0
    assert [c.name for c in result.calibration if c.name.startswith("m")] == list(names)
    # The nominal start is 0.14 m and 0.25 rad off; poses are those of the base all the same.
    assert scores(result, drive).ate_rmse_m < 0.03
    assert np.hypot(*(result.trajectory.poses[0] - base.poses[0])[:2]) < 0.03


@pytest.mark.parametrize("motion", ["square", "random", "figure-eight"])
def test_a_track_wrong_by_45_percent_converges(motion: str) -> None:
    drive = simulated(
        f"{motion}?seed=14&duration=120&nominal_track=0.48&effective_track=0.696"
        "&fix_every=10&fix_sigma=0.02"
    )
    nominal = scores(Model1().estimate(drive), drive)
    assert nominal.ate_rmse_m > 1.0, "the nominal track must be badly wrong to start with"
    result = smooth(drive)
    assert result.convergence.startswith("converged")
    assert_recovered(result, drive)
    assert parameters(result)["effective_track"].value == pytest.approx(0.696, rel=0.05)
    assert scores(result, drive).ate_rmse_m < 0.2


def test_keyframes_stand_at_the_fixes_and_nothing_is_lost() -> None:
    # Fixes every 0.37 s fall between wheel packets; dropped packets make long intervals.
    drive = simulated(
        "random?robot=differential&seed=15&duration=30&fix_every=0.37&encoder_dropout=0.3"
    )
    (fixes,) = drive.each(PositionFixes)
    result = smooth(drive)
    assert np.isin(fixes.stamps_ns, result.trajectory.stamps_ns).all()
    assert result.counts["fixes"].accepted + result.counts["fixes"].down_weighted == len(
        fixes.stamps_ns
    )
    assert_recovered(result, drive)


def test_fixes_outside_the_drive_are_counted_and_harmless() -> None:
    drive = simulated("figure-eight?seed=16&duration=30&fix_every=5")
    (fixes,) = drive.each(PositionFixes)
    late = fixes.stamps_ns[-1] + np.array([10**10, 2 * 10**10])
    more = replace(
        fixes,
        stamps_ns=np.concatenate([fixes.stamps_ns, late]),
        positions=np.vstack([fixes.positions, np.full((2, 2), 1e3)]),
        sigma=np.vstack([fixes.sigma, np.full((2, 2), 0.01)]),
    )
    plain, result = smooth(drive), smooth(with_sensor(drive, more))
    assert result.counts["fixes"].rejected == 2
    np.testing.assert_allclose(result.trajectory.poses, plain.trajectory.poses, atol=1e-9)


def test_covariances_are_in_map_axes_and_shrink_at_fixes() -> None:
    drive = simulated("figure-eight?seed=17&duration=40&fix_every=8&fix_sigma=0.01")
    (fixes,) = drive.each(PositionFixes)
    result = smooth(drive)
    p = result.trajectory.covariances
    assert p is not None
    np.testing.assert_allclose(p, p.swapaxes(1, 2), atol=1e-15)
    assert np.linalg.eigvalsh(p).min() > 0.0
    at = np.searchsorted(result.trajectory.stamps_ns, fixes.stamps_ns)
    spread = np.sqrt(np.trace(p[:, :2, :2], axis1=1, axis2=2))
    assert spread[at].max() < 0.01 * np.sqrt(2)
    between = (at[1:] + at[:-1]) // 2
    assert spread[between].min() > spread[at].max()
    assert smooth(drive, covariances=False).trajectory.covariances is None


def test_poses_do_not_depend_on_where_keyframes_are() -> None:
    drive = simulated("figure-eight?robot=differential&seed=18&duration=30&fix_every=5")
    fine, coarse = smooth(drive, keyframe_period_s=0.05), smooth(drive, keyframe_period_s=0.5)
    assert len(fine.trajectory) > 5 * len(coarse.trajectory)
    at = np.searchsorted(fine.trajectory.stamps_ns, coarse.trajectory.stamps_ns)
    apart = fine.trajectory.poses[at] - coarse.trajectory.poses
    assert np.abs(apart).max() < 5e-3
    for a, b in zip(fine.calibration, coarse.calibration, strict=True):
        assert abs(a.value - b.value) < 0.3 * a.sigma
        assert a.sigma == pytest.approx(b.sigma, rel=0.1)


# Consistency: errors must be as large as the covariances say, no larger and no smaller.

CONSISTENT = {
    "skid, fixes": "figure-eight?duration=30&fix_every=5&fix_sigma=0.02",
    "differential, fixes": "square?robot=differential&duration=30&fix_every=5&fix_sigma=0.02",
    "skid, fixes and yaw": (
        "figure-eight?duration=30&fix_every=5&fix_sigma=0.02"
        "&yaw=on&yaw_drift=0&yaw_resolution=0&yaw_rate=10"
    ),
    "tricycle, fixes and gyro": (
        "figure-eight?robot=tricycle&duration=30&fix_every=5&fix_sigma=0.02&gyro=on"
    ),
}


@pytest.mark.parametrize("query", CONSISTENT.values(), ids=CONSISTENT.keys())
def test_errors_are_as_large_as_the_covariance_says(query: str) -> None:
    # Drives without slip whose true calibration is drawn from its prior. The sum of n NEES of
    # k degrees of freedom is chi-square with n·k; its 95 % interval bounds the average.
    seeds = range(1, 61)
    pose, calibration, names = [], [], 0
    settings = Settings()
    for seed in seeds:
        drive = simulated(f"{query}&seed={seed}")
        assert drive.truth is not None
        assert drive.true_calibration is not None
        problem = build_problem(drive, settings)
        solution = optimise(problem, settings)
        assert solution.converged
        assert solution.covariance is not None
        assert solution.calibration_covariance is not None
        state, truth = solution.point.states[-1, :3], drive.truth.trajectory
        assert truth.stamps_ns[-1] == problem.keyframes_ns[-1]
        error = state - truth.poses[-1]
        covariance = rotate_covariance(solution.covariance[-1, :3, :3], state[2])
        pose.append(error @ np.linalg.solve(covariance, error))
        at = [k for k, p in enumerate(problem.parameters) if p.name in drive.true_calibration]
        true = [
            problem.parameters[k].to_solver(drive.true_calibration[problem.parameters[k].name])
            for k in at
        ]
        off = solution.point.u[at] - true
        covariance = solution.calibration_covariance[np.ix_(at, at)]
        calibration.append(off @ np.linalg.solve(covariance, off))
        names = len(at)
    for average, freedom in ((np.mean(pose), 3), (np.mean(calibration), names)):
        low, high = chi2.ppf([0.025, 0.975], freedom * len(seeds)) / len(seeds)
        assert low < average < high, (average, low, high)


@pytest.mark.parametrize("robot", ["skid", "differential", "tricycle"])
def test_an_hour_of_wheels_alone_tells_nothing_either(robot: str) -> None:
    # Start known to 0.1 mm, end lost by kilometres: sums of squares have no digits left for the
    # calibration's prior between them, so the elimination must work on the rows themselves.
    result = smooth(simulated(f"random?robot={robot}&seed=2&duration=3000"))
    for c in result.calibration:
        assert c.sigma == pytest.approx(c.prior_sigma, rel=1e-3)
        assert not c.observed


@pytest.mark.parametrize("walk", ["&yaw_walk=0", ""])
def test_a_constant_drift_of_the_yaw_is_found(walk: str) -> None:
    # The simulated IMU drifts by 0.01 rad every 7 s; estimators are told sigma 0.002 rad/s.
    drive = simulated(f"figure-eight?seed=3&duration=60&fix_every=5&fix_sigma=0.02&yaw=on{walk}")
    result = smooth(drive)
    (drift,) = (c for c in result.calibration if c.name == "yaw_drift")
    assert drift.unit == "rad/s"
    assert drift.observed
    assert abs(drift.value - 0.01 / 7.0) < 3.0 * drift.sigma
    assert drift.sigma < 3e-4
