"""Every base against the closed-form forward kinematics of the literature."""

from __future__ import annotations

import numpy as np
import pytest

from fgloc.core import bases
from fgloc.core.kinematics import prior_correlation
from fgloc.core.measurements import Floats
from fgloc.errors import FglocError

RNG_SEED = 7


def turns(columns: int, n: int = 40) -> Floats:
    """Return wheel angles that no rigid motion explains: the least squares must decide."""
    return np.random.default_rng(RNG_SEED).normal(size=(n, columns))


def test_differential() -> None:
    # v = (r_l φ_l + r_r φ_r) / 2, w = (r_r φ_r - r_l φ_l) / b, no side slip.
    base = bases.differential(0.042, 0.0425, 0.2)
    a = turns(2)
    left, right = 0.042 * a[:, 0], 0.0425 * a[:, 1]
    wanted = np.column_stack([(left + right) / 2, 0 * left, (right - left) / 0.2])
    np.testing.assert_allclose(base.displacements(a), wanted, atol=1e-15)


def test_differential_with_encoders_in_the_other_order() -> None:
    base = bases.differential(0.042, 0.0425, 0.2, order=("right", "left"))
    assert base.driven_names == ("right", "left")
    swapped = bases.differential(0.042, 0.0425, 0.2).displacements(turns(2)[:, ::-1])
    np.testing.assert_allclose(base.displacements(turns(2)), swapped, atol=1e-15)


@pytest.mark.parametrize("icr_x", [0.0, 0.07])
def test_skid_steer_is_model_1_with_four_encoders(icr_x: float) -> None:
    # Each side moves by the mean of its two wheels; v = (right + left)/2,
    # w = (right - left)/L_ef, and the centre of rotation sits at icr_x: v_y = -icr_x w.
    order = ("fl", "fr", "rl", "rr")
    base = bases.skid_steer(("fl", "rl"), ("fr", "rr"), 0.135, 0.72, icr_x=icr_x, order=order)
    a = turns(4)
    left = 0.135 * (a[:, 0] + a[:, 2]) / 2
    right = 0.135 * (a[:, 1] + a[:, 3]) / 2
    w = (right - left) / 0.72
    wanted = np.column_stack([(left + right) / 2, -icr_x * w, w])
    np.testing.assert_allclose(base.displacements(a), wanted, atol=1e-15)


def test_mecanum() -> None:
    # With rollers in the usual X: forward all equal; left fl, rr back; turn left left side back.
    r, lx, ly = 0.05, 0.2, 0.15
    base = bases.mecanum(r, lx, ly, ("fl", "fr", "rl", "rr"))
    fl, fr, rl, rr = turns(4).T
    wanted = np.column_stack(
        [
            r / 4 * (fl + fr + rl + rr),
            r / 4 * (-fl + fr + rl - rr),
            r / (4 * (lx + ly)) * (-fl + fr - rl + rr),
        ]
    )
    np.testing.assert_allclose(base.displacements(turns(4)), wanted, atol=1e-15)


def test_omni_with_three_wheels_at_120_degrees() -> None:
    # Wheel i rolls along its tangent: v_i = -sin(a_i) v_x + cos(a_i) v_y + R w, whose inverse for
    # 120° spacing is two thirds of the transpose, and the mean over R.
    angles = np.radians([60.0, 180.0, 300.0])
    base = bases.omni3([0.05, 0.051, 0.052], 0.195, angles.tolist())
    rolled = turns(3) * [0.05, 0.051, 0.052]
    wanted = np.column_stack(
        [
            -2 / 3 * rolled @ np.sin(angles),
            2 / 3 * rolled @ np.cos(angles),
            rolled.mean(axis=1) / 0.195,
        ]
    )
    np.testing.assert_allclose(base.displacements(turns(3)), wanted, atol=1e-15)


