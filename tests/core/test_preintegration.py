"""Preintegration against GTSAM's exponential map, finite differences and sampled noise."""

from __future__ import annotations

import itertools
import math

import gtsam
import numpy as np
import pytest

from fgloc.core import bases
from fgloc.core.geometry import EXACT, compose, integrate
from fgloc.core.kinematics import Wheel, WheeledBase
from fgloc.core.measurements import Floats, Stamps, WheelIncrements
from fgloc.core.preintegration import Preintegrated, preintegrate, rounding_sigma, split_at
from fgloc.core.robot import Robot, WheelNoise
from fgloc.errors import FglocError

NOISE = WheelNoise(rolling=0.02, lateral=0.01, turning=0.03, standing=1e-3, standing_turn=2e-3)
CORNERS = ((0.2, 0.15), (0.2, -0.15), (-0.2, 0.15), (-0.2, -0.15))
FOUR = ("fl", "fr", "rl", "rr")
BASES: dict[str, WheeledBase] = {
    "differential": bases.differential(0.05, 0.051, 0.3),
    "skid": bases.skid_steer(("fl", "rl"), ("fr", "rr"), 0.135, 0.7, icr_x=0.05, order=FOUR),
    "mecanum": bases.mecanum(0.05, 0.2, 0.15, FOUR),
    "omni3": bases.omni3((0.05, 0.051, 0.049), 0.2, (math.pi / 3, math.pi, -math.pi / 3)),
    "full-linear": bases.full_linear(bases.differential(0.05, 0.051, 0.3)),
    "tricycle": bases.tricycle(0.1, 0.8, steer_offset=0.02),
    "swerve": bases.four_wheel_steer(FOUR, CORNERS, (0.06, 0.06, 0.061, 0.059)),
    "odometry": bases.body_odometry(),
}
STEERED = ("tricycle", "swerve")


