"""Small bags with known content, written by rosbags' own writers."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="rosbags (extra `bags`) is not installed")

from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
"""The first stamp of most bags [ns]."""
STORES = {1: get_typestore(Stores.ROS1_NOETIC), 2: get_typestore(Stores.ROS2_HUMBLE)}


@dataclass(frozen=True)
class Message:
    """One message, not yet of either version of ROS."""

    topic: str
    kind: str
    """E.g. "sensor_msgs/msg/Imu"."""
    stamp: int
    """Stamp of its header [ns]; 0 leaves it blank."""
    values: dict[str, Any]
    """Fields by dotted name; others are zero."""
    received: int | None = None
    """When it was recorded [ns]; None: a millisecond after its stamp."""


def _value(store: Any, description: Any, name: str, values: dict[str, Any]) -> Any:
    """Return a field's value, or zeros of its type."""
    node, inner = description
    if name in values and node != Nodetype.NAME:
        given = values[name]
        numbers = isinstance(given, list | tuple) and inner[0][1][0] != "string"
        return np.array(given, dtype=inner[0][1][0]) if numbers else given
    if node == Nodetype.NAME:
        within = {k[len(name) + 1 :]: v for k, v in values.items() if k.startswith(f"{name}.")}
        return _make(store, inner, within)
    if node == Nodetype.BASE:
        return "" if inner[0] == "string" else type_of(inner[0])(0)
    (_, (kind, _)), length = inner
    return [] if kind == "string" else np.zeros(length, dtype=kind)


def type_of(kind: str) -> type:
    """Return the Python type of a base type."""
    return float if kind.startswith("float") else bool if kind == "bool" else int


def _make(store: Any, kind: str, values: dict[str, Any]) -> Any:
    """Return a message of a type with some fields set."""
    fields = store.fielddefs[kind][1]
    return store.types[kind](**{n: _value(store, d, n, values) for n, d in fields})


def write_bag(path: Path, messages: Iterable[Message]) -> Path:
    """Write messages as `.bag` (ROS 1), or as a ROS 2 folder of `.db3` or `.mcap` by the suffix.

    For ROS 2 the folder's name is the path without its suffix; that folder is returned.
    """
    version = 1 if path.suffix == ".bag" else 2
    store = STORES[version]
    writer: Any = (
        Writer1(path)
        if version == 1
        else Writer2(
            path.with_suffix(""),
            version=9,
            storage_plugin=StoragePlugin.MCAP if path.suffix == ".mcap" else StoragePlugin.SQLITE3,
        )
    )
    serialize = store.serialize_ros1 if version == 1 else store.serialize_cdr
    with writer:
        connections: dict[tuple[str, str], Any] = {}
        for m in messages:
            key = (m.topic, m.kind)
            if key not in connections:
                connections[key] = writer.add_connection(m.topic, m.kind, typestore=store)
            values = dict(m.values)
            if m.stamp:
                values["header.stamp.sec"] = m.stamp // SECOND
                values["header.stamp.nanosec"] = m.stamp % SECOND
            received = m.stamp + 1_000_000 if m.received is None else m.received
            raw = serialize(_make(store, m.kind, values), m.kind)
            writer.write(connections[key], received, raw)
    return path if version == 1 else path.with_suffix("")


def quaternion(yaw: float, scale: float = 1.0) -> dict[str, float]:
    """Return the fields z and w of a rotation about the vertical."""
    return {"z": scale * math.sin(yaw / 2.0), "w": scale * math.cos(yaw / 2.0)}


def prefixed(prefix: str, values: dict[str, Any]) -> dict[str, Any]:
    """Return fields below another one."""
    return {f"{prefix}.{k}": v for k, v in values.items()}


def pose_fields(x: float, y: float, yaw: float, scale: float = 1.0) -> dict[str, float]:
    """Return the fields of a geometry_msgs/Pose."""
    turned = prefixed("orientation", quaternion(yaw, scale))
    return {"position.x": x, "position.y": y, **turned}


def odometry(
    stamp: int,
    pose: tuple[float, float, float],
    twist: tuple[float, float, float] = (0.0, 0.0, 0.0),
    topic: str = "/odom",
    scale: float = 1.0,
    received: int | None = None,
    **more: Any,
) -> Message:
    """Return a nav_msgs/Odometry."""
    values: dict[str, Any] = prefixed("pose.pose", pose_fields(*pose, scale))
    values["twist.twist.linear.x"], values["twist.twist.linear.y"] = twist[0], twist[1]
    values["twist.twist.angular.z"] = twist[2]
    return Message(topic, "nav_msgs/msg/Odometry", stamp, {**values, **more}, received)


def pose_stamped(
    stamp: int, pose: tuple[float, float, float], topic: str = "/vrpn/robot/pose"
) -> Message:
    """Return a geometry_msgs/PoseStamped."""
    values = prefixed("pose", pose_fields(*pose))
    return Message(topic, "geometry_msgs/msg/PoseStamped", stamp, values)


def joints(
    stamp: int,
    names: list[str],
    position: list[float],
    velocity: list[float] | None = None,
    topic: str = "/joint_states",
) -> Message:
    """Return a sensor_msgs/JointState."""
    values = {"name": names, "position": position, "velocity": velocity or []}
    return Message(topic, "sensor_msgs/msg/JointState", stamp, values)


def imu(
    stamp: int,
    rate: tuple[float, float, float],
    acceleration: tuple[float, float, float] = (0.0, 0.0, 9.81),
    orientation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
    topic: str = "/imu",
    **more: Any,
) -> Message:
    """Return a sensor_msgs/Imu; the orientation is x y z w."""
    values: dict[str, Any] = {}
    for axis, w, a in zip("xyz", rate, acceleration, strict=True):
        values[f"angular_velocity.{axis}"], values[f"linear_acceleration.{axis}"] = w, a
    values |= {f"orientation.{k}": v for k, v in zip("xyzw", orientation, strict=True)}
    return Message(topic, "sensor_msgs/msg/Imu", stamp, {**values, **more})


def diagonal(size: int, *entries: float) -> list[float]:
    """Return a flat covariance matrix with these entries, repeated, on its diagonal."""
    out = np.zeros((size, size))
    np.fill_diagonal(out, np.resize(np.array(entries), size))
    return [float(v) for v in out.ravel()]


@dataclass
class Arc:
    """A robot on a circle: 0.5 m/s, 0.25 rad/s, ten poses a second, so a radius of 2 m."""

    seconds: float = 8.0
    speed: float = 0.5
    rate: float = 0.25
    start: int = START
    stamps: list[int] = field(init=False)

    def __post_init__(self) -> None:
        self.stamps = [self.start + k * SECOND // 10 for k in range(int(self.seconds * 10) + 1)]

    def pose(self, stamp: int) -> tuple[float, float, float]:
        """Return where it is: x = r sin θ, y = r (1 - cos θ)."""
        theta = self.rate * (stamp - self.start) / SECOND
        radius = self.speed / self.rate
        return radius * math.sin(theta), radius * (1.0 - math.cos(theta)), theta

    def odometry(self, topic: str = "/odom") -> list[Message]:
        """Return its odometry with poses and twists."""
        return [odometry(s, self.pose(s), (self.speed, 0.0, self.rate), topic) for s in self.stamps]
