"""Open-loop paths: where wheels alone put a reference sensor, and how that moves with parameters.

A drive's wheels are integrated from its true start; the path is compared with the recorded truth
at points spread evenly over the drive. With the reference mounted at m on the base and recorded at
s when the drive starts, and the wheels' displacement D since then, the reference is predicted at
s ∘ m⁻¹ ∘ D ∘ m. Derivatives are exact: those of the displacements come from the preintegration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.evaluation import MAX_GAP_S
from fgloc.core.geometry import compose
from fgloc.core.measurements import Floats, Stamps, WheelIncrements
from fgloc.core.preintegration import SplitIncrements, preintegrate, split_at
from fgloc.core.robot import Robot
from fgloc.core.start import start_pose, trim_to_truth
from fgloc.errors import FglocError

POINTS = 40
"""Points of a path that are compared with the truth."""


@dataclass(frozen=True)
class PathData:
    """One drive, prepared for comparing its open-loop path with its truth."""

    drive: Drive
    """The drive from the first wheel stamp on at which its truth is known."""
    start: Floats
    """(3,) recorded pose of the reference at the first wheel stamp."""
    seconds: Floats
    """(M,) times of the points since then, by the reference's clock [s]."""
    truth: Floats
    """(M, 3) recorded poses of the reference there; headings go on without leaps."""
    split: SplitIncrements
    """The wheels' increments, cut at the points."""


@dataclass(frozen=True)
class Path:
    """Residuals of one open-loop path and their derivatives."""

    residual: Floats
    """(M, 3) predicted minus recorded pose in map axes [m, m, rad]."""
    by_values: Floats
    """(M, 3, P) derivative by the robot's physical parameter values."""
    by_mount: Floats
    """(M, 3, 3) derivative by the mounting x, y [m], yaw [rad] of the reference."""
    by_time: Floats
    """(M, 3) derivative by the time at which the wheels are looked at [1/s]; zeros where that was
    not asked for."""


def path_data(drive: Drive, points: int = POINTS) -> PathData:
    """Return a drive with `points` of its truth, evenly over the time that wheels cover.

    Stamps at which no truth was recorded for over 0.5 s are not used. Raises FglocError where the
    drive has no truth, or none while its wheels turn. O(N).
    """
    if drive.truth is None:
        raise FglocError(f"{drive.name} has no recorded truth to compare its wheels with")
    drive = trim_to_truth(drive)
    assert drive.truth is not None
    begin, end = int(drive.wheels.stamps_ns[0]), int(drive.wheels.stamps_ns[-1])
    known = drive.truth.trajectory
    inside = np.flatnonzero((known.stamps_ns > begin) & (known.stamps_ns <= end))
    if inside.size < 2:
        raise FglocError(f"{drive.name}: fewer than two poses of the truth while the wheels turn")
    wanted = begin + (end - begin) * np.arange(1, points + 1) / points
    near = np.searchsorted(known.stamps_ns[inside], wanted)
    near = np.unique(np.clip(near, 0, inside.size - 1))
    # A point that stands for a gap of the truth is kept once, where the truth goes on.
    at = inside[near]
    mount = np.asarray(drive.truth.mount, dtype=np.float64)
    start = compose(start_pose(drive), mount)
    heading: Floats = np.unwrap(known.poses[:, 2])
    truth = np.column_stack([known.poses[at, :2], heading[at]])
    first = heading[max(int(np.searchsorted(known.stamps_ns, begin, side="right")) - 1, 0)]
    truth[:, 2] += 2.0 * np.pi * np.round((start[2] - first) / (2.0 * np.pi))
    seconds = np.asarray((known.stamps_ns[at] - begin) * 1e-9)
    return PathData(drive, start, seconds, np.asarray(truth), _split(drive.wheels, seconds))


def pieces(data: PathData, count: int) -> list[PathData]:
    """Return the drive cut into `count` drives of equal length in time, each from its own start.

    For choosing between models where there is only one drive. Pieces in which wheels or truth are
    missing are left out.
    """
    drive = data.drive
    stamps = drive.wheels.stamps_ns
    cuts = np.linspace(0, stamps.size - 1, count + 1).astype(int)
    found = []
    for a, b in pairwise(cuts.tolist()):
        if b - a < 2:
            continue
        try:
            found.append(path_data(replace(drive, wheels=drive.wheels.between(a, b))))
        except FglocError:
            continue
    return found


