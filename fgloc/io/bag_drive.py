"""A bag as a drive: topics are given or guessed, every stream is read, and all of it is told."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fgloc.core.drive import Drive
from fgloc.core.measurements import Sensor, WheelIncrements
from fgloc.core.named_bases import make_base
from fgloc.core.robot import Robot
from fgloc.datasets.text import count
from fgloc.errors import FglocError
from fgloc.io.bags import Bag, Topic
from fgloc.io.guess import guess, table_for, used_as
from fgloc.io.imu import check_against_wheels, read_imu
from fgloc.io.joints import read_joints
from fgloc.io.messages import Messages, short
from fgloc.io.odometry import read_camera, read_odometry
from fgloc.io.surroundings import read_gps, read_scans, read_truth
from fgloc.io.topics import TopicMap

CUT_OFF = "bag cut off or damaged"


@dataclass(frozen=True)
class BagDrive:
    """A drive and how it was read."""

    drive: Drive
    """What was measured."""
    topics: TopicMap
    """The topic map as it was used, guesses filled in."""


def read_bag(path: Path, name: str | None = None, given: TopicMap | None = None) -> BagDrive:
    """Return the drive in a ROS 1 or 2 bag, a file or a folder, and the topic map that was used.

    `given` says which topic is what; what it leaves out is guessed and told in the notes. Only
    the topics that are used are decoded, in one pass. Raises FglocError for a bag that cannot be
    read, a topic map that does not fit it, or where nothing tells how the robot moved.
    """
    given = TopicMap() if given is None else given
    notes: list[str] = []
    rejected: Counter[str] = Counter()
    with Bag(path) as bag:
        topics = bag.topics()
        if not topics:
            raise FglocError("this bag holds no messages; record it again", file=path)
        found = guess(topics, given, notes, str(path))
        if "wheels" not in found and "odometry" not in found:
            raise FglocError(_no_wheels(topics), file=path)
        messages = bag.read(found)
        if bag.cut_off is not None:
            count(rejected, CUT_OFF)
            notes.append(f"The bag is cut off or damaged ({bag.cut_off}): what could be read is.")
    for role, topic in found.items():
        count(rejected, f"{role} message that cannot be decoded", messages[topic.name].broken)
    try:
        return _assemble(path, name or str(path), given, found, messages, rejected, notes)
    except FglocError as error:
        if error.file is not None:
            raise
        raise FglocError(str(error), file=path) from None


def _assemble(
    path: Path,
    name: str,
    given: TopicMap,
    found: dict[str, Topic],
    messages: dict[str, Messages],
    rejected: Counter[str],
    notes: list[str],
) -> BagDrive:
    """Return the drive made of the messages of every role."""
    used: dict[str, Any] = {}

    def of(role: str) -> tuple[Messages, Any]:
        return messages[found[role].name], table_for(role, given)

    wheels, robot = _wheels(path, given, found, messages, used, rejected, notes)
    sensors: list[Sensor] = []
    if "imu" in found:
        streams, used["imu"] = read_imu(*of("imu"), rejected, notes)
        sensors += streams
        turns = robot.base.displacements(wheels.angles, wheels.steering)[:, 2]
        notes += check_against_wheels(streams, wheels, turns, found["imu"].name)
    if "camera" in found:
        camera, used["camera"] = read_camera(*of("camera"), rejected, notes)
        sensors += [camera] if camera is not None else []
    if "gps" in found:
        fixes, used["gps"] = read_gps(*of("gps"), rejected, notes)
        sensors += [fixes] if fixes is not None else []
    if "scan" in found:
        scans, used["scan"] = read_scans(*of("scan"), rejected, notes)
        sensors += [scans] if scans is not None else []
    truth = None
    if "truth" in found:
        truth, used["truth"] = read_truth(*of("truth"), rejected, notes)
    told = [used_as(role, found[role], table) for role, table in used.items() if table.topic]
    drive = Drive(
        name,
        robot,
        wheels,
        tuple(sensors),
        truth=truth,
        rejected=dict(rejected),
        notes=(*told, *notes),
    )
    roles = {role: table for role, table in used.items() if table.topic}
    topics = TopicMap(base=given.base, ignore=given.ignore).with_roles(**roles)
    return BagDrive(drive, topics)


def _wheels(
    path: Path,
    given: TopicMap,
    found: dict[str, Topic],
    messages: dict[str, Messages],
    used: dict[str, Any],
    rejected: Counter[str],
    notes: list[str],
) -> tuple[WheelIncrements, Robot]:
    """Return wheels and robot, from joints or from an odometry of the body."""
    if "wheels" not in found:
        wheels, robot, used["odometry"] = read_odometry(
            messages[found["odometry"].name], table_for("odometry", given), rejected, notes
        )
        name = (given.base or {}).get("name")
        if "kind" in (given.base or {}):
            notes.append("[base] describes wheels and is not used: an odometry tells the motion.")
        return wheels, robot if name is None else replace(robot, name=str(name))
    if given.base is None:
        raise given.error(
            "[wheels] needs [base], which says how large the wheels are and where they stand; "
            "see docs/bags.md",
            "wheels",
        )
    try:
        base = make_base(given.base, "base")
    except FglocError as error:
        raise given.error(str(error), "base") from None
    robot = Robot.typical(str(given.base.get("name", path.stem)), base)
    wheels, used["wheels"] = read_joints(
        messages[found["wheels"].name],
        table_for("wheels", given),
        base,
        given,
        rejected,
        notes,
    )
    return wheels, robot


def _no_wheels(topics: dict[str, Topic]) -> str:
    """Return what to do about a bag in which nothing tells how the robot moved."""
    there = ", ".join(f"{t.name} ({short(t.kind)})" for t in topics.values())
    if any(t.kind.endswith("/JointState") for t in topics.values()):
        return (
            "wheel joints are here, but nothing says how large the wheels are and where they "
            "stand; give --topics FILE with [base] and [wheels] (docs/bags.md); topics are "
            f"{there}"
        )
    return (
        "nothing here tells how the robot moved: no wheel joints, odometry or stamped twist; "
        f"topics are {there}"
    )
