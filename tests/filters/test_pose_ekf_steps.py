"""The pose EKF step by step: against filterpy, finite differences and numbers worked by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter

from fgloc.core import bases
from fgloc.core.drive import Drive, Reference
from fgloc.core.geometry import between, compose, inverse, wrap
from fgloc.core.measurements import (
    CameraPoses,
    Floats,
    PoseFixes,
    PositionFixes,
    Stamps,
    WheelIncrements,
    Yaw,
    YawRate,
)
from fgloc.core.preintegration import preintegrate, split_at
from fgloc.core.robot import Robot, WheelNoise
from fgloc.core.trajectory import Trajectory
from fgloc.filters.pose_ekf import PoseEkf
from fgloc.filters.pose_ekf_kernel import fuse_turn, predict
from fgloc.filters.pose_ekf_settings import PoseEkfSettings

BASE = bases.differential(0.1, 0.1, 0.5)
PLAIN = PoseEkfSettings(calibration=0.0, horizon_s=0.0)
"""Nothing but white noise, as textbook filters have it."""


def ns(seconds: Floats | list[float]) -> Stamps:
    return np.round(np.asarray(seconds) * 1e9).astype(np.int64)


def jacobian(function: Callable[[Floats], Floats], x: Floats) -> Floats:
    """Return d function / d x by complex steps: finite differences without their rounding."""
    steps = 1e-30j * np.eye(x.size)
    return np.stack([function(x + h).imag / 1e-30 for h in steps], axis=-1)


def test_predict_is_a_pose_step_and_its_covariance() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        x, step = rng.standard_normal(5), rng.standard_normal(3)
        root = rng.standard_normal((5, 5))
        q_root = rng.standard_normal((3, 3))
        p, q = root @ root.T, q_root @ q_root.T

        def moved(state: Floats, by: Floats) -> Floats:
            return np.concatenate([compose(state[:3], by), state[3:]])

        a = jacobian(lambda s, by=step: moved(s, by), x)
        g = jacobian(lambda by, s=x: moved(s, by), step)
        expected = a @ p @ a.T + g @ q @ g.T
        end = moved(x, step)
        predict(x, p, step, q)
        np.testing.assert_allclose(x, end, rtol=0, atol=1e-12)
        np.testing.assert_allclose(p, expected, rtol=0, atol=1e-12)


def test_a_gyros_turn_is_a_kalman_update_of_the_displacement() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        root = rng.standard_normal((3, 3))
        q, step, r = root @ root.T, rng.standard_normal(3), 0.3
        turn = float(rng.standard_normal())
        oracle = ExtendedKalmanFilter(3, 1)
        oracle.x, oracle.P = step.copy(), q.copy()
        h = np.array([[0.0, 0.0, 1.0]])
        oracle.update(np.array([turn]), lambda _, h=h: h, lambda x, h=h: h @ x, R=np.array([[r]]))
        fuse_turn(step, q, turn - step[2], r, 0.0)
        np.testing.assert_allclose(step, oracle.x, rtol=0, atol=1e-12)
        np.testing.assert_allclose(q, oracle.P, rtol=0, atol=1e-12)


def winding_drive(seed: int = 0) -> Drive:
    """60 s at 10 Hz, with yaw, camera and both kinds of fixes at stamps of their own."""
    rng = np.random.default_rng(seed)
    stamps = ns(np.arange(601) * 0.1)
    angles = rng.uniform(0.1, 0.5, (600, 2))
    wheels = WheelIncrements("wheels", stamps, angles, ("left", "right"))
    times = ns(np.sort(rng.uniform(0.5, 59.5, 400)))
    yaw = Yaw("yaw", times, wrap(rng.normal(2.0, 1.0, 400)), 0.5, drift_sigma=0.05)
    late = ns(np.arange(0.25, 60.0, 1.7))
    wild = rng.normal(0.0, 2.0, (late.size, 3))
    fixes = PositionFixes(
        "gps", late, wild[:, :2], np.full((late.size, 2), [2.0, 3.0]), mount=(0.3, -0.2)
    )
    later = ns(np.arange(0.1, 60.0, 2.9))
    poses = PoseFixes(
        "map",
        later,
        rng.normal(0.0, 2.0, (later.size, 3)),
        np.full((later.size, 3), [1.0, 2.0, 0.7]),
        mount=(0.1, 0.4, 0.5),
    )
    seen = ns(np.arange(0.033, 60.0, 0.5))
    camera = CameraPoses(
        "camera",
        seen,
        np.cumsum(rng.normal(0.0, 0.1, (seen.size, 3)), axis=0),
        0.1,
        0.1,
        position_sigma=1.5,
        heading_sigma=0.8,
        mount=(0.2, 0.1, 0.3),
    )
    return Drive("winding", Robot("test", BASE), wheels, (yaw, fixes, poses, camera))


def test_a_whole_drive_equals_filterpy() -> None:
    drive = winding_drive()
    start = Reference(Trajectory(drive.wheels.stamps_ns, np.zeros((601, 3))), sigma=(0.2, 0.3, 0.1))
    drive = replace(drive, truth=start)
    yaw, gps, poses, camera = drive.sensors
    settings = replace(
        PLAIN, camera_growth=0.0, camera_gate=math.inf, yaw_gate=math.inf, fix_gate=math.inf
    )
    result = PoseEkf(settings).estimate(drive)

    cuts = np.unique(
        np.concatenate([drive.wheels.stamps_ns, *(s.stamps_ns for s in drive.sensors)])
    )
    moved = preintegrate(split_at(drive.wheels, cuts), drive.robot)
    ekf = ExtendedKalmanFilter(4, 3)
    ekf.x, ekf.P = np.zeros(4), np.diag([0.04, 0.09, 0.01, 0.0])
    anchor, first = None, True

    def sensor_at(x: Floats, mount: Floats) -> Floats:
        return compose(x[:3], mount)

    def apply(z: Floats, h: Callable[[Floats], Floats], r: Floats, angle: int | None) -> None:
        def residual(a: Floats, b: Floats) -> Floats:
            out = a - b
            if angle is not None:
                out[angle] = wrap(out[angle])
            return out

        ekf.update(z, lambda x: jacobian(h, x), h, R=r, residual=residual)

    checked = 0
    for k, cut in enumerate(cuts):
        if k > 0:
            step, q = moved.displacement[k - 1], moved.covariance[k - 1]

            def move(x: Floats, by: Floats = step) -> Floats:
                return np.concatenate([compose(x[:3], by), x[3:]])

            a = jacobian(move, ekf.x)
            before = ekf.x.copy()
            g = jacobian(lambda by, x=before: move(x, by), step)
            ekf.x = move(ekf.x)
            ekf.P = a @ ekf.P @ a.T + g @ q @ g.T
            ekf.P[3, 3] += 0.05**2 * (cut - cuts[k - 1]) * 1e-9
        for m in np.flatnonzero(yaw.stamps_ns == cut):
            z = yaw.yaw[m : m + 1]
            if first:
                first = False
                ekf.x[3] = z[0] - ekf.x[2]
                t = np.diag([1.0, 1.0, 1.0, 0.0])
                t[3, 2] = -1.0
                ekf.P = t @ ekf.P @ t.T
                ekf.P[3, 3] += 0.25
            else:
                apply(z, lambda x: np.array([x[2] + x[3]]), np.array([[0.25]]), 0)
        for m in np.flatnonzero(gps.stamps_ns == cut):
            lever = np.array([0.3, -0.2, 0.0])
            r = np.diag([4.0, 9.0])
            apply(gps.positions[m], lambda x, lever=lever: sensor_at(x, lever)[:2], r, None)
        for m in np.flatnonzero(poses.stamps_ns == cut):
            mount = np.array(poses.mount)
            r = np.diag([1.0, 4.0, 0.49])
            apply(poses.poses[m], lambda x, mount=mount: sensor_at(x, mount), r, 2)
        for m in np.flatnonzero(camera.stamps_ns == cut):
            mount = np.array(camera.mount)
            if anchor is None:
                # Where the camera's own frame lies, with the nominal mount.
                anchor = compose(compose(ekf.x[:3], mount), inverse(camera.poses[m]))
            else:
                z = compose(compose(anchor, camera.poses[m]), inverse(mount))
                apply(z, lambda x: x[:3], np.diag([2.25, 2.25, 0.64]), 2)
        if cut in drive.wheels.stamps_ns:
            np.testing.assert_allclose(ekf.x[:3], result.trajectory.poses[checked], atol=1e-9)
            assert result.trajectory.covariances is not None
            np.testing.assert_allclose(
                ekf.P[:3, :3], result.trajectory.covariances[checked], rtol=0, atol=1e-9
            )
            checked += 1
    assert checked == 601
    assert result.counts["yaw"].accepted == 400
    assert result.sensors_used == ("wheels", "yaw", "gps", "map", "camera")
    # The reading of the camera relative to its first is what the filter makes of it.
    moved_by = between(camera.poses[0], camera.poses[-1])
    assert np.abs(moved_by).max() > 0.5


def test_one_step_and_one_fix_by_hand() -> None:
    # Both wheels turn 10 rad on a radius of 0.1 m: 1 m straight on. Rolling noise of 0.3 m/√m on
    # each wheel: the mean of two has variance 0.09 / 2 = 0.045 along x. Start sigma 0.1 m: 0.01.
    # So P_xx = 0.055 before a fix at x = 1.2 with sigma 0.3: S = 0.055 + 0.09 = 0.145,
    # K = 0.055 / 0.145 = 0.37931, x = 1 + 0.37931 · 0.2 = 1.07586,
    # P_xx = 0.055 · (1 - 0.37931) = 0.034138.
    noise = WheelNoise(0.3, 0.0, 0.0, 0.0, 0.0)
    wheels = WheelIncrements("wheels", ns([0.0, 1.0]), np.full((1, 2), 10.0), ("left", "right"))
    fix = PositionFixes("fix", ns([1.0]), np.array([[1.2, 0.0]]), np.full((1, 2), 0.3))
    truth = Reference(Trajectory(ns([0.0, 1.0]), np.zeros((2, 3))), sigma=(0.1, 1e-3, 1e-4))
    drive = Drive("by hand", Robot("test", BASE, noise), wheels, (fix,), truth)
    result = PoseEkf(PLAIN).estimate(drive)
    assert result.trajectory.poses[1, 0] == pytest.approx(1.07586, abs=1e-5)
    assert result.trajectory.covariances is not None
    assert result.trajectory.covariances[1, 0, 0] == pytest.approx(0.034138, abs=1e-6)
    (innovation,) = result.residuals
    assert innovation.values[0, 0] == pytest.approx(0.2)
    assert innovation.normalised[0, 0] == pytest.approx(0.2 / math.sqrt(0.145))


def test_a_gyro_between_wheel_packets_by_hand() -> None:
    # Wheels turn the base by (0.1·3 - 0.1·1) / 0.5 = 0.4 rad in a second. The gyro says 0.6 rad/s.
    # Variances: rolling 0.2²·(0.1 + 0.3) on a track of 0.5 m: 0.016 / 0.25 = 0.064 for the turn,
    # the gyro's 0.1² = 0.01. The heading: 0.4 + 0.064 / 0.074 · 0.2 = 0.57297.
    noise = WheelNoise(0.2, 0.0, 0.0, 0.0, 0.0)
    angles = np.array([[1.0, 3.0]])
    wheels = WheelIncrements("wheels", ns([0.0, 1.0]), angles, ("left", "right"))
    gyro = YawRate("gyro", ns([0.0, 0.5, 1.0]), np.full(3, 0.6), 0.1)
    drive = Drive("by hand", Robot("test", BASE, noise), wheels, (gyro,))
    result = PoseEkf(PLAIN).estimate(drive)
    assert result.trajectory.poses[1, 2] == pytest.approx(0.4 + 0.064 / 0.074 * 0.2, abs=1e-6)
    assert result.notes == ("gyro: the bias is not estimated, as in seed D",)
