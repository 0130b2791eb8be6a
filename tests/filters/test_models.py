"""Models 1 and 2 against the numbers seed A printed, and Model 2 where its sensor falls silent."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from fgloc.core import bases
from fgloc.core.drive import Drive, Reference
from fgloc.core.evaluation import evaluate
from fgloc.core.measurements import Floats, WheelIncrements, Yaw, YawRate
from fgloc.core.robot import Robot
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.registry import load_drive
from fgloc.errors import FglocError
from fgloc.filters.model1 import Model1
from fgloc.filters.model2 import Model2

BASE = bases.differential(0.1, 0.1, 0.5)


def stamps(seconds: Floats) -> np.ndarray:
    return np.round(seconds * 1e9).astype(np.int64)


def spinning(*sensors: Yaw | YawRate, rate: float = 1.0, wheel_scale: float = 1.0) -> Drive:
    """10 s at 10 Hz: forward 0.3 m/s, turning at `rate`; the wheels' turn is off by a scale."""
    t = np.arange(101) * 0.1
    side = 0.25 * rate * wheel_scale
    angles = np.tile([(0.3 - side) * 0.1 / 0.1, (0.3 + side) * 0.1 / 0.1], (100, 1))
    wheels = WheelIncrements("wheels", stamps(t), angles, ("left", "right"))
    return Drive("turning", Robot("test", BASE), wheels, sensors)


@pytest.mark.parametrize(
    ("case", "position", "heading"),
    # Table 3.2 of the seed, in m and degrees.
    [("straight", 0.379, 6.8), ("spin", 0.025, 13.5), ("circle", 0.539, 12.6)],
)
def test_model1_with_slip_is_table_3_2(case: str, position: float, heading: float) -> None:
    drive = load_drive(f"sim:seed-a-{case}-slip20")
    assert drive.truth is not None
    scores = evaluate(Model1("midpoint").estimate(drive).trajectory, drive.truth)
    assert round(scores.end_position_m, 3) == position
    # The straight case ends at 6.75° exactly, printed as 6.8.
    assert scores.end_heading_deg == pytest.approx(heading, abs=0.0501)


@pytest.mark.parametrize("case", ["straight", "spin", "circle"])
def test_ideal_cases_end_where_the_seed_says(case: str) -> None:
    drive = load_drive(f"sim:seed-a-{case}-ideal")
    end = Model1("midpoint").estimate(drive).trajectory.poses[-1]
    # 8 s at 5 packets of 40 counts, 2π·0.135/300 m each: 4.5239 m; two turns; one full circle.
    expected = {
        "straight": (4.5239, 0.0, 0.0),
        "spin": (0.0, 0.0, -4 * math.pi),
        "circle": (0.0, 0.0, -2 * math.pi),
    }
    np.testing.assert_allclose(end, expected[case], atol=1e-3)


@pytest.mark.parametrize(
    ("scenario", "case", "position"),
    # The slip of 20 % that the seed describes, and the +40 counts its Table 3.4 follows from.
    [
        ("slip20", "straight", 0.085),
        ("slip20", "spin", 0.026),
        ("slip20", "circle", 0.173),
        ("slip40ticks", "straight", 0.424),
        ("slip40ticks", "spin", 0.128),
        ("slip40ticks", "circle", 0.399),
    ],
)
def test_model2_with_slip(scenario: str, case: str, position: float) -> None:
    drive = load_drive(f"sim:seed-a-{case}-{scenario}")
    assert drive.truth is not None
    scores = evaluate(Model2().estimate(drive).trajectory, drive.truth)
    # The seed rounds 0.1725 up; a half is within rounding either way.
    assert scores.end_position_m == pytest.approx(position, abs=5.1e-4)
    assert scores.end_heading_deg == pytest.approx(0.0, abs=1e-9)


def test_euler_step_lies_along_the_old_heading() -> None:
    # One step of 0.2 m while turning by 0.4 rad from the origin, by hand.
    wheels = WheelIncrements(
        "wheels", stamps(np.array([0.0, 1.0])), np.array([[1.0, 3.0]]), ("left", "right")
    )
    drive = Drive("step", Robot("test", BASE), wheels)
    turn = (0.3 - 0.1) / 0.5
    ends = {
        "euler": (0.2, 0.0),
        "midpoint": (0.2 * math.cos(turn / 2), 0.2 * math.sin(turn / 2)),
        "exact": (0.2 / turn * math.sin(turn), 0.2 / turn * (1 - math.cos(turn))),
    }
    for integrator, (x, y) in ends.items():
        end = Model1(integrator).estimate(drive).trajectory.poses[-1]  # type: ignore[arg-type]
        np.testing.assert_allclose(end, [x, y, turn], rtol=1e-12, atol=1e-15)


