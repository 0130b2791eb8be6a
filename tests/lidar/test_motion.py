"""How the lidar moved in a scan, by the wheels."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fgloc.core import geometry
from fgloc.core.bases import differential
from fgloc.core.measurements import Floats, Scans, WheelIncrements
from fgloc.core.robot import Robot
from fgloc.lidar.motion import scan_motion

BASE = differential(0.1, 0.1, 0.5)
ROBOT = Robot.typical("cart", BASE)
PERIOD_NS = 20_000_000


def wheels(left: float, right: float, seconds: float = 1.0) -> WheelIncrements:
    """Return both wheels at constant rates [rad/s]."""
    count = round(seconds * 1e9 / PERIOD_NS)
    angles = np.tile(np.array([left, right]) * PERIOD_NS * 1e-9, (count, 1))
    stamps = np.arange(count + 1, dtype=np.int64) * PERIOD_NS
    return WheelIncrements("wheels", stamps, angles, BASE.driven_names)


def scans(*stamps_s: float, mount: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Scans:
    """Return scans of 100 beams that take 0.1 s."""
    stamps = np.array([round(t * 1e9) for t in stamps_s], dtype=np.int64)
    ranges = np.ones((stamps.size, 100))
    return Scans("lidar", stamps, ranges, 0.0, 0.06, beam_period=1e-3, mount=mount)


def test_straight_and_on_the_spot_by_hand() -> None:
    # 5 rad/s of 0.1 m is 0.5 m/s: 5 cm in 0.1 s, between the wheels' stamps as well.
    ahead = scan_motion(wheels(5.0, 5.0), ROBOT, scans(0.0, 0.213, 0.9))
    np.testing.assert_allclose(ahead, np.tile([0.05, 0.0, 0.0], (3, 1)), atol=1e-12)
    # ±5 rad/s of 0.1 m at 0.25 m from the middle: 2 rad/s. A lidar 0.3 m ahead goes to the left,
    # one that looks to the left of the robot sees that as ahead.
    turn = wheels(-5.0, 5.0)
    front = scan_motion(turn, ROBOT, scans(0.5, mount=(0.3, 0.0, 0.0)))
    np.testing.assert_allclose(front, [[0.0, 0.06, 0.2]], atol=1e-12)
    side = scan_motion(turn, ROBOT, scans(0.5, mount=(0.3, 0.0, math.pi / 2)))
    np.testing.assert_allclose(side, [[0.06, 0.0, 0.2]], atol=1e-12)


def test_changing_motion_ends_where_the_poses_do() -> None:
    rng = np.random.default_rng(1)
    given = wheels(0.0, 0.0)
    given = replace(given, angles=rng.normal(0.0, 0.1, given.angles.shape))
    mount = (0.1, -0.2, 2.5)
    # 0.1 s from a stamp of the wheels on: five intervals.
    found = scan_motion(given, ROBOT, scans(0.2, mount=mount))
    steps = ROBOT.base.displacements(given.angles[10:15])
    base: Floats = np.zeros(3)
    for step in steps:
        base = geometry.compose(base, geometry.exp(step))
    place = np.array(mount)
    seen = geometry.compose(geometry.inverse(place), geometry.compose(base, place))
    np.testing.assert_allclose(geometry.exp(found[0]), seen, atol=1e-12)


def test_the_ends_of_the_record() -> None:
    # Half inside: went on as it did. Outside: nothing is known, nothing is undone.
    found = scan_motion(wheels(5.0, 5.0), ROBOT, scans(0.95, 1.5))
    np.testing.assert_allclose(found, [[0.05, 0.0, 0.0], [0.0, 0.0, 0.0]], atol=1e-12)


def test_a_scan_at_once_does_not_move() -> None:
    at_once = replace(scans(0.1, 0.2), beam_period=0.0)
    assert not scan_motion(wheels(5.0, 4.0), ROBOT, at_once).any()
