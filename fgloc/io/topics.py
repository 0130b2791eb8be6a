"""The topic map: which topic of a bag is what, and how its numbers are meant (docs/bags.md).

[base]                                # only for wheel joints: as in `fgloc.core.named_bases`
kind = "differential"
radius_left = 0.033
radius_right = 0.033
track = 0.16

[wheels]
topic = "/joint_states"
joints = ["wheel_left_joint", "wheel_right_joint"]

[imu]
axis = "-z"                           # what is left out is guessed
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from dataclasses import replace as dataclass_replace
from pathlib import Path
from typing import Any, Literal, TypeVar

import msgspec

from fgloc.errors import FglocError
from fgloc.toml_file import SMALLEST, TomlFile, quoted, read_toml

Axis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
Pose = tuple[float, float, float]
T = TypeVar("T", bound="Role")


class Role(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What all roles share; None means that the reader decides."""

    topic: str | None = None
    """Name of the topic; None: guessed from types and names."""


class WheelsTable(Role, frozen=True, forbid_unknown_fields=True):
    """[wheels]: sensor_msgs/JointState, one joint a driven wheel of [base]."""

    field: Literal["position", "velocity"] | None = None
    """Which array is read; None: position, or velocity where no position moves."""
    joints: tuple[str, ...] | None = None
    """Joint of every driven wheel in the order of the base; None: the names of the wheels."""
    steering_joints: tuple[str, ...] | None = None
    """Steered bases: joint of every driven wheel's steering angle [rad], in the same order."""
    counts_per_revolution: float | None = None
    """Positions are encoder counts: so many a revolution of the motor; None: radians."""
    gear: float | None = None
    """Revolutions of the motor for one of the wheel; None: 1."""
    scale: float | None = None
    """Factor on what is read, e.g. 1/60 for a velocity by the minute; None: 1."""
    reverse: tuple[str, ...] | None = None
    """Joints that count backwards."""
    counter_bits: Literal[16, 32] | None = None
    """Positions are counts of a counter of so many bits that wraps."""


class OdometryTable(Role, frozen=True, forbid_unknown_fields=True):
    """[odometry]: nav_msgs/Odometry or a stamped twist, in place of wheels."""

    field: Literal["pose", "twist"] | None = None
    """What is read; None: the pose, or the twist where the pose does not move."""
    twist_frame: Literal["child", "parent"] | None = None
    """Frame of the twist: that of the robot, as it should be, or the odometry's; None: child."""
    noise: Literal["typical", "covariance"] | None = None
    """Wheel noise: typical of an odometry, or from the median twist covariance; None: typical."""


class ImuTable(Role, frozen=True, forbid_unknown_fields=True):
    """[imu]: sensor_msgs/Imu."""

    use: tuple[Literal["yaw", "rate", "acceleration"], ...] | None = None
    """What is taken; None: whatever it has."""
    axis: Axis | None = None
    """Axis of the IMU that points up; None: +z, or what gravity says where z is not vertical."""
    forward: Axis | None = None
    """Axis of the IMU that points forward; None: +x where axis is z, else no acceleration."""
    world: Literal["enu", "ned"] | None = None
    """Orientation is in a world with z up (counter-clockwise yaw) or down; None: enu."""
    yaw_sigma: float | None = None
    """Standard deviation of one heading [rad]; None: the median covariance, else 0.02."""
    yaw_drift: float | None = None
    """Random walk of the heading's zero [rad/sqrt(s)]; None: 0.002."""
    rate_density: float | None = None
    """Noise density of the yaw rate [rad/s/sqrt(Hz)]; None: the median covariance, else 5e-4."""


class TruthTable(Role, frozen=True, forbid_unknown_fields=True):
    """[truth]: stamped poses (also with covariance), poses, transforms or nav_msgs/Odometry."""

    sigma: Pose | None = None
    """Standard deviations of x, y [m], heading [rad]; None: the median covariance, else default."""
    mount: Pose | None = None
    """Pose of the tracked body on the robot: x, y [m], yaw [rad]; None: zeros."""
    mount_sigma: Pose | None = None
    """Prior standard deviations of that pose; None: 0.05 each."""


