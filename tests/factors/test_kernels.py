"""Every residual kernel against finite differences, and tables against dense whitening."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from fgloc.core.geometry import compose, wrap
from fgloc.core.measurements import Floats
from fgloc.errors import FglocError
from fgloc.factors.tables import (
    COMPONENTS,
    KERNELS,
    LANDMARK,
    LINKING,
    PAIRWISE,
    FactorTable,
    Kind,
    linearise,
    residuals,
)

from .calls import dimension, evaluate

SEED = 11
ANGLES = (0.0, 1e-5, -1e-5, 1e-9, 0.7, math.pi, -math.pi, math.pi - 1e-6, 4.0, -25.0)
"""Headings at which a Jacobian is easily wrong: none, tiny, on the cut, beyond it, many turns."""

MOUNT = np.array([1.0, -0.5, 0.0])
"""Where a sensor of points sits, so that a landmark can be put right there."""

DIAGONAL = np.array([0.6, -0.8])

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
    (Kind.CAMERA, -1, 4, 9),
    (Kind.POSITION_FIX, -1, 0, 4),
    (Kind.POSITION_FIX, -1, 2, 4),
    (Kind.POSE_FIX, -1, 0, 6),
    (Kind.POSE_FIX, 3, 3, 6),
    (Kind.STATE_PRIOR, -1, 0, 6),
    (Kind.STATE_PRIOR, 4, 2, 14),
    (Kind.WALL, -1, 0, 8),
    (Kind.WALL, 3, 3, 8),
    (Kind.RANGE_BEARING, -1, 0, 5),
    (Kind.RANGE_BEARING, 3, 3, 5),
    (Kind.CALIBRATION_WALK, -1, 0, 1),
    (Kind.CALIBRATION_WALK, 3, 0, 1),
    (Kind.ZERO_VELOCITY, -1, 0, 1),
    (Kind.ZERO_VELOCITY, 3, 0, 1),
    (Kind.WHEEL_SLIP, 3, 0, 9),
    (Kind.WHEEL_SLIP, 3, 4, 21),
    (Kind.SLIP_PRIOR, 4, 0, 1),
    (Kind.SLIP_SIDE, 4, 0, 1),
    (Kind.SLIP_WALK, 4, 0, 1),
    (Kind.WHEEL_REDUNDANCY, 3, 0, 8),
    (Kind.WHEEL_REDUNDANCY, 3, 2, 8),
    (Kind.SCAN_MATCH, -1, 0, 6),
    (Kind.SCAN_MATCH, 3, 3, 6),
    (Kind.LANDMARK_PRIOR, -1, 0, 2),
    (Kind.LANDMARK_PRIOR, 3, 0, 2),
]
"""(kind, slot, size of g, size of m)."""


def test_every_kernel_is_among_the_cases() -> None:
    assert {kind for kind, *_ in CASES} == set(KERNELS) == set(Kind)


def second_of(kind: Kind, xi: Floats, xj: Floats) -> list[Floats]:
    """Return what a kind's second state may be, given a pair of keyframes.

    Walls through the map's origin and the anchor, and far from both; points at the sensor, a
    tenth of a millimetre and a centimetre off it, and elsewhere.
    """
    if kind == Kind.WALL:
        return [np.array([xj[2], offset]) for offset in (0.0, 1e-5, -3.0, 1e4)]
    if kind == Kind.LANDMARK_PRIOR:
        return [xj[:2]]
    if kind == Kind.RANGE_BEARING:
        sensor = compose(xi[:3], MOUNT)[:2]
        if np.abs(xi[:2]).max() > 1e3:  # where a double has no digits for such distances
            return [xj[:2].copy()]
        return [sensor, sensor + DIAGONAL * 1e-4, sensor - DIAGONAL * 1e-2, xj[:2].copy()]
    return [xj]


def measurements_of(kind: Kind, xi: Floats, xj: Floats, size: int) -> list[Floats]:
    """Return measurement rows: any, and those a kind finds awkward."""
    m = np.random.default_rng(SEED).normal(size=size)
    if kind == Kind.WALL:
        near = m.copy()
        near[3:5] = xi[:2] + m[3:5]
        # An anchor at the origin, so that the wall of offset 0 goes through it.
        return [near, np.concatenate([m[:3], [0.0, 0.0], m[5:]])]
    if kind == Kind.RANGE_BEARING:
        return [np.concatenate([m[:2], MOUNT[:2], m[4:]])]
    if kind == Kind.WHEEL_REDUNDANCY:
        # Which variable is the radius of each of the two wheels: either, both, none.
        return [np.append(m[:6], index) for index in ((1, 0), (1, 1), (-1, 0), (-1, -1))]
    if kind == Kind.SLIP_SIDE:
        return [np.array([side]) for side in (-1.0, 0.0, 0.3, 1.0)]
    return [m]


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


def retract(kind: Kind, x: Floats, delta: Floats) -> Floats:
    """Return x ⊕ delta: a pose composed in the body frame, all else added."""
    moved = x + delta
    if x.size > 2 and kind != Kind.CALIBRATION_WALK:
        moved[:3] = compose(x[:3], delta[:3])
    return moved


def numerical(kind: Kind, function: Callable[[Floats], Floats], size: int, h: float) -> Floats:
    """Return d function / d delta at 0 by five-point differences, whole turns removed."""
    angular = np.array(["[rad]" in c for c in COMPONENTS[kind]], np.bool_)
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


def step_of(kind: Kind, xi: Floats, xj: Floats, g: Floats) -> float:
    """Return over how much to take differences: near a point its bearing turns
    quickly, and near no slip the side that is unlikely."""
    if kind == Kind.SLIP_SIDE:
        return 1e-4
    if kind != Kind.RANGE_BEARING:
        return 1e-3
    mount = MOUNT + g if g.size else MOUNT
    distance = float(np.linalg.norm(xj - compose(xi[:3], mount)[:2]))
    return 1e-12 if distance < 1e-9 else 1e-3 * min(1.0, distance)


def check_jacobians(kind: Kind, xi: Floats, xj: Floats, g: Floats, m: Floats, slot: int) -> None:
    """Assert that a kernel's Jacobians are what differences say at this state."""
    h = step_of(kind, xi, xj, g)
    r, ji, jj, jg = evaluate(kind, xi, xj, g, m, slot)
    assert np.isfinite(r).all()

    def moved(first: Floats, second: Floats, third: Floats) -> Floats:
        one, two = retract(kind, xi, first), retract(kind, xj, second)
        return evaluate(kind, one, two, g + third, m, slot)[0]

    o, p, q = np.zeros(xi.size), np.zeros(xj.size), np.zeros(g.size)
    by_first = numerical(kind, lambda d: moved(d, p, q), xi.size, h)
    by_second = numerical(kind, lambda d: moved(o, d, q), xj.size, h)
    by_g = numerical(kind, lambda d: moved(o, p, d), g.size, h)
    # 1e5 m away the digits of a double end at 1.5e-11 m, and differences divide by h.
    largest = max(float(np.abs(xi[:2]).max()), float(np.abs(xj[:2]).max()))
    # Beside a point, where bearings turn by hundreds of radians a metre, 1e-5 is as sharp.
    tolerance = min(1e-9 * (1.0 + 1e-2 * largest) * 1e-3 / h, max(1e-5, 1e-11 * largest))
    np.testing.assert_allclose(ji, by_first, atol=tolerance, rtol=1e-6)
    np.testing.assert_allclose(jg, by_g, atol=tolerance, rtol=1e-6)
    # Where the kernel belongs to one keyframe, this says that it does not look at the other.
    np.testing.assert_allclose(jj, by_second, atol=tolerance, rtol=1e-6)
    assert kind in PAIRWISE | LINKING or not jj.any()


