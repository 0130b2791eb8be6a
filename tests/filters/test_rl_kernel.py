"""The motion model of the robot_localization-like filter and its loop, by hand and by filterpy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from fgloc.core.consistency import average, squared_normalised
from fgloc.core.measurements import Floats, Stamps
from fgloc.filters.rl_kernel import STATES, Codes, advance, run_filter, transition


def moved(x: Floats, dt: float) -> Floats:
    """Return the state after dt, written as the equations of robot_localization are."""
    c, s = np.cos(x[2]), np.sin(x[2])
    half = 0.5 * dt * dt
    return np.array(
        [
            x[0] + (c * x[3] - s * x[4]) * dt + (c * x[6] - s * x[7]) * half,
            x[1] + (s * x[3] + c * x[4]) * dt + (s * x[6] + c * x[7]) * half,
            x[2] + x[5] * dt,
            x[3] + x[6] * dt,
            x[4] + x[7] * dt,
            x[5],
            x[6],
            x[7],
        ]
    )


def step(x: Floats, p: Floats, dt: float, q: Floats, dynamic: bool = False) -> None:
    advance(x, p, dt, q, dynamic, np.zeros((STATES, STATES)), np.zeros((STATES, STATES)))


def test_a_prediction_by_hand() -> None:
    # Facing along y (90°) at (1, 2), 2 m/s forward, 0.5 m/s to the left, 0.1 rad/s, accelerating
    # by 4 m/s² forward. After 0.5 s: forward 2·0.5 + ½·4·0.25 = 1.5 m, left 0.25 m. Forward is map
    # y, left is map -x: (1 - 0.25, 2 + 1.5) = (0.75, 3.5), yaw + 0.05, v_x = 2 + 4·0.5 = 4.
    x = np.array([1.0, 2.0, math.pi / 2, 2.0, 0.5, 0.1, 4.0, 0.0])
    # Only v_x and yaw are uncertain, by 0.1 m/s and 0.2 rad: y has 0.5² · 0.01 from the speed. The
    # yaw turns the way (-0.25, 1.5): x by -1.5 and y by -0.25 a radian, so x has 1.5² · 0.04 and
    # y another 0.25² · 0.04. Process noise of 0.06 on yaw adds 0.06 · 0.5.
    p = np.diag([0.0, 0.0, 0.04, 0.01, 0.0, 0.0, 0.0, 0.0])
    step(x, p, 0.5, np.diag([0.0, 0.0, 0.06, 0.0, 0.0, 0.0, 0.0, 0.0]))
    np.testing.assert_allclose(
        x, [0.75, 3.5, math.pi / 2 + 0.05, 4.0, 0.5, 0.1, 4.0, 0.0], atol=1e-12
    )
    assert p[0, 0] == pytest.approx(1.5**2 * 0.04)
    assert p[1, 1] == pytest.approx(0.5**2 * 0.01 + 0.25**2 * 0.04)
    assert p[2, 2] == pytest.approx(0.04 + 0.03)
    assert p[1, 3] == pytest.approx(0.5 * 0.01)


def test_the_jacobian_is_the_derivative() -> None:
    rng = np.random.default_rng(0)
    f = np.zeros((STATES, STATES))
    for _ in range(20):
        x, dt = rng.standard_normal(STATES), float(rng.uniform(0.001, 0.5))
        transition(x, dt, f)
        steps = 1e-6 * np.eye(STATES)
        numeric = np.stack([(moved(x + h, dt) - moved(x - h, dt)) / 2e-6 for h in steps], axis=1)
        np.testing.assert_allclose(f, numeric, rtol=0, atol=1e-8)
        end = x.copy()
        step(end, np.eye(STATES), dt, np.eye(STATES))
        np.testing.assert_allclose(end, moved(x, dt), rtol=0, atol=1e-12)


def test_dynamic_process_noise_grows_with_the_squared_speed() -> None:
    # |(3, 4, 12)|² = 169, on the pose alone.
    q = np.diag([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8])
    x, p = np.array([0.0, 0.0, 0.0, 3.0, 4.0, 12.0, 0.0, 0.0]), np.zeros((STATES, STATES))
    step(x, p, 0.01, q, dynamic=True)
    expected = np.diag(q) * 0.01 * [169.0, 169.0, 169.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    np.testing.assert_allclose(np.diag(p), expected)


class Loop:
    """The filter's arrays for measurements of the same states."""

    def __init__(self, states: list[int], times: Stamps, values: Floats, r: Floats) -> None:
        e, d = values.shape
        self.sizes: Codes = np.full(e, d, dtype=np.int64)
        self.states: Codes = np.zeros((e, 3), dtype=np.int64)
        self.states[:, :d] = states
        self.values, self.noises = np.zeros((e, 3)), np.zeros((e, 3, 3))
        self.values[:, :d], self.noises[:, :d, :d] = values, r
        self.times = times
        self.levers, self.thresholds = np.zeros((e, 2)), np.full(e, np.inf)
        self.accepted: Codes = np.zeros(e, dtype=np.int64)
        self.innovations, self.whitened = np.zeros((e, 3)), np.zeros((e, 3))

    def run(
        self,
        outputs: Stamps,
        x: Floats,
        p: Floats,
        q: Floats,
        *,
        predicting: bool = False,
        timeout_ns: int = 10**18,
    ) -> tuple[Stamps, Floats, Floats]:
        k = outputs.size
        stamps, poses = np.zeros(k, dtype=np.int64), np.zeros((k, 3))
        covariances = np.zeros((k, 3, 3))
        n = run_filter(
            self.times, self.sizes, self.states, self.values, self.noises, self.levers,
            self.thresholds, outputs, predicting, timeout_ns, 0, q, False, x, p, stamps, poses,
            covariances, self.accepted, self.innovations, self.whitened,
        )  # fmt: skip
        return stamps[:n], poses[:n], covariances[:n]


