"""A sensor that suddenly lies: found within moments, paused, heard again; and cameras freed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from fgloc.core.drive import Drive
from fgloc.core.measurements import CameraPoses, Floats, Yaw
from fgloc.datasets.simulator import load_sim
from fgloc.online.alarm import Pause, pause_notes
from fgloc.online.engine import OnlineEngine
from fgloc.online.online import notes
from fgloc.online.replay import packets

from .driving import counted, engine_for, run

BEGIN, END = 15.0, 18.0
"""When the heading is wrong [s]."""


def told_otherwise(drive: Drive, change: Callable[[Floats, Floats], Floats]) -> Drive:
    """Return the drive with a heading that is a function of time [s] and true reading."""
    (yaw,) = drive.each(Yaw)
    seconds = (yaw.stamps_ns - drive.wheels.stamps_ns[0]) * 1e-9
    false = replace(yaw, yaw=change(seconds, np.unwrap(yaw.yaw)))
    return replace(drive, sensors=tuple(false if s is yaw else s for s in drive.sensors))


def driven(drive: Drive) -> tuple[OnlineEngine, Floats]:
    """Return an engine after a drive and the (N, 3) poses after each packet."""
    engine, sent = engine_for(drive), list(packets(drive))
    poses = run(engine, sent, every=100)
    counted(engine, sent)
    return engine, poses


def seconds(engine: OnlineEngine, pause: Pause) -> tuple[float, float]:
    """Return begin and end of a pause since the start, infinity for none [s]."""
    end = np.inf if pause.until_ns is None else (pause.until_ns - engine.began_ns) * 1e-9
    return (pause.begin_ns - engine.began_ns) * 1e-9, end


@pytest.mark.parametrize("sensors", ["gyro=on", "gyro=on&camera=on", "gyro=off&camera=on"])
def test_a_heading_that_leaps_is_not_believed_while_it_is_wrong(sensors: str) -> None:
    drive = load_sim(f"random?seed=3&duration=30&slip=off&yaw=on&{sensors}")
    leaping = told_otherwise(drive, lambda t, yaw: yaw + 0.5 * ((t > BEGIN) & (t < END)))
    engine, poses = driven(leaping)
    (pause,) = engine.pauses
    begin, end = seconds(engine, pause)
    assert pause.sensor == "yaw"
    assert BEGIN - 0.5 < begin < BEGIN + 0.5
    assert END < end < END + 5.0
    (note,) = [n for n in notes(engine) if "not believed" in n]
    assert note.startswith(f"yaw was not believed from {begin:.1f} to {end:.1f} s: ")
    assert "wheels agree without it" in note
    # As good as without a leap, where 0.5 rad for 3 s would have cost a metre.
    _, sound = driven(drive)
    assert np.abs(poses[-1, :2] - sound[-1, :2]).max() < 0.1
    # It is heard again: half of the last readings count.
    assert engine.tally["yaw"].accepted > 100


def test_a_heading_that_stands_still_is_left_out_in_the_end() -> None:
    drive = load_sim("random?seed=3&duration=60&slip=off&yaw=on&gyro=on")
    stuck = told_otherwise(
        drive, lambda t, yaw: np.where(t < BEGIN, yaw, yaw[np.argmax(t > BEGIN)])
    )
    engine, poses = driven(stuck)
    assert {p.sensor for p in engine.pauses} == {"yaw"}
    assert [p.until_ns is None for p in engine.pauses] == [False, False, True]
    assert [bool(p.others) for p in engine.pauses] == [True, False, False]
    *_, last = pause_notes(engine.pauses, engine.began_ns)
    assert last.startswith("yaw is left out from ")
    # No pose was taken along by metres, not even when the sensor was tried again.
    (yaw,) = drive.each(Yaw)
    less = replace(drive, sensors=tuple(s for s in drive.sensors if s is not yaw))
    _, without = driven(less)
    assert np.abs(poses[-1, :2] - without[-1, :2]).max() < 0.5
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    assert steps.max() < 0.3


@pytest.mark.parametrize("camera", ["on", "off"])
def test_wheels_that_slip_are_not_held_against_those_who_see_it(camera: str) -> None:
    slip = "fl+rl:8:10:1.5,fr+rr:15:18:1.4"
    drive = load_sim(f"random?seed=5&duration=25&yaw=on&gyro=on&camera={camera}&slip={slip}")
    engine, _ = driven(drive)
    assert engine.pauses == []
    assert engine.left_out == {}


def test_a_single_wild_reading_pauses_nobody() -> None:
    drive = load_sim("random?seed=3&duration=30&slip=off&yaw=on&gyro=on")
    wild = told_otherwise(drive, lambda t, yaw: yaw + 2.0 * (np.abs(t - BEGIN) < 0.03))
    engine, _ = driven(wild)
    assert engine.pauses == []


def test_nobody_but_the_wheels_is_no_witness() -> None:
    drive = load_sim("random?seed=3&duration=30&slip=off&yaw=on&gyro=off&camera=off")
    leaping = told_otherwise(drive, lambda t, yaw: yaw + 0.5 * ((t > BEGIN) & (t < END)))
    engine, _ = driven(leaping)
    assert engine.pauses == []


def test_a_camera_of_wrong_scale_is_freed_and_told() -> None:
    drive = load_sim("random?seed=3&duration=30&slip=off&yaw=off&gyro=on&camera=on")
    (camera,) = drive.each(CameraPoses)
    longer = replace(camera, poses=camera.poses * np.array([1.2, 1.2, 1.0]))
    wrong = replace(drive, sensors=tuple(longer if s is camera else s for s in drive.sensors))
    engine, _ = driven(wrong)
    (note,) = engine.remarks
    assert note.startswith("camera could only be right in scale if ")
    assert note in list(notes(engine))
    names = [p.name for p in engine.layout.parameters]
    k = names.index("camera_scale")
    known = engine.smoother.posterior
    scale = engine.layout.parameters[k].to_value(float(known.border[k]))
    sigma = float(np.sqrt(known.covariance[engine.layout.width + k, engine.layout.width + k]))
    true = 1.2 * (drive.true_calibration or {})["camera_scale"]
    assert abs(scale - true) < 3.0 * sigma
    assert sigma < 0.05
