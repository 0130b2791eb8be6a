"""Headings that leap: found by increments, against everybody else's, and left out of batch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from fgloc.core.drive import Drive
from fgloc.core.measurements import Floats, Yaw, YawRate
from fgloc.datasets.simulator import load_sim
from fgloc.smoothing.batch import BatchSmoother
from fgloc.smoothing.leaps import MOST, without_leaps

BEGIN, END = 12.0, 14.0
"""When the heading is wrong [s]."""


def simulated(sensors: str) -> Drive:
    """Return half a minute of a 4×4 with a heading sensor and others."""
    return load_sim(f"random?seed=4&duration=30&slip=off&yaw=on&{sensors}")


def told_otherwise(drive: Drive, change: Callable[[Floats, Floats], Floats]) -> Drive:
    """Return the drive with a heading that is a function of time [s] and true reading."""
    (yaw,) = drive.each(Yaw)
    false = replace(yaw, yaw=change(seconds_of(drive, yaw), np.unwrap(yaw.yaw)))
    return replace(drive, sensors=tuple(false if s is yaw else s for s in drive.sensors))


def seconds_of(drive: Drive, yaw: Yaw) -> Floats:
    """Return the times of a sensor's readings since the first wheel stamp [s]."""
    return np.asarray((yaw.stamps_ns - drive.wheels.stamps_ns[0]) * 1e-9)


def leaping(t: Floats, yaw: Floats) -> Floats:
    """Return a heading that is off by 0.4 rad for two seconds."""
    return np.asarray(yaw + 0.4 * ((t > BEGIN) & (t < END)))


@pytest.mark.parametrize("sensors", ["gyro=on", "gyro=off&camera=on", "gyro=on&camera=on"])
def test_a_leap_and_back_is_cut_out(sensors: str) -> None:
    drive = simulated(sensors)
    less, found = without_leaps(told_otherwise(drive, leaping))
    (one,) = found
    (yaw,) = less.each(Yaw)
    (whole,) = drive.each(Yaw)
    seconds = seconds_of(drive, yaw)
    assert not np.any((seconds > BEGIN) & (seconds < END))
    # What is left out is no more than the time of the fault, and a step at each end of it.
    every = seconds_of(drive, whole)
    wrong = int(np.sum((every > BEGIN) & (every < END)))
    assert one.count == whole.stamps_ns.size - yaw.stamps_ns.size
    assert wrong <= one.count <= int(np.sum((every > BEGIN - 0.1) & (every < END + 0.1)))
    assert "leaps by +0.4" in one.note
    assert "-0.4" in one.note
    # Nothing was changed of what is left.
    at = np.searchsorted(whole.stamps_ns, yaw.stamps_ns)
    np.testing.assert_array_equal(yaw.yaw, np.unwrap(whole.yaw)[at])


def test_a_zero_that_moves_for_good_leaves_the_longer_part() -> None:
    drive = simulated("gyro=on")
    moved = told_otherwise(drive, lambda t, yaw: yaw + 0.4 * (t > 20.0))
    less, found = without_leaps(moved)
    (yaw,) = less.each(Yaw)
    assert len(found) == 1
    assert 19.7 < seconds_of(drive, yaw).max() <= 20.0


def test_nobody_is_doubted_who_does_not_leap() -> None:
    for sensors in ("gyro=on", "gyro=off&camera=on", "gyro=on&camera=on", "gyro=off"):
        drive = simulated(sensors)
        assert without_leaps(drive) == (drive, ())
    # A lie that grows slowly is for others to find, and so is a sensor that turns the wrong way.
    for change in (lambda t, yaw: yaw + 0.05 * t, lambda t, yaw: -yaw):
        assert without_leaps(told_otherwise(simulated("gyro=on"), change))[1] == ()


def test_with_wheels_alone_nobody_can_tell() -> None:
    drive = told_otherwise(simulated("gyro=off"), leaping)
    assert without_leaps(drive) == (drive, ())


def test_wheels_that_slip_do_not_count_against_the_heading() -> None:
    slip = "fl+rl:8:10:1.6,fr+rr:15:18:1.4"
    drive = load_sim(f"random?seed=5&duration=25&yaw=on&gyro=on&slip={slip}")
    assert without_leaps(drive) == (drive, ())


def test_a_gyro_that_spikes_is_alone() -> None:
    drive = simulated("gyro=on")
    (gyro,) = drive.each(YawRate)
    rate = gyro.rate.copy()
    middle = rate.size // 2
    rate[middle : middle + 3] += 20.0
    wrong = replace(gyro, rate=rate)
    spiked = replace(drive, sensors=tuple(wrong if s is gyro else s for s in drive.sensors))
    assert without_leaps(spiked)[1] == ()


def test_a_sensor_that_leaps_all_the_time_is_not_for_here() -> None:
    drive = simulated("gyro=on")
    often = told_otherwise(drive, lambda t, yaw: yaw + 0.4 * (np.floor(t) % 2))
    assert MOST < 29
    assert without_leaps(often)[1] == ()


def test_batch_counts_what_is_left_out_and_tells() -> None:
    drive = simulated("gyro=on&camera=on")
    sound = BatchSmoother().estimate(drive)
    result = BatchSmoother().estimate(told_otherwise(drive, leaping))
    left_out = without_leaps(told_otherwise(drive, leaping))[1][0].count
    assert result.counts["yaw"].rejected - sound.counts["yaw"].rejected == left_out
    assert [n for n in result.notes if n.startswith("yaw leaps by +0.4")]
    off = result.trajectory.poses - sound.trajectory.poses
    # 0.4 rad for two seconds would have cost decimetres.
    assert np.abs(off[:, :2]).max() < 0.05
    # A row less where the readings are missing, no more.
    assert sound.counts["yaw"].accepted - result.counts["yaw"].accepted < left_out
