"""The wheel equations, their Jacobians and the calibration parameters of a base."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from fgloc.core import bases
from fgloc.core.kinematics import (
    RADIUS,
    Parameter,
    Wheel,
    WheeledBase,
    X,
    prior_correlation,
)
from fgloc.core.kinematics_kernels import body_displacement, solve3
from fgloc.core.measurements import Floats
from fgloc.core.motion_models import lateral_scale, rotation_scale
from fgloc.errors import FglocError

ORDER = ("fl", "fr", "rl", "rr")
BASES = {
    "differential": bases.differential(0.042, 0.0425, 0.2),
    "skid-steer": bases.skid_steer(
        ("fl", "rl"), ("fr", "rr"), 0.135, 0.72, icr_x=0.05, order=ORDER
    ),
    "mecanum": bases.mecanum([0.05, 0.051, 0.049, 0.05], 0.2, 0.15, ORDER),
    "omni3": bases.omni3([0.05, 0.051, 0.052], 0.195, np.radians([60.0, 170.0, 300.0]).tolist()),
    "tricycle": bases.tricycle(0.0325, 0.15, steer_offset=-0.02),
    "4wis4wid": bases.four_wheel_steer(
        ORDER, [(0.11, 0.12), (0.10, -0.11), (-0.12, 0.1), (-0.11, -0.12)], [0.025, 0.026] * 2
    ),
    # One of each kind, off the axes, with unequal weights.
    "mixed": WheeledBase(
        "mixed",
        (
            Wheel("a", 0.3, 0.2, 0.1, steer=0.3),
            Wheel("b", -0.2, 0.4, 0.08, "roller", steer=-0.5, roller=0.6),
            Wheel("c", -0.4, -0.1, kind="passive", steer=0.2),
        ),
        (Parameter("k", 0.3, 0.1),),
        (("k", "a", X, 1.0), ("k", "b", RADIUS, 0.25)),
        rolling_weight=2.0,
        lateral_weight=0.5,
    ),
}
LINEAR = {
    "full-linear": bases.full_linear(BASES["skid-steer"]),
    "full-linear-omni": bases.full_linear(BASES["omni3"]),
    "odometry": bases.body_odometry(),
}
SCALED = {
    f"{name} scaled": lateral_scale(rotation_scale(base)).with_values(
        {"rotation_scale": 1.3, "lateral_scale": 0.9}
    )
    for name, base in {
        "skid-steer": BASES["skid-steer"],
        "4wis4wid": BASES["4wis4wid"],
        "full-linear-omni": LINEAR["full-linear-omni"],
    }.items()
}
ALL = BASES | LINEAR | SCALED
every_base = pytest.mark.parametrize("base", ALL.values(), ids=ALL)
every_geometry = pytest.mark.parametrize("base", BASES.values(), ids=BASES)


def solve(
    base: WheeledBase, angles: Floats, steering: Floats, primitives: Floats
) -> tuple[Floats, Floats, Floats, int]:
    """Return displacement, Jacobian by the flattened primitives, rows, and how many rows."""
    kinds, rollers = base.codes()
    w = len(base.wheels)
    rows, xi, gain = np.zeros((2 * w, 8)), np.zeros(3), np.zeros((3, 2 * w))
    jacobian = np.zeros((3, 4 * w))
    weights = np.array([base.rolling_weight, base.lateral_weight])
    n = body_displacement(
        angles, steering, primitives, kinds, rollers, weights, rows, xi, gain, jacobian, True
    )
    return xi, jacobian, rows, n


def states(base: WheeledBase) -> list[tuple[Floats, Floats]]:
    """Return wheel angles and steering: random, standing, one wheel only, consistent, large."""
    d = len(base.driven)
    rng = np.random.default_rng(11)
    random = [(rng.normal(size=d), rng.uniform(-1.2, 1.2, d)) for _ in range(10)]
    lonely = np.zeros(d)
    lonely[0] = 1.0
    return [
        *random,
        (np.zeros(d), np.zeros(d)),
        (np.zeros(d), rng.uniform(-1, 1, d)),
        (lonely, np.full(d, 0.4)),
        (np.ones(d), np.full(d, 0.3)),
        (1e3 * rng.normal(size=d), np.full(d, -0.7)),
    ]


@every_base
def test_jacobian_by_every_primitive_agrees_with_finite_differences(base: WheeledBase) -> None:
    primitives = base.primitives()
    for angles, steering in states(base):
        _, jacobian, _, n = solve(base, angles, steering, primitives)
        assert n > 0
        numeric = np.zeros_like(jacobian)
        h = 1e-6
        for k in range(primitives.size):
            # A passive wheel's radius has no meaning, and no influence either.
            up, down = primitives.copy(), primitives.copy()
            up.flat[k] += h
            down.flat[k] -= h
            ends = [solve(base, angles, steering, q)[0] for q in (up, down)]
            numeric[:, k] = (ends[0] - ends[1]) / (2 * h)
        scale = max(1.0, float(np.abs(angles).max()))
        np.testing.assert_allclose(jacobian / scale, numeric / scale, rtol=1e-6, atol=2e-8)


@every_base
def test_jacobian_by_the_parameters_agrees_with_finite_differences(base: WheeledBase) -> None:
    values = base.nominal()
    chain = base.primitive_jacobian()
    for angles, steering in states(base)[:6]:
        _, jacobian, _, _ = solve(base, angles, steering, base.primitives())
        for k in range(values.size):
            h = 1e-6
            ends = []
            for sign in (1.0, -1.0):
                moved = values.copy()
                moved[k] += sign * h
                ends.append(base.displacements(angles[None], steering[None], moved)[0])
            numeric = (ends[0] - ends[1]) / (2 * h)
            scale = max(1.0, float(np.abs(numeric).max()))
            np.testing.assert_allclose((jacobian @ chain)[:, k] / scale, numeric / scale, atol=1e-7)


@every_base
def test_primitive_jacobian_is_the_derivative_of_primitives(base: WheeledBase) -> None:
    values = base.nominal()
    rng = np.random.default_rng(12)
    step = rng.normal(size=values.size) * 0.01
    moved = base.primitives(values + step) - base.primitives(values)
    np.testing.assert_allclose(moved.ravel(), base.primitive_jacobian() @ step, atol=1e-15)


@every_geometry
def test_solution_is_the_weighted_least_squares_of_the_wheel_equations(base: WheeledBase) -> None:
    # Written out wheel by wheel from the velocity of its contact point, not from the code's rows.
    for angles, steering in states(base):
        rows, right, weights = [], [], []
        column = 0
        for w, (x, y, steer, radius) in zip(base.wheels, base.primitives(), strict=True):
            turn = 0.0
            if w.kind != "passive":
                steer, turn, column = steer + steering[column], angles[column], column + 1
            contact = np.array([[1.0, 0.0, -y], [0.0, 1.0, x]])
            along = np.array([math.cos(steer), math.sin(steer)])
            across = np.array([-math.sin(steer), math.cos(steer)])
            if w.kind == "roller":
                axis = math.cos(w.roller) * along + math.sin(w.roller) * across
                # What the wheel gives is r·turn along its heading; the roller lets slip the rest.
                rows.append(axis @ contact)
                right.append(radius * turn * float(axis @ along))
                weights.append(base.rolling_weight)
            if w.kind == "fixed":
                rows.append(along @ contact)
                right.append(radius * turn)
                weights.append(base.rolling_weight)
            if w.kind != "roller":
                rows.append(across @ contact)
                right.append(0.0)
                weights.append(base.lateral_weight)
        root = np.sqrt(weights)
        wanted = np.linalg.lstsq(np.array(rows) * root[:, None], np.array(right) * root)[0]
        ours = base.displacements(angles[None], steering[None])[0]
        np.testing.assert_allclose(ours, wanted, rtol=1e-9, atol=1e-12)


@every_base
def test_with_values_moves_the_nominal(base: WheeledBase) -> None:
    values = base.nominal() * 1.1 + 0.003
    named = {p.name: float(v) for p, v in zip(base.parameters, values, strict=True)}
    moved = base.with_values(named)
    np.testing.assert_allclose(moved.nominal(), values, rtol=1e-15)
    np.testing.assert_allclose(moved.primitives(), base.primitives(values), atol=1e-15)
    angles, steering = states(base)[0]
    np.testing.assert_allclose(
        moved.displacements(angles[None], steering[None]),
        base.displacements(angles[None], steering[None], values),
        atol=1e-15,
    )
    for old, new in zip(base.parameters, moved.parameters, strict=True):
        # A log prior is relative, so it grows with the nominal; an additive one stays.
        ratio = new.nominal / old.nominal if old.log else 1.0
        assert new.prior_sigma == pytest.approx(old.prior_sigma * ratio, rel=1e-14)
        assert new.solver_sigma == pytest.approx(old.solver_sigma, rel=1e-14)


def test_with_values_refuses_an_unknown_name() -> None:
    with pytest.raises(FglocError, match=r"no parameter wheel_radius\.front; it has wheel_radius"):
        BASES["differential"].with_values({"wheel_radius.front": 0.1})


def test_with_values_refuses_a_negative_radius() -> None:
    with pytest.raises(FglocError, match="must be positive"):
        BASES["differential"].with_values({"wheel_radius.left": -0.1})


@pytest.mark.parametrize(
    "parameter",
    [
        Parameter("wheel_radius.left", 0.05, 0.002, log=True),
        Parameter("wheel_x.fl", -0.11, 0.005, scale=0.1),
        Parameter("steer_offset.fl", 0.0, 0.02, unit="rad"),
    ],
    ids=lambda p: p.name,
)
def test_parameter_maps_there_and_back(parameter: Parameter) -> None:
    assert parameter.to_value(0.0) == parameter.nominal
    for u in (-0.4, 0.0, 1e-6, 0.7):
        assert parameter.to_solver(parameter.to_value(u)) == pytest.approx(u, abs=1e-14)
        h = 1e-6
        slope = (parameter.to_value(u + h) - parameter.to_value(u - h)) / (2 * h)
        assert parameter.derivative(u) == pytest.approx(slope, rel=1e-8)
    assert parameter.solver_sigma * parameter.derivative(0.0) == pytest.approx(
        parameter.prior_sigma
    )


def test_log_parameter_by_hand() -> None:
    # u = ln 2 doubles the radius; a 2 mm prior at 50 mm is 4 %.
    p = Parameter("wheel_radius.left", 0.05, 0.002, log=True)
    assert p.to_value(math.log(2.0)) == pytest.approx(0.1, rel=1e-15)
    assert p.solver_sigma == pytest.approx(0.04, rel=1e-15)


def test_bad_wheels_and_links_are_refused() -> None:
    good = Wheel("a", 0.0, 0.1, 0.05)
    with pytest.raises(FglocError, match="two wheels have the same name"):
        WheeledBase("x", (good, good))
    with pytest.raises(FglocError, match="kind must be one of fixed, roller, passive"):
        WheeledBase("x", (replace(good, kind="castor"),))  # type: ignore[arg-type]
    with pytest.raises(FglocError, match="radius must be positive, got nan"):
        WheeledBase("x", (replace(good, radius=math.nan),))
    with pytest.raises(FglocError, match="radius must be positive, got 0"):
        WheeledBase("x", (replace(good, radius=0.0),))
    with pytest.raises(FglocError, match="unknown parameter or wheel"):
        WheeledBase("x", (good,), (), (("k", "a", X, 1.0),))
    with pytest.raises(FglocError, match="unknown parameter or wheel"):
        WheeledBase("x", (good,), (Parameter("k", 1.0, 1.0),), (("k", "b", X, 1.0),))
    with pytest.raises(FglocError, match="k must be positive, got 0"):
        WheeledBase("x", (good,), (Parameter("k", 0.0, 1.0, log=True),))
    with pytest.raises(FglocError, match="k: the prior's sigma must not be negative"):
        WheeledBase("x", (good,), (Parameter("k", 1.0, -1.0),))


@pytest.mark.parametrize(
    "wheels",
    [
        (Wheel("a", 0.0, 0.1, 0.05),),
        (Wheel("a", 0.1, 0.0, 0.05, "roller"), Wheel("b", -0.1, 0.0, 0.05, "roller")),
        # Two wheels side by side at the same place say nothing about the rotation.
        (Wheel("a", 0.3, 0.0, 0.05), Wheel("b", 0.3, 0.0, 0.05)),
    ],
    ids=["one wheel", "no lateral row", "same place"],
)
def test_wheels_that_do_not_determine_the_motion_are_refused(wheels: tuple[Wheel, ...]) -> None:
    with pytest.raises(FglocError, match="do not determine the motion"):
        WheeledBase("x", wheels).displacements(np.ones((1, len(wheels))))


def test_arrays_that_do_not_fit_the_wheels_are_refused() -> None:
    base = BASES["skid-steer"]
    with pytest.raises(FglocError, match=r"angles must have shape \(N, 4\), got \(5, 3\)"):
        base.displacements(np.ones((5, 3)))
    with pytest.raises(FglocError, match=r"steering must have shape \(5, 4\), got \(4, 4\)"):
        base.displacements(np.ones((5, 4)), np.ones((4, 4)))


def test_solve3_inverts_and_tells_singular() -> None:
    rng = np.random.default_rng(13)
    inverse = np.empty((3, 3))
    for scale in (1e-6, 1.0, 1e6):
        a = rng.normal(size=(3, 5)) * scale
        assert solve3(a @ a.T, inverse)
        np.testing.assert_allclose(inverse @ (a @ a.T), np.eye(3), atol=1e-9)
        b = rng.normal(size=(3, 2)) * scale
        assert not solve3(b @ b.T, inverse)
    assert not solve3(np.zeros((3, 3)), inverse)
    assert not solve3(np.full((3, 3), np.nan), inverse)


def test_prior_errors_follow_the_signs_of_their_parameters() -> None:
    left = Parameter("linear_turn.left", -0.2, 0.02, "1", correlation=0.81)
    right = Parameter("linear_turn.right", 0.2, 0.02, "1", correlation=0.81)
    expected = [[1.0, -0.81], [-0.81, 1.0]]
    np.testing.assert_allclose(prior_correlation([left, right]), expected, atol=1e-15)


def test_radii_are_wrong_together_in_the_prior_and_nothing_else_is() -> None:
    base = bases.differential(0.1, 0.1, 0.5)
    assert [p.name for p in base.parameters][2] == "effective_track"
    rho = bases.RADIUS_CORRELATION
    expected = [[1.0, rho, 0.0], [rho, 1.0, 0.0], [0.0, 0.0, 1.0]]
    np.testing.assert_allclose(prior_correlation(base.parameters), expected, atol=1e-15)
    # 3 % each with correlation 0.9: the mean is known to 3 %·√0.95, half the difference to
    # 3 %·√0.05, so that two wheels of one robot differ by about a percent.
    covariance = 0.03**2 * np.array(expected)[:2, :2]
    half = np.array([0.5, -0.5])
    assert np.sqrt(half @ covariance @ half) == pytest.approx(0.03 * np.sqrt(0.05))