@pytest.mark.parametrize("offset", [0.0, -0.02])
def test_tricycle(offset: float) -> None:
    # v = r φ cos δ at the rear axle, w = r φ sin δ / L.
    base = bases.tricycle(0.0325, 0.15, steer_offset=offset)
    a = turns(1)
    steering = np.random.default_rng(8).uniform(-1.5, 1.5, a.shape)
    rolled, delta = 0.0325 * a[:, 0], steering[:, 0] + offset
    wanted = np.column_stack([rolled * np.cos(delta), 0 * rolled, rolled * np.sin(delta) / 0.15])
    np.testing.assert_allclose(base.displacements(a, steering), wanted, atol=1e-15)


A = np.array([0.1125, -0.1125, -0.1125, 0.1125])
B = np.array([0.1125, 0.1125, -0.1125, -0.1125])


def swerve(a: Floats, b: Floats) -> bases.WheeledBase:
    return bases.four_wheel_steer(
        "1234", list(zip(a.tolist(), b.tolist(), strict=True)), [0.0254] * 4
    )


def test_four_wheel_steer_is_the_seeds_formula_for_the_nominal_geometry() -> None:
    # v_x = ¼Σ v_i cos δ_i, v_y = ¼Σ v_i sin δ_i, w = Σ W_i v_i with
    # W_i = (-b_i cos δ_i + a_i sin δ_i) / (4a_i² + 4b_i²).
    rolled = 0.0254 * turns(4)
    steering = np.random.default_rng(9).uniform(-np.pi, np.pi, (40, 4))
    c, s = np.cos(steering), np.sin(steering)
    weights = (-B * c + A * s) / (4 * A**2 + 4 * B**2)
    wanted = np.column_stack(
        [(rolled * c).mean(1), (rolled * s).mean(1), (weights * rolled).sum(1)]
    )
    np.testing.assert_allclose(swerve(A, B).displacements(turns(4), steering), wanted, atol=1e-15)


def test_four_wheel_steer_solves_the_least_squares_for_other_geometries() -> None:
    # v_i (cos δ_i, sin δ_i) = (v_x - b_i w, v_y + a_i w) for four wheels, eight equations.
    rng = np.random.default_rng(10)
    a, b = A + rng.normal(size=4) * 0.01, B + rng.normal(size=4) * 0.01
    steering = rng.uniform(-np.pi, np.pi, (5, 4))
    ours = swerve(a, b).displacements(turns(4, 5), steering)
    zeros, ones = np.zeros(4), np.ones(4)
    matrix = np.vstack([np.column_stack([ones, zeros, -b]), np.column_stack([zeros, ones, a])])
    for angles, delta, xi in zip(turns(4, 5), steering, ours, strict=True):
        rolled = 0.0254 * angles
        right = np.concatenate([rolled * np.cos(delta), rolled * np.sin(delta)])
        np.testing.assert_allclose(xi, np.linalg.lstsq(matrix, right)[0], atol=1e-15)


def test_mecanum_radius_may_differ_by_wheel() -> None:
    # Only fl turns: the same displacement scaled by its own radius.
    order = ("fl", "fr", "rl", "rr")
    one = np.array([[1.0, 0.0, 0.0, 0.0]])
    nominal = bases.mecanum(0.05, 0.2, 0.15, order).displacements(one)
    larger = bases.mecanum([0.06, 0.05, 0.05, 0.05], 0.2, 0.15, order).displacements(one)
    np.testing.assert_allclose(larger, nominal * 1.2, atol=1e-15)


def test_names_and_radii_must_match_in_number() -> None:
    with pytest.raises(ValueError, match="zip"):
        bases.omni3([0.05, 0.05], 0.2, [0.0, 2.0, 4.0])


def test_a_base_needs_positive_sizes() -> None:
    with pytest.raises(FglocError, match=r"wheel left: radius must be positive, got -0\.1"):
        bases.differential(-0.1, 0.1, 0.5)
    with pytest.raises(FglocError, match="effective_track must be positive, got 0"):
        bases.differential(0.1, 0.1, 0.0)