def test_yaw_corrects_a_wrong_track_whatever_its_zero_and_wrapping() -> None:
    t = np.arange(-3, 520) * 0.02
    yaw = Yaw("yaw", stamps(t), (2.5 + t + np.pi) % (2 * np.pi) - np.pi, 0.01)
    result = Model2().estimate(spinning(yaw, wheel_scale=1.4))
    np.testing.assert_allclose(
        result.trajectory.poses[:, 2], np.arange(101) * 0.1, rtol=0, atol=1e-9
    )
    assert result.sensors_used == ("wheels", "yaw")
    assert result.notes == ()


def test_silent_yaw_is_bridged_by_the_encoders_and_counted() -> None:
    t = np.arange(501) * 0.02
    # Nothing from 3 s to 8 s: five seconds at 1 rad/s, more than half a turn.
    t = t[(t <= 3.0) | (t >= 8.0)]
    yaw = Yaw("yaw", stamps(t), t % (2 * np.pi), 0.01)
    result = Model2().estimate(spinning(yaw, wheel_scale=1.1))
    heading = result.trajectory.poses[:, 2]
    assert heading[30] == pytest.approx(3.0)
    # Inside the gap the wheels turn 10 % too fast, from the last reading on.
    assert heading[70] == pytest.approx(3.0 + 1.1 * 4.0)
    assert heading[-1] == pytest.approx(10.0)
    # Steps that end strictly between 3.0 and 8.0 s: 49.
    assert any("49 of 100 steps" in note for note in result.notes)


def test_yaw_that_begins_late_and_ends_early() -> None:
    t = np.arange(100, 301) * 0.02  # 2 s to 6 s
    yaw = Yaw("yaw", stamps(t), 7.0 + t, 0.01)
    heading = Model2().estimate(spinning(yaw, wheel_scale=1.1)).trajectory.poses[:, 2]
    assert heading[20] == pytest.approx(2.2)
    assert heading[60] == pytest.approx(2.2 + 4.0)
    assert heading[100] == pytest.approx(2.2 + 4.0 + 4.4)


def test_gyro_is_integrated_where_there_is_no_yaw() -> None:
    t = np.arange(0, 1001) * 0.01
    gyro = YawRate("gyro", stamps(t), 0.2 * t, 0.001)
    result = Model2().estimate(spinning(gyro))
    # The integral of 0.2 t is 0.1 t².
    np.testing.assert_allclose(result.trajectory.poses[:, 2], 0.1 * (np.arange(101) * 0.1) ** 2)
    assert any("gyro" in note for note in result.notes)


def test_gyro_silence_is_bridged_by_the_encoders() -> None:
    t = np.arange(0, 1001) * 0.01
    t = t[(t <= 4.05) | (t >= 5.15)]
    gyro = YawRate("gyro", stamps(t), np.ones(t.size), 0.001)
    result = Model2().estimate(spinning(gyro, wheel_scale=2.0))
    # The steps from 4.0 to 5.2 s touch the gap: 12 of them at twice the rate.
    assert result.trajectory.poses[-1, 2] == pytest.approx(10.0 + 1.2)
    assert any("12 of 100 steps" in note for note in result.notes)


def test_model2_without_a_heading_says_so() -> None:
    with pytest.raises(FglocError, match="model2 needs a yaw sensor; turning has none"):
        Model2().estimate(spinning())


def test_start_is_the_mounted_truth_at_the_first_common_stamp() -> None:
    # The truth begins at 0.25 s, between wheel stamps; its frame sits 0.2 m behind the base,
    # turned by 90°. It moves along x at 1 m/s, so at 0.3 s the base is 0.2 m to the truth's right.
    t = 0.25 + np.arange(60) * 0.02
    poses = np.column_stack([t, np.zeros(60), np.zeros(60)])
    reference = Reference(Trajectory(stamps(t), poses), mount=(-0.2, 0.0, math.pi / 2))
    result = Model1().estimate(replace(spinning(), truth=reference))
    assert result.trajectory.stamps_ns[0] == 300_000_000
    np.testing.assert_allclose(
        result.trajectory.poses[0], [0.3, -0.2, -math.pi / 2], rtol=0, atol=1e-12
    )
    assert result.counts["wheels"].rejected == 3


def test_truth_elsewhere_in_time_is_refused() -> None:
    reference = Reference(Trajectory(stamps(np.array([50.0, 51.0])), np.zeros((2, 3))))
    with pytest.raises(FglocError, match="does not overlap"):
        Model1().estimate(replace(spinning(), truth=reference))
