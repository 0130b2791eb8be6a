"""Where a drive starts: at or between recorded poses, or at the first of poses far apart."""

from __future__ import annotations

import numpy as np
import pytest

from fgloc.core import bases
from fgloc.core.drive import Drive, Reference
from fgloc.core.measurements import WheelIncrements
from fgloc.core.robot import Robot, typical_noise
from fgloc.core.start import start_pose, trim_to_truth
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError

SECOND = 1_000_000_000
BASE = bases.differential(0.1, 0.1, 0.5)


def drive(
    truth_s: list[float], wheels_s: list[float], mount: tuple[float, float, float] = (0, 0, 0)
) -> Drive:
    """Return a drive along x at 1 m/s: the truth is (t, 0, 0), wheels of 0.1 m turn 10 rad/s."""
    at = np.array(truth_s)
    stamps = np.round(np.array(wheels_s) * SECOND).astype(np.int64)
    angles = np.repeat(10.0 * np.diff(wheels_s)[:, None], 2, axis=1)
    poses = np.stack([at, np.zeros(at.size), np.zeros(at.size)], axis=1)
    return Drive(
        "straight",
        Robot("robot", BASE, typical_noise("differential")),
        WheelIncrements("wheels", stamps, angles, BASE.driven_names),
        truth=Reference(Trajectory(np.round(at * SECOND).astype(np.int64), poses), mount=mount),
    )


def test_sparse_truth_starts_the_clock_and_cuts_the_increment_there() -> None:
    # Poses every 10 s, the first at 2.3 s; wheels every second.
    whole = drive([2.3, 12.3, 22.3], [float(k) for k in range(31)])
    cut = trim_to_truth(whole)
    assert cut.wheels.stamps_ns[:3].tolist() == [2_300_000_000, 3 * SECOND, 4 * SECOND]
    assert cut.wheels.stamps_ns.size == 29
    # 0.7 s of the second between 2 and 3 is left: 7 rad.
    np.testing.assert_allclose(cut.wheels.angles[:2], [[7.0, 7.0], [10.0, 10.0]], atol=1e-12)
    assert cut.wheels.angles.shape == (28, 2)
    np.testing.assert_allclose(start_pose(whole), [2.3, 0.0, 0.0], atol=1e-12)
    # What was cut once stays as it is, and what was handed in was not touched.
    assert trim_to_truth(cut) is cut
    np.testing.assert_allclose(start_pose(cut), [2.3, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(whole.wheels.angles, 10.0)
    # The way from there to the end is what it is: 30 - 2.3 s at 1 m/s.
    assert 0.1 * cut.wheels.angles[:, 0].sum() == pytest.approx(27.7)


def test_sparse_truth_at_a_wheel_stamp_cuts_nothing() -> None:
    whole = drive([2.0, 12.0], [float(k) for k in range(21)])
    cut = trim_to_truth(whole)
    assert cut.wheels.stamps_ns[0] == 2 * SECOND
    np.testing.assert_allclose(cut.wheels.angles, 10.0)
    at_once = drive([0.0, 10.0], [float(k) for k in range(21)])
    assert trim_to_truth(at_once) is at_once


def test_sparse_truth_that_began_before_the_wheels() -> None:
    # Between poses 10 s apart nothing is known: the first one within the drive is at 5 s.
    cut = trim_to_truth(drive([-5.0, 5.0, 15.0], [float(k) for k in range(21)]))
    assert cut.wheels.stamps_ns[0] == 5 * SECOND


def test_sparse_truth_in_the_last_increment_leaves_one() -> None:
    cut = trim_to_truth(drive([9.25, 30.0], [float(k) for k in range(11)]))
    assert cut.wheels.stamps_ns.tolist() == [9_250_000_000, 10 * SECOND]
    np.testing.assert_allclose(cut.wheels.angles, [[7.5, 7.5]])


def test_sparse_truth_around_the_drive_is_interpolated() -> None:
    # No pose within the drive: whatever lies between them is better than nothing.
    whole = drive([-10.0, 30.0], [float(k) for k in range(11)])
    assert trim_to_truth(whole).wheels.stamps_ns[0] == 0
    np.testing.assert_allclose(start_pose(whole), [0.0, 0.0, 0.0], atol=1e-12)


def test_truth_after_the_wheels_is_an_error() -> None:
    for truth in ([20.0, 30.0], [20.0, 20.1, 20.2], [10.0, 20.0]):
        with pytest.raises(FglocError, match="does not overlap"):
            trim_to_truth(drive(truth, [float(k) for k in range(11)]))


def test_dense_truth_starts_at_a_wheel_stamp_between_two_poses() -> None:
    # Poses at 2.3, 2.7, …: the first wheel stamp between two of them is 3, none is cut.
    truth = (2.3 + 0.4 * np.arange(20)).tolist()
    whole = drive(truth, [float(k) for k in range(11)], mount=(0.5, 0.0, 0.0))
    cut = trim_to_truth(whole)
    assert cut.wheels.stamps_ns[0] == 3 * SECOND
    np.testing.assert_allclose(cut.wheels.angles, 10.0)
    # The reference sits half a metre ahead of the base.
    np.testing.assert_allclose(start_pose(whole), [2.5, 0.0, 0.0], atol=1e-9)


def test_steering_is_cut_with_the_wheels() -> None:
    whole = drive([2.3, 12.3, 22.3], [float(k) for k in range(31)])
    steering = np.repeat(np.arange(30.0)[:, None], 2, axis=1)
    steered = Drive(
        whole.name,
        whole.robot,
        WheelIncrements(
            "wheels", whole.wheels.stamps_ns, whole.wheels.angles, BASE.driven_names, steering
        ),
        truth=whole.truth,
    )
    cut = trim_to_truth(steered).wheels
    assert cut.steering is not None
    # A mean angle over the interval stays that of the part.
    assert cut.steering[:, 0].tolist() == list(np.arange(2.0, 30.0))
