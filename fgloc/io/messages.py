"""ROS messages as rows of numbers: what is taken out of each type, one message at a time.

Decoding is the one loop in Python over messages; it touches nothing but the fields that are used.
Types have the names that rosbags gives those of both ROS versions, e.g. "sensor_msgs/msg/Imu".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fgloc.core.measurements import Floats, Stamps

Row = tuple[Any, ...]

POSE = slice(0, 6)
"""Columns of a pose: x, y and the quaternion x, y, z, w."""
TWIST = slice(6, 9)
"""Columns of a twist: forward, left, turn."""
POSE_VARIANCE, TWIST_VARIANCE = slice(9, 12), slice(12, 15)
"""Columns of the variances along the same three axes; 0 where the type has none."""
NOTHING = (0.0, 0.0, 0.0)
ODOMETRY_WIDTH = 15
"""Columns of poses and twists."""
WIDTHS = {"sensor_msgs/msg/Imu": 19, "sensor_msgs/msg/NavSatFix": 6}
"""Columns of the other types with a fixed number of them."""


HUGE = 1e12
"""No measurement in SI units or encoder counts is this large."""


@dataclass
class Messages:
    """The messages of one topic, in the order in which they were recorded."""

    topic: str
    """Its name."""
    kind: str
    """Their type."""
    received: list[int] = field(default_factory=list)
    """When each was recorded [ns]."""
    stamped: list[int] = field(default_factory=list)
    """Stamp of each header [ns]; 0 where there is none."""
    rows: list[Row] = field(default_factory=list)
    """What was taken out of each; see the extractors below."""
    broken: int = 0
    """How many could not be decoded."""

    def __len__(self) -> int:
        return len(self.rows)

    def table(self) -> Floats:
        """Return the rows of a type with a fixed number of numbers as an array (N, C).

        Numbers beyond any measurement become NaN, so that they are dropped like one.
        """
        width = WIDTHS.get(self.kind, ODOMETRY_WIDTH)
        return sane(np.array(self.rows, dtype=np.float64).reshape(len(self.rows), width))

    def times(self) -> tuple[Stamps, Stamps]:
        """Return header stamps and times of recording as arrays (N,) [ns]."""
        return np.array(self.stamped, np.int64), np.array(self.received, np.int64)


def sane(values: Floats) -> Floats:
    """Return values with NaN for those beyond any measurement: a damaged message."""
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(values) < HUGE, values, np.nan)


def _pose(pose: Any) -> Row:
    """Return position and quaternion."""
    p, q = pose.position, pose.orientation
    return (p.x, p.y, q.x, q.y, q.z, q.w)


def _twist(twist: Any) -> Row:
    """Return the planar part of a twist."""
    return (twist.linear.x, twist.linear.y, twist.angular.z)


def _variance(covariance: Any) -> Row:
    """Return the variances of x, y and yaw in a 6×6 covariance."""
    return (covariance[0], covariance[7], covariance[35])


def _odometry(m: Any) -> Row:
    """Return pose, twist and their variances."""
    pose, twist = m.pose, m.twist
    return (
        *_pose(pose.pose),
        *_twist(twist.twist),
        *_variance(pose.covariance),
        *_variance(twist.covariance),
    )


def _pose_only(pose: Any, variance: Row = NOTHING) -> Row:
    """Return the columns of an odometry that has a pose and no twist."""
    return (*_pose(pose), *NOTHING, *variance, *NOTHING)


def _twist_only(twist: Any, variance: Row = NOTHING) -> Row:
    """Return the columns of an odometry that has a twist and no pose."""
    return (*NOTHING, *NOTHING, *_twist(twist), *NOTHING, *variance)


def _transform(m: Any) -> Row:
    """Return a transform as a pose."""
    t, q = m.transform.translation, m.transform.rotation
    return (t.x, t.y, q.x, q.y, q.z, q.w, *NOTHING, *NOTHING, *NOTHING)


def _imu(m: Any) -> Row:
    """Return orientation, rate, acceleration and the diagonals of their covariances."""
    q, w, a = m.orientation, m.angular_velocity, m.linear_acceleration
    diagonals = [
        float(c[k])
        for c in (
            m.orientation_covariance,
            m.angular_velocity_covariance,
            m.linear_acceleration_covariance,
        )
        for k in (0, 4, 8)
    ]
    return (q.x, q.y, q.z, q.w, w.x, w.y, w.z, a.x, a.y, a.z, *diagonals)


def _fix(m: Any) -> Row:
    """Return latitude, longitude, status, variances east and north and how these are known."""
    c = m.position_covariance
    return (m.latitude, m.longitude, m.status.status, c[0], c[4], m.position_covariance_type)


def _joints(m: Any) -> Row:
    """Return names, positions and velocities."""
    return (tuple(m.name), m.position, m.velocity)


def _scan(m: Any) -> Row:
    """Return angle of the first beam and between beams, time between beams, limits and ranges."""
    return (
        m.angle_min,
        m.angle_increment,
        m.time_increment,
        m.range_min,
        m.range_max,
        # A view of the bag's buffer would keep all of that in memory.
        np.array(m.ranges, dtype=np.float32),
    )


ODOMETRY = "nav_msgs/msg/Odometry"
JOINTS = "sensor_msgs/msg/JointState"
IMU = "sensor_msgs/msg/Imu"
FIX = "sensor_msgs/msg/NavSatFix"
SCAN = "sensor_msgs/msg/LaserScan"
POSES: dict[str, Callable[[Any], Row]] = {
    "geometry_msgs/msg/PoseStamped": lambda m: _pose_only(m.pose),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: _pose_only(
        m.pose.pose, _variance(m.pose.covariance)
    ),
    "geometry_msgs/msg/TransformStamped": _transform,
    "geometry_msgs/msg/Pose": _pose_only,
}
"""Types that are a pose and nothing else, as rows of the columns above."""
TWISTS: dict[str, Callable[[Any], Row]] = {
    "geometry_msgs/msg/TwistStamped": lambda m: _twist_only(m.twist),
    "geometry_msgs/msg/TwistWithCovarianceStamped": lambda m: _twist_only(
        m.twist.twist, _variance(m.twist.covariance)
    ),
}
"""Types that are a twist with a stamp."""
EXTRACTORS: dict[str, Callable[[Any], Row]] = {
    ODOMETRY: _odometry,
    **POSES,
    **TWISTS,
    JOINTS: _joints,
    IMU: _imu,
    FIX: _fix,
    SCAN: _scan,
}
"""What is taken out of a message, by its type."""


def short(kind: str) -> str:
    """Return a type as users know it, e.g. "sensor_msgs/Imu"."""
    return kind.replace("/msg/", "/")


def yaw_of(quaternions: Floats) -> tuple[Floats, Floats]:
    """Return the (N,) heading [rad] of quaternions (N, 4) x y z w, and their lengths (N,).

    The heading is that of the rotated x axis, projected on the ground; a quaternion need not be
    normalised. One of length zero has no heading (0 is returned).
    """
    x, y, z, w = quaternions.T
    yaw = np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return yaw, np.asarray(np.linalg.norm(quaternions, axis=1))


def rotated_axis(quaternions: Floats, axis: Floats) -> Floats:
    """Return (N, 3) the vector `axis` (3,) turned by quaternions (N, 4) x y z w of any length."""
    v, w = quaternions[:, :3], quaternions[:, 3:]
    turned = (
        2.0 * (v @ axis)[:, None] * v
        + (w * w - np.sum(v * v, axis=1, keepdims=True)) * axis
        + 2.0 * w * np.cross(v, axis)
    )
    return np.asarray(turned)
