"""The correction step against filterpy, and what Joseph's form is for."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from fgloc.core.consistency import squared_normalised
from fgloc.core.measurements import Floats
from fgloc.filters.kalman import correct, whiten


def step(x: Floats, p: Floats, h: Floats, r: Floats, v: Floats) -> tuple[float, Floats]:
    """Correct in place; return the squared distance and the whitened innovation."""
    n, d = x.size, v.size
    s, white = np.zeros((d, d)), np.zeros(d)
    squared = whiten(p, h, r, v, d, s, white)
    correct(x, p, h, r, v, d, s, np.zeros((n, d)), np.zeros((n, n)), np.zeros((n, n)))
    return squared, white


@pytest.mark.parametrize("d", [1, 2, 3])
def test_a_thousand_corrections_equal_filterpy(d: int) -> None:
    rng = np.random.default_rng(d)
    n = 5
    oracle = KalmanFilter(dim_x=n, dim_z=d)
    oracle.x = rng.standard_normal(n)
    oracle.P = np.diag(rng.uniform(0.1, 2.0, n))
    x, p = oracle.x.copy(), oracle.P.copy()
    for _ in range(1000):
        h = rng.standard_normal((d, n))
        root = rng.standard_normal((d, d))
        r = root @ root.T + 0.1 * np.eye(d)
        z = rng.standard_normal(d)
        before, innovation = p.copy(), z - h @ x
        squared, white = step(x, p, h, r, innovation)
        assert squared == pytest.approx(squared_normalised(innovation, h @ before @ h.T + r))
        assert white @ white == pytest.approx(squared)
        oracle.update(z, R=r, H=h)
        # A little process noise keeps the gains alive.
        oracle.P += 0.01 * np.eye(n)
        p += 0.01 * np.eye(n)
        np.testing.assert_allclose(x, oracle.x, rtol=0, atol=1e-9)
        np.testing.assert_allclose(p, oracle.P, rtol=0, atol=1e-9)


def test_joseph_stays_positive_where_the_short_form_does_not() -> None:
    # Two nearly equal, nearly exact measurements of a vague state: (I - K H) P loses all digits.
    h = np.array([[1.0, 1.0], [1.0, 1.0 + 1e-4]])
    r = 1e-10 * np.eye(2)
    x, p = np.zeros(2), np.diag([1e4, 1e4])
    short, worst = p.copy(), 0.0
    for _ in range(200):
        gain = short @ h.T @ np.linalg.inv(h @ short @ h.T + r)
        short = (np.eye(2) - gain @ h) @ short
        worst = min(worst, np.linalg.eigvalsh(0.5 * (short + short.T)).min())
        step(x, p, h, r, np.zeros(2))
        assert np.linalg.eigvalsh(p).min() > 0.0
        np.testing.assert_array_equal(p, p.T)
    assert worst < 0.0


def test_an_impossible_noise_is_noticed() -> None:
    s, white = np.zeros((1, 1)), np.zeros(1)
    h, p = np.array([[1.0, 0.0]]), np.eye(2)
    assert np.isnan(whiten(p, h, np.array([[-2.0]]), np.ones(1), 1, s, white))
    assert np.isnan(whiten(p * np.nan, h, np.eye(1), np.ones(1), 1, s, white))
