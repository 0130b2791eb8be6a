"""From joint states to wheel increments: which joint is which wheel, counts, signs, wraps."""

from __future__ import annotations

import math
from collections import Counter

import msgspec
import numpy as np

from fgloc.core.kinematics import WheeledBase
from fgloc.core.measurements import Floats, WheelIncrements
from fgloc.datasets.intervals import trapezoid
from fgloc.datasets.plausible import FASTEST_M_S
from fgloc.datasets.text import NOT_A_NUMBER, Integers, count, finite_rows
from fgloc.errors import FglocError
from fgloc.io.messages import Messages, sane
from fgloc.io.sources import bridge
from fgloc.io.stamps import stamps_of
from fgloc.io.topics import TopicMap, WheelsTable

SLACK_RAD = 1.0
"""A wheel may turn by so much at once beside what the fastest robot drives [rad]."""
ELSEWHERE = "wheels message of other joints"


def read_joints(
    messages: Messages,
    given: WheelsTable,
    base: WheeledBase,
    topics: TopicMap,
    rejected: Counter[str],
    notes: list[str],
) -> tuple[WheelIncrements, WheelsTable]:
    """Return the wheel increments of a base and the table as it was used.

    Joints are found by name in every message, so their order may change and messages of other
    joints may lie between. Where no message has names, joints are counted off. Velocities are
    integrated by the trapezoid rule. Raises FglocError for joints that are not there, or where
    fewer than two messages are usable. O(N).
    """
    stamps, index = stamps_of(messages, "wheels", rejected, notes)
    joints = tuple(given.joints or base.driven_names)
    steering = tuple(given.steering_joints or ())
    _check_names(given, base, joints, steering, topics)
    place, index_kept = _places(messages, index, (*joints, *steering), given, topics)
    count(rejected, ELSEWHERE, index.size - index_kept.size)
    stamps, index = stamps[np.isin(index, index_kept)], index_kept
    field = given.field or _moving_field(messages, index, place)
    values = _values(messages, index, place, 1 if field == "position" else 2, len(joints))
    angles_of = _values(messages, index, place[:, len(joints) :], 1, len(steering))
    good = finite_rows(np.hstack([values, angles_of]), rejected, f"wheels {NOT_A_NUMBER}")
    stamps, values, angles_of = stamps[good], values[good], angles_of[good]
    if stamps.size < 2:
        raise FglocError(f"{messages.topic} has fewer than two usable messages of the wheels")
    sign = np.array([-1.0 if j in (given.reverse or ()) else 1.0 for j in joints])
    unit = _unit(given)
    if field == "position":
        increments = _differences(values, given, notes, messages.topic) * (sign * unit)
    else:
        increments = trapezoid(stamps, values) * (sign * unit)
    seconds = np.diff(stamps) * 1e-9
    radii = np.array([base.wheels[i].radius for i in base.driven])
    limit = FASTEST_M_S / radii * seconds[:, None] + SLACK_RAD
    leaps = np.any(np.abs(increments) > limit, axis=1)
    # Where nearly all are too fast the unit is wrong, which the check of the drive says better.
    if leaps.mean() < 0.1:
        count(rejected, "implausible wheel increment", int(leaps.sum()))
        increments = bridge(increments, seconds, leaps)
    counted = field == "position" and given.counts_per_revolution is not None
    wheels = WheelIncrements(
        "wheels",
        stamps,
        increments,
        base.driven_names,
        steering=0.5 * (angles_of[1:] + angles_of[:-1]) if steering else None,
        resolution=unit if counted else 0.0,
    )
    used = msgspec.structs.replace(given, topic=messages.topic, field=field, joints=joints)
    return wheels, used


