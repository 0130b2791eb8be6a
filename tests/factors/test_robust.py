"""Robust losses: weights are the derivatives of the costs, and both have the right limits."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from fgloc.errors import FglocError
from fgloc.factors.robust import FAINT, PLAIN, Loss, LossName

NAMES: tuple[LossName, ...] = ("none", "huber", "cauchy", "tukey")
S = np.array([0.01, 0.1, 0.5, 1.0, 1.9, 2.1, 3.0, 5.0, 20.0, 1e3])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("k", [0.5, 2.0, 4.0])
def test_weight_is_twice_the_slope_over_the_squared_norm(name: LossName, k: float) -> None:
    loss, squared = Loss(name, k), S * S
    h = 1e-5 * squared + 1e-7
    slope = (loss.cost(squared + h) - loss.cost(squared - h)) / (2.0 * h)
    # d rho / d(s²) = rho'(s) / (2 s), so twice that is the weight; Tukey's, which would
    # end at nothing, is kept at a trace.
    expected = np.maximum(2.0 * slope, FAINT if name == "tukey" else 0.0)
    np.testing.assert_allclose(loss.weight(squared), expected, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("name", NAMES)
def test_small_residuals_are_plain_least_squares(name: LossName) -> None:
    squared = np.array([0.0, 1e-12, 1e-6])
    np.testing.assert_allclose(Loss(name).weight(squared), 1.0, atol=1e-6)
    np.testing.assert_allclose(Loss(name).cost(squared), 0.5 * squared, rtol=1e-6, atol=1e-14)


def test_large_residuals_pull_as_the_loss_promises() -> None:
    k, far = 3.0, 1e6
    s = np.array([far])
    # Pull = weight times s. Plain: grows with s; Huber: stays k; Cauchy: k²/s; Tukey: a trace.
    pull = {n: float((Loss(n, k).weight(s * s) * s)[0]) for n in NAMES}
    assert pull["none"] == far
    assert pull["huber"] == pytest.approx(k, rel=1e-12)
    assert pull["cauchy"] == pytest.approx(k * k / far, rel=1e-6)
    assert pull["tukey"] == pytest.approx(FAINT * far, rel=1e-12)
    assert FAINT < 1e-4
    cost = {n: float(Loss(n, k).cost(s * s)[0]) for n in NAMES}
    assert cost["none"] == 0.5 * far * far
    assert cost["huber"] == pytest.approx(k * far - k * k / 2, rel=1e-12)
    assert cost["cauchy"] == pytest.approx(k * k * np.log(far / k), rel=1e-6)
    assert cost["tukey"] == pytest.approx(k * k / 6)


def test_losses_are_gtsams_estimators() -> None:
    m = gtsam.noiseModel.mEstimator
    for loss, theirs in (
        (Loss("huber", 2.5), m.Huber.Create(2.5)),
        (Loss("cauchy", 1.5), m.Cauchy.Create(1.5)),
        (Loss("tukey", 4.5), m.Tukey.Create(4.5)),
    ):
        squared = S * S
        floor = FAINT if loss.name == "tukey" else 0.0
        weights = np.maximum([theirs.weight(s) for s in S], floor)
        np.testing.assert_allclose(loss.weight(squared), weights, rtol=1e-9)
        np.testing.assert_allclose(loss.cost(squared), [theirs.loss(s) for s in S], rtol=1e-9)


def test_shape_is_kept_and_plain_is_the_default() -> None:
    assert Loss() == PLAIN
    assert PLAIN.name == "none"
    squared = np.arange(6.0).reshape(2, 3)
    for name in NAMES:
        assert Loss(name).cost(squared).shape == (2, 3)
        assert Loss(name).weight(squared).shape == (2, 3)


@pytest.mark.parametrize("k", [0.0, -1.0, float("nan")])
def test_a_width_must_be_positive(k: float) -> None:
    with pytest.raises(FglocError, match="width of a robust loss must be positive"):
        Loss("huber", k)


def test_an_unknown_loss_is_named() -> None:
    with pytest.raises(FglocError, match="'welsch' must be none, huber, cauchy or tukey"):
        Loss("welsch")  # type: ignore[arg-type]
