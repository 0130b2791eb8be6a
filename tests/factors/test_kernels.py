"""Residual kernels against finite differences, GTSAM's own compositions and dense whitening."""

from __future__ import annotations

import math
from collections.abc import Callable

import gtsam
import numpy as np
import pytest

from fgloc.core.geometry import compose, wrap
from fgloc.core.measurements import Floats
from fgloc.factors.tables import (
    COMPONENTS,
    KERNELS,
    PAIRWISE,
    FactorTable,
    Kind,
    linearise,
    residuals,
)

SEED = 11
ANGLES = (0.0, 1e-5, -1e-5, 1e-9, 0.7, math.pi, -math.pi, math.pi - 1e-6, 4.0, -25.0)
"""Headings at which a Jacobian is easily wrong: none, tiny, on the cut, beyond it, many turns."""

# Calibration and measurement sizes of each kernel, with and without what it can do without.
CASES: list[tuple[Kind, int, int, int]] = [
    (Kind.WHEEL, -1, 0, 3),
    (Kind.WHEEL, -1, 3, 12),
    (Kind.WHEEL, 3, 5, 18),
    (Kind.YAW, -1, 1, 2),
    (Kind.YAW, -1, 2, 2),
    (Kind.YAW, 3, 0, 2),
    (Kind.YAW, 3, 1, 2),
    (Kind.YAW_RATE, -1, 1, 2),
    (Kind.YAW_RATE, 3, 0, 2),
    (Kind.ZERO_WALK, 3, 0, 1),
    (Kind.ZERO_PRIOR, 3, 0, 1),
    (Kind.CAMERA, -1, 4, 6),
    (Kind.POSITION_FIX, -1, 0, 4),
    (Kind.POSITION_FIX, -1, 2, 4),
    (Kind.POSE_FIX, -1, 0, 6),
    (Kind.POSE_FIX, 3, 3, 6),
    (Kind.STATE_PRIOR, -1, 0, 3),
    (Kind.STATE_PRIOR, 4, 2, 7),
]
"""(kind, slot, size of g, size of m)."""


def test_every_kernel_is_among_the_cases() -> None:
    assert {kind for kind, *_ in CASES} == set(KERNELS) == set(Kind)


def states_of(width: int) -> list[tuple[Floats, Floats]]:
    """Return pairs of keyframe states: random, at rest, on the cut of the angle, far away."""
    rng = np.random.default_rng(SEED)
    pairs = []
    for angle in ANGLES:
        for place in (0.0, 1.0, 1e5):
            xi = rng.normal(size=width)
            xi[:2] *= place
            step = np.zeros(width)
            step[:3] = rng.normal(), rng.normal(), angle
            xj = xi + rng.normal(size=width)
            xj[:3] = compose(xi[:3], step[:3])
            pairs.append((xi, xj))
        # Standing still at this heading, and turning on the spot by a hair.
        xi = np.concatenate([[1.0, -2.0, angle], np.zeros(width - 3)])
        pairs += [(xi, xi.copy()), (xi, xi + np.eye(width)[2] * 1e-5)]
    return pairs


def evaluate(
    kind: Kind, xi: Floats, xj: Floats, g: Floats, m: Floats, slot: int
) -> tuple[Floats, Floats, Floats, Floats]:
    """Call a kernel with fresh, zeroed outputs."""
    d, b = len(COMPONENTS[kind]), xi.size
    if kind == Kind.STATE_PRIOR:
        d = b + g.size
    r, ji, jj, jg = np.zeros(d), np.zeros((d, b)), np.zeros((d, b)), np.zeros((d, g.size))
    KERNELS[kind](xi, xj, g, m, slot, r, ji, jj, jg)
    return r, ji, jj, jg


def retract(x: Floats, delta: Floats) -> Floats:
    """Return x ⊕ delta: the pose composed in the body frame, zeros added."""
    moved = x + delta
    moved[:3] = compose(x[:3], delta[:3])
    return moved


