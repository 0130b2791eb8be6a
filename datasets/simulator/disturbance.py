"""Random slip of a driving base, and the driver who holds the heading against it.

The wheels turn as commanded and are measured as they turn; the base slips a little and moves
otherwise. That is the order in which an estimator reasons (wheels given, motion uncertain). The
other order, noise on the wheels of a base that moves as planned, would bias every estimate of a
track: noise in the regressor makes it look too wide.
"""

from __future__ import annotations

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.kinematics import WheeledBase
from fgloc.core.measurements import Floats
from fgloc.core.robot import WheelNoise
from fgloc.datasets.simulator.course import roll

HOLD_M = 1.0
"""Distance over which the driver takes back a heading error [m]."""
HOLD_RAD = 0.5
"""Turned angle over which the driver takes back a heading error [rad]."""

KNOT_S = 0.1
"""Slip changes linearly between values this far apart [s]: it is white for an encoder, but has
no jumps that a 50 Hz gyro could miss."""


def disturb(
    wanted: Floats,
    base: WheeledBase,
    values: Floats,
    steered: bool,
    noise: WheelNoise,
    step_s: float,
    rng: np.random.Generator,
) -> tuple[Floats, Floats]:
    """Return (commanded, true) displacements (M, 3) for wanted ones.

    Variances grow with distance and turned angle, as `WheelNoise` defines them: each driven wheel
    slips along on its own, wheels with a fixed axle slip sideways, turning scrubs. For steered
    bases the sideways part is simplified: it moves the base origin, without the turning that
    unequal slip of the wheels would add. A base at rest does not move. O(M).
    """
    angles, steering = roll(base, values, steered, wanted)
    # A roller wheel rolls, and slips, along its roller's axis: less than its radius' worth.
    along = [
        np.cos(base.wheels[i].roller) if base.wheels[i].kind == "roller" else 1.0
        for i in base.driven
    ]
    radii = np.array([base.wheels[i].radius for i in base.driven]) * along
    sigma = noise.rolling * np.sqrt(np.abs(angles) * radii) / radii
    slipped = angles + sigma * _noise(angles.shape, step_s, rng)
    slip = base.displacements(slipped, steering, values) - base.displacements(
        angles, steering, values
    )

    drawn = _noise((wanted.shape[0], 3), step_s, rng)
    distance, turn = np.hypot(wanted[:, 0], wanted[:, 1]), np.abs(wanted[:, 2])
    moving = (distance + turn > 0.0) * step_s
    sideways = np.zeros(wanted.shape[0])
    guided = [w for w in base.wheels if w.kind != "roller"]
    if guided:
        # Several wheels share the sideways force; each slips on its own, the base by the mean.
        arm = float(np.mean([np.hypot(w.x, w.y) for w in guided]))
        sideways = noise.lateral**2 * (distance + arm * turn) / len(guided)
    floor = noise.standing**2 * moving
    scrub = noise.turning**2 * turn + noise.standing_turn**2 * moving + noise.veering**2 * distance
    slip += drawn * np.sqrt(np.stack([floor, sideways + floor, scrub], axis=1))

    share = 1.0 - np.exp(-distance / HOLD_M - turn / HOLD_RAD)
    commanded = wanted.copy()
    commanded[:, 2] -= _corrections(slip[:, 2], share)
    return commanded, commanded + slip


def _noise(shape: tuple[int, ...], step_s: float, rng: np.random.Generator) -> Floats:
    """Return (M, D) noise, linear between knots, with unit variance per step over many steps."""
    steps, columns = shape
    at = np.arange(steps) * (step_s / KNOT_S)
    knots = rng.standard_normal((int(np.ceil(steps * step_s / KNOT_S)) + 1, columns))
    # A knot weighs on KNOT_S / step_s steps at once, their sum must keep the variance of all.
    scale = np.sqrt(step_s / KNOT_S)
    where = np.arange(knots.shape[0])
    noise: Floats = scale * np.stack([np.interp(at, where, c) for c in knots.T], axis=1)
    return noise


@compiled
def _corrections(slip: Floats, share: Floats) -> Floats:
    """Return (M,) heading corrections: each step takes back a share of the error so far."""
    out = np.empty(slip.size)
    error = 0.0
    for k in range(slip.size):
        out[k] = share[k] * error
        error += slip[k] - out[k]
    return out
