"""Which topic is what, guessed from types and names where nobody says; nothing is hidden."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping
from typing import Any

import msgspec

from fgloc.io.bags import Topic
from fgloc.io.messages import EXTRACTORS, FIX, IMU, JOINTS, ODOMETRY, POSES, SCAN, TWISTS, short
from fgloc.io.topics import TABLES, Role, TopicMap

TYPES: dict[str, tuple[str, ...]] = {
    "wheels": (JOINTS,),
    "odometry": (ODOMETRY, *TWISTS, *POSES),
    "imu": (IMU,),
    "truth": (*POSES, ODOMETRY),
    "camera": (ODOMETRY, *POSES),
    "scan": (SCAN,),
    "gps": (FIX,),
}
"""Types of message that a role can be read from."""


def _list(text: str) -> tuple[str, ...]:
    """Return the words of a text."""
    return tuple(text.split())


TRUTH = _list("truth gt groundtruth optitrack vicon mocap vrpn qualisys natnet rigid leica")
NO_TRUTH = _list(
    "goal target initialpose initial setpoint cmd command amcl ekf ukf estimate estimated slam "
    "localization localisation filtered waypoint plan tracked"
)
"""A pose by one of these names is a wish or an estimate."""
FUSED = _list(
    "ekf ukf filtered fused fusion kalman amcl slam cartographer localization localisation map "
    "global gps utm navsat combined corrected"
)
LASER = _list("laser lidar icp rf2o scan loam lio ndt")
VISUAL = _list(
    "visual vo vio vslam stereo camera cam zed realsense t265 svo orb rovio okvis vins rtabmap "
    "kimera basalt mono rgbd"
)
WHEEL = _list("wheel wheels encoder encoders velocity diff drive base joint")


def says(topic: str, words: Iterable[str]) -> bool:
    """Return True if a topic's name has one of the words, short ones only between separators."""
    name = topic.lower()
    parts = set(re.split(r"[^a-z0-9]+", name))
    return any(w in parts or (len(w) > 3 and w in name) for w in words)


def nature(topic: Topic) -> str:
    """Return what an odometry or a pose seems to be by its name.

    "truth", "fused" (an estimate of many sensors), "laser", "visual", "wheel", or "" if the name
    does not say.
    """
    for words, name in ((TRUTH, "truth"), (FUSED, "fused"), (LASER, "laser"), (VISUAL, "visual")):
        if says(topic.name, words):
            return name
    return "wheel" if says(topic.name, WHEEL) else ""


def guess(
    topics: Mapping[str, Topic], given: TopicMap, notes: list[str], bag: str
) -> dict[str, Topic]:
    """Return the topic of every role that there is one for; `notes` get what was ambiguous.

    What `given` names is taken; the rest is guessed. `bag` is what errors call the bag. Raises
    FglocError for a topic that is not there, or not of a type that its role can be read from.
    """
    found = {
        name: _named(name, role.topic, topics, given, bag)
        for name, role in given.roles()
        if role.topic is not None
    }
    taken = {t.name for t in found.values()}
    free = {
        t.name: t
        for t in topics.values()
        if t.count > 1 and t.name not in taken and t.name not in given.ignore
    }
    left: dict[str, str] = {}
    named = set(found)
    _guess_truth(free, found, left)
    _guess_wheels(free, found, left, given)
    _guess_camera(free, found, left)
    notes += _doubts({role: t for role, t in found.items() if role not in named})
    for role, avoid in (("imu", (*VISUAL, "raw", "odometry", "odom")), ("scan", ()), ("gps", ())):
        _guess_sensor(role, avoid, free, found, left)
    if "truth" in found and "gps" in found and given.gps is None:
        # Nobody knows how the truth's map lies to east and north.
        left[found.pop("gps").name] = (
            "the truth has a map of its own; [gps] in a topic map takes it"
        )
    for role, _ in given.roles():
        if role not in found and given.file is not None:
            kinds = ", ".join(short(k) for k in TYPES[role])
            message = f"[{role}]: {bag} has no topic for it that could be guessed, of {kinds}"
            if role in ("wheels", "odometry"):
                raise given.error(message, role)
            notes.append(f"{message}.")
    used = {t.name for t in found.values()}
    for t in topics.values():
        if t.kind in EXTRACTORS and t.name not in used:
            why = left.get(t.name) or _why_not(t, given)
            notes.append(f"Left out: {t.name} ({short(t.kind)}): {why}.")
    return found


def _why_not(topic: Topic, given: TopicMap) -> str:
    """Return why nothing was made of a topic of a type that could be read."""
    if topic.name in given.ignore:
        return "the topic map ignores it"
    if topic.count < 2:
        return f"it has {topic.count or 'no'} message{'' if topic.count == 1 else 's'}"
    if topic.kind in TWISTS:
        return "a command or a truth, by its name"
    if topic.kind in POSES:
        return "a wish or an estimate, by its name; [truth] in a topic map takes it"
    return "nothing here needs it"