def path(
    data: PathData,
    robot: Robot,
    values: Floats,
    mount: Floats,
    clock: tuple[float, float] | None = None,
) -> Path:
    """Return the open-loop path with these parameter values (P,) and its derivatives.

    `mount` (3,) is where the reference sits on the base, `clock` = (offset [s], rate [1]) says at
    which time the wheels are looked at: t + offset + rate·t, None: at the time of each point.
    O(N·P) in compiled code. Raises FglocError if the wheels do not determine the motion.
    """
    wanted = data.seconds
    if clock is not None:
        wanted = data.seconds + clock[0] + clock[1] * data.seconds
    seconds = np.clip(wanted, 0.0, _last(data))
    order = np.argsort(seconds, kind="stable")
    split = data.split if clock is None else _split(data.drive.wheels, seconds[order])
    moved, by_values = _displacement(split, robot, values)
    unsorted = np.argsort(order, kind="stable")
    moved, by_values = moved[unsorted], by_values[unsorted]
    turned, t = _rotation(moved[:, 2]), mount[:2]
    back = _rotation(np.array([-mount[2]]))[0]
    arm = turned @ t - t
    q = (moved[:, :2] + arm) @ back.T
    ahead = _rotation(data.start[2:])[0]
    out = data.start[:2] + q @ ahead.T
    residual = np.column_stack([out, data.start[2] + moved[:, 2]]) - data.truth
    both = ahead @ back
    swung = turned @ np.array([-t[1], t[0]])
    value = np.empty_like(by_values)
    value[:, :2] = np.einsum(
        "ab,mbp->map", both, by_values[:, :2] + swung[:, :, None] * by_values[:, 2:3]
    )
    value[:, 2] = by_values[:, 2]
    by_mount = np.zeros((seconds.size, 3, 3))
    by_mount[:, :2, :2] = both @ (turned - np.eye(2))
    by_mount[:, :2, 2] = np.stack([q[:, 1], -q[:, 0]], axis=1) @ ahead.T
    by_time = np.zeros((seconds.size, 3))
    if clock is not None:
        twist = _twist(data, robot, values, seconds)
        velocity = np.einsum("mab,mb->ma", turned, twist[:, :2]) + swung * twist[:, 2:3]
        by_time[:, :2] = velocity @ both.T
        by_time[:, 2] = twist[:, 2]
        by_time[seconds != wanted] = 0.0
    return Path(residual, value, by_mount, by_time)


def _last(data: PathData) -> float:
    """Return the last wheel stamp [s] since the first."""
    stamps = data.drive.wheels.stamps_ns
    return float(stamps[-1] - stamps[0]) * 1e-9


def _split(wheels: WheelIncrements, seconds: Floats) -> SplitIncrements:
    """Return the increments cut at times (M,) since the first stamp, in order."""
    at: Stamps = wheels.stamps_ns[0] + np.round(seconds * 1e9).astype(np.int64)
    at = np.minimum(at, wheels.stamps_ns[-1])
    return split_at(wheels, np.concatenate([wheels.stamps_ns[:1], at]))


def _displacement(split: SplitIncrements, robot: Robot, values: Floats) -> tuple[Floats, Floats]:
    """Return the base's (M, 3) displacements from the start and their derivatives (M, 3, P)."""
    pre = preintegrate(split, robot, values)
    step, d = pre.displacement, pre.jacobian
    heading = np.concatenate([[0.0], np.cumsum(step[:, 2])])
    by_heading = np.concatenate([np.zeros((1, d.shape[2])), np.cumsum(d[:, 2], axis=0)])
    turned = _rotation(heading[:-1])
    ahead = np.einsum("mab,mb->ma", turned, step[:, :2])
    aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    moved = np.column_stack([np.cumsum(ahead, axis=0), heading[1:]])
    jacobian = np.empty_like(d)
    jacobian[:, :2] = np.cumsum(
        np.einsum("mab,mbp->map", turned, d[:, :2]) + aside[:, :, None] * by_heading[:-1, None],
        axis=0,
    )
    jacobian[:, 2] = by_heading[1:]
    return moved, jacobian


def _twist(data: PathData, robot: Robot, values: Floats, seconds: Floats) -> Floats:
    """Return the base's (M, 3) twist in its own axes at times since the start."""
    wheels = data.drive.wheels
    stamps = (wheels.stamps_ns - wheels.stamps_ns[0]) * 1e-9
    k = np.clip(np.searchsorted(stamps, seconds) - 1, 0, stamps.size - 2)
    steering = None if wheels.steering is None else wheels.steering[k]
    moved = robot.base.displacements(wheels.angles[k], steering, values)
    # Over a long silence of the wheels a rate says little of the moment; a short step would do
    # harm there, none does not.
    step = stamps[k + 1] - stamps[k]
    return np.where(step[:, None] > MAX_GAP_S, 0.0, moved / step[:, None])


def _rotation(angle: Floats) -> Floats:
    """Return (N, 2, 2) rotation matrices of (N,) angles."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)


def all_data(drives: Sequence[Drive]) -> list[PathData]:
    """Return `path_data` of every drive; raises FglocError as that does."""
    return [path_data(d) for d in drives]
