"""Bundles of rows as gtsam factors: Jacobians by differences of what GTSAM itself is given."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace

import gtsam
import numpy as np
import pytest

from fgloc.core.measurements import Floats
from fgloc.errors import FglocError
from fgloc.factors.gtsam_factors import Bundle, Row, rows_of
from fgloc.factors.robust import Loss
from fgloc.factors.tables import FactorTable, Kind, linearise

X, C, L = 0, 100, 200
"""First keys of keyframes, calibration, landmarks."""
STATES = np.array([[4.0, -3.0, 2.5, 0.1], [4.2, -2.7, 2.9, 0.15], [4.1, -2.3, 3.3, 0.12]])
CALIBRATION = np.array([0.02, -0.03, 0.05, 0.04, 0.01])
LANDMARKS = np.array([[2.0, 1.0], [0.4, 0.2], [-5.0, 3.0]])


def table(
    kind: Kind, first: int, size: int, d: int, block: slice, slot: int = -1, second: int = -1
) -> FactorTable:
    """Return a table of one row with arbitrary numbers of the right shapes."""
    rng = np.random.default_rng(int(kind) + 17)
    return FactorTable(
        kind,
        kind.name,
        np.array([first], np.int64),
        rng.normal(size=(1, size)),
        rng.normal(size=(1, d, d)) + 3.0 * np.eye(d),
        block,
        slot=slot,
        second=np.array([second], np.int64) if second >= 0 else None,
    )


ALL = slice(0, 0)
WHEEL = table(Kind.WHEEL, 1, 3 + 9, 3, slice(0, 3))
FIX = table(Kind.POSITION_FIX, 2, 4, 2, slice(3, 5))
SINGLE: dict[str, list[FactorTable]] = {
    "wheel": [WHEEL],
    "wheel without calibration": [table(Kind.WHEEL, 1, 3, 3, ALL)],
    "yaw with drifting zero": [table(Kind.YAW, 2, 2, 1, ALL, slot=3)],
    "yaw rate": [table(Kind.YAW_RATE, 1, 2, 1, slice(4, 5))],
    "zero walk": [table(Kind.ZERO_WALK, 1, 1, 1, ALL, slot=3)],
    "fix": [FIX],
    "pose fix": [table(Kind.POSE_FIX, 2, 6, 3, ALL)],
    "joint prior": [table(Kind.STATE_PRIOR, 2, 18, 9, slice(0, 5))],
    "camera": [table(Kind.CAMERA, 1, 9, 3, slice(1, 5))],
    "standing still": [table(Kind.ZERO_VELOCITY, 1, 3, 3, ALL)],
    "wall": [table(Kind.WALL, 2, 8, 2, ALL, second=1)],
    "point": [table(Kind.RANGE_BEARING, 2, 5, 2, slice(0, 3), second=2)],
}
BUNDLES = SINGLE | {
    "an interval": [WHEEL, table(Kind.YAW, 2, 2, 1, ALL, slot=3), FIX],
    "interval and landmarks": [
        WHEEL,
        table(Kind.WALL, 2, 8, 2, ALL, second=1),
        table(Kind.RANGE_BEARING, 2, 5, 2, ALL, second=2),
        replace(table(Kind.WALL, 2, 8, 2, ALL, second=1), sensor="again"),
    ],
}


def bundle_of(tables: list[FactorTable], weights: Floats | None = None) -> Bundle:
    w = np.ones(len(tables)) if weights is None else weights
    bundle = Bundle([Row(t, 0, float(w[k])) for k, t in enumerate(tables)])
    frames = [X + k for k in range(bundle.first, bundle.last + 1)]
    bundle.attach(frames, C, [L + i for i in bundle.landmarks], CALIBRATION.size)
    return bundle


def values_of(states: Floats, u: Floats, landmarks: Floats) -> gtsam.Values:
    values = gtsam.Values()
    for begin, block in ((X, states), (L, landmarks)):
        for k, vector in enumerate(block):
            values.insert(begin + k, vector)
    values.insert(C, u)
    return values


def system(bundle: Bundle, states: Floats, u: Floats, landmarks: Floats) -> tuple[Floats, Floats]:
    """Return Jacobian and residual as GTSAM linearised them, columns in the order of the keys."""
    a, b = bundle.factor.linearize(values_of(states, u, landmarks)).jacobian()
    return np.asarray(a), -np.asarray(b)


@pytest.mark.parametrize("name", BUNDLES)
def test_jacobians_are_what_adding_to_the_variables_changes(name: str) -> None:
    weights = np.array([1.0, 0.3, 0.7, 0.2])[: len(BUNDLES[name])]
    bundle = bundle_of(BUNDLES[name], weights)
    jacobian, _ = system(bundle, STATES, CALIBRATION, LANDMARKS)
    columns = []
    for key in bundle.factor.keys():  # noqa: SIM118 - a method of gtsam's
        blocks = [STATES.copy(), CALIBRATION.copy(), LANDMARKS.copy()]
        which = 2 if key >= L else 1 if key >= C else 0
        variable = blocks[which] if which == 1 else blocks[which][key - (X, C, L)[which]]
        for n in range(variable.size):
            ends, h = [], 1e-6
            for sign in (1.0, -1.0):
                variable[n] += sign * h
                ends.append(system(bundle, *blocks)[1])
                variable[n] -= sign * h
            columns.append((ends[0] - ends[1]) / (2.0 * h))
    np.testing.assert_allclose(jacobian, np.array(columns).T, atol=2e-7 * np.abs(jacobian).max())


@pytest.mark.parametrize("name", BUNDLES)
def test_the_error_is_that_of_the_tables_and_weights(name: str) -> None:
    tables = BUNDLES[name]
    weights = np.array([0.5, 0.3, 0.7, 0.2])[: len(tables)]
    bundle = bundle_of(tables, weights)
    squared = np.array([linearise(t, STATES, CALIBRATION, LANDMARKS).squared[0] for t in tables])
    error = bundle.factor.error(values_of(STATES, CALIBRATION, LANDMARKS))
    assert error == pytest.approx(0.5 * float(weights @ squared), rel=1e-12)
    seen = LANDMARKS[list(bundle.landmarks)]
    first, last = STATES[bundle.first], STATES[bundle.last]
    np.testing.assert_allclose(bundle.squared(first, last, CALIBRATION, seen), squared, rtol=1e-12)


def test_a_wheel_row_says_what_gtsams_own_between_factor_says() -> None:
    # Where the residual is small, its logarithm is the residual itself, turned by the motion.
    motion, sigma = np.array([0.3, 0.1, 0.4]), np.array([0.01, 0.01, 0.03])
    wheel = FactorTable(
        Kind.WHEEL, "w", np.array([1]), motion[None], np.diag(1 / sigma)[None], slice(0, 0)
    )
    start = gtsam.Pose2(*STATES[1, :3])
    end = start.compose(gtsam.Pose2(*(motion + np.array([2e-6, -1e-6, 3e-6]))))
    states = STATES.copy()
    states[2, :3] = end.x(), end.y(), end.theta()
    poses = gtsam.Values()
    poses.insert(1, start)
    poses.insert(2, end)
    noise = gtsam.noiseModel.Diagonal.Sigmas(sigma)
    native = gtsam.BetweenFactorPose2(1, 2, gtsam.Pose2(*motion), noise)
    ours = bundle_of([wheel]).factor
    expected = native.error(poses)
    assert expected > 1e-9
    assert ours.error(values_of(states, CALIBRATION, LANDMARKS)) == pytest.approx(
        expected, rel=1e-4
    )


def test_new_weights_are_those_of_the_losses() -> None:
    bundle = bundle_of([replace(WHEEL, loss=Loss("cauchy", 2.0)), FIX])
    assert bundle.robust
    np.testing.assert_allclose(bundle.new_weights(np.array([12.0, 50.0])), [0.25, 1.0])
    assert not bundle_of([FIX]).robust


def test_a_bundle_is_freed_with_its_last_reference() -> None:
    bundle = bundle_of([WHEEL, FIX])
    system(bundle, STATES, CALIBRATION, LANDMARKS)
    gone, data = weakref.ref(bundle), weakref.ref(bundle.weights)
    del bundle
    gc.collect()
    assert gone() is None
    assert data() is None


def test_rows_of_two_keyframes_are_no_bundle() -> None:
    with pytest.raises(FglocError, match="one keyframe"):
        Bundle([*rows_of(WHEEL), *rows_of(table(Kind.POSE_FIX, 1, 6, 3, ALL))])
