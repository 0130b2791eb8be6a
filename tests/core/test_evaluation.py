"""Errors worked out by hand, ATE and RPE against evo, NEES against the chi-square distribution."""

from __future__ import annotations

import numpy as np
import pytest
from evo.core import metrics
from evo.core.trajectory import PoseTrajectory3D
from evo.core.units import Unit
from scipy.stats import chi2

from fgloc.core.drive import Reference
from fgloc.core.evaluation import (
    aligned_positions,
    error_series,
    evaluate,
    interpolate_trajectory,
    map_mount,
)
from fgloc.core.geometry import compose
from fgloc.core.measurements import Floats, Stamps
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError

S = 1_000_000_000


def seconds(*values: float) -> Stamps:
    return np.array([round(v * S) for v in values], dtype=np.int64)


def every(step_s: float, n: int) -> Stamps:
    return np.arange(n, dtype=np.int64) * round(step_s * S)


def straight(n: int = 41, step_m: float = 0.1, step_s: float = 0.25) -> Trajectory:
    """Return a drive along x."""
    poses = np.zeros((n, 3))
    poses[:, 0] = step_m * np.arange(n)
    return Trajectory(every(step_s, n), poses)


def test_a_constant_offset_by_hand() -> None:
    # 0.3 m and 0.4 m off all the time: 0.5 m unaligned, nothing once aligned, nothing relative.
    truth = straight()
    e = evaluate(
        Trajectory(truth.stamps_ns, truth.poses + np.array([0.3, -0.4, 0])), Reference(truth)
    )
    assert e.ate_rmse_m == pytest.approx(0.5)
    assert e.end_position_m == pytest.approx(0.5)
    assert e.ate_aligned_rmse_m == pytest.approx(0.0, abs=1e-15)
    assert e.rpe_1m_rmse_m == pytest.approx(0.0, abs=1e-15)
    assert (e.e_max.x, e.e_max.y, e.e_max.theta) == pytest.approx((0.3, 0.4, 0.0))
    assert e.path_length_m == pytest.approx(4.0)
    assert e.end_percent == pytest.approx(12.5)
    assert (e.stamps_used, e.stamps_excluded, e.stamps_outside) == (41, 0, 0)
    assert e.nees is None
    assert set(e.to_json()["e_max"]) == {"x", "y", "theta"}


def test_a_scale_error_by_hand() -> None:
    # 1 % too long over 4 m: e_x is 4 cm · k/40 for k = 0..40, and the mean of (k/40)² is
    # 22140/41/1600 = 0.3375. Over 1 m it is 1 cm everywhere.
    truth = straight()
    e = evaluate(Trajectory(truth.stamps_ns, truth.poses * [1.01, 1, 1]), Reference(truth))
    assert e.ate_rmse_m == pytest.approx(0.04 * np.sqrt(0.3375))
    assert e.e_max.x == pytest.approx(0.04)
    assert e.end_percent == pytest.approx(1.0)
    assert e.rpe_1m_rmse_m == pytest.approx(0.01)
    assert e.rpe_1m_heading_rmse_deg == pytest.approx(0.0, abs=1e-12)


def test_a_heading_drift_by_hand() -> None:
    # 2° per metre: the heading error after 4 m is 8°, over each metre 2°.
    truth = straight()
    drift = np.zeros((41, 3))
    drift[:, 2] = np.radians(2.0) * truth.poses[:, 0]
    e = evaluate(Trajectory(truth.stamps_ns, truth.poses + drift), Reference(truth))
    assert e.end_heading_deg == pytest.approx(8.0)
    assert e.e_max.theta == pytest.approx(np.radians(8.0))
    assert e.ate_heading_rmse_deg == pytest.approx(8.0 * np.sqrt(0.3375))
    assert e.rpe_1m_heading_rmse_deg == pytest.approx(2.0)


def spin(turns: float, n: int = 101) -> Trajectory:
    poses = np.zeros((n, 3))
    poses[:, 2] = np.linspace(0.0, 2 * np.pi * turns, n)
    return Trajectory(every(0.1, n), poses)


def test_three_turns_for_two_are_a_whole_turn_off() -> None:
    e = evaluate(spin(3.0), Reference(spin(2.0)))
    assert e.end_heading_deg == pytest.approx(360.0)
    assert e.e_max.theta == pytest.approx(2 * np.pi)
    assert e.rpe_1m_rmse_m is None
    assert e.end_percent is None


