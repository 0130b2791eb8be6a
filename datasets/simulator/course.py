"""The true course of a simulated drive, and how the wheels must turn to follow it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.core import geometry
from fgloc.core.kinematics import RADIUS, STEER, WheeledBase, X, Y
from fgloc.core.measurements import Floats, Stamps

STILL = 1e-6
"""Contact speed [m per step] below which a steered wheel has no direction of its own."""


@dataclass(frozen=True)
class Course:
    """A true motion as constant twists over equal steps, so that poses are exact at any time."""

    step_ns: int
    """Length of a step [ns]."""
    displacements: Floats
    """(M, 3) body displacement of every step: twist times time [m, m, rad]."""
    poses: Floats
    """(M+1, 3) poses at the step boundaries in the map frame; the heading is not wrapped."""

    @classmethod
    def follow(cls, displacements: Floats, step_ns: int, start: Floats | None = None) -> Course:
        """Return the course that takes these (M, 3) steps from a pose (3,), the origin. O(M)."""
        first = np.zeros(3) if start is None else start
        poses = geometry.integrate(displacements, first, geometry.EXACT)
        return cls(step_ns, displacements, poses)

    @property
    def duration_ns(self) -> int:
        """Return the length of the course [ns]."""
        return self.step_ns * int(self.displacements.shape[0])

    @property
    def boundaries_ns(self) -> Stamps:
        """Return the (M+1,) step boundaries [ns]."""
        return np.arange(self.displacements.shape[0] + 1, dtype=np.int64) * self.step_ns

    def _locate(self, stamps_ns: Stamps) -> tuple[Stamps, Floats]:
        """Return the step each stamp lies in and the fraction of the step that has passed."""
        step = np.minimum(stamps_ns // self.step_ns, self.displacements.shape[0] - 1)
        return step, (stamps_ns - step * self.step_ns) / self.step_ns

    def poses_at(self, stamps_ns: Stamps) -> Floats:
        """Return the (N, 3) true poses at any stamps within the course, exact within a step."""
        step, fraction = self._locate(stamps_ns)
        moved = geometry.exp(self.displacements[step] * fraction[:, None])
        return geometry.compose(self.poses[step], moved)

    def twists_at(self, stamps_ns: Stamps) -> Floats:
        """Return the (N, 3) body twists [m/s, m/s, rad/s] of the steps that hold the stamps."""
        step, _ = self._locate(stamps_ns)
        return self.displacements[step] / (self.step_ns * 1e-9)

    def stamps(self, rate: float) -> Stamps:
        """Return the stamps [ns] of a sensor with this rate [Hz], from 0 to the end."""
        count = int(np.floor(self.duration_ns * 1e-9 * rate + 1e-6)) + 1
        stamps = np.round(np.arange(count) * (1e9 / rate)).astype(np.int64)
        return stamps[stamps <= self.duration_ns]


def _directions(displacements: Floats, x: float, y: float, mount: float) -> Floats:
    """Return the (M,) heading [rad] of a steered wheel at (x, y) for body displacements (M, 3).

    Headings are continuous modulo π (a wheel may roll backwards instead of turning round); where
    the contact point does not move, the wheel turns evenly from its last heading to its next.
    `mount` is the heading of a wheel that never moves.
    """
    cx = displacements[:, 0] - y * displacements[:, 2]
    cy = displacements[:, 1] + x * displacements[:, 2]
    moving = np.flatnonzero(np.hypot(cx, cy) > STILL)
    if moving.size == 0:
        return np.full(displacements.shape[0], mount)
    headings = np.unwrap(np.arctan2(cy[moving], cx[moving]), period=np.pi)
    return np.interp(np.arange(displacements.shape[0]), moving, headings)


def roll(
    base: WheeledBase, values: Floats, steered: bool, displacements: Floats
) -> tuple[Floats, Floats | None]:
    """Return wheel angles (M, D) and measured steering angles (M, D) or None: inverse kinematics.

    The contact velocity of each driven wheel is projected on the wheel's heading (fixed) or its
    roller axis (roller) and divided by the radius. `values` are the TRUE parameters. Steered
    wheels point along their contact velocity; what is measured as steering lacks the true offset.
    """
    primitives = base.primitives(values)
    steps = displacements.shape[0]
    angles = np.empty((steps, len(base.driven)))
    steering = np.zeros((steps, len(base.driven)))
    for column, i in enumerate(base.driven):
        wheel = base.wheels[i]
        x, y, mount, radius = (float(primitives[i, c]) for c in (X, Y, STEER, RADIUS))
        heading = np.full(steps, mount)
        if steered:
            heading = _directions(displacements, x, y, mount)
            steering[:, column] = heading - mount
        along = heading + (wheel.roller if wheel.kind == "roller" else 0.0)
        cx = displacements[:, 0] - y * displacements[:, 2]
        cy = displacements[:, 1] + x * displacements[:, 2]
        free = np.cos(wheel.roller) if wheel.kind == "roller" else 1.0
        angles[:, column] = (np.cos(along) * cx + np.sin(along) * cy) / (radius * free)
    return angles, steering if steered else None
