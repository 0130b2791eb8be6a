"""Where the search begins: the full linear model by linear least squares, in closed form.

Over short intervals the displacement of a base is linear in its wheel angles, D = A Jᵀ. With the
displacements of a recorded truth, J is one linear least squares problem; the parameters of a
geometry that come closest to J are then a small one. It needs no nominal values worth the name: a
wheel that counts backwards or a radius that is off by a factor of two is found here. Directions in
which the wheels never moved against each other (four wheels move a base in three ways) keep their
nominal values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fgloc.calibration.path_fit import Model
from fgloc.calibration.paths import PathData
from fgloc.core.evaluation import interpolate_trajectory
from fgloc.core.geometry import between, log
from fgloc.core.kinematics import STEER, WheeledBase, prior_covariance
from fgloc.core.measurements import Floats
from fgloc.errors import FglocError

INTERVAL_S = 1.0
"""Length of an interval [s]: long enough for the truth's noise, short enough to be one arc."""
STEPS = 8
"""Steps from J to the parameters of a geometry."""
ILL = 100.0
"""Directions of the wheel angles that are so much weaker than the strongest are not told apart."""
WAYS = 3
"""In so many ways a base moves in the plane."""
UNLIKE = 0.5
"""A column of J that differs by more than this part from nominal is worth a note."""


@dataclass(frozen=True)
class Intervals:
    """What wheels turned and how the base moved over short times."""

    angles: Floats
    """(N, W) rotation of the driven wheels [rad]."""
    moved: Floats
    """(N, 3) displacement of the base, twist times time [m, m, rad]."""


@dataclass(frozen=True)
class ClosedForm:
    """What linear least squares found."""

    jacobian: Floats
    """(3, W) displacement of the base a radian of each driven wheel: x, y [m], turn [rad]."""
    condition: float
    """Condition number of the wheel angles, columns scaled to one, without the directions in which
    a base with more than three wheels cannot move."""
    u: Floats
    """(G,) solver variables of the model that come closest, zeros for the mounting."""
    notes: tuple[str, ...]
    """What a user should know, a sentence each."""


def closed_form(seen: Intervals, model: Model) -> ClosedForm | None:
    """Return the closed form of a model, None for a steered base, which is not linear.

    `seen` is that of `intervals`, the same for every model of a robot. The mounting of the
    reference is taken as nominal. O(N). Raises FglocError where no interval has a displacement.
    """
    base = model.robot.base
    if any(column == STEER for _, _, column, _ in base.links) and base.kind not in (
        "full-linear",
        "odometry",
    ):
        return None
    angles, moved = seen.angles, seen.moved
    if angles.shape[0] <= angles.shape[1]:
        return None
    norms = np.linalg.norm(angles, axis=0)
    if not np.all(norms > 0.0):
        still = [n for n, v in zip(base.driven_names, norms, strict=True) if not v > 0.0]
        raise FglocError(f"wheel {', '.join(still)} never turns in these drives; check the encoder")
    nominal = base.displacements(np.eye(len(base.driven))).T
    left, size, right = np.linalg.svd(angles / norms, full_matrices=False)
    told = size > size[0] / ILL
    more = right[told].T @ ((left[:, told].T @ (moved - angles @ nominal.T)) / size[told, None])
    jacobian = nominal + (more / norms[:, None]).T
    expected = min(WAYS, size.size)
    condition = float(size[0] / max(size[expected - 1], 1e-300))
    notes = _unlike(base, nominal, jacobian)
    if condition > ILL:
        notes.append(
            f"the wheels hardly moved against each other (condition number {condition:.0f}): what "
            "each of them does cannot be told apart; drive turns of both directions too"
        )
    u = _closest(model, jacobian, angles.T @ angles)
    return ClosedForm(jacobian, condition, u, tuple(notes))


def intervals(data: Sequence[PathData]) -> Intervals:
    """Return what was seen over short times on all drives. O(N)."""
    angles, moved = [], []
    for d in data:
        wheels = d.drive.wheels
        assert d.drive.truth is not None
        stamps = wheels.stamps_ns
        grid = np.arange(stamps[0], stamps[-1], round(INTERVAL_S * 1e9))
        index = np.unique(np.searchsorted(stamps, grid))
        total = np.concatenate([np.zeros((1, wheels.angles.shape[1])), np.cumsum(wheels.angles, 0)])
        poses, known = interpolate_trajectory(d.drive.truth.trajectory, stamps[index])
        both = known[1:] & known[:-1]
        step = log(between(poses[:-1], poses[1:])[both])
        turned = np.diff(total[index], axis=0)[both]
        # Half a turn and more between two poses cannot be told from less the other way round.
        clear = np.abs(step[:, 2]) < 0.5 * np.pi
        angles.append(turned[clear])
        moved.append(step[clear])
    return Intervals(np.concatenate(angles), np.concatenate(moved))


def _closest(model: Model, jacobian: Floats, information: Floats) -> Floats:
    """Return the solver variables with which the base moves most like J, weighted by the drives."""
    base, count = model.robot.base, len(model.free)
    root = np.linalg.cholesky(information + 1e-9 * np.trace(information) * np.eye(len(information)))
    prior = np.linalg.inv(prior_covariance(model.parameters))[:count, :count]
    # The prior only decides what the drives leave open.
    weak = 1e-6 * np.linalg.cholesky(prior).T
    eye, u = np.eye(len(base.driven)), np.zeros(len(model.parameters))

    def rows(v: Floats) -> Floats:
        turned = base.displacements(eye, values=model.values(v)).T - jacobian
        return np.concatenate([(turned @ root).ravel(), weak @ v[:count]])

    for _ in range(STEPS):
        r = rows(u)
        moves = [u + 1e-6 * e for e in np.eye(u.size)[:count]]
        j = np.stack([(rows(v) - r) / 1e-6 for v in moves], axis=1)
        u = u.copy()
        u[:count] -= np.clip(np.linalg.lstsq(j, r, rcond=None)[0], -0.7, 0.7)
    return u


def _unlike(base: WheeledBase, nominal: Floats, found: Floats) -> list[str]:
    """Return a sentence for every wheel that moves the base otherwise than described."""
    notes = []
    for k, name in enumerate(base.driven_names):
        size = float(nominal[:, k] @ nominal[:, k])
        along = float(nominal[:, k] @ found[:, k]) / size if size > 0.0 else 1.0
        if along < -UNLIKE:
            notes.append(f"wheel {name} seems to count backwards: check the sign of its encoder")
        elif not 1.0 - UNLIKE <= along <= 1.0 + 2.0 * UNLIKE:
            notes.append(
                f"wheel {name} moves the robot {along:.2f} times as much as described: check its "
                "radius, gear and counts per revolution"
            )
    return notes
