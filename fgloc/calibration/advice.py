"""Which motion would observe what a calibration did not: tried out, not looked up.

For each simple motion that the base can do, its wheels are integrated with their derivatives, which
tells what a measured pose at its end (or only a heading) would add to what is known. Motions are
taken the simplest first, each together with those that were advised before it; the one after which
a parameter is observed is the advice for it, and where none helps, that is said.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from fgloc.core.kinematics import WheeledBase
from fgloc.core.measurements import Floats
from fgloc.core.preintegration import SplitIncrements, preintegrate
from fgloc.core.robot import Robot
from fgloc.datasets.simulator.course import roll
from fgloc.estimator import CalibrationEstimate

POSITION_SIGMA = 0.01
"""How well a place is measured at the end of a motion [m]."""
HEADING_SIGMA = math.radians(1.0)
"""How well a heading is [rad]."""
REPEATED = 4
"""How often a motion is driven."""
PIECES = 50
"""Intervals of a motion."""
OBSERVED = 0.5
"""A parameter is observed if its sigma is below this part of its prior's."""


@dataclass(frozen=True)
class Motion:
    """Something simple to drive."""

    name: str
    """What it is, behind "drive"."""
    legs: tuple[tuple[float, float, float], ...]
    """Displacements in body axes (x, y [m], turn [rad]) of drives, each measured at its end."""


def motions(base: WheeledBase) -> Iterator[Motion]:
    """Yield the simple motions that a base can do, the simplest first."""
    # A quarter more than whole turns: after a whole one, a mounting is where it was.
    turn = 2.5 * math.pi
    yield Motion("5 m straight", ((5.0, 0.0, 0.0),))
    if base.kind not in ("tricycle", "ackermann"):
        yield Motion("spins in both directions", ((0.0, 0.0, turn), (0.0, 0.0, -turn)))
    circles = ((turn, 0.0, turn), (turn, 0.0, -turn))
    yield Motion("circles of 1 m radius in both directions", circles)
    if base.kind in ("mecanum", "omni-3", "4wis4wid", "full-linear"):
        yield Motion("5 m sideways", ((0.0, 5.0, 0.0),))
        yield Motion(
            "straight lines in several directions",
            ((5.0, 0.0, 0.0), (0.0, 5.0, 0.0), (3.5, 3.5, 0.0)),
        )


def advice(
    robot: Robot, parameters: Sequence[CalibrationEstimate], covariance: Floats, *, places: bool
) -> tuple[str, ...]:
    """Return a sentence for what was not observed: the motion that would tell, or that none would.

    `parameters` and `covariance` (G, G) are what a calibration found, the robot's own first;
    `places`: the reference tells where the robot is, not only its heading. A few integrations.
    """
    base = robot.base
    own = [p.name for p in base.parameters]
    missing = [p for p in parameters if not p.observed and p.prior_sigma > 0.0]
    if not missing:
        return ()
    left = [p for p in missing if places or p.name in own]
    found: dict[str, list[str]] = {}
    information = np.linalg.pinv(covariance)
    for motion in motions(base):
        more = information + _told(robot, parameters, motion, places)
        sigma = np.sqrt(np.diag(np.linalg.pinv(more)))
        gained = [p for p in left if sigma[parameters.index(p)] < OBSERVED * p.prior_sigma]
        if gained:
            found[motion.name] = [p.name for p in gained]
            left = [p for p in left if p not in gained]
            information = more
    told = {name for names in found.values() for name in names}
    rest = [p.name for p in missing if p.name not in told]
    if rest:
        found[""] = rest
    sentences = []
    for driven, names in found.items():
        who = f"{_listed(names)} {'is' if len(names) == 1 else 'are'} not observed"
        if driven:
            sentences.append(f"{who}: drive {driven}.")
        elif places:
            sentences.append(f"{who}, and no simple motion against this reference would tell.")
        else:
            sentences.append(
                f"{who}: this reference tells no distances; add a recorded truth, position fixes "
                "or a camera of known scale, or measure by hand."
            )
    return tuple(sentences)


def _told(
    robot: Robot, parameters: Sequence[CalibrationEstimate], motion: Motion, places: bool
) -> Floats:
    """Return the information (G, G) that a motion adds, driven a few times."""
    weight = np.array([1.0 / POSITION_SIGMA] * 2 + [1.0 / HEADING_SIGMA])
    weight[:2] *= float(places)
    scaled = [weight[:, None] * _derivative(robot, parameters, leg) for leg in motion.legs]
    return np.asarray(REPEATED * sum(j.T @ j for j in scaled))


def _derivative(
    robot: Robot, parameters: Sequence[CalibrationEstimate], leg: tuple[float, float, float]
) -> Floats:
    """Return the (3, G) derivative of the pose at the end of a leg by the parameters."""
    base = robot.base
    steps = np.tile(np.array(leg) / PIECES, (PIECES, 1))
    steered = any(p.family == "steer_offset" for p in base.parameters)
    if any(w.kind == "linear" for w in base.wheels):
        columns = base.displacements(np.eye(len(base.driven))).T
        angles, steering = steps @ np.linalg.pinv(columns).T, None
    else:
        angles, steering = roll(base, base.nominal(), steered, steps)
    split = SplitIncrements(
        np.ascontiguousarray(angles),
        np.zeros_like(angles) if steering is None else np.ascontiguousarray(steering),
        np.full(PIECES, 0.1),
        np.array([0, PIECES], dtype=np.int64),
        0.0,
    )
    found = preintegrate(split, robot)
    names = [p.name for p in base.parameters]
    out = np.zeros((3, len(parameters)))
    x, y, heading = found.displacement[0]
    c, s = math.cos(heading), math.sin(heading)
    for k, p in enumerate(parameters):
        if p.name in names:
            out[:, k] = found.jacobian[0, :, names.index(p.name)]
        # A mounting t, yaw: the reference moves by m⁻¹ ∘ D ∘ m, to first order about none.
        elif p.name.endswith("_x"):
            out[:2, k] = (c - 1.0, s)
        elif p.name.endswith("_y"):
            out[:2, k] = (-s, c - 1.0)
        elif p.name.endswith("_yaw"):
            out[:2, k] = (y, -x)
    return out


def _listed(names: Sequence[str]) -> str:
    """Return names as a list in words."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
