"""The published calibration problem of a four-wheel-steer robot: cost and exact derivatives.

Twelve parameters, the places a_i, b_i and radii r_i of four wheels, within 5 % of nominal; the
cost J is the sum over all samples of all runs of the squared errors of x, y [m] and heading [rad]
of the open-loop path. The kinematics are the publication's own (equation 3.2): the means of the
wheels' velocities, the rotation as a weighted sum with

    W_i = (-b_i cos d_i + a_i sin d_i) / (4 a_i² + 4 b_i²),

and Euler steps. That is the least-squares twist for the nominal geometry, and not for others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.drive import Drive
from fgloc.core.geometry import EULER, integrate
from fgloc.core.measurements import Floats
from fgloc.core.start import start_pose, trim_to_truth
from fgloc.errors import FglocError

PARAMETERS = tuple(f"{name}{k}" for name in ("a", "b", "r") for k in range(1, 5))
"""Names of the parameters, as published: places a (forward), b (left) and radii r of the wheels."""
MERGED = 5
"""Intervals that are one in a copy for second derivatives."""
DIFFERENCE = 5e-5
"""Step of differences of gradients, in widths of the bounds."""
WITHIN = 0.05
"""How far from nominal they may be, as a part of it."""


@dataclass(frozen=True)
class SwerveRun:
    """One run, prepared."""

    angles: Floats
    """(N, 4) what the wheels rolled in each interval [rad]."""
    steering: Floats
    """(N, 4) their steering angles [rad]."""
    start: Floats
    """(3,) true pose at the beginning."""
    truth: Floats
    """(N, 3) true poses at the ends of the intervals, headings without leaps."""


@dataclass(frozen=True)
class SwerveProblem:
    """Runs, nominal values and bounds."""

    runs: tuple[SwerveRun, ...]
    """All runs of the cost."""
    nominal: Floats
    """(12,) nominal parameters [m]."""
    low: Floats
    """(12,) lower bounds [m]."""
    high: Floats
    """(12,) upper bounds [m]."""

    @property
    def width(self) -> Floats:
        """Return (12,) widths of the bounds [m]."""
        return self.high - self.low

    def cost(self, parameters: Floats) -> float:
        """Return J. O(samples) in compiled code."""
        return sum(_run_cost(r.angles, r.steering, r.start, r.truth, parameters) for r in self.runs)

    def gradient(self, parameters: Floats) -> tuple[float, Floats]:
        """Return J and its gradient (12,); no Jacobian is stored. O(12 · samples), compiled."""
        total, half = 0.0, np.zeros(12)
        for r in self.runs:
            total += _run_gradient(r.angles, r.steering, r.start, r.truth, parameters, half)
        return total, 2.0 * half

    def merged(self, count: int) -> SwerveProblem:
        """Return a coarser copy: `count` intervals as one, with their mean steering angles.

        Its cost is about 1 / `count` of this one's.
        """
        runs = []
        for r in self.runs:
            n = r.angles.shape[0] // count * count
            shape = (n // count, count, 4)
            runs.append(
                SwerveRun(
                    np.ascontiguousarray(r.angles[:n].reshape(shape).sum(axis=1)),
                    np.ascontiguousarray(r.steering[:n].reshape(shape).mean(axis=1)),
                    r.start,
                    np.ascontiguousarray(r.truth[count - 1 : n : count]),
                )
            )
        return replace(self, runs=tuple(runs))

    def second_derivatives(self, parameters: Floats) -> Floats:
        """Return the second derivatives (12, 12) of J: central differences of exact gradients.

        On a copy with merged intervals, times their number, they are close enough for the
        direction of a step, and cost a tenth.
        """
        rows = np.empty((12, 12))
        for k in range(12):
            step = DIFFERENCE * self.width[k] * np.eye(12)[k]
            ends = [self.gradient(parameters + side * step)[1] for side in (1.0, -1.0)]
            rows[k] = (ends[0] - ends[1]) / (2.0 * step[k])
        return np.asarray(0.5 * (rows + rows.T))

    def active(self, parameters: Floats, near: float = 1e-6) -> tuple[str, ...]:
        """Return the bounds that hold parameters, e.g. "a1 high"; `near` in bound widths."""
        found = []
        for k, name in enumerate(PARAMETERS):
            if parameters[k] - self.low[k] <= near * self.width[k]:
                found.append(f"{name} low")
            elif self.high[k] - parameters[k] <= near * self.width[k]:
                found.append(f"{name} high")
        return tuple(found)


def swerve_problem(drives: Sequence[Drive]) -> SwerveProblem:
    """Return the problem of some drives of a robot with four steered wheels.

    The truth must be recorded at the wheels' stamps, as the reader joins them. Raises FglocError
    for another robot, or a truth that has other stamps.
    """
    wheels = [drives[0].robot.base.wheels[i] for i in drives[0].robot.base.driven]
    if drives[0].robot.base.kind != "4wis4wid" or len(wheels) != 4:
        raise FglocError(f"{drives[0].name} is not of a robot with four steered wheels")
    nominal = np.array([[w.x, w.y, w.radius] for w in wheels]).T.ravel()
    edge = WITHIN * np.abs(nominal)
    return SwerveProblem(
        tuple(_prepared(d) for d in drives), nominal, nominal - edge, nominal + edge
    )


def _prepared(drive: Drive) -> SwerveRun:
    """Return one run."""
    drive = trim_to_truth(drive)
    assert drive.truth is not None
    assert drive.wheels.steering is not None
    known = drive.truth.trajectory
    stamps = drive.wheels.stamps_ns
    at = np.searchsorted(known.stamps_ns, stamps)
    if np.any(known.stamps_ns[np.minimum(at, len(known) - 1)] != stamps):
        raise FglocError(f"{drive.name}: the truth is not recorded at the wheels' stamps")
    poses = known.poses[at]
    heading = np.unwrap(poses[:, 2])
    start = start_pose(drive)
    truth = np.column_stack([poses[:, :2], heading + start[2] - heading[0]])
    return SwerveRun(
        np.ascontiguousarray(drive.wheels.angles),
        np.ascontiguousarray(drive.wheels.steering),
        start,
        np.ascontiguousarray(truth[1:]),
    )


def seed_path(run: SwerveRun, parameters: Floats) -> Floats:
    """Return the (N+1, 3) open-loop path by the publication's kinematics."""
    moved = np.empty((run.angles.shape[0], 3))
    _displacements(run.angles, run.steering, parameters, moved)
    return integrate(moved, run.start, EULER)


