"""Where the graph has a pose: wheel stamps, and what must not be interpolated."""

from __future__ import annotations

import numpy as np

from fgloc.core import bases
from fgloc.core.drive import Drive
from fgloc.core.measurements import (
    Floats,
    LandmarkSightings,
    PositionFixes,
    Scans,
    Sensor,
    Stamps,
    WheelIncrements,
)
from fgloc.core.robot import Robot, typical_noise
from fgloc.datasets.simulator import load_sim
from fgloc.smoothing.build import build_problem
from fgloc.smoothing.front import look_around
from fgloc.smoothing.keyframes import choose_keyframes
from fgloc.smoothing.settings import Settings

MS = 1_000_000
BASE = bases.differential(0.1, 0.1, 0.5)


def drive(*sensors: Sensor) -> Drive:
    """Return a drive of 1 s with wheel stamps every 20 ms."""
    stamps = np.arange(51, dtype=np.int64) * 20 * MS
    wheels = WheelIncrements("wheels", stamps, np.ones((50, 2)), BASE.driven_names)
    return Drive("short", Robot("robot", BASE, typical_noise("differential")), wheels, sensors)


def ms(stamps: Stamps) -> list[int]:
    return (stamps // MS).tolist()


def at(*milliseconds: int) -> Stamps:
    return np.array(milliseconds, dtype=np.int64) * MS


TENTHS = list(range(0, 1001, 100))


def test_wheel_stamps_about_a_period_apart() -> None:
    assert ms(choose_keyframes(drive(), 0.1)) == TENTHS
    assert ms(choose_keyframes(drive(), 0.1, np.zeros(0, np.int64))) == TENTHS


def test_scans_are_keyframes_and_wheel_stamps_beside_them_are_not() -> None:
    # Half a period is 47 ms (5 % slack). Beside 330 lies 300 (30 ms), beside 549 lies 500 (49 ms,
    # kept) and 600 (51 ms, kept); 700 is a scan itself.
    found = ms(choose_keyframes(drive(), 0.1, at(330, 549, 700)))
    assert found == [0, 100, 200, 330, 400, 500, 549, 600, 700, 800, 900, 1000]


def test_begin_and_end_stay_whatever_scans_are_near() -> None:
    found = ms(choose_keyframes(drive(), 0.1, at(10, 990)))
    assert found == [0, 10, *TENTHS[1:-1], 990, 1000]


def test_scans_closer_than_the_period_replace_all_wheel_stamps() -> None:
    scans = at(*range(5, 1000, 50))
    assert ms(choose_keyframes(drive(), 0.1, scans)) == [0, *ms(scans), 1000]


def test_fixes_and_sightings_keep_their_own_keyframes_beside_scans() -> None:
    fix = PositionFixes("gps", at(333), np.zeros((1, 2)), np.ones((1, 2)))
    # Two marks in one picture, one sighting after the end of the drive.
    ones: Floats = np.ones(3)
    marks = LandmarkSightings("marks", at(335, 335, 1200), np.array([1, 2, 1]), ones, ones)
    found = ms(choose_keyframes(drive(fix, marks), 0.1, at(330)))
    assert found == [0, 100, 200, 330, 333, 335, *TENTHS[4:]]


def test_every_scan_in_use_stands_at_its_keyframe() -> None:
    simulated = load_sim("seed-b-room?seed=1&duration=6")
    front = look_around(simulated)
    assert front is not None
    problem = build_problem(simulated, Settings(), front)
    assert problem.scene is not None
    np.testing.assert_array_equal(problem.keyframes_ns[problem.scene.at], front.scans.stamps_ns)
    (every,) = simulated.each(Scans)
    np.testing.assert_array_equal(every.stamps_ns[front.numbers], front.scans.stamps_ns)
    np.testing.assert_array_equal(every.ranges[front.numbers], front.scans.ranges)
    assert front.left_out == every.stamps_ns.size - front.numbers.size
    # At 0.5 m/s and 10 scans a second every third or fourth has gone on by 15 cm, and none waits
    # longer than a second.
    steps = np.diff(front.scans.stamps_ns) * 1e-9
    assert steps.max() <= 1.0 + 1e-9
    assert 0.2 < np.median(steps) < 0.5
