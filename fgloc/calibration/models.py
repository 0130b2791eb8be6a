"""The kinematic models that a robot's drives may choose between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from fgloc.core.bases import full_linear
from fgloc.core.drive import Drive, Reference
from fgloc.core.kinematics import Parameter, WheeledBase
from fgloc.core.motion_models import MODELS
from fgloc.core.robot import Robot
from fgloc.errors import FglocError
from fgloc.smoothing.sensors import KNOWN, mount_parameters

GEOMETRY = "geometry"
"""The base as it is described: radii, track, places of wheels."""
FIXED_STEERING = "fixed-steering"
"""The same without steering offsets."""
FULL_LINEAR = "full-linear"
"""Every wheel moves the base as it likes, in proportion to its angle."""
TITLES = {
    GEOMETRY: "radii and places of the wheels",
    FIXED_STEERING: "radii and places, no steering offsets",
    FULL_LINEAR: "full linear model",
    "rotation-scale": "rotation scale that grows with curvature",
    "lateral-scale": "scale of sideways motion (roller angle)",
    "icr": "centre of rotation along the robot",
}
"""What the parts of a model's id mean."""
MOUNT_SIGMA = (0.02, 0.02, 0.035)
"""Prior sigmas of where a reference's frame is on the robot [m, m, rad] where a recording says that
it is at the origin: a marker body is put there by hand."""


@dataclass(frozen=True)
class Choice:
    """A model by name, and the robot that it makes."""

    id: str
    """Parts joined by "+", e.g. "full-linear+rotation-scale"."""
    robot: Robot
    """The robot with its parameters."""

    @property
    def title(self) -> str:
        """Return what the id means, in words."""
        return ", ".join(TITLES[part] for part in self.id.split("+"))


def choices(robot: Robot) -> list[Choice]:
    """Return all models that make sense for a robot, simple ones first.

    Radii and places; without steering offsets where it has them; the full linear model of bases
    that are linear in their wheels; each with a rotation scale, rollers with a sideways scale,
    skidding tyres with a free centre of rotation.
    """
    base = robot.base
    names = [GEOMETRY]
    if any(p.family == "steer_offset" and p.prior_sigma > 0.0 for p in base.parameters):
        if len(base.driven) > 1:
            names.append(FIXED_STEERING)
    elif base.kind not in ("full-linear", "odometry"):
        names.append(FULL_LINEAR)
    # A single driven wheel has no other that could pivot otherwise.
    turns = len(base.driven) > 1 and not any(p.name == "rotation_scale" for p in base.parameters)
    if turns:
        names += [f"{name}+rotation-scale" for name in tuple(names)]
    if base.kind == "mecanum":
        names += [f"{GEOMETRY}+lateral-scale", f"{GEOMETRY}+lateral-scale+rotation-scale"]
    if base.kind == "skid-steer":
        names += [f"{GEOMETRY}+icr", f"{GEOMETRY}+icr+rotation-scale"]
    found = [choice(robot, name) for name in names]
    return sorted(found, key=lambda c: sum(p.prior_sigma > 0.0 for p in c.robot.base.parameters))


def choice(robot: Robot, name: str) -> Choice:
    """Return one model by its id. Raises FglocError for an unknown one, or one of another base."""
    base = robot.base
    for part in name.split("+"):
        if part == GEOMETRY:
            continue
        if part == FULL_LINEAR:
            base = full_linear(base)
        elif part == FIXED_STEERING:
            base = _without(base, "steer_offset")
        elif part in MODELS:
            base = MODELS[part](base)
        else:
            known = ", ".join(TITLES)
            raise FglocError(f"unknown model {part!r} in {name!r}; join some of {known} by +")
    return Choice(name, replace(robot, base=base))


def mounting(truths: Sequence[Reference]) -> tuple[Parameter, ...]:
    """Return the mounting of a reference as parameters, with the prior that it is recorded with.

    One that is recorded as known exactly is still placed by hand: see `MOUNT_SIGMA`.
    """
    first = truths[0]
    sigmas = first.mount_sigma if any(first.mount_sigma) else MOUNT_SIGMA
    placed = mount_parameters(first.sensor, first.mount, sigmas)
    return tuple(p for p in placed if p.prior_sigma > KNOWN)


def same_robot(drives: Sequence[Drive]) -> tuple[list[Drive], list[str]]:
    """Return the drives with the first one's robot, and a note where others were described so.

    Raises FglocError for drives of different robots: another base, other wheels or parameters.
    """
    first = drives[0].robot
    found, other = [], []
    for drive in drives:
        robot = drive.robot
        if (robot.base.kind, robot.base.driven_names) != (first.base.kind, first.base.driven_names):
            raise FglocError(
                f"{drive.name} is of another robot than {drives[0].name}: {robot.base.kind} with "
                f"wheels {', '.join(robot.base.driven_names)}, not {first.base.kind} with "
                f"{', '.join(first.base.driven_names)}; calibrate one robot at a time"
            )
        if robot.base != first.base:
            other.append(drive.name)
        found.append(replace(drive, robot=first))
    if not other:
        return found, []
    more = f" and {len(other) - 1} more" if len(other) > 1 else ""
    note = (
        f"{other[0]}{more} state other nominal values than {drives[0].name}; those of the latter "
        "are taken for all"
    )
    return found, [note]


def _without(base: WheeledBase, family: str) -> WheeledBase:
    """Return the base with the parameters of a family fixed at their nominal values."""
    if not any(p.family == family for p in base.parameters):
        raise FglocError(f"{base.kind}: has no {family}")
    fixed = tuple(replace(p, prior_sigma=0.0) if p.family == family else p for p in base.parameters)
    return replace(base, parameters=fixed)
