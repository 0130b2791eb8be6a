"""One kinematics for every wheeled base: wheels give rows in the body twist, least squares solves.

A wheel at (x, y) with steering angle d sees the contact velocity c = (v_x - y w, v_y + x w).
Along its heading u = (cos d, sin d) and across it n = (-sin d, cos d):

- fixed:   u·c = r·rate (rolling row) and n·c = 0 (no side slip);
- roller:  g·c = r·rate·cos(gamma) with g = (cos(d+gamma), sin(d+gamma)) along the roller's axis,
           so gamma = ±45° is a mecanum wheel and gamma = 0 an omni wheel or a skidding tyre;
- passive: n·c = 0 only, no encoder;
- linear:  no geometry at all: each radian moves the base by (x, y, steer) = (forward, left,
           turn), one column of the full linear model, displacement = J·wheel angles (Okawara et
           al.). Such wheels stand alone, but for passive ones that only carry side slip noise;
- scale:   no wheel, at most one: what all wheels do together differs from what they say by the
           kind of motion. The turn is multiplied by 1 + (x - 1)·s with s = (R w)² / ((R w)² + v²),
           1 in a spin and fading as the path straightens (R = radius), the way to the left by y.

The base's twist is the weighted least-squares solution of all rows. Increments obey the same
equations with angles for rates: what comes out is the body displacement as a twist times time,
exact on an arc of constant twist (see `fgloc.core.geometry.exp`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from fgloc.core.kinematics_kernels import all_displacements
from fgloc.core.measurements import Floats
from fgloc.errors import FglocError

WheelKind = Literal["fixed", "roller", "passive", "linear", "scale"]
KINDS: tuple[WheelKind, ...] = ("fixed", "roller", "passive", "linear", "scale")
FIXED, ROLLER, PASSIVE, LINEAR, SCALE = range(5)
UNDRIVEN = ("passive", "scale")
"""Kinds without an encoder."""
X, Y, STEER, RADIUS = range(4)
"""Columns of a wheel's primitive quantities."""


@dataclass(frozen=True)
class Wheel:
    """One wheel (or, passive, one constraint against side slip) in the base frame."""

    name: str
    """Identity, e.g. "fl"; encoders refer to it."""
    x: float
    """Contact point, forward of the base origin [m]; linear: way forward a radian [m]; scale:
    rotation scale in a spin [1]."""
    y: float
    """Contact point, left of the base origin [m]; linear: way to the left a radian [m]; scale:
    scale of the way to the left [1]."""
    radius: float = 1.0
    """Rolling radius [m]; has no meaning for a passive wheel, linear: only scales the noise; scale:
    path radius [m] at which half of the rotation scale acts."""
    kind: WheelKind = "fixed"
    """fixed: rolls, no side slip; roller: one row along the roller axis; passive: no side slip;
    linear: moves the base in proportion to its angle; scale: how motion scales what they say."""
    steer: float = 0.0
    """Constant heading of the wheel [rad], to which a measured steering angle is added; linear:
    turn of the base a radian of the wheel [1]."""
    roller: float = 0.0
    """Angle from the wheel's heading to its rollers' axis [rad]; roller wheels only."""


@dataclass(frozen=True)
class Parameter:
    """One calibration variable, its nominal value and its prior."""

    name: str
    """Contract name, e.g. "effective_track" or "wheel_radius.left"."""
    nominal: float
    """Nominal value in `unit`."""
    prior_sigma: float
    """Standard deviation of the prior in `unit`; 0 keeps the parameter fixed at nominal."""
    unit: str = "m"
    """Physical unit of nominal and sigma: "m", "rad", "s", or "1"."""
    log: bool = False
    """True: the solver's variable is log(value / nominal); False: (value - nominal) / scale."""
    scale: float = 1.0
    """Unit of the additive solver variable, in `unit`."""
    correlation: float = 0.0
    """Prior correlation with the other parameters of its family, the part of the name before the
    dot: wheels of one make are all worn or all new, so their radii are wrong together. Where
    nominal values differ in sign, so do the errors."""

    @property
    def family(self) -> str:
        """Return the part of the name that like parameters share, e.g. "wheel_radius"."""
        return self.name.partition(".")[0]

    def to_value(self, u: float) -> float:
        """Return the physical value of the solver's variable `u`."""
        return self.nominal * float(np.exp(u)) if self.log else self.nominal + self.scale * u

    def to_solver(self, value: float) -> float:
        """Return the solver's variable of a physical value (inverse of `to_value`)."""
        if self.log:
            return float(np.log(value / self.nominal))
        return (value - self.nominal) / self.scale

    def derivative(self, u: float) -> float:
        """Return d value / d u at `u`; turns solver sigmas into physical ones."""
        return self.to_value(u) if self.log else self.scale

    @property
    def solver_sigma(self) -> float:
        """Return the prior's standard deviation in the solver's variable."""
        return self.prior_sigma / (self.nominal if self.log else self.scale)


