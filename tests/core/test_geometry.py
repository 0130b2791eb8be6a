"""SE(2) against GTSAM's Pose2, quadrature and finite differences."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from fgloc.core import geometry as se2
from fgloc.core.measurements import Floats

ANGLES = [
    *(0.0, 1e-12, 1e-7, 1e-5, -1e-5, 9.9e-5, 1.01e-4, 1e-3, 0.0499, 0.0501, -0.0499, -0.0501),
    *(0.3, -1.2, np.pi / 2, 3.0, np.pi - 1e-9, -np.pi + 1e-9, np.pi, -np.pi, 5.0),
]


def as_gtsam(pose: Floats) -> gtsam.Pose2:
    return gtsam.Pose2(*(float(v) for v in pose))


def assert_same_pose(ours: Floats, theirs: gtsam.Pose2, tolerance: float = 1e-13) -> None:
    np.testing.assert_allclose(ours[:2], [theirs.x(), theirs.y()], atol=tolerance)
    assert abs(np.angle(np.exp(1j * (ours[2] - theirs.theta())))) < tolerance


def random_poses(seed: int, n: int = 50) -> Floats:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.normal(size=(n, 2)) * 5.0, rng.uniform(-3.1, 3.1, n)])


@pytest.mark.parametrize("angle", ANGLES)
def test_exp_agrees_with_gtsam(angle: float) -> None:
    xi = np.array([0.7, -0.4, angle])
    # GTSAM divides 1 - cos by the angle, so near zero its own rounding is eps / angle.
    tolerance = 1e-14 + 2e-16 / max(abs(angle), 1e-5)
    assert_same_pose(se2.exp(xi), gtsam.Pose2.Expmap(xi), tolerance)


@pytest.mark.parametrize("angle", [a for a in ANGLES if abs(a) < np.pi])
def test_log_agrees_with_gtsam_and_inverts_exp(angle: float) -> None:
    pose = np.array([0.7, -0.4, angle])
    theirs = gtsam.Pose2.Logmap(as_gtsam(pose))
    np.testing.assert_allclose(se2.log(pose), theirs, atol=1e-14 + 2e-16 / max(abs(angle), 1e-5))
    np.testing.assert_allclose(se2.exp(se2.log(pose)), pose, atol=1e-14)


def test_log_inverts_exp_beyond_half_a_turn() -> None:
    # The heading is not wrapped: an arc of 1.6 turns comes back as one of 1.6 turns.
    xi = np.array([[2.0, -0.5, 10.0], [0.1, 0.2, -7.0], [1.0, 0.0, 4.0]])
    np.testing.assert_allclose(se2.log(se2.exp(xi)), xi, atol=1e-12)


def test_compose_between_inverse_agree_with_gtsam() -> None:
    for p, q in zip(random_poses(1), random_poses(2), strict=True):
        assert_same_pose(se2.compose(p, q), as_gtsam(p).compose(as_gtsam(q)))
        assert_same_pose(se2.between(p, q), as_gtsam(p).between(as_gtsam(q)))
        assert_same_pose(se2.inverse(p), as_gtsam(p).inverse())


def test_interpolation_is_gtsams_geodesic() -> None:
    rng = np.random.default_rng(3)
    for p, q, f in zip(random_poses(4), random_poses(5), rng.uniform(0, 1, 50), strict=True):
        step = gtsam.Pose2.Logmap(as_gtsam(p).between(as_gtsam(q)))
        wanted = as_gtsam(p).compose(gtsam.Pose2.Expmap(f * step))
        assert_same_pose(se2.interpolate(p, q, f), wanted, 1e-12)


def test_interpolation_takes_the_shorter_way_and_continues_the_heading() -> None:
    # From 10 turns + 170° to -170° is 20° on, so half of it is 10 turns + 180°.
    p = np.array([0.0, 0.0, 20 * np.pi + np.radians(170.0)])
    q = np.array([0.0, 0.0, np.radians(-170.0)])
    half = se2.interpolate(p, q, np.array(0.5))
    assert half[2] == pytest.approx(20 * np.pi + np.pi, abs=1e-12)


def test_interpolation_runs_along_the_arc() -> None:
    # Quarter circle of radius 1 about (0, 1): half of it is at 45°.
    half = se2.interpolate(np.zeros(3), np.array([1.0, 1.0, np.pi / 2]), np.array([0.0, 0.5, 1.0]))
    r = np.sqrt(0.5)
    wanted = [[0, 0, 0], [r, 1 - r, np.pi / 4], [1, 1, np.pi / 2]]
    np.testing.assert_allclose(half, wanted, atol=1e-15)


@pytest.mark.parametrize("angle", ANGLES)
def test_arc_coefficients_agree_with_quadrature(angle: float) -> None:
    # a = ∫ cos(ts) ds, b = ∫ sin(ts) ds over [0, 1]; differentiated under the integral. No term
    # cancels, unlike in the closed forms.
    nodes, weights = np.polynomial.legendre.leggauss(40)
    s, w = (nodes + 1) / 2, weights / 2
    wanted = [
        np.sum(w * np.cos(angle * s)),
        np.sum(w * np.sin(angle * s)),
        -np.sum(w * s * np.sin(angle * s)),
        np.sum(w * s * np.cos(angle * s)),
    ]
    np.testing.assert_allclose(se2.arc_coefficients(angle), wanted, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("angle", ANGLES)
def test_exp_jacobian_agrees_with_finite_differences(angle: float) -> None:
    xi = np.array([0.7, -0.4, angle])
    jacobian = np.empty((3, 3))
    se2.exp_jacobian_scalar(xi, jacobian)
    h = 1e-5
    for k in range(3):
        step = np.zeros(3)
        step[k] = h
        difference = (se2.exp(xi + step) - se2.exp(xi - step)) / (2 * h)
        np.testing.assert_allclose(jacobian[:, k], difference, atol=1e-9)


@pytest.mark.parametrize("angle", ANGLES)
def test_scalar_and_array_forms_agree(angle: float) -> None:
    p, q = np.array([1.0, 2.0, angle]), np.array([0.3, -0.7, 0.4])
    out = np.empty(3)
    se2.step_scalar(p, se2.EXACT, out)
    np.testing.assert_allclose(out, se2.exp(p), rtol=0, atol=2e-14)
    se2.compose_scalar(p, q, out)
    np.testing.assert_allclose(out, se2.compose(p, q), atol=1e-15)
    se2.between_scalar(p, q, out)
    np.testing.assert_allclose(out, se2.between(p, q), atol=1e-15)
    assert se2.wrap_scalar(7.0 * angle) == se2.wrap(np.array(7.0 * angle))


def test_compose_scalar_may_write_over_its_arguments() -> None:
    p, q = np.array([1.0, 2.0, 0.5]), np.array([0.3, -0.7, 0.4])
    wanted = se2.compose(p, q)
    onto_p, onto_q = p.copy(), q.copy()
    se2.compose_scalar(onto_p, q, onto_p)
    se2.compose_scalar(p, onto_q, onto_q)
    np.testing.assert_allclose([onto_p, onto_q], [wanted, wanted], atol=1e-15)


def test_exact_integrator_closes_a_circle_from_any_step() -> None:
    # v = 0.5 m/s, w = 0.25 rad/s: radius 2 m about (0, 2). Uneven steps, one of half a turn.
    parts = np.array([np.pi, 0.1, 1.0, 1e-6, 2 * np.pi - np.pi - 1.1 - 1e-6])
    steps = np.column_stack([2.0 * parts, np.zeros(5), parts])
    poses = se2.integrate(steps, np.zeros(3), se2.EXACT)
    heading = poses[:, 2]
    circle = np.column_stack([2 * np.sin(heading), 2 - 2 * np.cos(heading), heading])
    np.testing.assert_allclose(poses, circle, atol=1e-14)
    np.testing.assert_allclose(poses[-1], [0, 0, 2 * np.pi], atol=1e-14)


def test_exact_integrator_follows_a_sideways_twist() -> None:
    # A base that slides to the left while turning left: centre at (-v_y/w, v_x/w) = (-2, 0).
    steps = np.tile([0.0, 0.2, 0.1], (31, 1))
    poses = se2.integrate(steps, np.zeros(3), se2.EXACT)
    np.testing.assert_allclose(np.hypot(poses[:, 0] + 2.0, poses[:, 1]), 2.0, atol=1e-13)


def test_midpoint_and_euler_steps_by_hand() -> None:
    # 1 m ahead while turning 90°: along the mean heading of 45°, or straight on.
    xi = np.array([1.0, 0.0, np.pi / 2])
    out = np.empty(3)
    se2.step_scalar(xi, se2.MIDPOINT, out)
    np.testing.assert_allclose(out, [np.sqrt(0.5), np.sqrt(0.5), np.pi / 2], atol=1e-15)
    se2.step_scalar(xi, se2.EULER, out)
    np.testing.assert_allclose(out, [1.0, 0.0, np.pi / 2], atol=0)


def test_rotate_covariance_turns_the_long_axis() -> None:
    # Long along body x; heading 90° puts it along map y. Its x-θ term becomes a y-θ term.
    body = np.array([[4.0, 0.0, 0.5], [0.0, 1.0, 0.0], [0.5, 0.0, 0.2]])
    wanted = np.array([[1.0, 0.0, 0.0], [0.0, 4.0, 0.5], [0.0, 0.5, 0.2]])
    turned = se2.rotate_covariance(np.stack([body, body]), np.array([np.pi / 2, 0.0]))
    np.testing.assert_allclose(turned, [wanted, body], atol=1e-15)
