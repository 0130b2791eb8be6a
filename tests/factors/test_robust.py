"""Robust losses: weights are the derivatives of the costs, and both have the right limits."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from fgloc.errors import FglocError
from fgloc.factors.robust import FAINT, LOSSES, PLAIN, Graduated, Loss, LossName, graduated

NAMES = LOSSES
FLOORED = ("tukey", "geman-mcclure", "truncated")
"""Losses whose weight would end at nothing; it is kept at a trace."""
S = np.array([0.01, 0.1, 0.5, 1.0, 1.9, 2.1, 3.0, 5.0, 20.0, 1e3])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("k", [0.5, 2.0, 4.0])
def test_weight_is_twice_the_slope_over_the_squared_norm(name: LossName, k: float) -> None:
    smooth = S[k != S] if name == "truncated" else S  # its cost has a corner at k
    loss, squared = Loss(name, k), smooth * smooth
    h = 1e-5 * squared + 1e-7
    slope = (loss.cost(squared + h) - loss.cost(squared - h)) / (2.0 * h)
    # d rho / d(s²) = rho'(s) / (2 s), so twice that is the weight.
    expected = np.maximum(2.0 * slope, FAINT if name in FLOORED else 0.0)
    np.testing.assert_allclose(loss.weight(squared), expected, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("name", NAMES)
def test_small_residuals_are_plain_least_squares(name: LossName) -> None:
    squared = np.array([0.0, 1e-12, 1e-6])
    np.testing.assert_allclose(Loss(name).weight(squared), 1.0, atol=1e-6)
    np.testing.assert_allclose(Loss(name).cost(squared), 0.5 * squared, rtol=1e-6, atol=1e-14)


def test_large_residuals_pull_as_the_loss_promises() -> None:
    k, far = 3.0, 1e6
    s = np.array([far])
    # Pull = weight times s. Plain: grows with s; Huber: stays k; Cauchy: k²/s; others: a trace.
    pull = {n: float((Loss(n, k).weight(s * s) * s)[0]) for n in NAMES}
    assert pull["none"] == far
    assert pull["huber"] == pytest.approx(k, rel=1e-12)
    assert pull["cauchy"] == pytest.approx(k * k / far, rel=1e-6)
    for name in FLOORED:
        assert pull[name] == pytest.approx(FAINT * far, rel=1e-12)
    assert FAINT < 1e-4
    cost = {n: float(Loss(n, k).cost(s * s)[0]) for n in NAMES}
    assert cost["none"] == 0.5 * far * far
    assert cost["huber"] == pytest.approx(k * far - k * k / 2, rel=1e-12)
    assert cost["cauchy"] == pytest.approx(k * k * np.log(far / k), rel=1e-6)
    assert cost["tukey"] == pytest.approx(k * k / 6)
    assert cost["geman-mcclure"] == pytest.approx(k * k / 2)
    assert cost["truncated"] == pytest.approx(k * k / 2)


def test_losses_are_gtsams_estimators() -> None:
    m = gtsam.noiseModel.mEstimator
    for loss, theirs in (
        (Loss("huber", 2.5), m.Huber.Create(2.5)),
        (Loss("cauchy", 1.5), m.Cauchy.Create(1.5)),
        (Loss("tukey", 4.5), m.Tukey.Create(4.5)),
        (Loss("geman-mcclure", 1.7), m.GemanMcClure.Create(1.7)),
    ):
        squared = S * S
        floor = FAINT if loss.name in FLOORED else 0.0
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
    with pytest.raises(FglocError, match=r"'welsch' must be none, .* or truncated"):
        Loss("welsch")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("mu", "s", "cost", "weight"),
    [
        # Parabola up to s² = mu/(mu+1) k², half of Yang's r²; with k = 2 and mu = 1 that is 2.
        (1.0, 1.0, 0.5, 1.0),
        # Between: half of 2 k s sqrt(mu(mu+1)) - mu(k²+s²); weight k/s sqrt(mu(mu+1)) - mu.
        (1.0, 2.0, 2.0 * 2.0 * np.sqrt(2.0) - 4.0, np.sqrt(2.0) - 1.0),
        # Beyond (mu+1)/mu k² = 8: constant.
        (1.0, 3.0, 2.0, FAINT),
        # mu = 1/8 is their sqrt(9/64) = 3/8: from s² = 4/9 to 36.
        (0.125, 4.0, 2.0 * 4.0 * 0.375 - 0.0625 * 20.0, 0.5 * 0.375 - 0.125),
        (0.125, 6.0, 2.0, FAINT),
    ],
)
def test_a_truncated_parabola_is_bent_as_worked_by_hand(
    mu: float, s: float, cost: float, weight: float
) -> None:
    loss, squared = Graduated("truncated", 2.0, mu), np.array([s * s])
    assert loss.cost(squared)[0] == pytest.approx(cost, rel=1e-12)
    assert loss.weight(squared)[0] == pytest.approx(weight, rel=1e-12)


def test_geman_mcclure_is_graduated_as_worked_by_hand() -> None:
    # Yang's mu k² s² / (mu k² + s²) with k = 2, mu = 3, s² = 24: 8, here halved; weight (1/3)².
    loss = Graduated("geman-mcclure", 2.0, 3.0)
    assert loss.cost(np.array([24.0]))[0] == pytest.approx(4.0)
    assert loss.weight(np.array([24.0]))[0] == pytest.approx(1.0 / 9.0)


@pytest.mark.parametrize("name", ["cauchy", "tukey", "geman-mcclure", "truncated"])
@pytest.mark.parametrize("mu", [0.03, 1.0, 7.0])
def test_a_graduated_weight_belongs_to_its_cost(name: LossName, mu: float) -> None:
    loss, squared = Graduated(name, 1.5, mu), S * S
    h = 1e-5 * squared + 1e-7
    slope = (loss.cost(squared + h) - loss.cost(squared - h)) / (2.0 * h)
    expected = np.maximum(2.0 * slope, FAINT if name in FLOORED else 0.0)
    np.testing.assert_allclose(loss.weight(squared), expected, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("name", ["cauchy", "tukey", "geman-mcclure", "truncated"])
def test_graduation_starts_convex_and_ends_at_the_loss(name: LossName) -> None:
    final, s = Loss(name, 2.0), np.linspace(0.0, 60.0, 601)
    loss = graduated(final, s * s)
    assert isinstance(loss, Graduated)
    bend = np.diff(loss.cost(s * s), 2)
    # No bend downwards anywhere; the truncated parabola has a slight one by construction.
    assert bend.min() > (-0.01 * bend.max() if name == "truncated" else -1e-9)
    assert np.diff(final.cost(s * s), 2).min() < -0.01 * bend.max()
    rounds = 0
    while not loss.finished(s * s):
        loss, rounds = loss.sharper(), rounds + 1
        assert rounds < 50
    clear = np.abs(s - 2.0) > 0.01
    np.testing.assert_allclose(loss.weight(s * s)[clear], final.weight(s * s)[clear], rtol=1e-12)
    assert loss.sharp == final


def test_nothing_to_graduate_is_left_alone() -> None:
    far, near = np.array([0.1, 1e6]), np.array([0.0, 0.3])
    for name in ("none", "huber"):
        assert graduated(Loss(name), far) == Loss(name)
    for name in ("cauchy", "tukey", "geman-mcclure", "truncated"):
        assert graduated(Loss(name), near) == Loss(name)
        assert graduated(Loss(name), np.zeros(0)) == Loss(name)
    with pytest.raises(FglocError, match="mu must be positive"):
        Graduated("tukey", 3.0, 0.0)


def test_graduation_finds_the_line_that_most_points_lie_on() -> None:
    rng = np.random.default_rng(4)
    x = np.linspace(-1.0, 1.0, 60)
    y = 1.0 + 2.0 * x + 0.01 * rng.normal(size=x.size)
    y[5:55:2] = -3.0 + rng.normal(size=25)  # 42 % strays, all to one side
    design = np.stack([np.ones_like(x), x], axis=1)

    def fit(weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        root = np.sqrt(weight)
        line = np.linalg.lstsq(design * root[:, None], y * root, rcond=None)[0]
        return line, ((design @ line - y) / 0.01) ** 2

    plain, squared = fit(np.ones_like(x))
    for name in ("tukey", "geman-mcclure", "truncated"):
        loss = graduated(Loss(name, 3.0), squared)
        assert isinstance(loss, Graduated)
        line, now = fit(loss.weight(squared))
        while not loss.finished(now):
            loss = loss.sharper()
            line, now = fit(loss.weight(now))
        np.testing.assert_allclose(line, [1.0, 2.0], atol=0.02)
    # Without graduation the same loss cannot let go of where it starts.
    assert np.abs(plain - [1.0, 2.0]).max() > 0.5