class CameraTable(Role, frozen=True, forbid_unknown_fields=True):
    """[camera]: nav_msgs/Odometry or stamped poses of a visual odometry."""

    mount: Pose | None = None
    """Pose of the camera on the robot: x, y [m], yaw [rad]; None: zeros."""
    mount_sigma: Pose | None = None
    """Prior standard deviations of that pose; None: 0.05 m, 0.05 m, 0.05 rad."""
    position_walk: float | None = None
    """Random walk of the position [m/sqrt(m)]; None: from the twist covariance, else 0.02."""
    heading_walk: float | None = None
    """Random walk of the heading [rad/sqrt(m)]; None: from the twist covariance, else 0.01."""


class ScanTable(Role, frozen=True, forbid_unknown_fields=True):
    """[scan]: sensor_msgs/LaserScan."""

    mount: Pose | None = None
    """Pose of the lidar on the robot: x, y [m], yaw [rad]; None: zeros."""
    mount_sigma: Pose | None = None
    """Prior standard deviations of that pose; None: 0.05 m, 0.05 m, 0.05 rad."""
    range_sigma: float | None = None
    """Noise of a range [m] that does not grow with it; None: 0.01."""
    range_sigma_share: float | None = None
    """Noise of a range as a share of it; None: 0.01, as small lidars have."""
    bearing_sigma: float | None = None
    """Noise of a beam's direction [rad]; None: a quarter of the angle between beams."""


class GpsTable(Role, frozen=True, forbid_unknown_fields=True):
    """[gps]: sensor_msgs/NavSatFix."""

    mount: tuple[float, float] | None = None
    """Antenna on the robot: x, y [m]; None: zeros."""
    mount_sigma: tuple[float, float] | None = None
    """Prior standard deviations of that position; None: 0.2 m each."""
    sigma: float | None = None
    """Standard deviation along east and north [m], for every fix; None: each fix' own, else 2.5."""
    origin: tuple[float, float] | None = None
    """Latitude and longitude of the map's origin [degrees]; None: the first fix."""


TABLES: dict[str, type[Role]] = {
    "wheels": WheelsTable,
    "odometry": OdometryTable,
    "imu": ImuTable,
    "truth": TruthTable,
    "camera": CameraTable,
    "scan": ScanTable,
    "gps": GpsTable,
}
"""The table of every role."""
_POSITIVE = (
    "counts_per_revolution",
    "gear",
    "yaw_sigma",
    "rate_density",
    "position_walk",
    "heading_walk",
    "sigma",
    "range_sigma",
)
"""Keys whose numbers must be above zero."""
_NOT_NEGATIVE = ("mount_sigma", "yaw_drift", "range_sigma_share", "bearing_sigma")
"""Keys whose numbers may be zero."""


