"""Constructors for the common bases; each is a list of wheels and parameters, nothing more."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fgloc.core.kinematics import RADIUS, STEER, Parameter, Wheel, WheeledBase, X, Y
from fgloc.errors import FglocError

Link = tuple[str, str, int, float]

RADIUS_PRIOR = 0.03
"""Relative prior sigma of a wheel radius: tyre wear, load and pressure."""
RADIUS_CORRELATION = 0.9
"""Prior correlation between the radii of one robot: 2.8 % in common, 1 % each for itself."""
TRACK_PRIOR = 0.05
"""Relative prior sigma of a geometric track or base radius: contact width of the tyres."""
SKID_TRACK_PRIOR = 0.35
"""Relative prior sigma of a skid-steer effective track: in practice track < effective < 2·track."""
CROSS_PRIOR = 0.05
"""Prior sigma of how far a wheel moves a base across its way, in the full linear model, by its
own rolling: 3 degrees of toe, or a centre of rotation a twentieth of the track off the axle."""


def _radii(names: Sequence[str], radii: Sequence[float]) -> tuple[list[Parameter], list[Link]]:
    """Return one radius parameter a wheel, each linked to its wheel."""
    parameters = [
        Parameter(
            f"wheel_radius.{n}", r, RADIUS_PRIOR * r, log=True, correlation=RADIUS_CORRELATION
        )
        for n, r in zip(names, radii, strict=True)
    ]
    return parameters, [(f"wheel_radius.{n}", n, RADIUS, 1.0) for n in names]


def differential(
    radius_left: float,
    radius_right: float,
    track: float,
    order: tuple[str, str] = ("left", "right"),
) -> WheeledBase:
    """Return a differential drive: two fixed wheels at (0, ±track/2); radii and track in m.

    `order` gives the encoder columns. Parameters: both radii and `effective_track`.
    """
    wheels = tuple(
        Wheel("left", 0.0, track / 2, radius_left)
        if n == "left"
        else Wheel("right", 0.0, -track / 2, radius_right)
        for n in order
    )
    parameters, links = _radii(("left", "right"), (radius_left, radius_right))
    parameters.append(Parameter("effective_track", track, TRACK_PRIOR * track, log=True))
    links += [("effective_track", "left", Y, 0.5), ("effective_track", "right", Y, -0.5)]
    return WheeledBase("differential", wheels, tuple(parameters), tuple(links))


def skid_steer(
    left: Sequence[str],
    right: Sequence[str],
    radius: float,
    track: float,
    *,
    icr_x: float = 0.0,
    icr_prior: float = 0.0,
    track_prior: float = SKID_TRACK_PRIOR,
    order: Sequence[str] | None = None,
) -> WheeledBase:
    """Return a skid-steer base with one radius a side; `track` is the nominal effective track [m].

    Each encoder gives a rolling row at y = ±track/2 (a tyre that skids sideways is a roller wheel
    with free axis along its heading), plus one lateral row v_y + icr_x·w = 0. Four fixed wheels
    would wrongly force the effective track to L + D²/L. Parameters: `wheel_radius.left/right`,
    `effective_track`, `icr_x` (fixed unless `icr_prior` > 0).
    """
    names = tuple(order) if order is not None else (*left, *right)
    wheels = [
        Wheel(n, 0.0, track / 2 if n in left else -track / 2, radius, "roller") for n in names
    ]
    wheels.append(Wheel("icr", icr_x, 0.0, kind="passive"))
    parameters = [
        *_radii(("left", "right"), (radius, radius))[0],
        Parameter("effective_track", track, track_prior * track, log=True),
        Parameter("icr_x", icr_x, icr_prior, scale=track / 2),
    ]
    links: list[Link] = [("icr_x", "icr", X, 1.0)]
    for n in names:
        side = "left" if n in left else "right"
        links.append((f"wheel_radius.{side}", n, RADIUS, 1.0))
        links.append(("effective_track", n, Y, 0.5 if side == "left" else -0.5))
    return WheeledBase("skid-steer", tuple(wheels), tuple(parameters), tuple(links))


def mecanum(
    radius: float | Sequence[float], half_length: float, half_width: float, order: Sequence[str]
) -> WheeledBase:
    """Return a mecanum base, rollers in the usual X seen from above; names fl fr rl rr in `order`.

    Only half_length + half_width matters to the motion: it is the parameter `base_radius` [m],
    split in the nominal proportion. Parameters: four radii and `base_radius`.
    """
    radii = [radius] * 4 if isinstance(radius, float | int) else list(radius)
    sign = {"fl": (1, 1), "fr": (1, -1), "rl": (-1, 1), "rr": (-1, -1)}
    wheels = []
    links: list[Link] = []
    total = half_length + half_width
    parameters, radius_links = _radii(order, radii)
    for n, r in zip(order, radii, strict=True):
        sx, sy = sign[n]
        # Seen from above, the visible upper rollers form an X; the lower ones, which touch the
        # ground and carry the force, stand at right angles to them.
        wheels.append(
            Wheel(n, sx * half_length, sy * half_width, r, "roller", roller=-sx * sy * math.pi / 4)
        )
        links.append(("base_radius", n, X, sx * half_length / total))
        links.append(("base_radius", n, Y, sy * half_width / total))
    parameters.append(Parameter("base_radius", total, TRACK_PRIOR * total, log=True))
    return WheeledBase("mecanum", tuple(wheels), tuple(parameters), (*radius_links, *links))


def omni3(
    radii: Sequence[float],
    base_radius: float,
    angles: Sequence[float],
    names: Sequence[str] = ("1", "2", "3"),
) -> WheeledBase:
    """Return a three-wheel omni base: wheel i at `angles[i]` on a circle of `base_radius` [m].

    Each wheel's heading is the tangent (counter-clockwise), rollers free along the radius.
    Parameters: three radii and `base_radius`.
    """
    wheels = []
    parameters, links = _radii(names, radii)
    for n, r, a in zip(names, radii, angles, strict=True):
        ux, uy = math.cos(a), math.sin(a)
        wheels.append(
            Wheel(n, base_radius * ux, base_radius * uy, r, "roller", steer=a + math.pi / 2)
        )
        links += [("base_radius", n, X, ux), ("base_radius", n, Y, uy)]
    parameters.append(Parameter("base_radius", base_radius, TRACK_PRIOR * base_radius, log=True))
    return WheeledBase("omni-3", tuple(wheels), tuple(parameters), tuple(links))


def tricycle(
    radius: float, wheelbase: float, *, steer_offset: float = 0.0, name: str = "front"
) -> WheeledBase:
    """Return a tricycle: one steered and driven front wheel, a passive rear axle at the origin.

    Parameters: `wheel_radius.front`, `wheel_x.front` (the wheelbase) and `steer_offset.front`.
    """
    wheels = (Wheel(name, wheelbase, 0.0, radius), Wheel("rear", 0.0, 0.0, kind="passive"))
    parameters, links = _radii((name,), (radius,))
    parameters.append(
        Parameter(f"wheel_x.{name}", wheelbase, TRACK_PRIOR * wheelbase, scale=wheelbase / 2)
    )
    parameters.append(Parameter(f"steer_offset.{name}", steer_offset, 0.03, unit="rad"))
    links += [(f"wheel_x.{name}", name, X, 1.0), (f"steer_offset.{name}", name, STEER, 1.0)]
    return WheeledBase("tricycle", wheels, tuple(parameters), tuple(links))


def four_wheel_steer(
    names: Sequence[str],
    positions: Sequence[tuple[float, float]],
    radii: Sequence[float],
    *,
    position_prior: float = 0.005,
    radius_prior: float = 0.05,
    steer_prior: float = 0.02,
) -> WheeledBase:
    """Return a 4WIS4WID base: every wheel driven and steered, at `positions` (x, y) [m].

    Parameters per wheel: radius, x, y, steering offset, with prior sigmas `radius_prior`
    (relative), `position_prior` [m] and `steer_prior` [rad].
    """
    wheels = []
    parameters: list[Parameter] = []
    links: list[Link] = []
    half = max(abs(y) for _, y in positions)
    for n, (x, y), r in zip(names, positions, radii, strict=True):
        wheels.append(Wheel(n, x, y, r))
        parameters += [
            Parameter(
                f"wheel_radius.{n}",
                r,
                radius_prior * r,
                log=True,
                correlation=RADIUS_CORRELATION,
            ),
            Parameter(f"wheel_x.{n}", x, position_prior, scale=half),
            Parameter(f"wheel_y.{n}", y, position_prior, scale=half),
            Parameter(f"steer_offset.{n}", 0.0, steer_prior, unit="rad"),
        ]
        links += [
            (f"wheel_radius.{n}", n, RADIUS, 1.0),
            (f"wheel_x.{n}", n, X, 1.0),
            (f"wheel_y.{n}", n, Y, 1.0),
            (f"steer_offset.{n}", n, STEER, 1.0),
        ]
    return WheeledBase("4wis4wid", tuple(wheels), tuple(parameters), tuple(links))


def body_odometry() -> WheeledBase:
    """Return the base of a robot that is known only by an odometry of its body.

    Three linear pseudo-wheels carry the measured displacement (dx, dy, dtheta as twist times
    time): a radian of `forward` and of `left` is a metre, one of `turn` a radian. Parameters:
    `odometry_scale` of the way (wheel radii that are wrong) and `rotation_scale` of the turn (radii
    and track), both 1 nominally. Whatever wheels there are can slip sideways.
    """
    along, turn = RADIUS_PRIOR, math.hypot(RADIUS_PRIOR, TRACK_PRIOR)
    return WheeledBase(
        "odometry",
        (
            Wheel("forward", 1.0, 0.0, kind="linear"),
            Wheel("left", 0.0, 1.0, kind="linear"),
            # The turn is all parameter, since that is added to what the wheel itself has.
            Wheel("turn", 0.0, 0.0, kind="linear"),
            Wheel("side", 0.0, 0.0, kind="passive"),
        ),
        (
            Parameter("odometry_scale", 1.0, along, unit="1", log=True),
            Parameter("rotation_scale", 1.0, turn, unit="1", log=True),
        ),
        (
            ("odometry_scale", "forward", X, 1.0),
            ("odometry_scale", "left", Y, 1.0),
            ("rotation_scale", "turn", STEER, 1.0),
        ),
    )


def full_linear(base: WheeledBase, *, turn_prior: float | None = None) -> WheeledBase:
    """Return the full linear model of a base: displacement (dx, dy, dtheta) = J·(wheel angles).

    Every entry of J is a parameter that starts at the base's own kinematics: `linear_x.NAME` and
    `linear_y.NAME` [m/rad], `linear_turn.NAME` [rad/rad] for every wheel, or for the wheels of a
    side together where they share a radius: 6 with two sides, 3N with N omni wheels. Entries
    along the way of a wheel have the prior of a radius, turns the relative sigma `turn_prior`
    (None: that of the base's track), all but for a percent in common. Encoders keep their order.
    Raises FglocError for a steered base, which is not linear in its wheel angles.
    """
    if any(w.kind == "linear" for w in base.wheels):
        return base
    if any(column == STEER for _, _, column, _ in base.links):
        raise FglocError(f"{base.kind}: a steered base has no full linear model")
    driven = [base.wheels[i] for i in base.driven]
    columns = base.displacements(np.eye(len(driven))).T
    shared = {
        wheel: link.partition(".")[2] for link, wheel, column, _ in base.links if column == RADIUS
    }
    names = [shared.get(w.name, w.name) for w in driven]
    relative = SKID_TRACK_PRIOR if base.kind == "skid-steer" else TRACK_PRIOR
    relative = relative if turn_prior is None else turn_prior
    parameters: list[Parameter] = []
    links: list[Link] = []
    for name in dict.fromkeys(names):
        group = [k for k, n in enumerate(names) if n == name]
        radius = driven[group[0]].radius
        along = columns[:, group].sum(axis=1)
        along[np.abs(along) < 1e-12 * radius] = 0.0
        for a, (axis, value) in enumerate(zip(("x", "y", "turn"), along.tolist(), strict=True)):
            leading = axis == "turn" or abs(value) >= 0.1 * math.hypot(along[0], along[1])
            spread = relative if axis == "turn" else RADIUS_PRIOR
            parameters.append(
                Parameter(
                    f"linear_{axis}.{name}",
                    value,
                    spread * abs(value) if leading else CROSS_PRIOR * radius,
                    unit="1" if axis == "turn" else "m",
                    scale=abs(value) if leading and value else radius,
                    correlation=_common(spread) if leading else 0.0,
                )
            )
            column, part = (X, Y, STEER)[a], 1.0 / len(group)
            links += [(f"linear_{axis}.{name}", driven[k].name, column, part) for k in group]
    start = WheeledBase(
        "full-linear",
        tuple(Wheel(w.name, 0.0, 0.0, w.radius, "linear") for w in driven),
        tuple(parameters),
        tuple(links),
    )
    moved = start.with_values({})
    if all(w.kind == "roller" for w in base.wheels):
        return moved
    # What kept the base from slipping sideways still does, with the same noise.
    return replace(moved, wheels=(*moved.wheels, Wheel("side", 0.0, 0.0, kind="passive")))


def _common(spread: float) -> float:
    """Return the correlation of relative errors `spread` that differ by a percent each."""
    own = RADIUS_PRIOR**2 * (1.0 - RADIUS_CORRELATION)
    return max(0.0, 1.0 - own / spread**2) if spread > 0.0 else 0.0