def test_whole_turns_at_the_start_do_not_count() -> None:
    # Both turn twice; the result counts from 10 turns and is 0.1 rad off, the truth is wrapped.
    ahead = np.array([0, 0, 20 * np.pi + 0.1])
    result = Trajectory(spin(2.0).stamps_ns, spin(2.0).poses + ahead)
    wrapped = spin(2.0).poses
    wrapped[:, 2] = (wrapped[:, 2] + np.pi) % (2 * np.pi) - np.pi
    e = evaluate(result, Reference(Trajectory(result.stamps_ns, wrapped)))
    assert e.e_max.theta == pytest.approx(0.1)
    assert e.end_heading_deg == pytest.approx(np.degrees(0.1))


def test_errors_are_taken_from_the_first_common_stamp_to_the_last() -> None:
    # The result runs from 2 s to 8 s; the truth from 0 s to 10 s in steps of 0.25 s.
    truth = straight()
    part = slice(8, 33)
    e = evaluate(Trajectory(truth.stamps_ns[part], truth.poses[part]), Reference(truth))
    assert (e.stamps_used, e.stamps_excluded, e.stamps_outside) == (25, 0, 16)
    assert e.ate_rmse_m == pytest.approx(0.0, abs=1e-15)


def test_gaps_over_half_a_second_are_excluded_and_counted() -> None:
    # Estimates at 0, 0.5, 1.25, 1.75 s: the step of 0.75 s is a gap, those of 0.5 s are not.
    stamps = seconds(0.0, 0.5, 1.25, 1.75)
    poses = np.column_stack([stamps / S, np.zeros(4), np.zeros(4)])
    wanted = seconds(0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0)
    got, valid = interpolate_trajectory(Trajectory(stamps, poses), wanted)
    assert valid.tolist() == [True, True, True, False, False, True, True, True, False]
    np.testing.assert_allclose(got[valid, 0], [0, 0.25, 0.5, 1.25, 1.5, 1.75], atol=1e-15)
    assert np.isnan(got[~valid]).all()
    truth = Trajectory(wanted, np.column_stack([wanted / S, np.zeros(9), np.zeros(9)]))
    e = evaluate(Trajectory(stamps, poses), Reference(truth))
    assert (e.stamps_used, e.stamps_excluded, e.stamps_outside) == (6, 2, 1)