def test_a_thousand_steps_equal_filterpy() -> None:
    """Predictions with the filter's own F, corrections of x, y, yaw: against filterpy, 1e-9."""
    rng = np.random.default_rng(2)
    times = np.cumsum(rng.integers(5_000_000, 90_000_000, 1000)).astype(np.int64)
    values = np.cumsum(rng.normal(0.0, 0.05, (1000, 3)), axis=0)
    root = rng.standard_normal((3, 3))
    r = 0.01 * (root @ root.T + np.eye(3))
    q = np.diag([0.05, 0.05, 0.06, 0.025, 0.025, 0.02, 0.01, 0.01])
    loop = Loop([0, 1, 2], times, values, r)
    x, p = np.zeros(STATES), 0.1 * np.eye(STATES)
    oracle = KalmanFilter(dim_x=STATES, dim_z=3)
    oracle.x, oracle.P = x.copy(), p.copy()
    oracle.H, oracle.R = np.eye(3, STATES), r
    stamps, poses, covariances = loop.run(times, x, p, q)
    np.testing.assert_array_equal(stamps, times)
    f, now = np.zeros((STATES, STATES)), 0
    for k in range(1000):
        dt = (times[k] - now) * 1e-9
        now = times[k]
        transition(oracle.x, dt, f)
        oracle.P = f @ oracle.P @ f.T + q * dt
        oracle.x = moved(oracle.x, dt)
        # The innovation's heading is wrapped, as headings are.
        z = values[k].copy()
        z[2] = oracle.x[2] + (z[2] - oracle.x[2] + np.pi) % (2 * np.pi) - np.pi
        oracle.update(z)
        np.testing.assert_allclose(poses[k], oracle.x[:3], rtol=0, atol=1e-9)
        np.testing.assert_allclose(covariances[k], oracle.P[:3, :3], rtol=0, atol=1e-9)
    np.testing.assert_allclose(x, oracle.x, rtol=0, atol=1e-9)


def test_a_threshold_rejects_from_its_distance_on() -> None:
    # Variance 0.75 + 0.25 = 1, so that the distance is the innovation itself.
    for innovation, accepted in ((1.999, 1), (2.0, 0), (2.001, 0)):
        loop = Loop([0], np.array([0]), np.array([[innovation]]), np.array([[0.25]]))
        loop.thresholds[:] = 2.0
        x, p = np.zeros(STATES), 0.75 * np.eye(STATES)
        loop.run(np.array([0]), x, p, np.zeros((STATES, STATES)))
        assert loop.accepted[0] == accepted
        assert x[0] == pytest.approx(0.75 * innovation * accepted)
        assert loop.innovations[0, 0] == loop.whitened[0, 0] == innovation


def test_a_yaw_is_compared_on_the_circle() -> None:
    loop = Loop([2], np.array([0]), np.array([[-3.1]]), np.array([[1.0]]))
    x, p = np.zeros(STATES), np.eye(STATES)
    x[2] = 3.1
    loop.run(np.array([0]), x, p, np.zeros((STATES, STATES)))
    # From 3.1 on to -3.1 + 2π is 0.0832 rad; half of it with equal variances.
    assert x[2] == pytest.approx(3.1 + 0.5 * (2 * math.pi - 6.2))


