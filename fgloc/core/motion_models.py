"""Models beyond a base's geometry: what its motion, its rollers or its tyres do to it.

Each takes a base and returns one with more parameters; which of them a robot needs, its drives
tell (`fgloc.calibration`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fgloc.core.bases import TRACK_PRIOR
from fgloc.core.kinematics import Parameter, Wheel, WheeledBase, X, Y
from fgloc.errors import FglocError

SCALE_WHEEL = "motion"
"""Name of the wheel of kind scale."""
SKID_SPIN_PRIOR = 0.2
"""Prior sigma of a skid-steer's rotation scale: how far the effective track of a spin is from that
of an arc."""
ICR_PRIOR = 0.25
"""Prior sigma of a skid-steer's icr_x, in nominal tracks: weight is seldom in the middle."""


def rotation_scale(base: WheeledBase) -> WheeledBase:
    """Return the base with `rotation_scale` [1]: turns in a spin are as much more than on an arc.

    The turn of an interval is multiplied by 1 + (rotation_scale - 1)·s, where s is 1 in a spin and
    fades to 0 as the path straightens, at one half on a circle as large as the wheels' own around
    the origin: a wheel that pivots on the spot behaves otherwise than one that rolls along.
    Raises FglocError for a base that has a parameter of that name.
    """
    prior = SKID_SPIN_PRIOR if base.kind == "skid-steer" else TRACK_PRIOR
    return _scaled(base, "rotation_scale", X, prior)


def lateral_scale(base: WheeledBase) -> WheeledBase:
    """Return the base with `lateral_scale` [1]: ways to the left are so much more than told.

    For mecanum wheels that is the tangent of the rollers' angle, which wears off 45 degrees.
    Raises FglocError for a base that has a parameter of that name.
    """
    return _scaled(base, "lateral_scale", Y, TRACK_PRIOR)


def free_icr(base: WheeledBase) -> WheeledBase:
    """Return a skid-steer base with `icr_x` free: where along the robot its turns are centred.

    Raises FglocError for a base without that parameter.
    """
    if not any(p.name == "icr_x" for p in base.parameters):
        raise FglocError(f"{base.kind}: has no icr_x")
    track = next(p.nominal for p in base.parameters if p.name == "effective_track")
    return replace(
        base,
        parameters=tuple(
            replace(p, prior_sigma=p.prior_sigma or ICR_PRIOR * track) if p.name == "icr_x" else p
            for p in base.parameters
        ),
    )


MODELS: dict[str, Callable[[WheeledBase], WheeledBase]] = {
    "rotation-scale": rotation_scale,
    "lateral-scale": lateral_scale,
    "icr": free_icr,
}
"""Models by the name that files and reports use."""


def turning_radius(base: WheeledBase) -> float:
    """Return how far the driven wheels are from where the base turns [m], at nominal values.

    The way of the wheels over the turn that they make together, were each to roll against the
    others: half the track of a differential drive. Needs no geometry, so a full linear model has
    it too; wheels that must be steered to turn the base tell it by their places.
    """
    driven = [base.wheels[i] for i in base.driven]
    turn = float(np.sum(np.abs(base.displacements(np.eye(len(driven)))[:, 2])))
    steered = base.kind != "differential" and any(w.kind == "fixed" for w in driven)
    if steered or turn <= 0.0:
        return float(np.mean([math.hypot(w.x, w.y) for w in driven]))
    return float(np.mean([w.radius for w in driven])) / turn


def _scaled(base: WheeledBase, name: str, column: int, prior: float) -> WheeledBase:
    """Return the base with a parameter that is a primitive of its wheel of kind scale."""
    if any(p.name == name for p in base.parameters):
        raise FglocError(f"{base.kind}: already has {name}")
    wheels = base.wheels
    if not any(w.kind == "scale" for w in wheels):
        wheels = (*wheels, Wheel(SCALE_WHEEL, 1.0, 1.0, turning_radius(base), "scale"))
    wheel = next(w.name for w in wheels if w.kind == "scale")
    return replace(
        base,
        wheels=wheels,
        parameters=(*base.parameters, Parameter(name, 1.0, prior, unit="1")),
        links=(*base.links, (name, wheel, column, 1.0)),
    )
