"""EKF-SLAM with a lidar: a mecanum robot maps a room; blind scans; walls out of sight."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from fgloc.core.drive import Drive
from fgloc.core.evaluation import evaluate
from fgloc.core.geometry import compose
from fgloc.core.measurements import Scans
from fgloc.estimator import Result
from fgloc.experiments.map_error import judge_associations, true_wall_of_each, wall_errors
from fgloc.filters.ekf_slam import EkfSlam
from fgloc.filters.ekf_slam_sight import missed
from fgloc.filters.ekf_slam_tables import (
    ANGLE_STEP,
    BEAMS,
    FIELD,
    LEFT_X,
    LEFT_Y,
    MAX_RANGE,
    NORMAL_X,
    NORMAL_Y,
    RIGHT_X,
    RIGHT_Y,
    SHAPE,
    STREAM_COLUMNS,
    WALL,
)
from fgloc.filters.model1 import Model1
from fgloc.lidar.walls import Map, Walls
from tests.filters import room_world as room


@pytest.fixture(scope="module")
def drive() -> Drive:
    return room.drive(1, 30.0)


@pytest.fixture(scope="module")
def result(drive: Drive) -> Result:
    return EkfSlam().estimate(drive)


def scans_of(drive: Drive) -> Scans:
    (scans,) = drive.each(Scans)
    return scans


def map_of(result: Result) -> tuple[Map, Walls]:
    assert result.map is not None
    assert result.map.walls is not None
    return result.map, result.map.walls


def error(result: Result, drive: Drive) -> float:
    assert drive.truth is not None
    return evaluate(result.trajectory, drive.truth).ate_rmse_m


def test_a_mecanum_robot_maps_the_room(drive: Drive, result: Result) -> None:
    # The room has five walls, seen in nearly every scan; a centimetre of noise in a metre.
    found, walls = map_of(result)
    errors = wall_errors(walls, room.ROOM)
    assert sorted(errors.truth.tolist()) == [0, 1, 2, 3, 4]
    assert errors.middle_m.max() < 0.04
    assert np.degrees(errors.direction_rad).max() < 1.0
    assert errors.overlap_m.min() > 0.8 * np.hypot(2.0, 1.5)
    assert error(result, drive) < 0.5 * error(Model1().estimate(drive), drive)
    # Normals point into the room, from the walls to its middle.
    normal = np.stack([np.cos(walls.normal), np.sin(walls.normal)], axis=1)
    assert (np.sum(normal * (np.array([0.5, -1.0]) - walls.anchor), axis=1) > 0.0).all()
    assert np.isfinite(walls.covariance).all()
    # Every piece of wall was given to the wall that it is of.
    assert drive.truth is not None
    assert found.segments is not None
    assert found.wall is not None
    stamps = scans_of(drive).stamps_ns
    base = drive.truth.trajectory.poses[np.searchsorted(drive.wheels.stamps_ns, stamps)]
    lidar = compose(base, np.array(room.MOUNT))
    true_wall = true_wall_of_each(found.segments, lidar, room.ROOM)
    judged = judge_associations(found.wall, true_wall, room.ROOM)
    assert (judged.wrong, judged.spurious) == (0, 0)
    # All but those of the scans that end after the drive.
    assert judged.used > 0.95 * found.segments.scan.size
    # The first four sightings of each wall only told of it.
    assert judged.used - result.counts["lidar"].accepted == 4 * 5


def test_a_scan_counts_when_its_last_beam_has_returned(drive: Drive) -> None:
    # Nothing that comes after a moment changes what was emitted before it.
    scans = scans_of(drive)
    cut = 200
    later = scans.ranges.copy()
    later[cut:] = 0.0
    whole = EkfSlam().estimate(drive)
    changed = EkfSlam().estimate(replace(drive, sensors=(replace(scans, ranges=later),)))
    known = scans.stamps_ns[cut] + round(room.BEAMS * scans.beam_period * 1e9)
    before = drive.wheels.stamps_ns < known
    np.testing.assert_array_equal(whole.trajectory.poses[before], changed.trajectory.poses[before])
    assert not np.array_equal(whole.trajectory.poses[~before], changed.trajectory.poses[~before])


def test_scans_without_walls_leave_wheel_odometry(drive: Drive) -> None:
    scans = scans_of(drive)
    rng = np.random.default_rng(0)
    clutter = np.where(
        rng.random(scans.ranges.shape) < 0.3, 8.0 * rng.random(scans.ranges.shape), 0
    )
    plain = Model1().estimate(drive).trajectory.poses
    for ranges in (np.zeros_like(scans.ranges), clutter):
        blind = replace(drive, sensors=(replace(scans, ranges=ranges),))
        found = EkfSlam().estimate(blind)
        if found.counts["lidar"].accepted == 0:
            assert found.sensors_used == ("wheels",)
            np.testing.assert_allclose(found.trajectory.poses, plain, atol=1e-9)
        assert error(found, drive) < 2.0 * error(Model1().estimate(drive), drive) + 0.05


def test_the_map_does_not_depend_on_where_the_lidar_stands(drive: Drive, result: Result) -> None:
    # The same beams by a lidar that is mounted turned by a quarter.
    scans = scans_of(drive)
    turned = replace(scans, angle_min=scans.angle_min - math.pi / 2, mount=(0.25, 0.0, math.pi / 2))
    again = EkfSlam().estimate(replace(drive, sensors=(turned,)))
    np.testing.assert_allclose(again.trajectory.poses, result.trajectory.poses, atol=1e-6)


def test_a_wall_out_of_sight_is_not_missed() -> None:
    # A wall across the way at x = 3, from y = -1 to 1, seen from the left; the robot at the origin.
    shape = np.zeros(SHAPE)
    shape[[NORMAL_X, NORMAL_Y]] = -1.0, 0.0
    shape[[RIGHT_X, RIGHT_Y, LEFT_X, LEFT_Y]] = 3.0, 1.0, 3.0, -1.0
    row = np.zeros(STREAM_COLUMNS)
    row[[ANGLE_STEP, BEAMS, MAX_RANGE]] = math.radians(1.0), 360, 8.0
    free = np.full(360, 5.0)

    def is_missed(x: list[float], ranges: np.ndarray, turn: float = 0.0) -> bool:
        return bool(missed(np.array(x), WALL, row, shape, np.zeros(FIELD), ranges, 0, turn))

    # The beam ahead goes on to 5 m: the wall is gone.
    assert is_missed([0.0, 0.0, 0.0], free)
    # Something stands before it, at 2 m; the beam did not return.
    hidden = free.copy()
    hidden[0] = 2.0
    assert not is_missed([0.0, 0.0, 0.0], hidden)
    hidden[0] = 0.0
    assert not is_missed([0.0, 0.0, 0.0], hidden)
    # It is too far; along the wall only a grazing beam would find it.
    assert not is_missed([-5.0, 0.0, 0.0], free)
    assert not is_missed([2.9, -2.0, 0.0], free)
    # Behind: the beam at 180°, which was sent in the middle of a turn. The lidar turned by 20° in
    # the scan, so that half of it was still to come: what is now at 180° was then at 190°.
    hidden = free.copy()
    hidden[180] = 2.0
    assert not is_missed([0.0, 0.0, math.pi], hidden)
    hidden = free.copy()
    hidden[188:192] = 2.0
    assert is_missed([0.0, 0.0, math.pi], hidden)
    assert not is_missed([0.0, 0.0, math.pi], hidden, math.radians(20.0))
    # A lidar that looks ahead only (90 beams from -45°) sees nothing behind.
    row[BEAMS] = 90
    assert not is_missed([0.0, 0.0, math.pi], free)


def test_a_wall_through_the_origin_is_said(drive: Drive) -> None:
    # The same room, the drive beginning on its lower wall: the map's origin.
    assert drive.truth is not None
    path = drive.truth.trajectory
    moved = compose(np.array([0.0, 5.0, 0.0]), path.poses)
    there = replace(drive, truth=replace(drive.truth, trajectory=replace(path, poses=moved)))
    result = EkfSlam().estimate(there)
    assert any("within 0.5 m of the map's origin" in note for note in result.notes)
    assert np.isfinite(result.trajectory.poses).all()
