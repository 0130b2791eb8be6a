"""The general elimination against a dense solution of the same rows."""

from __future__ import annotations

import numpy as np
import pytest

from fgloc.core.measurements import Floats
from fgloc.factors.tables import FactorTable, Kind, Linearised
from fgloc.smoothing.arrow import ChainRows
from fgloc.smoothing.marginals import sparse_marginals
from fgloc.smoothing.network import NetworkRows, gather, step_of

K, L = 7, 3


def table(
    kind: Kind, first: list[int], second: list[int] | None, calibration: slice
) -> FactorTable:
    """Return a table whose numbers do not matter: only its linearisation does."""
    m, d = len(first), 3 if kind in (Kind.SCAN_MATCH, Kind.CAMERA) else 2
    if kind == Kind.POSE_FIX:
        d = 3
    return FactorTable(
        kind,
        "any",
        np.array(first, np.int64),
        np.zeros((m, 12)),
        np.tile(np.eye(d), (m, 1, 1)),
        calibration,
        second=None if second is None else np.array(second, np.int64),
    )


def random_network(
    g: int, width: int
) -> tuple[list[tuple[FactorTable, Linearised, Floats]], Floats, Floats]:
    """Return weighted tables, prior rows, and the dense rows that they mean (N, K B + 2 L + G + 1).

    A chain, a match from the first keyframe to the last, walls seen from several.
    """
    rng = np.random.default_rng(5)
    block = slice(0, g)
    tables = [
        table(Kind.POSE_FIX, [0], None, slice(0, 0)),
        table(Kind.CAMERA, list(range(K - 1)), None, block),
        table(Kind.SCAN_MATCH, [0, 1], [K - 1, 4], slice(0, 0)),
        table(Kind.WALL, [0, 2, 2, 6, 5, 6], [0, 0, 1, 1, 2, 2], block),
    ]
    linear, dense = [], []
    for t in tables:
        m, d = t.first.size, t.dimension
        other = 2 if t.sees_landmarks else width
        used = t.calibration.stop - t.calibration.start
        lin = Linearised(
            rng.normal(size=(m, d)),
            rng.normal(size=(m, d, width)),
            rng.normal(size=(m, d, other)),
            rng.normal(size=(m, d, used)),
        )
        weight = rng.uniform(0.1, 1.0, size=m)
        linear.append((t, lin, weight))
        for k in range(m):
            rows = np.zeros((d, K * width + 2 * L + g + 1))
            i = int(t.first[k])
            rows[:, i * width : (i + 1) * width] = lin.by_first[k]
            if t.pairwise:
                rows[:, (i + 1) * width : (i + 2) * width] = lin.by_second[k]
            elif t.second is not None:
                at = int(t.second[k]) * other + (K * width if t.sees_landmarks else 0)
                rows[:, at : at + other] = lin.by_second[k]
            rows[:, K * width + 2 * L : K * width + 2 * L + used] = lin.by_calibration[k]
            rows[:, -1] = -lin.residual[k]
            dense.append(np.sqrt(weight[k]) * rows)
    if width > 3:  # what no factor of one pose sees
        extra = table(Kind.POSE_FIX, list(range(K)), None, slice(0, 0))
        lin = Linearised(
            rng.normal(size=(K, 3)),
            rng.normal(size=(K, 3, width)),
            np.zeros((K, 3, width)),
            np.zeros((K, 3, 0)),
        )
        linear.append((extra, lin, np.ones(K)))
        for k in range(K):
            rows = np.zeros((3, K * width + 2 * L + g + 1))
            rows[:, k * width : (k + 1) * width] = lin.by_first[k]
            rows[:, -1] = -lin.residual[k]
            dense.append(rows)
    prior = rng.normal(size=(g, g + 1))
    rows = np.zeros((g, K * width + 2 * L + g + 1))
    rows[:, K * width + 2 * L :] = prior
    dense.append(rows)
    return linear, prior, np.concatenate(dense)