def test_a_lever_arm_is_taken_off_with_the_filters_yaw() -> None:
    # An antenna 0.5 m ahead of a base that faces along y: at (1, 1.5) the base is at (1, 1).
    loop = Loop([0, 1], np.array([0]), np.array([[1.0, 1.5]]), 1e-8 * np.eye(2))
    loop.levers[:] = [0.5, 0.0]
    x, p = np.zeros(STATES), np.eye(STATES)
    x[2] = math.pi / 2
    loop.run(np.array([0]), x, p, np.zeros((STATES, STATES)))
    np.testing.assert_allclose(x[:2], [1.0, 1.0], atol=1e-6)


def test_what_is_put_out_when() -> None:
    """Measurements at 0.05, 0.15 and 0.95 s, outputs every 0.1 s, a timeout of 0.25 s."""
    times = np.array([50_000_000, 150_000_000, 950_000_000])
    outputs = np.arange(1, 11) * 100_000_000
    start = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    q = np.zeros((STATES, STATES))

    def put_out(**how: object) -> list[float]:
        loop = Loop([1], times, np.zeros((3, 1)), np.eye(1))
        x = start.copy()
        stamps, poses, _ = loop.run(outputs, x, np.eye(STATES), q, **how)  # type: ignore[arg-type]
        # Driving at 1 m/s, x tells the time that the pose is of.
        np.testing.assert_allclose(poses[:, 0], stamps * 1e-9, atol=1e-12)
        return (stamps * 1e-9).round(3).tolist()

    # Those of the last measurement; from 0.4 s on, 0.25 s after it, predicted to the output, and
    # again 0.25 s or more after that. At 1.0 s a measurement has come again.
    assert put_out(timeout_ns=250_000_000) == [0.05, 0.15, 0.4, 0.7, 0.95]
    assert put_out() == [0.05, 0.15, 0.95]
    assert put_out(predicting=True) == pytest.approx((outputs * 1e-9).tolist())


def test_no_measurement_is_believed_beyond_reason() -> None:
    loop = Loop([0], np.array([0]), np.array([[1.0]]), np.array([[0.0]]))
    x, p = np.zeros(STATES), np.eye(STATES)
    loop.run(np.array([0]), x, p, np.zeros((STATES, STATES)))
    assert x[0] == pytest.approx(1.0 / (1.0 + 1e-9), rel=1e-12)
    assert p[0, 0] > 0.0


def test_covariances_are_right_for_motion_as_modelled() -> None:
    """Drives made of the filter's own noise: NEES of the whole state over 100 of them, 8 degrees.

    Each is 5 s of twists at 20 Hz and poses at 2 Hz, with process noise drawn a step.
    """
    q = np.diag([1e-4, 1e-4, 1e-4, 1e-2, 1e-2, 1e-2, 0.1, 0.1])
    times = np.arange(1, 101) * 50_000_000
    found = []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        p = np.diag([0.01, 0.01, 1e-3, 0.1, 0.1, 0.01, 0.1, 0.1])
        x = rng.multivariate_normal(np.zeros(STATES), p)
        twists, poses = [], []
        for k in range(100):
            x = moved(x, 0.05) + np.sqrt(np.diag(q) * 0.05) * rng.standard_normal(STATES)
            twists.append(x[3:6] + 0.1 * rng.standard_normal(3))
            if k % 10 == 9:
                poses.append(x[:3] + 0.05 * rng.standard_normal(3))
        speed = Loop([3, 4, 5], times, np.array(twists), 0.01 * np.eye(3))
        place = Loop([0, 1, 2], times[9::10], np.array(poses), 0.0025 * np.eye(3))
        both = Loop([0], np.zeros(0, np.int64), np.zeros((0, 1)), np.eye(1))
        order = np.argsort(np.concatenate([speed.times, place.times]), kind="stable")
        for name in vars(both):
            joined = np.concatenate([getattr(speed, name), getattr(place, name)])
            setattr(both, name, joined[order])
        estimate, covariance = np.zeros(STATES), p.copy()
        both.run(times, estimate, covariance, q)
        error = estimate - x
        error[2] = (error[2] + np.pi) % (2 * np.pi) - np.pi
        found.append(squared_normalised(error, covariance))
    assert average(found, STATES, 0.99).verdict == "inside"
