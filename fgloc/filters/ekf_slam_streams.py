"""What EKF-SLAM is told by a stream of landmark sightings or by a lidar."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.measurements import Floats, LandmarkSightings, Scans, Stamps
from fgloc.filters.ekf_slam_settings import EkfSlamSettings
from fgloc.filters.ekf_slam_tables import (
    ANGLE_MIN,
    ANGLE_STEP,
    BEAMS,
    BEARING_VARIANCE,
    MAX_RANGE,
    MIN_RANGE,
    MOUNT_X,
    MOUNT_Y,
    MOUNT_YAW,
    POINT,
    RANGE_SHARE,
    RANGE_VARIANCE,
    STREAM_COLUMNS,
    WALL,
    Codes,
)
from fgloc.lidar.segments import Segments


@dataclass(frozen=True)
class Stream:
    """One sensor that sees landmarks, its sightings ready for the filter."""

    sensor: Scans | LandmarkSightings
    """Where it comes from."""
    kind: int
    """POINT or WALL."""
    row: Floats
    """(STREAM_COLUMNS,) mount, noise and beams."""
    groups_ns: Stamps
    """(K,) moments inside the drive at which it saw something or nothing."""
    group_size: Codes
    """(K,) how many sightings each one holds."""
    group_row: Codes
    """(K,) where its ranges begin in `ranges`."""
    group_turn: Floats
    """(K,) how far the lidar turned during it [rad]."""
    values: Floats
    """(E, 5) POINT: range [m], bearing [rad]; WALL: direction of the normal [rad], middle (2) and
    reach (2) [m] in the lidar's axes at the group's moment."""
    identities: Codes
    """(E,) identity that the sensor tells, -1 if none."""
    left_out: int
    """Sightings before the drive begins or after it ends."""
    ranges: Floats
    """Flattened ranges of the scans [m]; empty for marks."""
    segments: Segments | None = None
    """WALL: all pieces of wall as extracted."""
    segment_of: Codes | None = None
    """WALL: (E,) index into `segments`."""


def _row(sensor: Scans | LandmarkSightings, rounding: Floats) -> Floats:
    """Return a stream's mount, and the variances of what is not known of mount and counts."""
    row = np.zeros(STREAM_COLUMNS)
    row[[MOUNT_X, MOUNT_Y, MOUNT_YAW]] = sensor.mount
    # Which of the two axes counts depends on the bearing: the larger one stands for both.
    row[RANGE_VARIANCE] = max(sensor.mount_sigma[:2]) ** 2 + float(rounding[:2].max()) ** 2
    row[BEARING_VARIANCE] = sensor.mount_sigma[2] ** 2 + float(rounding[2]) ** 2
    return row


def mark_stream(sensor: LandmarkSightings, drive: Drive, rounding: Floats) -> Stream:
    """Return the sightings inside the drive, those of one stamp in one group. O(N).

    `rounding` (3,) is the sigma of a pose that rounded counts tell [m, m, rad].
    """
    wheels = drive.wheels.stamps_ns
    inside = (sensor.stamps_ns >= wheels[0]) & (sensor.stamps_ns <= wheels[-1])
    values = np.zeros((int(inside.sum()), 5))
    values[:, 0], values[:, 1] = sensor.range_m[inside], sensor.bearing[inside]
    groups, sizes = np.unique(sensor.stamps_ns[inside], return_counts=True)
    row = _row(sensor, rounding)
    row[RANGE_VARIANCE] += sensor.range_sigma**2
    row[BEARING_VARIANCE] += sensor.bearing_sigma**2
    return Stream(
        sensor,
        POINT,
        row,
        groups,
        sizes.astype(np.int64),
        np.zeros(groups.size, dtype=np.int64),
        np.zeros(groups.size),
        values,
        np.ascontiguousarray(sensor.landmark[inside]),
        int(inside.size - inside.sum()),
        np.zeros(0),
    )


def wall_stream(sensor: Scans, drive: Drive, settings: EkfSlamSettings, rounding: Floats) -> Stream:
    """Return the pieces of wall in the scans inside the drive, each scan a group at its end.

    A scan is known when its last beam has returned: its walls are moved into the lidar's axes of
    that moment, by the wheels. Scans that begin before the drive or end after it are left out.
    """
    from fgloc.lidar.lines import extract
    from fgloc.lidar.motion import scan_motion
    from fgloc.lidar.scan import cloud

    wheels = drive.wheels.stamps_ns
    duration = round(sensor.ranges.shape[1] * sensor.beam_period * 1e9)
    inside = (sensor.stamps_ns >= wheels[0]) & (sensor.stamps_ns + duration <= wheels[-1])
    motion = scan_motion(drive.wheels, drive.robot, sensor)
    straight = cloud(sensor, motion)
    if settings.extractor == "lines":
        segments = extract(straight, sensor)
    else:
        from fgloc.lidar.ransac import extract_ransac

        segments = extract_ransac(straight, sensor, np.random.default_rng(settings.seed))
    kept = np.flatnonzero(inside[segments.scan]).astype(np.int64)
    scan = segments.scan[kept]
    moved = motion[scan]
    c, s = np.cos(moved[:, 2]), np.sin(moved[:, 2])
    d = segments.middle[kept] - moved[:, :2]
    values = np.column_stack(
        [
            segments.normal[kept] - moved[:, 2],
            c * d[:, 0] + s * d[:, 1],
            -s * d[:, 0] + c * d[:, 1],
            segments.reach[kept],
        ]
    )
    row = _row(sensor, rounding)
    row[RANGE_VARIANCE] += settings.wall_range_sigma**2
    row[RANGE_SHARE] = settings.wall_range_share**2
    row[BEARING_VARIANCE] += settings.wall_bearing_sigma**2
    row[ANGLE_MIN], row[ANGLE_STEP] = sensor.angle_min, sensor.angle_increment
    row[BEAMS] = sensor.ranges.shape[1]
    row[MIN_RANGE], row[MAX_RANGE] = sensor.min_range, sensor.max_range
    scans = np.flatnonzero(inside)
    return Stream(
        sensor,
        WALL,
        row,
        sensor.stamps_ns[scans] + duration,
        np.bincount(scan, minlength=inside.size)[scans].astype(np.int64),
        (scans * sensor.ranges.shape[1]).astype(np.int64),
        np.ascontiguousarray(motion[scans, 2]),
        np.ascontiguousarray(values),
        np.full(kept.size, -1, dtype=np.int64),
        int(segments.scan.size - kept.size),
        np.ascontiguousarray(sensor.ranges, dtype=np.float64).reshape(-1),
        segments,
        kept,
    )