def largest_errors(run: SwerveRun, parameters: Floats) -> Floats:
    """Return (3,) the largest absolute errors of x, y [m] and heading [rad] of a run."""
    return np.asarray(np.abs(seed_path(run, parameters)[1:] - run.truth).max(axis=0))


@compiled
def _interval(angles: Floats, steering: Floats, p: Floats) -> tuple[float, float, float]:
    """Return the body displacement of one interval, from its (4,) angles and steering angles."""
    x = y = turn = 0.0
    for i in range(4):
        a, b = p[i], p[4 + i]
        v = p[8 + i] * angles[i]
        c, s = np.cos(steering[i]), np.sin(steering[i])
        x += 0.25 * v * c
        y += 0.25 * v * s
        turn += v * (a * s - b * c) / (4.0 * (a * a + b * b))
    return x, y, turn


@compiled
def _displacements(angles: Floats, steering: Floats, p: Floats, out: Floats) -> None:
    """Write the body displacements of all intervals into `out` (N, 3)."""
    for k in range(angles.shape[0]):
        out[k, 0], out[k, 1], out[k, 2] = _interval(angles[k], steering[k], p)


@compiled
def _run_cost(angles: Floats, steering: Floats, start: Floats, truth: Floats, p: Floats) -> float:
    """Return the cost of one run."""
    x, y, heading = start[0], start[1], start[2]
    total = 0.0
    for k in range(angles.shape[0]):
        vx, vy, turn = _interval(angles[k], steering[k], p)
        c, s = np.cos(heading), np.sin(heading)
        x += c * vx - s * vy
        y += s * vx + c * vy
        heading += turn
        ex, ey, eh = x - truth[k, 0], y - truth[k, 1], heading - truth[k, 2]
        total += ex * ex + ey * ey + eh * eh
    return total


@compiled
def _run_gradient(
    angles: Floats, steering: Floats, start: Floats, truth: Floats, p: Floats, half: Floats
) -> float:
    """Return the cost of one run; add Jᵀr, half its gradient, to `half` (12,)."""
    x, y, heading = start[0], start[1], start[2]
    d = np.zeros((3, 12))
    by_way = np.zeros((2, 12))
    cos, sin = np.zeros(4), np.zeros(4)
    total = 0.0
    for k in range(angles.shape[0]):
        vx, vy, turn = _interval(angles[k], steering[k], p)
        for i in range(4):
            cos[i], sin[i] = np.cos(steering[k, i]), np.sin(steering[k, i])
            by_way[0, 8 + i] = 0.25 * angles[k, i] * cos[i]
            by_way[1, 8 + i] = 0.25 * angles[k, i] * sin[i]
        c0, s0 = np.cos(heading), np.sin(heading)
        mx, my = c0 * vx - s0 * vy, s0 * vx + c0 * vy
        for j in range(12):
            d[0, j] += -my * d[2, j] + c0 * by_way[0, j] - s0 * by_way[1, j]
            d[1, j] += mx * d[2, j] + s0 * by_way[0, j] + c0 * by_way[1, j]
        # The heading moves on after the position has used the old one.
        for i in range(4):
            a, b, r = p[i], p[4 + i], p[8 + i]
            v = r * angles[k, i]
            n = 4.0 * (a * a + b * b)
            w = (a * sin[i] - b * cos[i]) / n
            d[2, i] += v * (sin[i] - 8.0 * a * w) / n
            d[2, 4 + i] += v * (-cos[i] - 8.0 * b * w) / n
            d[2, 8 + i] += angles[k, i] * w
        x += mx
        y += my
        heading += turn
        e = (x - truth[k, 0], y - truth[k, 1], heading - truth[k, 2])
        for m in range(3):
            total += e[m] * e[m]
            for j in range(12):
                half[j] += d[m, j] * e[m]
    return total
