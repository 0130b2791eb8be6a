"""A stream that is not sound is refused when it is built, with its name and what is wrong."""

from __future__ import annotations

import numpy as np
import pytest

from fgloc.core.drive import Reference
from fgloc.core.measurements import (
    CameraPoses,
    LandmarkSightings,
    PoseFixes,
    PositionFixes,
    Scans,
    Stamps,
    WheelIncrements,
    Yaw,
    YawRate,
)
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError


def stamps(*values: int) -> Stamps:
    return np.array(values, dtype=np.int64)


THREE = stamps(0, 10, 20)


def test_wheel_increments_have_one_row_less_than_stamps() -> None:
    wheels = WheelIncrements("wheels", THREE, np.zeros((2, 2)), ("left", "right"))
    assert wheels.angles.shape == (2, 2)
    with pytest.raises(FglocError, match="wheels: angles has 3 rows, expected 2"):
        WheelIncrements("wheels", THREE, np.zeros((3, 2)), ("left", "right"))
    with pytest.raises(FglocError, match=r"wheels: angles must have shape \(2, 2\)"):
        WheelIncrements("wheels", THREE, np.zeros((2, 3)), ("left", "right"))
    with pytest.raises(FglocError, match="wheels: steering has 1 rows, expected 2"):
        WheelIncrements("wheels", THREE, np.zeros((2, 1)), ("front",), np.zeros((1, 1)))
    with pytest.raises(FglocError, match=r"steering must have shape \(2, 1\)"):
        WheelIncrements("wheels", THREE, np.zeros((2, 1)), ("front",), np.zeros((2, 2)))
    with pytest.raises(FglocError, match="at least two stamps are needed, got 1"):
        WheelIncrements("wheels", stamps(0), np.zeros((0, 1)), ("front",))


@pytest.mark.parametrize(("second", "third"), [(10, 10), (10, 5), (0, 20)])
def test_stamps_must_strictly_increase(second: int, third: int) -> None:
    bad = 2 if third <= second else 1
    with pytest.raises(FglocError, match=f"yaw: stamp {bad} does not come after"):
        Yaw("yaw", stamps(0, second, third), np.zeros(3), 0.01)


def test_stamps_must_be_integers() -> None:
    with pytest.raises(FglocError, match="gyro: stamps must be a one-dimensional int64 array"):
        YawRate("gyro", np.array([0.0, 0.1]), np.zeros(2), 0.01)  # type: ignore[arg-type]
    with pytest.raises(FglocError, match="one-dimensional int64"):
        YawRate("gyro", np.zeros((2, 1), dtype=np.int64), np.zeros(2), 0.01)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_must_be_finite(bad: float) -> None:
    with pytest.raises(FglocError, match="yaw: yaw holds a value that is not finite"):
        Yaw("yaw", THREE, np.array([0.0, bad, 0.0]), 0.01)
    with pytest.raises(FglocError, match="camera: poses holds a value that is not finite"):
        CameraPoses("camera", THREE, np.full((3, 3), bad), 0.01, 0.01)


def test_rows_must_match_the_stamps() -> None:
    with pytest.raises(FglocError, match="gyro: rate has 2 rows, expected 3"):
        YawRate("gyro", THREE, np.zeros(2), 0.01)
    with pytest.raises(FglocError, match="lidar: ranges has 2 rows, expected 3"):
        Scans("lidar", THREE, np.zeros((2, 5)), 0.0, 0.1)


def test_fixes_need_a_positive_sigma() -> None:
    with pytest.raises(FglocError, match="gps: every sigma of a position fix must be positive"):
        PositionFixes("gps", THREE, np.zeros((3, 2)), np.zeros((3, 2)))
    sigma = np.ones((3, 3))
    sigma[1, 2] = -1.0
    with pytest.raises(FglocError, match="map: every sigma of a pose fix must be positive"):
        PoseFixes("map", THREE, np.zeros((3, 3)), sigma)


@pytest.mark.parametrize("bad", [0.0, -0.01, np.nan, np.inf])
def test_noise_must_be_positive(bad: float) -> None:
    # A sigma of zero is an infinite weight, a negative one means nothing.
    with pytest.raises(FglocError, match="yaw: sigma must be positive and finite"):
        Yaw("yaw", THREE, np.zeros(3), bad)
    with pytest.raises(FglocError, match="gyro: density must be positive"):
        YawRate("gyro", THREE, np.zeros(3), bad)
    with pytest.raises(FglocError, match="camera: heading_sigma must be positive"):
        CameraPoses("camera", THREE, np.zeros((3, 3)), 0.01, 0.01, heading_sigma=bad)
    with pytest.raises(FglocError, match="truth: sigma of y must be positive"):
        Reference(Trajectory(THREE, np.zeros((3, 3))), sigma=(0.01, bad, 0.01))


def test_what_is_known_exactly_has_sigma_zero() -> None:
    YawRate("gyro", THREE, np.zeros(3), 0.01, bias_sigma=0.0)
    CameraPoses(
        "camera", THREE, np.zeros((3, 3)), 0.0, 0.0, mount_sigma=(0.0, 0.0, 0.0), scale_sigma=0.0
    )
    with pytest.raises(FglocError, match="mount_sigma must be finite and not negative"):
        PositionFixes("gps", THREE, np.zeros((3, 2)), np.ones((3, 2)), mount_sigma=(0.1, -0.1))
    with pytest.raises(FglocError, match="must have 2 numbers"):
        PositionFixes("gps", THREE, np.zeros((3, 2)), np.ones((3, 2)), mount=(0.1, 0.1, 0.0))  # type: ignore[arg-type]


def test_fixes_must_have_one_column_a_coordinate() -> None:
    with pytest.raises(FglocError, match=r"gps: positions must have shape \(3, 2\)"):
        PositionFixes("gps", THREE, np.zeros((3, 3)), np.ones((3, 2)))
    with pytest.raises(FglocError, match=r"map: sigma must have shape \(3, 3\)"):
        PoseFixes("map", THREE, np.zeros((3, 3)), np.ones((3, 2)))
    with pytest.raises(FglocError, match=r"camera: poses must have shape \(3, 3\)"):
        CameraPoses("camera", THREE, np.zeros((3, 2)), 0.01, 0.01)
    with pytest.raises(FglocError, match=r"yaw: yaw must have shape \(3,\)"):
        Yaw("yaw", THREE, np.zeros((3, 1)), 0.01)


def test_landmark_sightings_may_share_a_stamp_but_not_go_back() -> None:
    marks = np.arange(3)
    LandmarkSightings("marks", stamps(0, 0, 10), marks, np.ones(3), np.zeros(3))
    with pytest.raises(FglocError, match="marks: stamps go back in time"):
        LandmarkSightings("marks", stamps(0, 10, 5), marks, np.ones(3), np.zeros(3))


def test_an_empty_stream_is_sound() -> None:
    fixes = PositionFixes("gps", stamps(), np.zeros((0, 2)), np.zeros((0, 2)))
    assert fixes.stamps_ns.size == 0
