"""Residuals against GTSAM's own compositions and answers worked by hand."""

from __future__ import annotations

import math

import gtsam
import numpy as np
import pytest

from fgloc.core.geometry import compose, wrap
from fgloc.core.measurements import Floats
from fgloc.factors.tables import Kind

from .calls import evaluate


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
    moved = pose2(xi).between(pose2(xj))
    predicted = np.array([moved.x(), moved.y(), moved.theta()])
    m = np.concatenate([np.zeros(3), nominal, predicted])
    r = evaluate(Kind.CAMERA, xi, xj, g, m, -1)[0]
    same_pose(r, scaled)
    motion = np.array([0.5, 0.6, -1.0])
    m = np.concatenate([motion, nominal, predicted])
    shifted = evaluate(Kind.CAMERA, xi, xj, g, m, -1)[0]
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


@pytest.mark.parametrize("offset", [(), (0.05, -0.02, 0.1)])
def test_a_wall_is_seen_from_its_mount(
    pair: tuple[Floats, Floats], offset: tuple[float, ...]
) -> None:
    # The wall y = 2 seen from below: its normal towards the sensor points down.
    x, _ = pair
    x = x - [0.0, 10.0 + x[1], 0.0]
    nominal, g = np.array([0.2, -0.1, 0.5]), np.array(offset)
    sensor = pose2(x).compose(pose2(nominal + g if offset else nominal))
    ends = [sensor.transformTo(np.array([e, 2.0])) for e in (x[0] - 1.0, x[0] + 3.0)]
    middle, along = (ends[0] + ends[1]) / 2, ends[1] - ends[0]
    beta = math.atan2(along[1], along[0]) - math.pi / 2
    for anchor in ([0.0, 0.0], [x[0], 2.0], [7.0, 2.0], [-3.0, 1e4]):
        wall = np.array([-math.pi / 2, anchor[1] - 2.0])
        m = np.concatenate([[beta], middle, anchor, nominal])
        r = evaluate(Kind.WALL, x, wall, g, m, -1)[0]
        np.testing.assert_allclose(r, 0.0, atol=1e-9)
        # 3 cm further up than it was seen, and turned by a hundredth to the left.
        r = evaluate(Kind.WALL, x, wall - [0.0, 0.03], g, m, -1)[0]
        np.testing.assert_allclose(r, [0.0, 0.03], atol=1e-9)
        m[0] -= 0.01
        assert evaluate(Kind.WALL, x, wall, g, m, -1)[0][0] == pytest.approx(-0.01, abs=1e-12)
        # Seen from behind it is half a turn off: another wall.
        m[0] += 0.01 + math.pi
        r = evaluate(Kind.WALL, x, wall, g, m, -1)[0]
        assert abs(r[0]) == pytest.approx(math.pi, abs=1e-9)


@pytest.mark.parametrize("offset", [(), (0.05, -0.02, 0.1)])
def test_a_point_is_seen_as_gtsam_sees_it(
    pair: tuple[Floats, Floats], offset: tuple[float, ...]
) -> None:
    x, point = pair[0], pair[1][:2]
    nominal, g = np.array([0.2, -0.1, 0.5]), np.array(offset)
    sensor = pose2(x).compose(pose2(nominal + g if offset else nominal))
    m = np.concatenate([[1.0, 3.0], nominal])
    r = evaluate(Kind.RANGE_BEARING, x, point, g, m, -1)[0]
    # NEAR lengthens a range n by 5e-7/n and dims a bearing's error by 1e-6/n².
    assert r[0] == pytest.approx(sensor.range(point) - 1.0, abs=1e-6)
    assert r[1] == pytest.approx(wrap(np.array(sensor.bearing(point).theta() - 3.0)), abs=1e-5)


def test_standing_still_is_no_relative_pose(pair: tuple[Floats, Floats]) -> None:
    xi, xj = pair
    none, unused = np.zeros(0), np.zeros(1)
    r = evaluate(Kind.ZERO_VELOCITY, xi, xj, none, unused, -1)[0]
    same_pose(r, pose2(xi).between(pose2(xj)))
    turned = xi + np.array([0.0, 0.0, 2 * math.pi])
    r = evaluate(Kind.ZERO_VELOCITY, xi, turned, none, unused, -1)[0]
    np.testing.assert_allclose(r, 0.0, atol=1e-12)


def test_slip_takes_its_part_off_the_displacement(pair: tuple[Floats, Floats]) -> None:
    # Sides of 1 m/turn 0.5 m apart roll 1.25 and 1 m; a fifth of the left's is slip.
    e = np.array([[-0.625, -0.5], [0.0, 0.0], [2.5, -2.0]])
    d, none = np.array([1.125, 0.0, -0.5]), np.zeros(0)
    m = np.concatenate([d, e.ravel()])
    xi = np.concatenate([pair[0], [9.0, 9.0, 9.0]])
    straight = compose(xi[:3], np.array([1.0, 0.0, 0.0]))
    xj = np.concatenate([straight, [9.0, 0.2, 0.0]])
    np.testing.assert_allclose(evaluate(Kind.WHEEL_SLIP, xi, xj, none, m, 4)[0], 0.0, atol=1e-12)
    xj[4] = 0.0
    r = evaluate(Kind.WHEEL_SLIP, xi, xj, none, m, 4)[0]
    np.testing.assert_allclose(r, [-0.125, 0.0, 0.5], atol=1e-12)


