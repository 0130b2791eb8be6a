"""The angle a gyro turned, as it is known at the time."""

from __future__ import annotations

import numpy as np

from fgloc.core.measurements import Floats, Stamps, YawRate
from fgloc.filters.causal_gyro import turned_so_far


def ns(seconds: list[float] | Floats) -> Stamps:
    return np.round(np.asarray(seconds) * 1e9).astype(np.int64)


def test_trapezoid_to_the_last_reading_then_held() -> None:
    gyro = YawRate("gyro", ns([0.0, 0.1, 0.2, 0.3]), np.array([1.0, 3.0, 5.0, 5.0]), 0.01)
    turned, heard = turned_so_far(gyro, ns([0.0, 0.15, 0.25, 0.3]))
    # To 0.15: 0.2 by the trapezoid and 0.05 s at 3 rad/s: 0.35. To 0.25: 0.2 + 0.4 and 0.05 s at 5:
    # 0.85. To 0.3: 0.2 + 0.4 + 0.5 = 1.1.
    np.testing.assert_allclose(np.cumsum(turned), [0.35, 0.85, 1.1])
    assert heard.all()


def test_what_comes_later_changes_nothing() -> None:
    rng = np.random.default_rng(0)
    stamps = np.cumsum(rng.integers(1_000_000, 60_000_000, 300)).astype(np.int64)
    gyro = YawRate("gyro", stamps, rng.standard_normal(300), 0.01)
    cuts = np.arange(0, int(stamps[-1]), 37_000_000, dtype=np.int64)
    turned, heard = turned_so_far(gyro, cuts)
    for k in (20, 60, 110):
        known = stamps <= cuts[k]
        early = YawRate("gyro", stamps[known], gyro.rate[known], 0.01)
        some, some_heard = turned_so_far(early, cuts[: k + 1])
        np.testing.assert_allclose(some, turned[:k], rtol=0, atol=1e-12)
        np.testing.assert_array_equal(some_heard, heard[:k])


def test_silence_is_not_bridged() -> None:
    # Readings of 1 rad/s until 1 s and from 3 s on.
    t = np.concatenate([np.arange(0, 1.001, 0.1), np.arange(3, 4.001, 0.1)])
    gyro = YawRate("gyro", ns(t), np.ones(t.size), 0.01)
    cuts = ns(np.arange(0, 4.5, 0.25))
    turned, heard = turned_so_far(gyro, cuts)
    # The rate is held up to 1.5 s and heard again from 3.0 s on.
    expected = (cuts[1:] <= ns([1.5])[0]) | (cuts[:-1] >= ns([3.0])[0])
    np.testing.assert_array_equal(heard, expected)
    np.testing.assert_allclose(turned[heard], 0.25)


def test_no_readings_and_one() -> None:
    cuts = ns([0.0, 1.0, 2.0])
    none = YawRate("gyro", ns([]), np.zeros(0), 0.01)
    assert not turned_so_far(none, cuts)[1].any()
    late = YawRate("gyro", ns([1.6]), np.ones(1), 0.01)
    assert not turned_so_far(late, cuts)[1].any()
