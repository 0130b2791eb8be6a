"""A change of the ground, and the effective track over time."""

from __future__ import annotations

import numpy as np
import pytest

from fgloc.core.drive import Drive
from fgloc.datasets.registry import load_drive
from fgloc.errors import FglocError
from fgloc.estimator import TurningHistory
from fgloc.filters.model3 import Model3
from fgloc.online.online import OnlineSmoother

DRIVE = "sim:random?seed=2&duration=110&gyro=on&yaw=on&camera=on&slip=off"


def history(options: str = "") -> TurningHistory:
    """Return the effective track as the online engine knew it over time."""
    found = OnlineSmoother().estimate(load_drive(DRIVE + options)).turning
    assert found is not None
    return found


def at(found: TurningHistory, seconds: float) -> float:
    """Return the track at a time."""
    return float(np.interp(seconds, (found.stamps_ns - found.stamps_ns[0]) * 1e-9, found.values))


def test_a_new_ground_is_followed_within_half_a_minute() -> None:
    true = load_drive(DRIVE).true_calibration
    assert true is not None
    found = history("&track_steps=60:1.25")
    assert at(found, 59.0) == pytest.approx(true["effective_track"], rel=0.06)
    assert at(found, 95.0) == pytest.approx(1.25 * true["effective_track"], rel=0.06)


def test_a_ground_that_stays_the_same_is_left_alone() -> None:
    true = load_drive(DRIVE).true_calibration
    assert true is not None
    found = history()
    seconds = (found.stamps_ns - found.stamps_ns[0]) * 1e-9
    off = np.abs(found.values - true["effective_track"])[seconds > 20.0]
    assert float(np.mean(off <= 2.0 * found.sigmas[seconds > 20.0])) > 0.9
    # What is known grows, but for the little that it walks.
    assert found.sigmas[-1] < 0.2 * found.sigmas[0]


def test_model_3_tells_its_own_track_over_time() -> None:
    found = Model3().estimate(load_drive(DRIVE)).turning
    assert found is not None
    assert found.name == "effective_track"
    assert found.values.size == found.stamps_ns.size == found.sigmas.size
    assert found.nominal == 0.48


def test_steps_of_the_simulator() -> None:
    first, other = load_drive(DRIVE), load_drive(DRIVE + "&track_steps=60:2")
    begin = first.wheels.stamps_ns - first.wheels.stamps_ns[0] < 59_000_000_000
    np.testing.assert_array_equal(first.wheels.angles[begin[1:]], other.wheels.angles[begin[1:]])

    # Left minus right for the same turn: twice the track, twice the difference.
    def turning(drive: Drive) -> float:
        late = drive.wheels.angles[~begin[1:]]
        return float(np.abs(late[:, 0] - late[:, 1]).sum())

    assert turning(other) == pytest.approx(2.0 * turning(first), rel=0.05)
    for text in ("60", "60:0", "x:1"):
        with pytest.raises(FglocError, match="track_steps"):
            load_drive(f"{DRIVE}&track_steps={text}")
