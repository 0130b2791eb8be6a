"""Wheel slip as tables: what it does to the displacement, and what is usual of it.

Most of the time a wheel grips; when it slips, it does so for a while; a driven wheel turns too
fast and a braked one too slowly. So every slip has a prior at none, a walk from interval to
interval, and a pull away from the side that the wheel's acceleration speaks against. Prior and
walk have the Cauchy loss, under which a clear slip costs little more than a small one and may
begin and end at once; the pull has Huber's, as Cauchy's would forget the side of a large slip.
The costs of both are concave in the squared residual, so that every round of reweighted least
squares lowers the cost of a linear problem, whatever the start; one without slip trusts
everything alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fgloc.core.kinematics import RADIUS, STEER, Parameter, Wheel, WheeledBase, X, Y
from fgloc.core.measurements import Floats
from fgloc.core.preintegration import Preintegrated, SplitIncrements, preintegrate
from fgloc.core.robot import Robot
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
    """Acceleration of the vehicle at which that side is fairly certain [m/s²]."""
    resistance: float = 0.3
    """What the motors push against in a steady drive, as an acceleration [m/s²]: rolling
    resistance and scrub of a few percent of the weight."""
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


def slipping(base: WheeledBase) -> WheeledBase:
    """Return the base with parameters `way.<wheel>` behind its own: what each wheel moves it by.

    Their derivatives are those by the slip of one wheel alone, which the base's own parameters
    (a radius a side, say) cannot tell apart; see `slip_effect`.
    """
    primitives = base.primitives()
    parameters, links = list(base.parameters), list(base.links)
    for i in base.driven:
        wheel = base.wheels[i]
        for column in _moving(wheel):
            name = f"way.{wheel.name}.{column}"
            value = float(primitives[i, column])
            parameters.append(
                Parameter(name, value - (wheel.steer if column == STEER else 0.0), 0.0)
            )
            links.append((name, wheel.name, column, 1.0))
    return replace(base, parameters=tuple(parameters), links=tuple(links))


def slip_effect(
    split: SplitIncrements, robot: Robot, values: Floats, slips: Floats
) -> tuple[Preintegrated, Floats]:
    """Integrate wheels that slip by (K-1, W) `slips` at the physical (P,) `values`.

    Returns what `preintegrate` does for the ways over ground and E (K-1, 3, W), the derivative of
    the displacements by the slips of the W driven wheels. To roll (1 - s) of a way is to move the
    base by that much less: E = -p·dD/dp / (1 - s), summed over what a wheel moves the base by (its
    radius; in the full linear model its three coefficients). Slips must be below 1. O(M·(P + W)).
    """
    base = robot.base
    own, at = len(base.parameters), base.primitives(values)
    columns = [(i, column) for i in base.driven for column in _moving(base.wheels[i])]
    moved = [at[i, c] - (base.wheels[i].steer if c == STEER else 0.0) for i, c in columns]
    left = 1.0 - slips
    gripping = replace(split, angles=split.angles * np.repeat(left, np.diff(split.bounds), axis=0))
    wider = replace(robot, base=slipping(base))
    pre = preintegrate(gripping, wider, np.concatenate([values, moved]))
    effect = np.zeros((*pre.displacement.shape, len(base.driven)))
    for k, (i, column) in enumerate(columns):
        effect[:, :, base.driven.index(i)] -= pre.jacobian[:, :, own + k] * at[i, column]
    effect /= left[:, None, :]
    return replace(pre, jacobian=np.ascontiguousarray(pre.jacobian[:, :, :own])), effect


def _moving(wheel: Wheel) -> tuple[int, ...]:
    """Return the columns of a wheel's primitives that are proportional to the way it rolls."""
    return (X, Y, STEER) if wheel.kind == "linear" else (RADIUS,)


def redundant(base: WheeledBase) -> Floats:
    """Return C (n, W): C·ways = 0 for every motion of the base, if no wheel slips.

    The ways [m] are those that the W driven wheels roll; the rows are orthonormal. Empty where
    the wheels tell nothing twice, and for bases that steer, whose conditions change with the
    steering (and whose wheels do not roll exactly where they point).
    """
    driven = [base.wheels[i] for i in base.driven]
    steered = any(column == STEER for _, _, column, _ in base.links)
    if steered or any(w.kind == "linear" for w in driven):
        return np.zeros((0, len(driven)))
    rows = [_row(w, w.steer + (w.roller if w.kind == "roller" else 0.0)) for w in driven]
    rows += [_row(w, w.steer + np.pi / 2) for w in base.wheels if w.kind != "roller"]
    left, _, _ = np.linalg.svd(np.array(rows))
    rank = np.linalg.matrix_rank(np.array(rows))
    # What is left of the conditions where the lateral rows' right sides are zero.
    _, size, conditions = np.linalg.svd(left[: len(driven), rank:].T)
    return np.asarray(conditions[: int(np.sum(size > 1e-9))])


def _row(wheel: Wheel, direction: float) -> tuple[float, float, float]:
    """Return the row of a wheel that looks along `direction` in the body twist."""
    c, s = float(np.cos(direction)), float(np.sin(direction))
    return c, s, wheel.x * s - wheel.y * c


