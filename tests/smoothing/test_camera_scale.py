"""A camera whose scale is wrong by a fifth, and one that is mounted 5 degrees off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgloc.core.drive import Drive
from fgloc.core.evaluation import evaluate
from fgloc.core.geometry import compose
from fgloc.core.measurements import CameraPoses
from fgloc.datasets.registry import load_drive
from fgloc.estimator import Result
from fgloc.experiments.fixes import with_fixes
from fgloc.smoothing.batch import BatchSmoother


@pytest.fixture(scope="module")
def healthy() -> Drive:
    return load_drive("sim:random?seed=1&duration=80&gyro=on&yaw=off&camera=on&slip=off")


def faulty(drive: Drive, scale: float = 1.0, yaw: float = 0.0) -> Drive:
    """Return the drive with a camera that measures too long, or was turned on its mount."""
    sensors = []
    for s in drive.sensors:
        if isinstance(s, CameraPoses):
            poses = s.poses * np.array([scale, scale, 1.0])
            turned = compose(np.array([0.0, 0.0, -yaw]), compose(poses, np.array([0.0, 0.0, yaw])))
            s = replace(s, poses=turned)
        sensors.append(s)
    return replace(drive, sensors=tuple(sensors))


def without_camera(drive: Drive) -> Drive:
    return replace(drive, sensors=tuple(s for s in drive.sensors if not isinstance(s, CameraPoses)))


def estimate(drive: Drive) -> tuple[Result, float]:
    result = BatchSmoother().estimate(drive)
    assert drive.truth is not None
    return result, evaluate(result.trajectory, drive.truth).ate_rmse_m


def value(result: Result, name: str) -> tuple[float, float]:
    found = next(c for c in result.calibration if c.name == name)
    return found.value, found.sigma


@pytest.mark.parametrize("scale", [1.2, 0.8])
def test_a_wrong_scale_is_estimated_and_named(healthy: Drive, scale: float) -> None:
    assert healthy.true_calibration is not None
    true = scale * healthy.true_calibration["camera_scale"]
    result, error = estimate(faulty(healthy, scale))
    _, alone = estimate(without_camera(healthy))
    assert error < 2.0 * alone
    found, sigma = value(result, "camera_scale")
    assert abs(found - true) < 3.0 * sigma < 0.15
    assert any("could only be right in scale" in note for note in result.notes)


def test_fixes_decide_about_the_scale(healthy: Drive) -> None:
    result, error = estimate(with_fixes(faulty(healthy, 1.2), 10.0, 0.02, 0))
    assert error < 0.05
    assert healthy.true_calibration is not None
    true = 1.2 * healthy.true_calibration["camera_scale"]
    found, sigma = value(result, "camera_scale")
    # The prior of 1 ± 0.01 would pull it 2.6 of these sigmas towards 1: 0.2 · (0.0013/0.01)².
    assert abs(found - true) < 2.0 * sigma < 0.004
    assert any("camera measures ways" in note for note in result.notes)


def test_a_turned_mount_is_estimated(healthy: Drive) -> None:
    assert healthy.true_calibration is not None
    result, error = estimate(faulty(healthy, yaw=np.radians(5.0)))
    _, sound = estimate(healthy)
    assert error < 1.1 * sound
    found, sigma = value(result, "camera_yaw")
    assert abs(found - np.radians(5.0) - healthy.true_calibration["camera_yaw"]) < 4.0 * sigma


def test_a_healthy_camera_is_left_as_it_is(healthy: Drive) -> None:
    result, _ = estimate(healthy)
    assert not any("scale" in note for note in result.notes)