def _check_names(
    given: WheelsTable,
    base: WheeledBase,
    joints: tuple[str, ...],
    steering: tuple[str, ...],
    topics: TopicMap,
) -> None:
    """Raise FglocError where the lists of joints do not fit the base."""
    wheels = base.driven_names
    for key, names in (("joints", joints), ("steering_joints", steering)):
        if (names or key == "joints") and len(names) != len(wheels):
            raise topics.error(
                f"wheels.{key} names {len(names)} joints where the base has {len(wheels)} driven "
                f"wheels ({', '.join(wheels)}); name one for each",
                "wheels",
                key,
            )
    for name in given.reverse or ():
        if name not in joints:
            raise topics.error(
                f"wheels.reverse names {name!r}, which is not one of the joints "
                f"{', '.join(joints)}",
                "wheels",
                "reverse",
            )


def _places(
    messages: Messages,
    index: Integers,
    wanted: tuple[str, ...],
    given: WheelsTable,
    topics: TopicMap,
) -> tuple[Integers, Integers]:
    """Return (M, J) where each wanted joint is, and the (M,) messages that have all of them.

    The kinds of messages are few, so names are looked up once for each.
    """
    names = [messages.rows[k][0] for k in index]
    known: dict[tuple[str, ...], list[int] | None] = {}
    for kind in dict.fromkeys(names):
        found = [kind.index(j) if j in kind else -1 for j in wanted]
        known[kind] = None if -1 in found else found
    if set(known) <= {()} and given.joints is None:
        known[()] = list(range(len(wanted)))
    usable = [(k, known[n]) for k, n in zip(index.tolist(), names, strict=True) if known[n]]
    if not usable:
        there = list(dict.fromkeys(n for kind in known for n in kind))
        raise topics.error(
            f"{messages.topic} has no message with the joints {', '.join(wanted)}; it has "
            f"{', '.join(there) or 'no names at all'}: name those of the wheels in wheels.joints",
            "wheels",
            "joints",
        )
    kept, places = zip(*usable, strict=True)
    return np.array(places, dtype=np.int64), np.array(kept, dtype=np.int64)


def _values(
    messages: Messages, index: Integers, place: Integers, column: int, joints: int
) -> Floats:
    """Return (M, J) of the positions (column 1) or velocities (2) of the first J places.

    A message whose array is too short (positions and velocities are optional) gives NaN.
    """
    out = np.full((index.size, joints), np.nan)
    rows = messages.rows
    lengths = np.array([rows[k][column].size for k in index], dtype=np.int64)
    for length in np.unique(lengths):
        at = np.flatnonzero(lengths == length)
        if not joints or place[at, :joints].max() >= length:
            continue
        stacked = np.stack([rows[k][column] for k in index[at]])
        out[at] = np.take_along_axis(stacked, place[at, :joints], axis=1)
    return sane(out)


def _moving_field(messages: Messages, index: Integers, place: Integers) -> str:
    """Return "velocity" where no position moves and a velocity does, else "position"."""
    positions = _values(messages, index, place, 1, place.shape[1])
    velocities = _values(messages, index, place, 2, place.shape[1])
    known = positions[np.isfinite(positions).all(axis=1)]
    still = known.shape[0] < 2 or bool(np.all(np.ptp(known, axis=0) == 0.0))
    return "velocity" if still and bool(np.any(np.nan_to_num(velocities))) else "position"


def _unit(given: WheelsTable) -> float:
    """Return the wheel's angle [rad] (or rate [rad/s]) of one unit of what is read."""
    unit = (1.0 if given.scale is None else given.scale) / (given.gear or 1.0)
    if given.counts_per_revolution is not None:
        unit *= 2.0 * math.pi / given.counts_per_revolution
    return unit


def _differences(values: Floats, given: WheelsTable, notes: list[str], topic: str) -> Floats:
    """Return (M-1, J) differences of positions, a wrap of the counter or of the angle undone."""
    step = np.diff(values, axis=0)
    if given.counter_bits is not None:
        turn = 2.0**given.counter_bits
        return np.asarray((step + turn / 2.0) % turn - turn / 2.0)
    within = float(np.ptp(values)) <= 2.0 * math.pi + 1e-6
    if given.counts_per_revolution is None and within and bool(np.any(np.abs(step) > math.pi)):
        notes.append(f"The joint positions of {topic} are wrapped to one turn; that is undone.")
        return np.diff(np.unwrap(values, axis=0), axis=0)
    return step