def test_turns_are_not_lost_in_a_gap() -> None:
    # One turn a second; the estimate lacks 0.9 s to 2.1 s but knows that it turned.
    poses = np.zeros((31, 3))
    poses[:, 2] = 2 * np.pi * 0.1 * np.arange(31)
    full = Trajectory(every(0.1, 31), poses)
    keep = (full.stamps_ns <= 9 * S // 10) | (full.stamps_ns >= 21 * S // 10)
    e = evaluate(Trajectory(full.stamps_ns[keep], poses[keep]), Reference(full))
    assert e.stamps_excluded == 11
    assert e.e_max.theta == pytest.approx(0.0, abs=1e-12)


def test_interpolation_follows_the_arc() -> None:
    # Quarter circle of radius 1 in 0.4 s; after 0.1 s at 22.5°.
    arc = Trajectory(seconds(0.0, 0.4), np.array([[0, 0, 0], [1, 1, np.pi / 2]], dtype=float))
    got, valid = interpolate_trajectory(arc, seconds(0.1, 0.4))
    a = np.pi / 8
    np.testing.assert_allclose(got, [[np.sin(a), 1 - np.cos(a), a], arc.poses[1]], atol=1e-15)
    assert valid.all()


def test_a_single_pose_and_none() -> None:
    one = Trajectory(seconds(1.0), np.array([[1.0, 2.0, 3.0]]))
    got, valid = interpolate_trajectory(one, seconds(0.9, 1.0, 1.1))
    assert valid.tolist() == [False, True, False]
    np.testing.assert_array_equal(got[1], [1, 2, 3])
    none = Trajectory(seconds(), np.zeros((0, 3)))
    assert not interpolate_trajectory(none, seconds(1.0))[1].any()


def test_no_common_time_is_an_error() -> None:
    late = Trajectory(straight().stamps_ns + 100 * S, straight().poses)
    with pytest.raises(FglocError, match="the trajectory and mocap have no time in common"):
        evaluate(late, Reference(straight(), "mocap"))


def test_the_reference_is_where_it_is_mounted() -> None:
    # A marker 0.2 m behind and 0.1 m left, turned by 0.3 rad, on a robot that spins twice.
    base = spin(2.0)
    mount = (-0.2, 0.1, 0.3)
    marker = Trajectory(base.stamps_ns, compose(base.poses, np.array(mount)))
    right = evaluate(base, Reference(marker, mount=mount))
    assert right.ate_rmse_m == pytest.approx(0.0, abs=1e-14)
    assert right.e_max.theta == pytest.approx(0.0, abs=1e-14)
    # On a spin, a mount taken as zero is off by its full lever arm, always.
    wrong = evaluate(base, Reference(marker, mount=mount), mount=(0.0, 0.0, 0.0))
    assert wrong.ate_rmse_m == pytest.approx(np.hypot(0.2, 0.1))
    assert wrong.end_heading_deg == pytest.approx(np.degrees(0.3))


def test_covariance_of_a_mounted_frame_by_sampling() -> None:
    rng = np.random.default_rng(1)
    pose = np.array([1.0, 2.0, 0.7])
    a = rng.normal(size=(3, 3)) * 0.01
    body = Trajectory(seconds(0.0), pose[None], (a @ a.T)[None])
    mapped = map_mount(body, (0.5, -0.3, 1.0))
    assert mapped.covariances is not None
    draws = compose(rng.multivariate_normal(pose, a @ a.T, 20000), np.array([0.5, -0.3, 1.0]))
    sigma = np.sqrt(np.diag(mapped.covariances[0]))
    sampled = np.cov(draws.T) / np.outer(sigma, sigma)
    np.testing.assert_allclose(sampled, mapped.covariances[0] / np.outer(sigma, sigma), atol=0.05)


def random_drive(seed: int, n: int = 400) -> tuple[Trajectory, Trajectory]:
    """Return a winding truth in equal steps of 5.01 cm, and a drifting estimate of it."""
    rng = np.random.default_rng(seed)
    heading = np.cumsum(rng.normal(size=n) * 0.1)
    steps = 0.0501 * np.column_stack([np.cos(heading), np.sin(heading)])
    truth = np.column_stack([np.cumsum(steps, axis=0), heading])
    estimate = truth + np.cumsum(rng.normal(size=(n, 3)) * [0.01, 0.01, 0.005], axis=0)
    stamps = every(0.02, n)
    return Trajectory(stamps, estimate), Trajectory(stamps, truth)


def as_evo(trajectory: Trajectory) -> PoseTrajectory3D:
    x, y, heading = trajectory.poses.T
    zero = np.zeros(len(trajectory))
    return PoseTrajectory3D(
        np.column_stack([x, y, zero]),
        np.column_stack([np.cos(heading / 2), zero, zero, np.sin(heading / 2)]),
        trajectory.stamps_ns * 1e-9,
    )


@pytest.mark.parametrize("seed", range(4))
def test_ate_agrees_with_evo(seed: int) -> None:
    estimate, truth = random_drive(seed)
    ours = evaluate(estimate, Reference(truth))
    reference, moving = as_evo(truth), as_evo(estimate)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, moving))
    assert ours.ate_rmse_m == pytest.approx(ape.get_statistic(metrics.StatisticsType.rmse))
    angle = metrics.APE(metrics.PoseRelation.rotation_angle_deg)
    angle.process_data((reference, moving))
    wanted = angle.get_statistic(metrics.StatisticsType.rmse)
    assert ours.ate_heading_rmse_deg == pytest.approx(wanted, rel=1e-6)
    moving.align(reference)
    ape.process_data((reference, moving))
    # evo aligns in space; the noise is planar, so its best rotation is about z.
    assert ours.ate_aligned_rmse_m == pytest.approx(ape.get_statistic(metrics.StatisticsType.rmse))