def test_wheels_contradict_each_other_by_what_one_rolls_more() -> None:
    # Two wheels of a side: 1.25 and 1 m rolled; the difference over the root of two is 0.1768 m.
    half = math.sqrt(0.5)
    m = np.array([half, -half, 0.0, 0.0, 1.25, 1.0, 0.0, 0.0])
    x, g = np.zeros(5), np.zeros(1)
    r = evaluate(Kind.WHEEL_REDUNDANCY, x, x, g, m, 3)[0]
    np.testing.assert_allclose(r, [0.25 * half, 0.0], atol=1e-12)
    # A fifth of the first one's way is slip.
    slipping = np.array([0.0, 0.0, 0.0, 0.2, 0.0])
    r = evaluate(Kind.WHEEL_REDUNDANCY, x, slipping, np.array([0.3]), m, 3)[0]
    np.testing.assert_allclose(r, 0.0, atol=1e-12)
    # Smaller wheels altogether are no explanation: a common radius changes nothing.
    twice = np.array([math.log(2.0), 0.0])
    r = evaluate(Kind.WHEEL_REDUNDANCY, x, x, twice[:1], m, 3)[0]
    np.testing.assert_allclose(r, [0.25 * half, 0.0], atol=1e-12)
    # One radius twice the other's: sqrt(2) and 1/sqrt(2) of their geometric mean.
    m[-2:] = 0.0, 1.0
    r = evaluate(Kind.WHEEL_REDUNDANCY, x, x, twice, m, 3)[0]
    np.testing.assert_allclose(r, [0.75, 0.0], atol=1e-12)
    # The second one's is known.
    m[-2:] = 0.0, -1.0
    r = evaluate(Kind.WHEEL_REDUNDANCY, x, x, twice, m, 3)[0]
    np.testing.assert_allclose(r, [1.5 * half, 0.0], atol=1e-12)


def test_slip_is_dear_on_the_unlikely_side() -> None:
    def residual(kind: Kind, slip: float, side: float) -> float:
        x = np.array([0.0, 0.0, 0.0, slip])
        return float(evaluate(kind, x, x, np.zeros(0), np.array([side]), 3)[0][0])

    # Far from the rounded corner (0.01), which takes off half of itself.
    for side in (1.0, -1.0):
        assert residual(Kind.SLIP_SIDE, side * 1e3, side) == pytest.approx(-0.005, abs=1e-6)
        assert residual(Kind.SLIP_SIDE, -side * 1e3, side) == pytest.approx(1e3 - 0.005)
        assert residual(Kind.SLIP_SIDE, 0.0, side) == 0.0
        # Near it: sqrt(0.03² + 0.01²) = 0.0316228.
        near = residual(Kind.SLIP_SIDE, -side * 0.03, side)
        assert near == pytest.approx((0.0316228 - 0.01) / 2 + 0.015, abs=1e-6)
    assert residual(Kind.SLIP_SIDE, -0.2, 0.0) == 0.0
    assert residual(Kind.SLIP_SIDE, -1e3, 0.5) == pytest.approx(500.0 - 0.0025)
    assert residual(Kind.SLIP_PRIOR, -0.2, 1.0) == -0.2


def test_slip_and_calibration_last() -> None:
    xi, xj, none = np.array([1.0, 2.0, 3.0, 0.2]), np.array([1.5, 2.0, 9.0, 0.15]), np.zeros(0)
    r = evaluate(Kind.SLIP_WALK, xi, xj, none, np.array([0.9]), 3)[0]
    np.testing.assert_allclose(r, -0.03, atol=1e-15)
    r = evaluate(Kind.CALIBRATION_WALK, xi, xj, none, np.zeros(1), -1)[0]
    np.testing.assert_allclose(r, [0.5, 0.0, 6.0, -0.05], atol=1e-15)


def test_slopes_of_a_camera_s_calibration_are_free_of_the_noise_of_poses(
    pair: tuple[Floats, Floats],
) -> None:
    """Only the prediction of the wheels may enter the slopes by lever arm and scale."""
    xi, xj = pair
    m = np.array([0.1, 0.0, 0.02, 0.2, -0.1, 0.5, 0.11, 0.01, 0.03])
    moved = np.array([*xj[:2] + 0.3, xj[2] - 0.4])
    g = np.array([0.03, 0.02, -0.1, 0.04])
    _, _, _, one = evaluate(Kind.CAMERA, xi, xj, g, m, -1)
    _, _, _, other = evaluate(Kind.CAMERA, xi, moved, g, m, -1)
    np.testing.assert_allclose(one[:, [0, 1, 3]], other[:, [0, 1, 3]], atol=1e-12)
    # By hand, at the nominal mount turned by 0.4: the base moves by (0.11, 0.01), turns by 0.03.
    c, s = math.cos(0.03) - 1.0, math.sin(0.03)
    x = 0.11 + c * 0.23 - s * -0.08
    y = 0.01 + s * 0.23 + c * -0.08
    by_scale = math.cos(0.4) * x + math.sin(0.4) * y, -math.sin(0.4) * x + math.cos(0.4) * y
    np.testing.assert_allclose(one[:2, 3], by_scale, atol=1e-12)
