"""Drives that are not what one hopes for: slow, silent or frozen sensors, known robots, leaps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgloc.core.drive import Drive
from fgloc.core.measurements import PositionFixes, Yaw
from fgloc.errors import FglocError
from fgloc.estimator import Result
from fgloc.smoothing.batch import BatchSmoother
from fgloc.smoothing.settings import Settings

from .drives import scores, simulated, with_sensor


def smooth(drive: Drive, **settings: object) -> Result:
    return BatchSmoother(Settings(**settings)).estimate(drive)  # type: ignore[arg-type]


@pytest.mark.parametrize("solver", ["arrow", "gtsam"])
def test_a_robot_that_is_known_exactly_is_not_calibrated(solver: str) -> None:
    drive = simulated(
        "figure-eight?robot=differential&seed=3&duration=20&fix_every=4&calibration=nominal"
    )
    base = drive.robot.base
    fixed = tuple(replace(p, prior_sigma=0.0) for p in base.parameters)
    known = replace(drive.robot, base=replace(base, parameters=fixed))
    result = smooth(replace(drive, robot=known), solver=solver)
    assert result.calibration == ()
    assert scores(result, drive).ate_rmse_m < 0.03


def test_a_gyro_whose_bias_is_known_is_used() -> None:
    drive = simulated("figure-eight?seed=4&duration=20&gyro=on&gyro_bias_sigma=0&gyro_density=0")
    result = smooth(drive)
    assert "gyro" in result.sensors_used
    assert scores(result, drive).ate_heading_rmse_deg < 0.5


def test_a_slow_yaw_sensor_is_used_once_a_reading() -> None:
    # A compass at 2 Hz is too slow to interpolate: each reading gets a keyframe of its own.
    quiet = "yaw=on&yaw_drift=0&yaw_walk=0"
    drive = simulated(f"figure-eight?seed=6&duration=30&yaw_rate=2&{quiet}")
    (yaw,) = drive.each(Yaw)
    between = replace(yaw, stamps_ns=yaw.stamps_ns[:-1] + 37_000_000, yaw=yaw.yaw[:-1])
    count = smooth(with_sensor(drive, between)).counts["yaw"]
    assert count.accepted + count.down_weighted == between.stamps_ns.size
    # At 5 Hz it is interpolated, but what lies between two readings must not count again.
    drive = simulated(f"figure-eight?seed=6&duration=30&rate=20&yaw_rate=5&{quiet}")
    (yaw,) = drive.each(Yaw)
    count = smooth(drive, keyframe_period_s=0.05).counts["yaw"]
    assert count.accepted + count.down_weighted == yaw.stamps_ns.size


def test_streams_that_cannot_be_used_are_named_with_the_reason() -> None:
    drive = simulated("figure-eight?seed=7&duration=20&fix_every=4&gyro=on&gyro_rate=2")
    (fixes,) = drive.each(PositionFixes)
    other_clock = replace(fixes, stamps_ns=fixes.stamps_ns + 10**18)
    result = smooth(with_sensor(drive, other_clock))
    assert result.sensors_used == ("wheels",)
    notes = " ".join(result.notes)
    assert "fixes was not used: no reading lies between" in notes
    assert "gyro was not used: readings are more than 0.25 s apart" in notes


def test_wheels_that_fall_silent_are_mentioned() -> None:
    drive = simulated("figure-eight?seed=8&duration=20")
    w = drive.wheels
    whole = w.angles[30:60].sum(axis=0)[None]
    silent = replace(
        w,
        stamps_ns=np.delete(w.stamps_ns, np.arange(31, 60)),
        angles=np.concatenate([w.angles[:30], whole, w.angles[60:]]),
    )
    assert smooth(drive).notes == ()
    (note,) = smooth(replace(drive, wheels=silent)).notes
    assert note.startswith("the wheels are silent for 6 s, 6.0 s after the start")


def test_a_heading_that_freezes_without_an_arbiter_is_mentioned() -> None:
    drive = simulated("figure-eight?robot=differential&seed=9&duration=40&yaw=on&yaw_drift=0")
    (yaw,) = drive.each(Yaw)
    frozen = yaw.yaw.copy()
    frozen[frozen.size // 2 :] = frozen[frozen.size // 2]
    result = smooth(with_sensor(drive, replace(yaw, yaw=frozen)))
    assert any("were given up because the others contradict" in note for note in result.notes)


def test_a_leap_that_swamps_all_digits_is_a_known_error() -> None:
    drive = simulated("figure-eight?seed=10&duration=20&fix_every=2")
    angles = drive.wheels.angles.copy()
    angles[20, 0] = 1e150
    with pytest.raises(FglocError, match=r"cannot be smoothed|indeterminate"):
        smooth(replace(drive, wheels=replace(drive.wheels, angles=angles)))