def numerical(kind: Kind, function: Callable[[Floats], Floats], size: int) -> Floats:
    """Return d function / d delta at 0 by five-point differences, whole turns removed."""
    h = 1e-3
    angular = np.array(["[rad]" in c for c in COMPONENTS[kind]])
    centre = function(np.zeros(size))
    angular = np.append(angular, np.zeros(centre.size - angular.size, np.bool_))
    jacobian = np.empty((centre.size, size))
    for k in range(size):
        values = []
        for factor in (-2, -1, 1, 2):
            delta = np.zeros(size)
            delta[k] = factor * h
            change = function(delta) - centre
            values.append(np.where(angular, wrap(change), change))
        jacobian[:, k] = (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * h)
    return jacobian


def check_jacobians(kind: Kind, xi: Floats, xj: Floats, g: Floats, m: Floats, slot: int) -> None:
    """Assert that a kernel's Jacobians are what differences say at this state."""
    _, ji, jj, jg = evaluate(kind, xi, xj, g, m, slot)
    by_first = numerical(kind, lambda d: evaluate(kind, retract(xi, d), xj, g, m, slot)[0], xi.size)
    by_second = numerical(
        kind, lambda d: evaluate(kind, xi, retract(xj, d), g, m, slot)[0], xi.size
    )
    by_g = numerical(kind, lambda d: evaluate(kind, xi, xj, g + d, m, slot)[0], g.size)
    # 1e5 m away the digits of a double end at 1.5e-11 m, and differences divide by 1e-3.
    tolerance = 1e-9 * (1.0 + 1e-2 * float(np.abs(xi[:2]).max()))
    np.testing.assert_allclose(ji, by_first, atol=tolerance)
    np.testing.assert_allclose(jg, by_g, atol=tolerance)
    # Where the kernel belongs to one keyframe, this says that it does not look at the other.
    np.testing.assert_allclose(jj, by_second, atol=tolerance)
    assert kind in PAIRWISE or not jj.any()


@pytest.mark.parametrize(("kind", "slot", "g_size", "m_size"), CASES)
def test_jacobians_are_the_derivatives(kind: Kind, slot: int, g_size: int, m_size: int) -> None:
    rng = np.random.default_rng(SEED)
    for xi, xj in states_of(3 if slot < 0 else 5):
        g, m = 0.1 * rng.normal(size=g_size), rng.normal(size=m_size)
        check_jacobians(kind, xi, xj, g, m, slot)


def pose2(p: Floats) -> gtsam.Pose2:
    return gtsam.Pose2(*p[:3])


def same_pose(ours: Floats, theirs: gtsam.Pose2) -> None:
    """Assert that a residual against the zero measurement is GTSAM's pose."""
    np.testing.assert_allclose(ours[:2], [theirs.x(), theirs.y()], atol=1e-9)
    np.testing.assert_allclose(wrap(ours[2:] - theirs.theta()), 0.0, atol=1e-12)


@pytest.fixture(params=range(8))
def pair(request: pytest.FixtureRequest) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(request.param)
    return rng.normal(size=3) * [5, 5, 2], rng.normal(size=3) * [5, 5, 2]


def test_wheel_is_between_minus_the_displacement(pair: tuple[Floats, Floats]) -> None:
    xi, xj = pair
    d, j, g = np.array([0.3, -0.1, 0.2]), np.arange(6.0).reshape(3, 2) / 10, np.array([0.05, -0.2])
    m = np.concatenate([d, j.ravel()])
    r = evaluate(Kind.WHEEL, xi, xj, g, m, -1)[0]
    same_pose(r + d + j @ g, pose2(xi).between(pose2(xj)))
    assert -math.pi <= r[2] < math.pi


def test_camera_sees_the_base_motion_from_its_mount(pair: tuple[Floats, Floats]) -> None:
    xi, xj = pair
    nominal, g = np.array([0.2, -0.1, 0.5]), np.array([0.03, 0.02, -0.1, 0.04])
    mount = pose2(nominal + g[:3])
    seen = mount.inverse().compose(pose2(xi).between(pose2(xj))).compose(mount)
    scaled = gtsam.Pose2(1.04 * seen.x(), 1.04 * seen.y(), seen.theta())
    r = evaluate(Kind.CAMERA, xi, xj, g, np.concatenate([np.zeros(3), nominal]), -1)[0]
    same_pose(r, scaled)
    motion = np.array([0.5, 0.6, -1.0])
    shifted = evaluate(Kind.CAMERA, xi, xj, g, np.concatenate([motion, nominal]), -1)[0]
    np.testing.assert_allclose(wrap(r - motion)[2] - shifted[2], 0.0, atol=1e-12)
    np.testing.assert_allclose(r[:2] - motion[:2], shifted[:2], atol=1e-12)


