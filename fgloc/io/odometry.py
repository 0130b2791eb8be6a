"""From an odometry of the body to the increments of a body odometry base, and to camera poses."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace

import msgspec
import numpy as np

from fgloc.core.bases import body_odometry
from fgloc.core.geometry import EXACT, between, integrate, log, wrap
from fgloc.core.measurements import CameraPoses, Floats, Stamps, WheelIncrements
from fgloc.core.robot import Robot, WheelNoise
from fgloc.datasets.intervals import trapezoid
from fgloc.datasets.text import NOT_A_NUMBER, Integers, Mask, count, finite_rows
from fgloc.errors import FglocError
from fgloc.io.messages import POSE, POSES, TWIST, TWIST_VARIANCE, TWISTS, Messages, yaw_of
from fgloc.io.sources import bridge, one_source
from fgloc.io.stamps import stamps_of
from fgloc.io.topics import CameraTable, OdometryTable

UNEQUAL = 1.25
"""Poses and twists whose paths differ by more than this factor contradict each other."""
TELLING = 4.0
"""A twist so many times nearer to the motion in another frame is given in that frame."""
CAMERA_WALK, CAMERA_HEADING_WALK = 0.02, 0.01
"""Random walk of a visual odometry where nothing better is known [m/sqrt(m)], [rad/sqrt(m)]:
2 % of a metre and half a degree, what stereo odometry without loop closure usually reaches."""
LARGEST_WALK = 0.3
"""A covariance that means more [m/sqrt(m)], [rad/sqrt(m)] is a placeholder."""
SMALLEST_WALK = 1e-4
"""So is one that means less."""


def poses_of(
    messages: Messages, stamps: Stamps, index: Integers, role: str, rejected: Counter[str]
) -> tuple[Stamps, Integers, Floats]:
    """Return stamps (M,), message indices (M,) and poses (M, 3) x, y [m], heading [rad] unwrapped.

    Poses with a value that is not finite or a quaternion of length zero are dropped and counted;
    a quaternion that is not normalised is taken for its direction.
    """
    table = messages.table()[index]
    good = finite_rows(table[:, POSE], rejected, f"{role} {NOT_A_NUMBER}")
    yaw, length = yaw_of(table[good, 2:6])
    upright = length > 1e-6
    count(rejected, f"{role} quaternion of length zero", int((~upright).sum()))
    kept = np.flatnonzero(good)[upright]
    poses = np.column_stack([table[kept, :2], np.unwrap(yaw[upright])])
    return stamps[kept], index[kept], poses


def read_odometry(
    messages: Messages, given: OdometryTable, rejected: Counter[str], notes: list[str]
) -> tuple[WheelIncrements, Robot, OdometryTable]:
    """Return the increments of a body odometry base, the robot, and the table as it was used.

    Poses are differenced, so an odometry that starts anywhere will do; twists are integrated by
    the trapezoid rule. Raises FglocError where fewer than two messages are usable. O(N).
    """
    stamps, index = stamps_of(messages, "odometry", rejected, notes)
    usual = "twist" if messages.kind in TWISTS else "pose"
    field = given.field or usual
    if messages.kind not in TWISTS and messages.kind not in POSES and given.field is None:
        field = _moving_field(messages, index)
        if field != usual:
            notes.append(f"The poses of {messages.topic} do not move: its twist is integrated.")
    if (field == "twist" and messages.kind in POSES) or (
        field == "pose" and messages.kind in TWISTS
    ):
        raise FglocError(f"{messages.topic} has no {field}")
    if field == "pose":
        boundaries, increments = _from_poses(messages, stamps, index, rejected, notes)
    else:
        boundaries, increments = _from_twists(messages, stamps, index, given, rejected)
    if boundaries.size < 2:
        raise FglocError(f"{messages.topic} has fewer than two usable messages")
    base = body_odometry()
    robot = Robot.typical("robot with odometry", base)
    if given.noise == "covariance":
        robot = replace(robot, noise=_noise(messages, stamps, index, robot.noise, notes))
    frame = given.twist_frame if field == "pose" else given.twist_frame or "child"
    table = msgspec.structs.replace(
        given, topic=messages.topic, field=field, twist_frame=frame, noise=given.noise or "typical"
    )
    wheels = WheelIncrements("wheels", boundaries, increments, base.driven_names)
    return wheels, robot, table


def _moving_field(messages: Messages, index: Integers) -> str:
    """Return "twist" where the poses stand still or have no heading and the twists move."""
    table = messages.table()[index]
    poses = table[np.isfinite(table[:, POSE]).all(axis=1)][:, POSE]
    twists = table[np.isfinite(table[:, TWIST]).all(axis=1)][:, TWIST]
    still = poses.shape[0] < 2 or bool(np.all(np.ptp(poses, axis=0) == 0.0))
    blind = poses.shape[0] == 0 or float(np.abs(poses[:, 2:]).max()) <= 1e-6
    return "twist" if (still or blind) and bool(np.any(twists != 0.0)) else "pose"


def _from_poses(
    messages: Messages,
    stamps: Stamps,
    index: Integers,
    rejected: Counter[str],
    notes: list[str],
) -> tuple[Stamps, Floats]:
    """Return interval boundaries (M+1,) and displacements (M, 3) between poses."""
    stamps, index, poses = poses_of(messages, stamps, index, "odometry", rejected)
    if stamps.size < 2:
        return stamps, np.zeros((0, 3))
    kept, resets = one_source(stamps, poses, messages.topic, "odometry", rejected, notes)
    stamps, poses = stamps[kept], poses[kept]
    moved = bridge(_steps(poses), np.diff(stamps) * 1e-9, resets)
    if messages.kind not in POSES:
        twists = messages.table()[index[kept]][:, TWIST]
        _compare(moved, resets, stamps, twists, poses[:, 2], messages.topic, notes)
    return stamps, moved


def _steps(poses: Floats) -> Floats:
    """Return the (M-1, 3) displacements between poses (M, 3), as twist times time."""
    step = between(poses[:-1], poses[1:])
    step[:, 2] = wrap(step[:, 2])
    return log(step)


def _compare(
    moved: Floats,
    resets: Mask,
    stamps: Stamps,
    twists: Floats,
    heading: Floats,
    topic: str,
    notes: list[str],
) -> None:
    """Add a note where the twists contradict the motion between poses (N, 3)."""
    usable = ~resets & np.isfinite(twists[1:]).all(axis=1) & np.isfinite(twists[:-1]).all(axis=1)
    if not usable.any() or not np.any(twists[1:][usable] != 0.0):
        return
    told = trapezoid(stamps, twists)[usable]
    path = float(np.hypot(moved[usable, 0], moved[usable, 1]).sum())
    way = float(np.hypot(told[:, 0], told[:, 1]).sum())
    turned = trapezoid(stamps, turned_twists(twists, -heading))[usable]
    own = float(np.sum((moved[usable, :2] - told[:, :2]) ** 2))
    other = float(np.sum((moved[usable, :2] - turned[:, :2]) ** 2))
    if path > 1.0 and other * TELLING < own:
        notes.append(
            f"The twist of {topic} fits its poses in the odometry's frame, not in the robot's as "
            "nav_msgs/Odometry wants it; the poses are used."
        )
    elif path > 1.0 and not path / UNEQUAL < way < path * UNEQUAL:
        notes.append(
            f"The poses of {topic} drive {path:.4g} m, its twists {way:.4g} m; the poses are used."
        )


def turned_twists(twists: Floats, angle: Floats) -> Floats:
    """Return twists (N, 3) with their velocities turned by (N,) angles [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, turn = twists.T
    return np.stack([c * x - s * y, s * x + c * y, turn], axis=1)


def _from_twists(
    messages: Messages,
    stamps: Stamps,
    index: Integers,
    given: OdometryTable,
    rejected: Counter[str],
) -> tuple[Stamps, Floats]:
    """Return interval boundaries (M+1,) and displacements (M, 3) of integrated twists."""
    table = messages.table()[index]
    good = finite_rows(table[:, TWIST], rejected, f"odometry {NOT_A_NUMBER}")
    twists = table[good, TWIST]
    if given.twist_frame == "parent":
        yaw, length = yaw_of(table[good, 2:6])
        if not bool(np.all(length > 1e-6)):
            raise FglocError(
                f"{messages.topic}: a twist in the parent frame needs an orientation, and not "
                "every message has one"
            )
        twists = turned_twists(twists, -yaw)
    stamps = stamps[good]
    return stamps, trapezoid(stamps, twists)


def walk_of(
    messages: Messages, stamps: Stamps, index: Integers
) -> tuple[float | None, float | None]:
    """Return the random walks [m/sqrt(m)], [rad/sqrt(m)] that the median twist covariance means.

    `stamps` (M,) are those of the messages `index` (M,). A velocity with variance v, anew with
    every message, walks the variance v·dt² a message, so v·dt²/(speed·dt) a metre. None where the
    covariance is zero, not finite or a placeholder.
    """
    table = messages.table()[index]
    if stamps.size < 2 or messages.kind in POSES:
        return None, None
    period = float(np.median(np.diff(stamps))) * 1e-9
    speed = np.hypot(table[:, TWIST.start], table[:, TWIST.start + 1])
    moving = speed[np.isfinite(speed) & (speed > 0.01)]
    if not moving.size:
        return None, None
    found = []
    for column in (TWIST_VARIANCE.start, TWIST_VARIANCE.start + 2):
        variance = table[:, column]
        sensible = variance[np.isfinite(variance) & (variance > 0.0)]
        typical = float(np.median(sensible)) if sensible.size else 0.0
        walk = math.sqrt(typical * period / float(np.median(moving)))
        found.append(walk if SMALLEST_WALK <= walk <= LARGEST_WALK else None)
    return found[0], found[1]


def _noise(
    messages: Messages, stamps: Stamps, index: Integers, usual: WheelNoise, notes: list[str]
) -> WheelNoise:
    """Return the wheel noise of a robot whose odometry's covariance is to be believed."""
    way, heading = walk_of(messages, stamps, index)
    if way is None or heading is None:
        notes.append(
            f"The twist covariance of {messages.topic} is no measure of its noise: what is "
            "typical of an odometry is used."
        )
        return usual
    return replace(usual, rolling=way, lateral=way, turning=0.0, veering=heading)


def read_camera(
    messages: Messages, given: CameraTable, rejected: Counter[str], notes: list[str]
) -> tuple[CameraPoses | None, CameraTable]:
    """Return a visual odometry and the table as it was used; None without two usable poses. O(N).

    Only differences of its poses count, so it may start anywhere and have any map frame.
    """
    stamps, index = stamps_of(messages, "camera", rejected, notes)
    stamps, index, poses = poses_of(messages, stamps, index, "camera", rejected)
    if stamps.size < 2:
        notes.append(f"{messages.topic} has fewer than two usable poses and is left out.")
        return None, given
    kept, resets = one_source(stamps, poses, messages.topic, "camera", rejected, notes)
    stamps, index = stamps[kept], index[kept]
    # Only differences count: from the origin on, coordinates keep their digits and the heading
    # has no jumps, whatever was dropped and however often the camera began anew.
    moved = bridge(_steps(poses[kept]), np.diff(stamps) * 1e-9, resets)
    poses = integrate(moved, np.array([0.0, 0.0, poses[kept[0], 2]]), EXACT)
    way, heading = walk_of(messages, stamps, index)
    if given.position_walk is None and given.heading_walk is None:
        told = "the median twist covariance" if way and heading else "what is usual"
        notes.append(
            f"Noise of the camera: {way or CAMERA_WALK:.2g} m/√m and "
            f"{heading or CAMERA_HEADING_WALK:.2g} rad/√m, {told}."
        )
    camera = CameraPoses(
        "camera",
        stamps,
        poses,
        position_walk=given.position_walk or way or CAMERA_WALK,
        heading_walk=given.heading_walk or heading or CAMERA_HEADING_WALK,
        mount=given.mount or (0.0, 0.0, 0.0),
        mount_sigma=given.mount_sigma or (0.05, 0.05, 0.05),
    )
    used = msgspec.structs.replace(
        given,
        topic=messages.topic,
        mount=camera.mount,
        mount_sigma=camera.mount_sigma,
        position_walk=camera.position_walk,
        heading_walk=camera.heading_walk,
    )
    return camera, used