def prior_correlation(parameters: Sequence[Parameter]) -> Floats:
    """Return the (P, P) prior correlation matrix of parameters: non-zero within a family only."""
    own = np.array([math.copysign(math.sqrt(p.correlation), p.nominal) for p in parameters])
    family = np.array([p.family for p in parameters], dtype=np.str_)
    matrix = np.outer(own, own) * (family[:, None] == family[None, :])
    np.fill_diagonal(matrix, 1.0)
    return np.asarray(matrix, dtype=np.float64)


def prior_covariance(parameters: Sequence[Parameter]) -> Floats:
    """Return the (P, P) prior covariance of parameters in the solver's variables."""
    sigma = np.array([p.solver_sigma for p in parameters])
    return prior_correlation(parameters) * np.outer(sigma, sigma)


@dataclass(frozen=True)
class WheeledBase:
    """A list of wheels and the calibration parameters that shape it."""

    kind: str
    """Which constructor made it: "differential", "skid-steer", …; shown to the user."""
    wheels: tuple[Wheel, ...]
    """All wheels at nominal values."""
    parameters: tuple[Parameter, ...] = ()
    """Calibration parameters, in solver order."""
    links: tuple[tuple[str, str, int, float], ...] = ()
    """(parameter, wheel, primitive column X/Y/STEER/RADIUS, coefficient):
    primitive = coefficient·value or, for a STEER link, wheel.steer + coefficient·value."""
    rolling_weight: float = 1.0
    """Weight of rolling rows in the least squares."""
    lateral_weight: float = 1.0
    """Weight of no-side-slip rows in the least squares."""

    def __post_init__(self) -> None:
        names = [w.name for w in self.wheels]
        if len(set(names)) != len(names):
            raise FglocError(f"{self.kind}: two wheels have the same name: {names}")
        for w in self.wheels:
            if w.kind not in KINDS:
                raise FglocError(f"wheel {w.name}: kind must be one of {', '.join(KINDS)}")
            if w.kind != "passive" and not w.radius > 0.0:
                raise FglocError(f"wheel {w.name}: radius must be positive, got {w.radius}")
        kinds = {w.kind for w in self.wheels}
        if sum(w.kind == "scale" for w in self.wheels) > 1:
            raise FglocError(f"{self.kind}: there can be one wheel of kind scale")
        if "linear" in kinds and kinds & {"fixed", "roller"}:
            raise FglocError(f"{self.kind}: linear wheels cannot be mixed with others")
        known = {p.name for p in self.parameters}
        for name, wheel, column, _ in self.links:
            if name not in known or wheel not in names:
                raise FglocError(f"link {name} -> {wheel} names an unknown parameter or wheel")
            if column not in (X, Y, STEER, RADIUS):
                raise FglocError(f"link {name} -> {wheel} has no quantity {column}")
        for p in self.parameters:
            if p.log and not p.nominal > 0.0:
                raise FglocError(f"{p.name} must be positive, got {p.nominal}")
            if not p.prior_sigma >= 0.0:
                raise FglocError(f"{p.name}: the prior's sigma must not be negative")

    @property
    def driven(self) -> tuple[int, ...]:
        """Return the indices of the wheels that have an encoder."""
        return tuple(i for i, w in enumerate(self.wheels) if w.kind not in UNDRIVEN)

    @property
    def driven_names(self) -> tuple[str, ...]:
        """Return the names of the wheels that have an encoder, in column order."""
        return tuple(self.wheels[i].name for i in self.driven)

    def nominal(self) -> Floats:
        """Return the (P,) nominal physical parameter values."""
        return np.array([p.nominal for p in self.parameters], dtype=np.float64)

    def primitives(self, values: Floats | None = None) -> Floats:
        """Return the (W, 4) primitive quantities x, y, steer, radius for (P,) parameter values."""
        base = np.array([[w.x, w.y, w.steer, w.radius] for w in self.wheels], dtype=np.float64)
        values = self.nominal() if values is None else values
        index = {p.name: k for k, p in enumerate(self.parameters)}
        wheel = {w.name: i for i, w in enumerate(self.wheels)}
        for name, target, column, coefficient in self.links:
            moved = coefficient * float(values[index[name]])
            i = wheel[target]
            base[i, column] = self.wheels[i].steer + moved if column == STEER else moved
        return base

    def primitive_jacobian(self) -> Floats:
        """Return the constant (4 W, P) derivative of the flattened primitives by the values."""
        jacobian = np.zeros((4 * len(self.wheels), len(self.parameters)))
        index = {p.name: k for k, p in enumerate(self.parameters)}
        wheel = {w.name: i for i, w in enumerate(self.wheels)}
        for name, target, column, coefficient in self.links:
            jacobian[4 * wheel[target] + column, index[name]] = coefficient
        return jacobian

    def codes(self) -> tuple[Floats, Floats]:
        """Return (W,) wheel kinds as FIXED/ROLLER/PASSIVE numbers and (W,) roller angles."""
        kinds = np.array([KINDS.index(w.kind) for w in self.wheels], dtype=np.float64)
        return kinds, np.array([w.roller for w in self.wheels], dtype=np.float64)

    def with_values(self, values: dict[str, float]) -> WheeledBase:
        """Return the base with other NOMINAL values (priors kept, log priors in the same ratio).

        Raises FglocError for a name that is not a parameter of this base.
        """
        names = [p.name for p in self.parameters]
        for name in values:
            if name not in names:
                raise FglocError(f"{self.kind} has no parameter {name}; it has {', '.join(names)}")
        vector = np.array([values.get(p.name, p.nominal) for p in self.parameters])
        moved = self.primitives(vector)
        wheels = tuple(
            replace(w, x=float(q[X]), y=float(q[Y]), radius=float(q[RADIUS]))
            for w, q in zip(self.wheels, moved, strict=True)
        )
        parameters = tuple(
            replace(
                p, nominal=float(v), prior_sigma=p.prior_sigma * (v / p.nominal if p.log else 1)
            )
            for p, v in zip(self.parameters, vector, strict=True)
        )
        return replace(self, wheels=wheels, parameters=parameters)

    def displacements(
        self, angles: Floats, steering: Floats | None = None, values: Floats | None = None
    ) -> Floats:
        """Return (N, 3) body displacements (dx, dy, dtheta as twist times time) of N intervals.

        `angles` (N, D) wheel rotations [rad], `steering` (N, D) mean steering angles [rad],
        `values` (P,) physical parameters (nominal when None). O(N) in compiled code.
        Raises FglocError if the wheels do not determine all three degrees of freedom, or if the
        arrays do not fit them.
        """
        # Compiled code does not check bounds: a missing column would be read from elsewhere.
        driven = len(self.driven)
        if angles.ndim != 2 or angles.shape[1] != driven:
            raise FglocError(
                f"{self.kind}: angles must have shape (N, {driven}), got {angles.shape}"
            )
        steering = np.zeros_like(angles) if steering is None else steering
        if steering.shape != angles.shape:
            raise FglocError(
                f"{self.kind}: steering must have shape {angles.shape}, got {steering.shape}"
            )
        kinds, rollers = self.codes()
        out = np.empty((angles.shape[0], 3))
        weights = np.array([self.rolling_weight, self.lateral_weight])
        ok = all_displacements(
            np.ascontiguousarray(angles),
            np.ascontiguousarray(steering),
            self.primitives(values),
            kinds,
            rollers,
            weights,
            out,
        )
        if not ok:
            raise FglocError(f"{self.kind}: these wheels do not determine the motion of the base")
        return out
