"""Encoder selection by hand, on the seed's scenarios, and what noise makes of it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fgloc.core import bases
from fgloc.core.drive import Drive
from fgloc.core.encoder_selection import packet_means, select_encoders, wheel_sides
from fgloc.core.kinematics import WheeledBase
from fgloc.core.measurements import Acceleration, Floats, WheelIncrements
from fgloc.core.robot import Robot
from fgloc.datasets.registry import load_drive
from fgloc.errors import FglocError

TICK = 2.0 * math.pi / 300
SKID = bases.skid_steer(("fl", "rl"), ("fr", "rr"), 0.135, 0.48, order=("fl", "fr", "rl", "rr"))


def stamps(seconds: list[float]) -> np.ndarray:
    return np.round(np.array(seconds) * 1e9).astype(np.int64)


def drive(angles: list[list[float]], *sensors: Acceleration, base: WheeledBase = SKID) -> Drive:
    """Packets of 1 s from 0 s on."""
    t = stamps([float(k) for k in range(len(angles) + 1)])
    wheels = WheelIncrements("wheels", t, np.array(angles), base.driven_names)
    return Drive("byhand", Robot("test", base), wheels, sensors, notes=("Recorded.",))


def selected(angles: list[list[float]], *sensors: Acceleration) -> list[list[float]]:
    out: list[list[float]] = select_encoders(drive(angles, *sensors)).wheels.angles.tolist()
    return out


def test_smaller_while_accelerating_larger_while_braking() -> None:
    # Columns fl fr rl rr; samples at the stamp's end belong to the packet, at its begin do not.
    acceleration = Acceleration(
        "acc", stamps([0.0, 0.5, 1.0, 1.5, 2.0, 2.5]), np.array([-9.0, 1.0, -0.5, -1.0, 0.5, 0.0])
    )
    angles = [
        [3.0, -2.0, 2.0, -4.0],  # mean of 1 and -0.5: accelerating
        [3.0, -2.0, 2.0, -4.0],  # mean of -1 and 0.5: braking
        [-1.0, 5.0, 3.0, 6.0],  # 0.0: counts as accelerating
        [1.0, 2.0, -3.0, 2.0],  # no samples: taken as zero
    ]
    assert selected(angles, acceleration) == [
        [2.0, -2.0, 2.0, -2.0],
        [3.0, -4.0, 3.0, -4.0],
        [-1.0, 5.0, -1.0, 5.0],
        [1.0, 2.0, 1.0, 2.0],
    ]


def test_of_equal_ones_as_printed() -> None:
    # Equations 3.3 and 3.5: for |front| <= |rear| the front one accelerating, the rear one braking.
    braking = Acceleration("acc", stamps([0.5]), np.array([-1.0]))
    angles = [[2.0, 1.0, -2.0, 1.0]]
    assert selected(angles) == [[2.0, 1.0, 2.0, 1.0]]
    assert selected(angles, braking) == [[-2.0, 1.0, -2.0, 1.0]]


def test_means_skip_what_lies_outside_and_empty_packets() -> None:
    t = [0.2, 0.4, 2.5, 2.6, 2.7, 9.0]
    acceleration = Acceleration("acc", stamps(t), np.array([1.0, 2.0, 3.0, 4.0, 5.0, 100.0]))
    found = drive([[0.0] * 4] * 5, acceleration)
    mean, known = packet_means(found, found.wheels.stamps_ns)
    assert mean.tolist() == [1.5, 0.0, 4.0, 0.0, 0.0]
    assert known.tolist() == [True, False, True, False, False]
    late = drive([[0.0] * 4] * 2, Acceleration("acc", stamps([0.5]), np.array([np.pi])))
    mean, known = packet_means(late, late.wheels.stamps_ns + 7_000_000_000)
    assert (mean.tolist(), known.any()) == ([0.0, 0.0], False)


def test_notes_tell_what_was_done_and_the_rest_is_untouched() -> None:
    acceleration = Acceleration("acc", stamps([0.5]), np.array([-1.0]))
    before = drive([[3.0, 2.0, 2.0, 2.0], [1.0, 1.0, 1.0, 1.0]], acceleration)
    after = select_encoders(before)
    assert after.notes == (
        "Recorded.",
        "Encoder selection: one encoder a side is believed, the faster one in 1 of 2 packets "
        "(braking); those of a side differed 1 times.",
        "Encoder selection: 1 of 2 packets hold no acceleration; it is taken as zero there.",
    )
    assert before.wheels.angles[0, 2] == 2.0
    assert after.wheels.stamps_ns is before.wheels.stamps_ns
    assert after.sensors == before.sensors
    without = select_encoders(drive([[1.0] * 4]))
    assert without.notes[-1] == (
        "Encoder selection: there is no accelerometer; acceleration is taken as zero."
    )


def test_three_wheels_a_side_in_any_column_order() -> None:
    base = bases.skid_steer(
        ("l1", "l2", "l3"), ("r1", "r2"), 0.1, 0.5, order=("r1", "l3", "l1", "r2", "l2")
    )
    assert wheel_sides(base) == {"left": [1, 2, 4], "right": [0, 3]}
    out = select_encoders(drive([[9.0, 3.0, 2.0, -8.0, 4.0]], base=base)).wheels.angles
    assert out.tolist() == [[-8.0, 2.0, 2.0, -8.0, 2.0]]


@pytest.mark.parametrize("case", ["straight", "spin", "circle"])
@pytest.mark.parametrize("scenario", ["slip20", "slip40ticks"])
def test_scenario_3_returns_to_scenario_1(case: str, scenario: str) -> None:
    slipping = load_drive(f"sim:seed-a-{case}-{scenario}")
    ideal = load_drive(f"sim:seed-a-{case}-ideal")
    assert np.any(slipping.wheels.angles != ideal.wheels.angles)
    # Bit by bit, since on every side one wheel grips throughout.
    np.testing.assert_array_equal(select_encoders(slipping).wheels.angles, ideal.wheels.angles)


@pytest.mark.parametrize("case", ["straight", "spin", "circle"])
def test_both_wheels_of_a_side_slipping_are_believed(case: str) -> None:
    slipping = load_drive(f"sim:seed-a-{case}-bothleft")
    np.testing.assert_array_equal(select_encoders(slipping).wheels.angles, slipping.wheels.angles)


@pytest.mark.parametrize("case", ["straight", "spin", "circle"])
def test_count_noise_shortens_every_packet_by_a_sixth_of_a_count(case: str) -> None:
    # The smaller of two numbers uniform in ±1/2 is -1/6 on average, with a variance of 1/18; of
    # their magnitudes likewise when a side drives backwards.
    ideal = load_drive(f"sim:seed-a-{case}-ideal").wheels.angles
    moving = ideal != 0.0
    off: list[Floats] = []
    for seed in range(20):
        noisy = select_encoders(load_drive(f"sim:seed-a-{case}-noise?seed={seed}")).wheels.angles
        off.append((np.abs(noisy) - np.abs(ideal))[moving] / TICK)
    values = np.concatenate(off)
    # Both wheels of a side have the same increment: half as many draws as values.
    spread = math.sqrt(1.0 / 18.0 / (values.size / 2))
    assert abs(values.mean() + 1.0 / 6.0) < 4.0 * spread
    assert values.mean() + 4.0 * spread < 0.0


def test_accelerometer_noise_flips_the_rule_at_constant_speed() -> None:
    # Symmetric noise: at constant speed every packet is a coin's throw between the slipping wheel
    # and the gripping one; 15 increments of a drive slip.
    ideal = load_drive("sim:seed-a-straight-ideal").wheels.angles
    wrong = total = 0
    for seed in range(30):
        noisy = load_drive(
            f"sim:seed-a-straight-slip20?seed={seed}&acc=on&acc_bias_sigma=0&acc_resolution=0"
        )
        slipping = noisy.wheels.angles != ideal
        chosen = select_encoders(noisy).wheels.angles
        wrong += int((chosen != ideal)[slipping].sum())
        total += int(slipping.sum())
    assert total == 30 * 15
    # Ten throws a drive, five of which decide two increments at once: a variance of
    # (5·1² + 5·2²)/4, so a standard deviation of 2.5 of 15 a drive.
    assert abs(wrong / total - 0.5) < 4.0 * 2.5 / 15.0 / math.sqrt(30.0)


@pytest.mark.parametrize(
    ("base", "message"),
    [
        (bases.differential(0.1, 0.1, 0.5), "byhand: encoder selection needs two or more encoders"),
        (
            bases.skid_steer(("a", "b"), ("c",), 0.1, 0.5),
            "two or more encoders on each side, the right side has 1",
        ),
        (bases.mecanum(0.05, 0.2, 0.2, ("fl", "fr", "rl", "rr")), "a mecanum base is not one"),
        (bases.tricycle(0.1, 0.8), "a tricycle base is not one"),
    ],
)
def test_where_it_cannot_be_done(base: WheeledBase, message: str) -> None:
    with pytest.raises(FglocError, match=message):
        select_encoders(drive([[1.0] * len(base.driven)], base=base))