def _named(role: str, name: str, topics: Mapping[str, Topic], given: TopicMap, bag: str) -> Topic:
    """Return the topic that a map names for a role."""
    if name not in topics:
        near = difflib.get_close_matches(name, topics, n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise given.error(
            f"{role}.topic: {bag} has no topic {name}; {hint}it has {', '.join(topics)}",
            role,
            "topic",
        )
    topic = topics[name]
    if topic.kind not in TYPES[role]:
        kinds = ", ".join(short(k) for k in TYPES[role])
        raise given.error(
            f"{role}.topic: {name} is {short(topic.kind)}, and {role} can be read from {kinds}",
            role,
            "topic",
        )
    return topic


def _take(
    role: str, candidates: list[Topic], free: dict[str, Topic], found: dict[str, Topic]
) -> list[Topic]:
    """Give the first candidate to a role; return the others."""
    if candidates:
        found[role] = free.pop(candidates[0].name)
    return candidates[1:]


def _doubts(guessed: Mapping[str, Topic]) -> list[str]:
    """Return what is less than certain about the roles that were guessed."""
    notes = []
    truth, odometry = guessed.get("truth"), guessed.get("odometry")
    if truth is not None and nature(truth) != "truth":
        notes.append(
            f"{truth.name} is taken for the truth as a pose that is called nothing else; "
            f'ignore = ["{truth.name}"] in a topic map leaves it out.'
        )
    kinds = {"fused": "an estimate of several sensors", "laser": "a lidar", "visual": "a camera"}
    if odometry is not None and nature(odometry) in kinds:
        notes.append(
            f"There is no odometry of wheels: the motion of the body is {odometry.name}, by its "
            f"name that of {kinds[nature(odometry)]}."
        )
    return notes


def _guess_truth(free: dict[str, Topic], found: dict[str, Topic], left: dict[str, str]) -> None:
    """Find the truth: what is called so, else a pose that is not called anything else."""
    named = [t for t in free.values() if t.kind in TYPES["truth"] and nature(t) == "truth"]
    poses = [
        t
        for t in free.values()
        if t.kind in POSES and t not in named and not says(t.name, NO_TRUTH) and not nature(t)
    ]
    candidates = sorted(named, key=lambda t: -t.count) + sorted(poses, key=lambda t: -t.count)
    others = candidates if "truth" in found else _take("truth", candidates, free, found)
    for t in others:
        left[t.name] = f"the truth is {found['truth'].name}"
        free.pop(t.name, None)


def _guess_wheels(
    free: dict[str, Topic], found: dict[str, Topic], left: dict[str, str], given: TopicMap
) -> None:
    """Find wheel joints where the robot is described, else an odometry of the body."""
    joints = [t for t in free.values() if t.kind == JOINTS]
    joints.sort(key=lambda t: (not says(t.name, WHEEL), -t.count))
    odometries = [t for t in free.values() if t.kind in (ODOMETRY, *TWISTS)]
    odometries = [t for t in odometries if not says(t.name, ["cmd", *TRUTH])]
    rank = {"wheel": 0, "": 1, "fused": 3, "laser": 4, "visual": 5}
    odometries.sort(key=lambda t: (rank[nature(t)], t.kind != ODOMETRY, -t.count))
    if "wheels" not in found and "odometry" not in found:
        described = given.base is not None and "kind" in given.base
        wanted = given.wheels is not None or (described and given.odometry is None)
        if joints and wanted:
            joints = _take("wheels", joints, free, found)
        elif odometries:
            odometries = _take("odometry", odometries, free, found)
    for t in joints:
        if "wheels" in found:
            left[t.name] = f"the wheels are {found['wheels'].name}"
        else:
            left[t.name] = (
                "nothing says how large the wheels are; [base] and [wheels] in a topic map do"
            )
    source = found.get("wheels") or found.get("odometry")
    for t in odometries:
        kind = nature(t)
        if source is not None and kind in ("wheel", "", "fused"):
            why = "an estimate of several sensors" if kind == "fused" else "one of its kind is used"
            left[t.name] = f"{why}; the motion of the body is {source.name}"
            free.pop(t.name, None)


def _guess_camera(free: dict[str, Topic], found: dict[str, Topic], left: dict[str, str]) -> None:
    """Find a visual odometry; a laser odometry is named and left out."""
    odometries = [t for t in free.values() if t.kind == ODOMETRY]
    visual = sorted((t for t in odometries if nature(t) == "visual"), key=lambda t: -t.count)
    others = visual if "camera" in found else _take("camera", visual, free, found)
    for t in others:
        left[t.name] = f"the visual odometry is {found['camera'].name}"
    for t in odometries:
        if nature(t) == "laser":
            left[t.name] = "an odometry of a lidar; [camera] in a topic map takes it as one"


def _guess_sensor(
    role: str,
    avoid: Iterable[str],
    free: dict[str, Topic],
    found: dict[str, Topic],
    left: dict[str, str],
) -> None:
    """Find the one sensor of a type: that with most messages, those with words to avoid last."""
    candidates = [t for t in free.values() if t.kind in TYPES[role]]
    candidates.sort(key=lambda t: (says(t.name, avoid), -t.count))
    others = candidates if role in found else _take(role, candidates, free, found)
    for t in others:
        left[t.name] = f"the {role} is {found[role].name}"


def table_for(role: str, given: TopicMap) -> Any:
    """Return the given table of a role, or one that leaves everything to the reader."""
    table: Role | None = given.role(role)
    return TABLES[role]() if table is None else table


def used_as(role: str, topic: Topic, table: Role) -> str:
    """Return the sentence that says which topic a role is read from, and how."""
    options = {
        key: value
        for key, value in msgspec.structs.asdict(table).items()
        if key != "topic" and value is not None
    }
    words = ", ".join(f"{key} {_words(value)}" for key, value in options.items())
    how = f": {words}" if words else ""
    return f"{role} ← {topic.name} ({short(topic.kind)}, {topic.count} messages){how}."


def _words(value: Any) -> str:
    """Return an option's value in words."""
    if isinstance(value, tuple):
        return f"({', '.join(_words(v) for v in value)})"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