@pytest.mark.parametrize("offset", [(), (0.05, -0.02, 0.1)])
def test_pose_fix_is_the_mounted_pose(
    pair: tuple[Floats, Floats], offset: tuple[float, ...]
) -> None:
    xi, xj = pair
    nominal, g = np.array([0.2, -0.1, 0.5]), np.array(offset)
    mount = nominal + g if offset else nominal
    r = evaluate(Kind.POSE_FIX, xi, xj, g, np.concatenate([np.zeros(3), nominal]), -1)[0]
    same_pose(r, pose2(xi).compose(pose2(mount)))


@pytest.mark.parametrize("offset", [(), (0.05, -0.02)])
def test_position_fix_is_the_mounted_point(
    pair: tuple[Floats, Floats], offset: tuple[float, ...]
) -> None:
    xi, xj = pair
    nominal, g = np.array([0.2, -0.1]), np.array(offset)
    lever = nominal + g if offset else nominal
    m = np.concatenate([[1.0, 2.0], nominal])
    r = evaluate(Kind.POSITION_FIX, xi, xj, g, m, -1)[0]
    np.testing.assert_allclose(r, pose2(xi).transformFrom(lever) - [1.0, 2.0], atol=1e-12)


def test_yaw_does_not_mind_whole_turns_but_a_gyro_does() -> None:
    none, x = np.zeros(0), np.array([0.0, 0.0, 0.1, 0.02])
    for turns in (-3, 0, 5):
        reading = np.array([0.05 + turns * 2 * math.pi, 10.0])
        r = evaluate(Kind.YAW, x, x, none, reading, 3)[0]
        assert r[0] == pytest.approx(0.07, abs=1e-12)
        # A drift of 0.001 rad/s has moved the zero by 0.01 rad after 10 s.
        r = evaluate(Kind.YAW, x, x, np.array([0.001]), reading, 3)[0]
        assert r[0] == pytest.approx(0.08, abs=1e-12)
    # 7 rad in 2 s with a bias of 0.01 rad/s: the gyro counted 7.02.
    after = x + np.array([0.0, 0.0, 7.0, 0.0])
    for bias in (0.0, 0.01):
        r = evaluate(Kind.YAW_RATE, x, after, np.array([bias]), np.array([7.02, 2.0]), -1)[0]
        assert r[0] == pytest.approx(2 * bias - 0.02, abs=1e-12)


@pytest.mark.parametrize(("kind", "slot", "g_size", "m_size"), CASES)
def test_linearise_whitens_rows_and_finds_its_keyframes(
    kind: Kind, slot: int, g_size: int, m_size: int
) -> None:
    rng = np.random.default_rng(SEED)
    width, keyframes, factors = 3 if slot < 0 else 5, 9, 6
    d = width + g_size if kind == Kind.STATE_PRIOR else len(COMPONENTS[kind])
    states, calibration = rng.normal(size=(keyframes, width)), rng.normal(size=g_size + 3)
    first = np.array([0, 7, 2, 2, 5, 3], dtype=np.int64)
    table = FactorTable(
        kind,
        "any",
        first,
        rng.normal(size=(factors, m_size)),
        rng.normal(size=(factors, d, d)),
        slice(2, 2 + g_size),
        slot=slot,
    )
    rows = linearise(table, states, calibration)
    plain = residuals(table, states, calibration)
    for k, i in enumerate(first):
        g = calibration[2 : 2 + g_size].copy()
        second = states[i + 1] if table.pairwise else states[i]
        r, ji, jj, jg = evaluate(kind, states[i], second, g, table.measurements[k], slot)
        s = table.sqrt_information[k]
        np.testing.assert_allclose(plain[k], r, atol=1e-14)
        np.testing.assert_allclose(rows.residual[k], s @ r, atol=1e-12)
        np.testing.assert_allclose(rows.by_first[k], s @ ji, atol=1e-12)
        np.testing.assert_allclose(rows.by_second[k], s @ jj, atol=1e-12)
        np.testing.assert_allclose(rows.by_calibration[k], s @ jg, atol=1e-12)