@pytest.mark.parametrize(("g", "width"), [(0, 3), (2, 3), (3, 4)])
@pytest.mark.parametrize("damping", [0.0, 0.1])
def test_step_is_that_of_the_dense_rows(g: int, width: int, damping: float) -> None:
    linear, prior, dense = random_network(g, width)
    system = gather(linear, K, width, L, prior)
    found = step_of(system, damping, with_covariance=True)
    assert found is not None
    a, right = dense[:, :-1], dense[:, -1]
    information = a.T @ a
    if damping:
        information += damping * np.diag(np.diag(information))
    expected = np.linalg.solve(information, a.T @ right)
    flat = np.concatenate([found.step.ravel(), found.landmark_step.ravel(), found.calibration_step])
    np.testing.assert_allclose(flat, expected, atol=1e-8 * np.abs(expected).max())
    covariance = np.linalg.inv(information)
    assert found.covariance is not None
    assert found.landmark_covariance is not None
    for k in range(K):
        block = slice(k * width, (k + 1) * width)
        np.testing.assert_allclose(found.covariance[k], covariance[block, block], rtol=1e-6)
    for k in range(L):
        block = slice(K * width + 2 * k, K * width + 2 * k + 2)
        np.testing.assert_allclose(
            found.landmark_covariance[k], covariance[block, block], rtol=1e-6
        )
    assert found.calibration_covariance is not None
    last = slice(K * width + 2 * L, None)
    np.testing.assert_allclose(found.calibration_covariance, covariance[last, last], rtol=1e-6)


@pytest.mark.parametrize(("g", "width"), [(0, 3), (2, 3), (3, 4)])
def test_marginals_without_gtsam_are_those_of_the_dense_rows(g: int, width: int) -> None:
    linear, prior, dense = random_network(g, width)
    system = gather(linear, K, width, L, prior)
    assert isinstance(system, NetworkRows)
    marginals = sparse_marginals(system)
    assert marginals is not None
    information = dense[:, :-1].T @ dense[:, :-1]
    covariance = np.linalg.inv(information)
    for k in range(K):
        block = slice(k * width, (k + 1) * width)
        np.testing.assert_allclose(marginals[0][k], covariance[block, block], rtol=1e-6)
    for k in range(L):
        block = slice(K * width + 2 * k, K * width + 2 * k + 2)
        np.testing.assert_allclose(marginals[1][k], covariance[block, block], rtol=1e-6)
    last = slice(K * width + 2 * L, None)
    np.testing.assert_allclose(marginals[2], covariance[last, last], rtol=1e-6)


def test_numbers_of_very_different_weight_have_marginals() -> None:
    # Every keyframe's second number is known 10⁵ times as well as the others, which GTSAM takes
    # for indeterminate when it looks for marginals.
    linear, prior, dense = random_network(2, 3)
    sharp = np.array([1.0, 1e5, 1.0])
    for _, rows, _ in linear:
        rows.by_first[:] *= sharp
        if rows.by_second.shape[2] == 3:
            rows.by_second[:] *= sharp
    found = step_of(gather(linear, K, 3, L, prior), with_covariance=True)
    assert found is not None
    assert found.covariance is not None
    columns = np.concatenate([np.tile(sharp, K), np.ones(2 * L + 2)])
    jacobian = dense[:, :-1]
    expected = np.linalg.inv(jacobian.T @ jacobian) / np.outer(columns, columns)
    for k in range(K):
        block = slice(3 * k, 3 * k + 3)
        np.testing.assert_allclose(found.covariance[k], expected[block, block], rtol=1e-5)


def test_a_chain_stays_a_chain() -> None:
    linear, prior, _ = random_network(2, 3)
    chain = [t for t in linear if not t[0].links]
    assert isinstance(gather(chain, K, 3, 0, prior), ChainRows)
    assert isinstance(gather(linear, K, 3, L, prior), NetworkRows)


def test_a_landmark_that_nobody_sees_is_not_determined() -> None:
    linear, prior, _ = random_network(0, 3)
    assert step_of(gather(linear, K, 3, L + 1, prior)) is None