@dataclass(frozen=True)
class TopicMap:
    """What is known of the topics of a bag: given by a user or a dataset, or guessed."""

    base: Mapping[str, Any] | None = None
    """The robot of wheel joints: kind and arguments of its constructor, and optionally `name`."""
    wheels: WheelsTable | None = None
    """Wheel joints."""
    odometry: OdometryTable | None = None
    """An odometry of the body, in place of wheels."""
    imu: ImuTable | None = None
    """IMU."""
    truth: TruthTable | None = None
    """Recorded truth."""
    camera: CameraTable | None = None
    """Visual odometry."""
    scan: ScanTable | None = None
    """Planar lidar."""
    gps: GpsTable | None = None
    """Satellite positions."""
    ignore: tuple[str, ...] = ()
    """Topics that are never used."""
    file: TomlFile | None = None
    """Where the map was read, for error messages."""

    def role(self, name: str) -> Role | None:
        """Return the table of a role."""
        found: Role | None = getattr(self, name)
        return found

    def roles(self) -> Iterator[tuple[str, Role]]:
        """Yield name and table of every role that is known."""
        for name in TABLES:
            table = self.role(name)
            if table is not None:
                yield name, table

    def error(self, message: str, *key: str) -> FglocError:
        """Return an error about `key`, with file and line where the map was read from a file."""
        return FglocError(message) if self.file is None else self.file.error(message, *key)

    def over(self, other: TopicMap) -> TopicMap:
        """Return this map with what it leaves out taken from `other`, key by key.

        A role whose topic this map changes takes nothing from the other's, one that takes the
        place of the other's wheels replaces them, and what this map ignores is not taken.
        """
        merged: dict[str, Any] = {"base": self.base if self.base is not None else other.base}
        for name in TABLES:
            own, below = self.role(name), other.role(name)
            below = None if below is not None and below.topic in self.ignore else below
            if own is not None and below is not None and own.topic in (None, below.topic):
                given = {k: v for k, v in msgspec.structs.asdict(own).items() if v is not None}
                own = msgspec.structs.replace(below, **given)
            merged[name] = own if own is not None else below
        if self.odometry is not None and self.wheels is None:
            merged["wheels"] = None
        if self.wheels is not None and self.odometry is None:
            merged["odometry"] = None
        return TopicMap(**merged, ignore=(*self.ignore, *other.ignore), file=self.file)

    def with_roles(self, **roles: Role | None) -> TopicMap:
        """Return the map with other tables."""
        return dataclass_replace(self, **roles)  # type: ignore[arg-type]


def load_topics(path: str | Path) -> TopicMap:
    """Return the topic map in a TOML file, checked for everything that needs no bag.

    Raises FglocError naming file, line where it is known, and key: a missing file, bad TOML, an
    unknown key, a wrong type, a number that is not finite or has the wrong sign.
    """
    file = read_toml(Path(path), "--topics", "topic map")
    raw = file.parse("base", *TABLES, "ignore")
    base = raw.get("base")
    if base is not None and not isinstance(base, dict):
        raise file.error("base must be a table", "base")
    ignore = raw.get("ignore", [])
    if not isinstance(ignore, list) or not all(isinstance(t, str) for t in ignore):
        raise file.error("ignore must be a list of topics", "ignore")
    tables = {n: file.table(raw[n], kind, n) for n, kind in TABLES.items() if n in raw}
    for name, table in tables.items():
        for key, value in msgspec.structs.asdict(table).items():
            lowest = SMALLEST if key in _POSITIVE else -math.inf
            lowest = 0.0 if key in _NOT_NEGATIVE else lowest
            for number in value if isinstance(value, tuple) else (value,):
                if isinstance(number, float):
                    file.check_number(number, lowest, name, key)
    if "wheels" in tables and "odometry" in tables:
        raise file.error(
            "[wheels] and [odometry] are both given, and a drive has one of them; remove one",
            "odometry",
        )
    return TopicMap(base=base, **tables, ignore=tuple(ignore), file=file)  # type: ignore[arg-type]


def as_dict(topics: TopicMap) -> dict[str, Any]:
    """Return a topic map as plain tables by name, without what is left out; ready for JSON."""
    tables: dict[str, Any] = {"ignore": list(topics.ignore)} if topics.ignore else {}
    if topics.base:
        tables["base"] = dict(topics.base)
    for name, table in topics.roles():
        given = msgspec.structs.asdict(table)
        tables[name] = {key: value for key, value in given.items() if value is not None}
    return tables


def topics_toml(topics: TopicMap) -> str:
    """Return a topic map as a file that `load_topics` reads."""
    parts = []
    for name, table in as_dict(topics).items():
        if name == "ignore":
            parts.append(f"ignore = {_value(table)}\n")
            continue
        keys = [f"{key} = {_value(value)}\n" for key, value in table.items()]
        parts.append("".join([f"[{name}]\n", *keys]))
    return "\n".join(parts)


def _value(value: Any) -> str:
    """Return a string, number or list in TOML."""
    if isinstance(value, str):
        return quoted(value)
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_value, value))}]"
    return repr(value)