def drive(name: str, n: int = 60, seed: int = 3, resolution: float = 0.0) -> WheelIncrements:
    """Return n jittering intervals of about 0.05 s with turns, stops and wheels that disagree."""
    rng = np.random.default_rng(seed)
    base = BASES[name]
    wheels = len(base.driven)
    stamps = np.cumsum(rng.integers(30_000_000, 70_000_000, n + 1)).astype(np.int64)
    angles = 0.4 * np.sin(np.arange(n)[:, None] / 9.0 + np.arange(wheels)) + 0.3
    angles += 0.02 * rng.normal(size=(n, wheels))
    angles[n // 2 : n // 2 + 5] = 0.0
    steering = None
    if name in STEERED:
        steering = 0.5 * np.sin(np.arange(n)[:, None] / 7.0) + 0.02 * rng.normal(size=(n, wheels))
    return WheelIncrements("wheels", stamps, angles, base.driven_names, steering, resolution)


def at(wheels: WheelIncrements, *indices: int) -> Stamps:
    return wheels.stamps_ns[list(indices)]


@pytest.mark.parametrize("name", BASES)
def test_displacement_is_the_product_of_exponentials(name: str) -> None:
    wheels, base = drive(name), BASES[name]
    bounds = (0, 1, 9, 34, 60)
    pre = preintegrate(split_at(wheels, at(wheels, *bounds)), Robot("r", base, NOISE))
    twists = base.displacements(wheels.angles, wheels.steering)
    for k, (begin, end) in enumerate(itertools.pairwise(bounds)):
        pose, heading = gtsam.Pose2(), 0.0
        for twist in twists[begin:end]:
            pose = pose.compose(gtsam.Pose2.Expmap(twist))
            heading += twist[2]
        # The heading is not wrapped: it is the turned angle.
        np.testing.assert_allclose(
            pre.displacement[k], [pose.x(), pose.y(), heading], rtol=1e-9, atol=1e-12
        )


@pytest.mark.parametrize("name", BASES)
def test_jacobian_is_the_derivative_by_the_parameters(name: str) -> None:
    base = BASES[name]
    wheels, robot = drive(name), Robot("r", base, NOISE)
    split = split_at(wheels, at(wheels, 2, 20, 60))
    values = base.nominal() * 1.02 + 0.003
    jacobian = preintegrate(split, robot, values).jacobian
    assert jacobian.shape == (2, 3, len(base.parameters))
    h = 1e-5
    for k in range(values.size):
        moved = {}
        for factor in (-2, -1, 1, 2):
            changed = values.copy()
            changed[k] += factor * h
            moved[factor] = preintegrate(split, robot, changed).displacement
        slope = (moved[-2] - 8 * moved[-1] + 8 * moved[1] - moved[2]) / (12 * h)
        scale = max(1.0, float(np.abs(slope).max()))
        np.testing.assert_allclose(jacobian[:, :, k], slope, atol=2e-9 * scale)


def sampled(base: WheeledBase, wheels: WheelIncrements, n: int) -> Floats:
    """Return (n, 3) displacements of a differential drive disturbed as `WheelNoise` says.

    Per interval: each wheel rolls r·angle + rolling·sqrt(|r·angle|)·noise and its encoder rounds
    evenly within a count; each axle end slips lateral·sqrt(path + arm·|turn|) sideways, the
    origin by their mean; scrub turning·sqrt(|turn|); a floor over time.
    """
    rng = np.random.default_rng(5)
    m = wheels.angles.shape[0]
    radii = np.array([w.radius for w in base.wheels])
    path = np.abs(wheels.angles) * radii
    clean = base.displacements(wheels.angles)
    seconds = np.diff(wheels.stamps_ns) * 1e-9
    ends = np.empty((n, 3))
    arm = abs(base.wheels[0].y)
    side = NOISE.lateral * np.sqrt(np.hypot(clean[:, 0], clean[:, 1]) + arm * np.abs(clean[:, 2]))
    for k in range(n):
        rolled = NOISE.rolling * np.sqrt(path) * rng.normal(size=path.shape) / radii
        twists = base.displacements(wheels.angles + rolled)
        twists[:, 1] += side * rng.normal(size=(m, 2)).mean(axis=1)
        twists[:, :2] += NOISE.standing * np.sqrt(seconds)[:, None] * rng.normal(size=(m, 2))
        turning = NOISE.turning**2 * np.abs(clean[:, 2]) + NOISE.standing_turn**2 * seconds
        twists[:, 2] += np.sqrt(turning) * rng.normal(size=m)
        ends[k] = integrate(twists, np.zeros(3), EXACT)[-1]
    return ends


def test_covariance_is_that_of_sampled_drives() -> None:
    base = BASES["differential"]
    wheels = drive("differential")
    pre = preintegrate(split_at(wheels, at(wheels, 0, 60)), Robot("r", base, NOISE))
    n = 4000
    errors = sampled(base, wheels, n) - pre.displacement[0]
    white = np.linalg.solve(np.linalg.cholesky(pre.covariance[0]), errors.T)
    # A sample variance has sigma sqrt(2/n) = 0.022, a correlation 1/sqrt(n) = 0.016: 4.5 of
    # them, and the little that second order adds, stay below 0.12.
    np.testing.assert_allclose(white @ white.T / n, np.eye(3), atol=0.12)


@pytest.mark.parametrize("name", ["mecanum", "swerve"])
def test_covariance_of_redundant_bases_is_that_of_sampled_rows(name: str) -> None:
    # With rolling noise alone the wheels are all there is to sample, whatever the base.
    base, wheels = BASES[name], drive(name)
    tiny = 1e-9
    noise = WheelNoise(rolling=0.02, lateral=tiny, turning=tiny, standing=tiny, standing_turn=tiny)
    pre = preintegrate(split_at(wheels, at(wheels, 0, 60)), Robot("r", base, noise))
    rng = np.random.default_rng(8)
    radii = np.array([base.wheels[i].radius for i in base.driven])
    roller = np.cos([base.wheels[i].roller for i in base.driven])
    n, ends = 3000, np.empty((3000, 3))
    # A mecanum roller's row is r·angle·cos(roller) long, and so is what it slips over.
    sigma = 0.02 * np.sqrt(np.abs(wheels.angles) * radii * roller) / (radii * roller)
    for k in range(n):
        turned = wheels.angles + sigma * rng.normal(size=sigma.shape)
        twists = base.displacements(turned, wheels.steering)
        ends[k] = integrate(twists, np.zeros(3), EXACT)[-1]
    errors = ends - pre.displacement[0]
    white = np.linalg.solve(np.linalg.cholesky(pre.covariance[0]), errors.T)
    np.testing.assert_allclose(white @ white.T / n, np.eye(3), atol=0.13)


def joined(pre: Preintegrated) -> tuple[Floats, Floats]:
    """Return displacement and covariance of all keyframe intervals composed, first order."""
    pose, cov = np.zeros(3), np.zeros((3, 3))
    for step, q in zip(pre.displacement, pre.covariance, strict=True):
        c, s = np.cos(pose[2]), np.sin(pose[2])
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        moved = compose(pose, step)
        lever = np.eye(3)
        lever[:2, 2] = -(moved[1] - pose[1]), moved[0] - pose[0]
        cov = lever @ cov @ lever.T + turn @ q @ turn.T
        pose = moved
    return pose, cov


@pytest.mark.parametrize("name", BASES)
def test_keyframes_inside_intervals_lose_nothing(name: str) -> None:
    wheels, robot = drive(name), Robot("r", BASES[name], NOISE)
    whole = preintegrate(split_at(wheels, at(wheels, 0, 60)), robot)
    cuts = np.linspace(wheels.stamps_ns[0], wheels.stamps_ns[-1], 38).astype(np.int64)
    assert not np.isin(cuts[1:-1], wheels.stamps_ns).all()
    split = split_at(wheels, cuts)
    assert split.bounds[0] == 0
    assert split.bounds[-1] == split.angles.shape[0]
    np.testing.assert_allclose(split.angles.sum(axis=0), wheels.angles.sum(axis=0), rtol=1e-12)
    assert split.seconds.sum() == pytest.approx((cuts[-1] - cuts[0]) * 1e-9, abs=1e-12)
    pose, covariance = joined(preintegrate(split, robot))
    # Poses compose exactly, an arc being an arc in any number of pieces.
    np.testing.assert_allclose(pose, whole.displacement[0], atol=1e-11)
    np.testing.assert_allclose(covariance, whole.covariance[0], rtol=0.02, atol=1e-6)
    assert covariance[2, 2] == pytest.approx(whole.covariance[0, 2, 2], rel=1e-9)


def test_calibration_derivative_is_additive_too() -> None:
    wheels, base = drive("swerve"), BASES["swerve"]
    robot = Robot("r", base, NOISE)
    whole = preintegrate(split_at(wheels, at(wheels, 5, 40)), robot)
    middle = int(wheels.stamps_ns[20]) + 7_000_000
    halves = preintegrate(
        split_at(wheels, np.array([*at(wheels, 5), middle, *at(wheels, 40)])), robot
    )
    a, b = halves.displacement
    ja, jb = halves.jacobian
    c, s = np.cos(a[2]), np.sin(a[2])
    by_a = np.eye(3)
    by_a[:2, 2] = -s * b[0] - c * b[1], c * b[0] - s * b[1]
    by_b = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(by_a @ ja + by_b @ jb, whole.jacobian[0], atol=1e-11)


@pytest.mark.parametrize("name", BASES)
def test_noise_does_not_depend_on_the_sampling_rate(name: str) -> None:
    slow = drive(name)
    pieces = 10
    stamps = np.interp(np.arange(60 * pieces + 1) / pieces, np.arange(61), slow.stamps_ns)
    fast = WheelIncrements(
        "wheels",
        np.round(stamps).astype(np.int64),
        np.repeat(slow.angles / pieces, pieces, axis=0),
        slow.wheels,
        None if slow.steering is None else np.repeat(slow.steering, pieces, axis=0),
    )
    robot = Robot("r", BASES[name], NOISE)
    ends = at(slow, 0, 60)
    a = preintegrate(split_at(slow, ends), robot)
    b = preintegrate(split_at(fast, ends), robot)
    np.testing.assert_allclose(b.displacement, a.displacement, atol=1e-11)
    sigma = np.sqrt(np.diagonal(a.covariance[0]))
    apart = (b.covariance[0] - a.covariance[0]) / np.outer(sigma, sigma)
    np.testing.assert_allclose(apart, 0.0, atol=0.02)


def test_a_standing_robot_is_almost_but_not_quite_certain() -> None:
    n = 20
    stamps = np.arange(n + 1, dtype=np.int64) * 50_000_000
    wheels = WheelIncrements("wheels", stamps, np.zeros((n, 2)), ("left", "right"), resolution=0.1)
    pre = preintegrate(split_at(wheels, stamps[[0, n]]), Robot("r", BASES["differential"], NOISE))
    assert not pre.displacement.any()
    # One second: the floors over time.
    expected = np.diag([NOISE.standing**2, NOISE.standing**2, NOISE.standing_turn**2])
    np.testing.assert_allclose(pre.covariance[0], expected, rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize("name", ["differential", "skid", "mecanum", "omni3"])
def test_rounded_counts_stay_near_the_base_however_long_the_drive(name: str) -> None:
    base, count = BASES[name], 0.05
    robot = Robot("r", base, NOISE)
    planned = drive(name, 60).angles
    rng = np.random.default_rng(4)
    ends = []
    # Counts of a cumulative encoder that began anywhere within its first count, 3 and 60 on.
    for steps in (3, 60):
        off = []
        for _ in range(2000):
            phase = rng.random(planned.shape[1])
            # No two drives turn a wheel by the same fraction of a count.
            true = (
                planned[:steps] + count * rng.random(phase.size) * (np.arange(steps) == 0)[:, None]
            )
            total = np.vstack([np.zeros(phase.size), np.cumsum(true, axis=0)])
            counted = np.diff(np.floor(total / count + phase), axis=0) * count
            off.append(base.displacements(counted - true).sum(axis=0))
        ends.append(np.std(off, axis=0))
    sigma = rounding_sigma(robot, count)
    # The start's rounding and the end's; 2000 draws of a sigma: 1.6 %.
    np.testing.assert_allclose(ends, np.sqrt(2.0) * np.array([sigma, sigma]), rtol=0.08, atol=1e-9)
    assert not rounding_sigma(robot, 0.0).any()


@pytest.mark.parametrize(("first", "last"), [(-1, 60), (0, 61)])
def test_a_keyframe_outside_the_wheel_data_is_refused(first: int, last: int) -> None:
    wheels = drive("differential")
    ends = np.array([wheels.stamps_ns[0], wheels.stamps_ns[-1]])
    ends += np.array([min(first, 0), max(last - 60, 0)])
    with pytest.raises(FglocError, match="wheels: a keyframe lies outside"):
        split_at(wheels, ends)


def test_wheels_that_do_not_determine_the_motion_are_refused() -> None:
    # Two parallel tyres without any hold sideways: v_y is free.
    loose = WheeledBase(
        "loose", (Wheel("a", 0.0, 0.1, 0.05, "roller"), Wheel("b", 0.0, -0.1, 0.05, "roller"))
    )
    stamps = np.arange(4, dtype=np.int64) * 10_000_000
    wheels = WheelIncrements("wheels", stamps, np.ones((3, 2)), ("a", "b"))
    with pytest.raises(FglocError, match="loose: these wheels do not determine"):
        preintegrate(split_at(wheels, stamps[[0, 3]]), Robot("r", loose, NOISE))


def test_a_body_odometry_slips_sideways_and_veers_on_its_way() -> None:
    # One straight interval of 4 m in 2 s: its heading wanders evenly along the way.
    base = bases.body_odometry()
    stamps = np.array([0, 2_000_000_000], dtype=np.int64)
    wheels = WheelIncrements("wheels", stamps, np.array([[4.0, 0.0, 0.0]]), base.driven_names)
    noise = WheelNoise(0.01, 0.03, 0.5, standing=0.0, standing_turn=0.0, veering=0.02)
    pre = preintegrate(split_at(wheels, stamps), Robot("r", base, noise))
    np.testing.assert_allclose(pre.displacement[0], [4.0, 0.0, 0.0], atol=1e-15)
    turned = 0.02**2 * 4.0
    # As a twist the heading error is steady: half of it times the way is the error across.
    across = 0.03**2 * 4.0 + (4.0 / 2.0) ** 2 * turned
    expected = [[0.01**2 * 4.0, 0, 0], [0, across, 2.0 * turned], [0, 2.0 * turned, turned]]
    np.testing.assert_allclose(pre.covariance[0], expected, atol=1e-12)
    # Scales of 1: the way by odometry_scale, the turn by rotation_scale of no turn.
    np.testing.assert_allclose(pre.jacobian[0], [[4.0, 0.0], [0.0, 0.0], [0.0, 0.0]], atol=1e-12)