@pytest.mark.parametrize(("kind", "slot", "g_size", "m_size"), CASES)
def test_jacobians_are_the_derivatives(kind: Kind, slot: int, g_size: int, m_size: int) -> None:
    rng = np.random.default_rng(SEED)
    for xi, xj in states_of(3 if slot < 0 else 5):
        # A sensor exactly where it should be, so that a landmark can be exactly there.
        exact = kind == Kind.RANGE_BEARING and bool(rng.integers(2))
        g = (0.0 if exact else 0.1) * rng.normal(size=g_size)
        for second in second_of(kind, xi, xj):
            for m in measurements_of(kind, xi, xj, m_size):
                if kind == Kind.WHEEL_REDUNDANCY and not g_size:
                    m[6:] = -1.0
                check_jacobians(kind, xi, second, g, m, slot)


@pytest.mark.parametrize(("kind", "slot", "g_size", "m_size"), CASES)
def test_linearise_whitens_rows_and_finds_its_keyframes(
    kind: Kind, slot: int, g_size: int, m_size: int
) -> None:
    rng = np.random.default_rng(SEED)
    width, keyframes, factors = 3 if slot < 0 else 5, 9, 6
    d = dimension(kind, width, g_size)
    states, calibration = rng.normal(size=(keyframes, width)), rng.normal(size=g_size + 3)
    first = np.array([0, 7, 2, 2, 5, 3], dtype=np.int64)
    landmarks = rng.normal(size=(4, 2)) if kind in LANDMARK else None
    seen = np.array([3, 0, 0, 1, 3, 2], dtype=np.int64)
    measurements = rng.normal(size=(factors, m_size))
    if kind == Kind.WHEEL_REDUNDANCY:
        measurements[:, 6:] = g_size - 1
    table = FactorTable(
        kind,
        "any",
        first,
        measurements,
        # From next to nothing known to a nanometre: none may drown or overflow.
        rng.normal(size=(factors, d, d)) * 10.0 ** np.array([0, -150, -9, 9, 0, 3])[:, None, None],
        slice(2, 2 + g_size),
        slot=slot,
        second=seen if kind in LINKING else None,
    )
    rows = linearise(table, states, calibration, landmarks)
    plain = residuals(table, states, calibration, landmarks)
    for k, i in enumerate(first):
        g = calibration[2 : 2 + g_size].copy()
        second = states[i + 1] if table.pairwise else states[i]
        if kind == Kind.SCAN_MATCH:
            second = states[seen[k]]
        if landmarks is not None:
            second = landmarks[seen[k]]
        r, ji, jj, jg = evaluate(kind, states[i], second, g, table.measurements[k], slot)
        s = table.sqrt_information[k]
        np.testing.assert_allclose(plain[k], r, atol=1e-14)
        np.testing.assert_allclose(rows.residual[k], s @ r, atol=1e-12 * np.abs(s).max())
        np.testing.assert_allclose(rows.by_first[k], s @ ji, atol=1e-12 * np.abs(s).max())
        np.testing.assert_allclose(rows.by_second[k], s @ jj, atol=1e-12 * np.abs(s).max())
        np.testing.assert_allclose(rows.by_calibration[k], s @ jg, atol=1e-12 * np.abs(s).max())


def test_landmark_tables_say_which_and_others_none() -> None:
    first = np.zeros(2, dtype=np.int64)
    root, empty = np.tile(np.eye(2), (2, 1, 1)), slice(0, 0)
    with pytest.raises(FglocError, match="lidar: a WALL table needs second indices"):
        FactorTable(Kind.WALL, "lidar", first, np.zeros((2, 8)), root, empty)
    with pytest.raises(FglocError, match="a POSITION_FIX table has no use for second indices"):
        FactorTable(Kind.POSITION_FIX, "gnss", first, np.zeros((2, 4)), root, empty, second=first)
    table = FactorTable(Kind.WALL, "lidar", first, np.zeros((2, 8)), root, empty, second=first)
    with pytest.raises(FglocError, match=r"lidar: .* none were given"):
        linearise(table, np.zeros((1, 3)), np.zeros(0))