@pytest.mark.parametrize("seed", range(4))
def test_rpe_over_one_metre_agrees_with_evo(seed: int) -> None:
    # Equal steps of 5.01 cm: 20 of them (1.002 m) are both the first to reach 1 m, as ours takes,
    # and the closest to 1 m, as evo does.
    estimate, truth = random_drive(seed)
    ours = evaluate(estimate, Reference(truth))
    for relation, value in (
        (metrics.PoseRelation.translation_part, ours.rpe_1m_rmse_m),
        (metrics.PoseRelation.rotation_angle_deg, ours.rpe_1m_heading_rmse_deg),
    ):
        rpe = metrics.RPE(relation, 1.0, Unit.meters, 0.01, True, True)
        rpe.process_data((as_evo(truth), as_evo(estimate)))
        assert value == pytest.approx(rpe.get_statistic(metrics.StatisticsType.rmse), rel=1e-6)
    assert ours.path_length_m == pytest.approx(as_evo(truth).path_length)


def test_alignment_recovers_a_rigid_motion() -> None:
    rng = np.random.default_rng(5)
    fixed = rng.normal(size=(30, 2))
    for angle in (0.0, 2.5, np.pi, -1.0):
        c, s = np.cos(angle), np.sin(angle)
        moved = fixed @ np.array([[c, s], [-s, c]]) + [3.0, -7.0]
        np.testing.assert_allclose(aligned_positions(moved, fixed), fixed, atol=1e-13)


def test_a_standing_robots_noise_is_no_path() -> None:
    # 2000 fixes of 0.2 mm noise add up to half a metre if every step counts.
    rng = np.random.default_rng(6)
    poses = np.column_stack([rng.normal(size=(2000, 2)) * 2e-4, np.zeros(2000)])
    standing = Trajectory(every(0.01, 2000), poses)
    assert np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1).sum() > 0.5
    assert evaluate(standing, Reference(standing)).path_length_m == 0.0


def with_covariance(
    errors: Floats, covariances: Floats, n: int | None = None
) -> tuple[Trajectory, Reference]:
    truth = straight(errors.shape[0] if n is None else n)
    return Trajectory(truth.stamps_ns, truth.poses + errors, covariances), Reference(truth)


def test_nees_by_hand() -> None:
    # Each error is one, two and three sigma: 1 + 4 + 9 = 14, undivided.
    sigma = np.array([0.1, 0.2, 0.01])
    errors = np.tile(sigma * [1, -2, 3], (5, 1))
    e = evaluate(*with_covariance(errors, np.tile(np.diag(sigma**2), (5, 1, 1))))
    assert e.nees == pytest.approx(14.0)
    assert e.nees_skipped == 0


def test_nees_of_correlated_errors_is_chi_square() -> None:
    rng = np.random.default_rng(7)
    n = 2000
    a = rng.normal(size=(n, 3, 3)) * [[[0.1], [0.3], [0.01]]]
    errors = np.einsum("nij,nj->ni", a, rng.normal(size=(n, 3)))
    e = evaluate(*with_covariance(errors, a @ a.transpose(0, 2, 1)))
    assert e.nees is not None
    low, high = chi2.ppf([0.001, 0.999], 3 * n) / n
    assert low < e.nees < high
    assert e.nees_skipped < 5


def test_nees_leaves_out_covariances_that_say_nothing() -> None:
    # Zero, singular (x and y fully correlated), not finite, negative; one good row with nees 3.
    bad = np.array([[0.01, 0.01, 0.0], [0.01, 0.01, 0.0], [0.0, 0.0, 1e-4]])
    rows = np.stack([np.zeros((3, 3)), bad, np.full((3, 3), np.nan), -np.eye(3), np.eye(3)])
    e = evaluate(*with_covariance(np.ones((5, 3)), rows))
    assert e.nees == pytest.approx(3.0)
    assert e.nees_skipped == 4
    none = evaluate(*with_covariance(np.ones((5, 3)), np.zeros((5, 3, 3))))
    assert (none.nees, none.nees_skipped) == (None, 5)


def test_covariances_are_interpolated_linearly() -> None:
    # I at 0 s and 3 I at 0.4 s is 1.5 I at 0.1 s; errors of 1.5 in x there give 2.25 / 1.5.
    poses = np.zeros((2, 3))
    poses[:, 0] = 1.5
    result = Trajectory(seconds(0.0, 0.4), poses, np.stack([np.eye(3), 3 * np.eye(3)]))
    truth = Reference(Trajectory(seconds(0.1), np.zeros((1, 3))))
    series = error_series(result, truth)
    assert series.covariances is not None
    np.testing.assert_allclose(series.covariances[0], 1.5 * np.eye(3))
    assert evaluate(result, truth).nees == pytest.approx(1.5)
