"""Wheel slip as tables: what it does to the displacement, and what is usual of it.

Most of the time a wheel grips; when it slips, it does so for a while; a driven wheel turns too
fast and a braked one too slowly. So every slip has a prior at none, a walk from interval to
interval, and a pull away from the side that the wheel's acceleration speaks against. Prior and
walk have the Cauchy loss, under which a clear slip costs little more than a small one and may
begin and end at once; the pull has Huber's, as Cauchy's would forget the side of a large slip.
The costs of both are concave in the squared residual, so that every round of reweighted least
squares lowers the cost, whatever the start; a start without slip trusts everything alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.core.kinematics import WheeledBase
from fgloc.core.measurements import Floats
from fgloc.errors import FglocError
from fgloc.factors.robust import Loss
from fgloc.factors.tables import FactorTable, Kind

GRIP = Loss("cauchy", 1.0)
"""Usual loss of the prior and the walk."""
PULL = Loss("huber", 0.5)
"""Usual loss of slip on the unlikely side: a hint, as a wheel that regains its grip slows too."""


@dataclass(frozen=True)
class SlipModel:
    """What is usual of the slip of a wheel; slips are fractions of the way it rolls."""

    usual: float = 0.01
    """Standard deviation of the slip of a wheel that grips, over one second [1]."""
    unlikely: float = 2.0
    """How many times less usual slip is on the side that the acceleration speaks against [1]."""
    clear: float = 0.5
    """Acceleration of a wheel at which that side is fairly certain [m/s²]."""
    change: float = 0.02
    """Standard deviation of its change [1/sqrt(s)]."""
    lasts: float = 5.0
    """Time in which slip fades by itself to 1/e [s]."""
    loss: Loss = GRIP
    """Loss of the prior: when a wheel does slip, it may slip much."""
    against: Loss = PULL
    """Loss of slip on the unlikely side."""
    jumps: Loss = GRIP
    """Loss of the walk: slip begins and ends at once."""

    def __post_init__(self) -> None:
        for name in ("usual", "clear", "change", "lasts"):
            if not getattr(self, name) > 0.0:
                raise FglocError(f"slip model: {name} must be positive, got {getattr(self, name)}")
        if not self.unlikely >= 1.0:
            raise FglocError(f"slip model: unlikely must be at least 1, got {self.unlikely}")


@dataclass(frozen=True)
class SlipGroup:
    """A wheel, or the wheels of one side, that slip together: they share a radius."""

    name: str
    """The part of the parameter's name after the dot, e.g. "left"."""
    parameters: tuple[int, ...]
    """Calibration parameters that are proportional to the way these wheels roll."""
    columns: tuple[int, ...]
    """Encoder columns."""


def slip_groups(base: WheeledBase) -> tuple[SlipGroup, ...]:
    """Return the groups of wheels of a base that slip together, in the order of its parameters."""
    driven = {name: column for column, name in enumerate(base.driven_names)}
    parameters: dict[str, list[int]] = {}
    columns: dict[str, list[int]] = {}
    for k, p in enumerate(base.parameters):
        if p.family != "wheel_radius":
            continue
        name = p.name.partition(".")[2]
        parameters.setdefault(name, []).append(k)
        wheels = {wheel for link, wheel, _, _ in base.links if link == p.name}
        columns.setdefault(name, []).extend(driven[w] for w in wheels)
    return tuple(
        SlipGroup(n, tuple(parameters[n]), tuple(sorted(set(columns[n])))) for n in parameters
    )


def slip_effect(base: WheeledBase, jacobian: Floats, values: Floats) -> Floats:
    """Return E (N, 3, S), the derivative of displacements by the slip of every group.

    `jacobian` (N, 3, P) are the derivatives by the physical parameters, (P,) `values` where they
    were taken. To roll (1 - s) of a way is to have radii smaller by that: E = -r·dD/dr.
    """
    scaled = -jacobian * values
    columns = [scaled[:, :, g.parameters].sum(axis=2) for g in slip_groups(base)]
    return np.stack(columns, axis=2) if columns else np.zeros((*jacobian.shape[:2], 0))


def likely_side(base: WheeledBase, angles: Floats, seconds: Floats, clear: float) -> Floats:
    """Return (N, S) in [-1, 1]: 1 where a wheel speeds up, -1 where it is braked, in between else.

    `angles` (N, D) are the wheels' rotations [rad] in intervals of (N,) `seconds`; the side is
    tanh((a/clear)³) of the acceleration a of the wheel's speed, forwards or backwards alike; the
    cube, so that the noise of a steady drive takes no side. `clear` in m/s².
    """
    n, groups = seconds.size, slip_groups(base)
    side = np.zeros((n, len(groups)))
    if n < 2:
        return side
    radii = np.array([base.wheels[i].radius for i in base.driven])
    middle = np.cumsum(seconds) - seconds / 2
    for s, group in enumerate(groups):
        columns = list(group.columns)
        speed = np.abs((angles[:, columns] * radii[columns]).mean(axis=1) / seconds)
        side[:, s] = np.tanh((np.gradient(speed, middle) / clear) ** 3)
    return side


def slip_tables(
    model: SlipModel, side: Floats, seconds: Floats, slot: int
) -> tuple[FactorTable, ...]:
    """Return prior, side and walk of every slip, for K keyframes with slips from column `slot`.

    `side` (K-1, S) as `likely_side` gives it and (K-1,) `seconds` belong to the intervals; the
    slips of the first keyframe belong to none and have a prior of one second. Information is by
    the second, not by the interval, so that the keyframes' rate does not matter.
    """
    k = seconds.size + 1
    over = np.sqrt(np.concatenate([[1.0], seconds]))
    prior = _roots(model.usual / over)
    against = _roots(model.usual / model.unlikely / over[1:])
    walk = _roots(model.change * over[1:])
    kept = np.exp(-seconds / model.lasts)[:, None]
    each, empty = np.arange(k, dtype=np.int64), slice(0, 0)
    tables = []
    for s in range(side.shape[1]):
        column, likely = slot + s, np.ascontiguousarray(side[:, s, None])
        unused = np.zeros((k, 1))
        tables += [
            FactorTable(Kind.SLIP_PRIOR, "slip", each, unused, prior, empty, model.loss, column),
            FactorTable(
                Kind.SLIP_SIDE, "slip", each[1:], likely, against, empty, model.against, column
            ),
            FactorTable(Kind.SLIP_WALK, "slip", each[:-1], kept, walk, empty, model.jumps, column),
        ]
    return tuple(tables)


def _roots(sigma: Floats) -> Floats:
    """Return (M, 1, 1) square roots of information for (M,) standard deviations."""
    return np.ascontiguousarray(1.0 / sigma)[:, None, None]