FULL = {
    "differential": (bases.differential(0.042, 0.0425, 0.2), 2),
    "skid": (bases.skid_steer(("fl", "rl"), ("fr", "rr"), 0.135, 0.7, icr_x=0.05), 2),
    "mecanum": (bases.mecanum(0.05, 0.2, 0.15, ("fl", "fr", "rl", "rr")), 4),
    "omni3": (bases.omni3((0.05, 0.051, 0.049), 0.2, (1.0, 3.1, -1.0)), 3),
}


@pytest.mark.parametrize("name", FULL)
def test_the_full_linear_model_starts_as_the_base_itself(name: str) -> None:
    base, groups = FULL[name]
    full = bases.full_linear(base)
    assert full.kind == "full-linear"
    assert full.driven_names == base.driven_names
    assert len(full.parameters) == 3 * groups
    a = turns(len(base.driven))
    np.testing.assert_allclose(full.displacements(a), base.displacements(a), atol=1e-14)
    assert bases.full_linear(full) == full


def test_the_full_linear_model_is_a_matrix() -> None:
    full = bases.full_linear(bases.differential(0.1, 0.1, 0.5, order=("right", "left")))
    values = {p.name: 0.01 * k for k, p in enumerate(full.parameters, 1)}
    assert list(values)[:3] == ["linear_x.right", "linear_y.right", "linear_turn.right"]
    moved, a = full.with_values(values), turns(2)
    matrix = np.array([[0.01, 0.04], [0.02, 0.05], [0.03, 0.06]])
    np.testing.assert_allclose(moved.displacements(a), a @ matrix.T, atol=1e-15)
    np.testing.assert_allclose(
        full.displacements(a, values=np.array(list(values.values()))), a @ matrix.T, atol=1e-15
    )


def test_priors_of_the_full_linear_model_are_those_of_its_base() -> None:
    # Radius 0.1 m and track 0.5 m: 0.05 m forward and 0.2 rad of turn a radian of one wheel.
    full = bases.full_linear(bases.skid_steer(("l",), ("r",), 0.1, 0.5))
    sigma = {p.name: (p.nominal, p.prior_sigma) for p in full.parameters}
    assert sigma["linear_x.left"] == pytest.approx((0.05, 0.0015))
    assert sigma["linear_turn.left"] == pytest.approx((-0.2, 0.07))
    assert sigma["linear_turn.right"] == pytest.approx((0.2, 0.07))
    assert sigma["linear_y.right"] == pytest.approx((0.0, 0.005))
    # All a robot turns is uncertain by 35 %, but going straight turns it little: two sides that
    # differ by a percent each (3 %·√0.1) give √2·0.2·0.0095 rad a radian.
    by = np.array([p.name.startswith("linear_turn") for p in full.parameters], dtype=float)
    spread = np.array([p.prior_sigma for p in full.parameters]) * by
    correlation = prior_correlation(full.parameters)
    straight = np.sqrt(spread @ correlation @ spread)
    assert straight == pytest.approx(np.sqrt(2.0) * 0.2 * 0.03 * np.sqrt(0.1), rel=1e-9)


def test_a_steered_base_has_no_full_linear_model() -> None:
    with pytest.raises(FglocError, match="tricycle: a steered base has no full linear model"):
        bases.full_linear(bases.tricycle(0.1, 0.8))


def test_body_odometry_is_the_displacement_itself_times_its_scales() -> None:
    base = bases.body_odometry()
    assert base.driven_names == ("forward", "left", "turn")
    moved = turns(3)
    np.testing.assert_array_equal(base.displacements(moved), moved)
    scaled = base.with_values({"odometry_scale": 0.96, "rotation_scale": 1.1})
    np.testing.assert_allclose(scaled.displacements(moved), moved * [0.96, 0.96, 1.1], atol=1e-15)
    assert bases.full_linear(base) == base
    sigma = {p.name: p.prior_sigma for p in base.parameters}
    # Radii alone make the way, radii and track the turn: √(3² + 5²) % = 5.8 %.
    assert sigma == pytest.approx({"odometry_scale": 0.03, "rotation_scale": 0.0583}, abs=1e-4)