def redundancy_table(
    split: SplitIncrements,
    robot: Robot,
    free: Sequence[int],
    slot: int,
    loss: Loss,
    conditions: Floats | None = None,
) -> FactorTable | None:
    """Return how far the wheels of each interval contradict each other.

    `free` are the indices of the robot's parameters that are calibration variables; the wheels'
    slips are in columns from `slot`. None where there is nothing to contradict. Noise: each
    wheel's own slip and the rounding of its counts. `conditions` are those of `redundant`, for
    callers who ask often.
    """
    base, noise = robot.base, robot.noise
    conditions = redundant(base) if conditions is None else conditions
    n, wheels = conditions.shape
    if n == 0:
        return None
    rolling = np.multiply(*_radii(base))
    ways = np.add.reduceat(split.angles, split.bounds[:-1], axis=0) * rolling
    paths = np.add.reduceat(np.abs(split.angles), split.bounds[:-1], axis=0) * np.abs(rolling)
    seconds = np.add.reduceat(split.seconds, split.bounds[:-1])
    variance = noise.rolling**2 * paths + noise.standing**2 * seconds[:, None]
    variance += (split.resolution * rolling) ** 2 / 6.0
    covariance = np.einsum("aw,kw,bw->kab", conditions, variance, conditions)
    k = ways.shape[0]
    rows = [
        np.broadcast_to(conditions.ravel(), (k, n * wheels)),
        ways,
        np.broadcast_to(_radius_index(base, free), (k, wheels)),
    ]
    return FactorTable(
        Kind.WHEEL_REDUNDANCY,
        "wheels against each other",
        np.arange(k, dtype=np.int64),
        np.ascontiguousarray(np.concatenate(rows, axis=1)),
        np.linalg.inv(np.linalg.cholesky(covariance)),
        slice(0, len(free)),
        loss,
        slot,
    )


def _radius_index(base: WheeledBase, free: Sequence[int]) -> Floats:
    """Return for each driven wheel which of the `free` parameters is its radius, -1 for none."""
    names = [base.parameters[k].name for k in free]
    index = {
        wheel: names.index(name)
        for name, wheel, column, _ in base.links
        if column == RADIUS and name in names
    }
    return np.array([index.get(name, -1) for name in base.driven_names], dtype=np.float64)


def _radii(base: WheeledBase) -> tuple[Floats, Floats]:
    """Return the (W,) radii of the driven wheels [m] and the (W,) part of it that counts."""
    driven = [base.wheels[i] for i in base.driven]
    along = [np.cos(w.roller) if w.kind == "roller" else 1.0 for w in driven]
    return np.array([w.radius for w in driven]), np.array(along)


def likely_side(base: WheeledBase, split: SplitIncrements, model: SlipModel) -> Floats:
    """Return (K-1,) in [-1, 1]: 1 where wheels are driven, so that slip is overspeed, -1 braked.

    The side is tanh((a/clear)³) of the force on the wheels as an acceleration: that of the
    vehicle and the resistance it moves against; the cube, so that the noise of a steady drive
    changes little. What all wheels do alike is the vehicle's acceleration, forwards or backwards:
    the least of theirs where their signs agree, else none, so that a wheel that begins to slip
    does not pass for it.
    """
    radii, along = _radii(base)
    seconds = np.add.reduceat(split.seconds, split.bounds[:-1])
    if seconds.size < 2:
        return np.zeros(seconds.size)
    angles = np.add.reduceat(split.angles, split.bounds[:-1], axis=0)
    speed = np.abs(angles * radii * along) / seconds[:, None]
    middle = np.cumsum(seconds) - seconds / 2
    change = np.stack([np.gradient(column, middle) for column in speed.T], axis=1)
    alike = np.abs(np.sign(change).sum(axis=1)) == change.shape[1]
    own = np.where(alike, np.sign(change[:, 0]) * np.abs(change).min(axis=1), 0.0)
    moving = speed.max(axis=1) > 0.0
    return np.where(moving, np.tanh(((own + model.resistance) / model.clear) ** 3), 0.0)


def slip_tables(
    model: SlipModel, side: Floats, seconds: Floats, slot: int, wheels: int
) -> tuple[FactorTable, ...]:
    """Return prior, side and walk of every wheel's slip, for K keyframes, from column `slot`.

    `side` (K-1,) as `likely_side` gives it and (K-1,) `seconds` belong to the intervals; the
    slips of the first keyframe belong to none and have a prior of one second. Information is by
    the second, not by the interval, so that the keyframes' rate does not matter.
    """
    k = seconds.size + 1
    over = np.sqrt(np.concatenate([[1.0], seconds]))
    prior = _roots(model.usual / over)
    against = _roots(model.usual / model.unlikely / over[1:])
    walk = _roots(model.change * over[1:])
    kept = np.exp(-seconds / model.lasts)[:, None]
    # A slip that lasts costs by its time, not by how often it is looked at.
    lasting = replace(model.loss, k=model.loss.k * float(np.sqrt(np.median(seconds))))
    each, empty = np.arange(k, dtype=np.int64), slice(0, 0)
    likely, unused = np.ascontiguousarray(side[:, None]), np.zeros((k, 1))
    tables = []
    for column in range(slot, slot + wheels):
        tables += [
            FactorTable(Kind.SLIP_PRIOR, "slip", each, unused, prior, empty, lasting, column),
            FactorTable(
                Kind.SLIP_SIDE, "slip", each[1:], likely, against, empty, model.against, column
            ),
            FactorTable(Kind.SLIP_WALK, "slip", each[:-1], kept, walk, empty, model.jumps, column),
        ]
    return tuple(tables)


def _roots(sigma: Floats) -> Floats:
    """Return (M, 1, 1) square roots of information for (M,) standard deviations."""
    return np.ascontiguousarray(1.0 / sigma)[:, None, None]
