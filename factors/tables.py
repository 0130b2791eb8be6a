"""Factor tables: every factor of one sensor as arrays, linearised in one compiled loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats, Stamps
from fgloc.errors import FglocError
from fgloc.factors.kernels.camera import camera_odometry
from fgloc.factors.kernels.fix import pose_fix, position_fix
from fgloc.factors.kernels.heading import yaw, yaw_rate, zero_prior, zero_walk
from fgloc.factors.kernels.lidar import landmark_prior, range_bearing, wall
from fgloc.factors.kernels.match import scan_match
from fgloc.factors.kernels.motion import calibration_walk, zero_velocity
from fgloc.factors.kernels.prior import state_prior
from fgloc.factors.kernels.slip import (
    slip_prior,
    slip_side,
    slip_walk,
    wheel_redundancy,
    wheel_slip,
)
from fgloc.factors.kernels.wheel import wheel_odometry
from fgloc.factors.robust import PLAIN, Loss


class Kind(IntEnum):
    """Which kernel a table uses; the number is what the compiled dispatch understands."""

    WHEEL = 0
    YAW = 1
    YAW_RATE = 2
    ZERO_WALK = 3
    ZERO_PRIOR = 4
    CAMERA = 5
    POSITION_FIX = 6
    POSE_FIX = 7
    STATE_PRIOR = 8
    WALL = 9
    RANGE_BEARING = 10
    CALIBRATION_WALK = 11
    ZERO_VELOCITY = 12
    WHEEL_SLIP = 13
    SLIP_PRIOR = 14
    SLIP_WALK = 15
    SLIP_SIDE = 16
    WHEEL_REDUNDANCY = 17
    SCAN_MATCH = 18
    LANDMARK_PRIOR = 19


KERNELS: dict[Kind, Callable[..., None]] = {
    Kind.WHEEL: wheel_odometry,
    Kind.YAW: yaw,
    Kind.YAW_RATE: yaw_rate,
    Kind.ZERO_WALK: zero_walk,
    Kind.ZERO_PRIOR: zero_prior,
    Kind.CAMERA: camera_odometry,
    Kind.POSITION_FIX: position_fix,
    Kind.POSE_FIX: pose_fix,
    Kind.STATE_PRIOR: state_prior,
    Kind.WALL: wall,
    Kind.RANGE_BEARING: range_bearing,
    Kind.CALIBRATION_WALK: calibration_walk,
    Kind.ZERO_VELOCITY: zero_velocity,
    Kind.WHEEL_SLIP: wheel_slip,
    Kind.SLIP_PRIOR: slip_prior,
    Kind.SLIP_WALK: slip_walk,
    Kind.SLIP_SIDE: slip_side,
    Kind.WHEEL_REDUNDANCY: wheel_redundancy,
    Kind.SCAN_MATCH: scan_match,
    Kind.LANDMARK_PRIOR: landmark_prior,
}
"""The kernels by kind, for tests and for single factors; the compiled loop dispatches itself."""

COMPONENTS: dict[Kind, tuple[str, ...]] = {
    Kind.WHEEL: ("forward [m]", "left [m]", "heading [rad]"),
    Kind.YAW: ("heading [rad]",),
    Kind.YAW_RATE: ("turned angle [rad]",),
    Kind.ZERO_WALK: ("change of zero [rad]",),
    Kind.ZERO_PRIOR: ("zero [rad]",),
    Kind.CAMERA: ("forward [m]", "left [m]", "heading [rad]"),
    Kind.POSITION_FIX: ("x [m]", "y [m]"),
    Kind.POSE_FIX: ("x [m]", "y [m]", "heading [rad]"),
    Kind.STATE_PRIOR: ("forward [m]", "left [m]", "heading [rad]"),
    Kind.WALL: ("normal [rad]", "offset [m]"),
    Kind.RANGE_BEARING: ("range [m]", "bearing [rad]"),
    Kind.CALIBRATION_WALK: (),
    Kind.ZERO_VELOCITY: ("forward [m]", "left [m]", "heading [rad]"),
    Kind.WHEEL_SLIP: ("forward [m]", "left [m]", "heading [rad]"),
    Kind.SLIP_PRIOR: ("slip [1]",),
    Kind.SLIP_WALK: ("change of slip [1]",),
    Kind.SLIP_SIDE: ("slip on the unlikely side [1]",),
    Kind.WHEEL_REDUNDANCY: (),
    Kind.SCAN_MATCH: ("forward [m]", "left [m]", "heading [rad]"),
    Kind.LANDMARK_PRIOR: ("x [m]", "y [m]"),
}
"""Leading residual components with units; all of them but for STATE_PRIOR, CALIBRATION_WALK and
WHEEL_REDUNDANCY, whose number depends on the state or the wheels."""

ROW: dict[Kind, int] = {
    Kind.WHEEL: 3,
    Kind.YAW: 2,
    Kind.YAW_RATE: 2,
    Kind.ZERO_WALK: 0,
    Kind.ZERO_PRIOR: 1,
    Kind.CAMERA: 9,
    Kind.POSITION_FIX: 4,
    Kind.POSE_FIX: 6,
    Kind.STATE_PRIOR: 0,
    Kind.WALL: 8,
    Kind.RANGE_BEARING: 5,
    Kind.CALIBRATION_WALK: 0,
    Kind.ZERO_VELOCITY: 0,
    Kind.WHEEL_SLIP: 3,
    Kind.SLIP_PRIOR: 0,
    Kind.SLIP_WALK: 1,
    Kind.SLIP_SIDE: 1,
    Kind.WHEEL_REDUNDANCY: 1,
    Kind.SCAN_MATCH: 6,
    Kind.LANDMARK_PRIOR: 2,
}
"""Fewest numbers in a measurement row; wheels add 3 a calibration variable, priors have 2 (B+G)."""

PAIRWISE = frozenset(
    {
        Kind.WHEEL,
        Kind.YAW_RATE,
        Kind.ZERO_WALK,
        Kind.CAMERA,
        Kind.CALIBRATION_WALK,
        Kind.ZERO_VELOCITY,
        Kind.WHEEL_SLIP,
        Kind.SLIP_WALK,
        Kind.WHEEL_REDUNDANCY,
    }
)
"""Kinds that join state `first` (a keyframe, or a calibration segment) and the one after it."""

LANDMARK = frozenset({Kind.WALL, Kind.RANGE_BEARING, Kind.LANDMARK_PRIOR})
"""Kinds that join keyframe `first` and landmark `second`."""

LINKING = LANDMARK | {Kind.SCAN_MATCH}
"""Kinds that join keyframe `first` and what `second` says: they make more than a chain."""


@dataclass(frozen=True)
class FactorTable:
    """All factors of one type and sensor."""

    kind: Kind
    """Which residual."""
    sensor: str
    """Sensor name for results."""
    first: Stamps
    """(M,) keyframe index of each factor; pairwise kinds join it to the next keyframe."""
    measurements: Floats
    """(M, m) measurement rows as the kernel documents them."""
    sqrt_information: Floats
    """(M, d, d) S with SᵀS = inverse covariance; the whitened residual is S r."""
    calibration: slice
    """Columns of the global calibration vector that the kernel receives; empty slice for none."""
    loss: Loss = PLAIN
    """Robust loss of the whole residual."""
    slot: int = -1
    """State column of the sensor's drifting zero or (first) slip, -1 for none."""
    second: Stamps | None = None
    """(M,) landmark or keyframe index of each factor, for `LINKING` kinds; None for the rest."""

    def __post_init__(self) -> None:
        if self.links != (self.second is not None):
            need = "needs" if self.links else "has no use for"
            raise FglocError(f"{self.sensor}: a {self.kind.name} table {need} second indices")
        # Compiled code does not check bounds: a missing column would be read from elsewhere.
        least = ROW[self.kind]
        if self.kind in (Kind.WHEEL, Kind.WHEEL_SLIP):
            least += 3 * (self.calibration.stop - self.calibration.start)
        elif self.kind == Kind.WHEEL_REDUNDANCY:
            least = 2 + self.dimension
        elif self.kind == Kind.STATE_PRIOR:
            least = 2 * self.dimension
        if self.measurements.shape[1] < least:
            raise FglocError(
                f"{self.sensor}: a {self.kind.name} row needs {least} numbers, "
                f"got {self.measurements.shape[1]}"
            )

    @property
    def sees_landmarks(self) -> bool:
        """Return True if each factor joins keyframe `first` and landmark `second`."""
        return self.kind in LANDMARK

    @property
    def links(self) -> bool:
        """Return True if each factor joins keyframe `first` and what `second` counts."""
        return self.kind in LINKING

    @property
    def pairwise(self) -> bool:
        """Return True if each factor joins keyframe `first` and the next."""
        return self.kind in PAIRWISE

    @property
    def dimension(self) -> int:
        """Return the dimension d of the residual."""
        return int(self.sqrt_information.shape[1])


@dataclass(frozen=True)
class Linearised:
    """Whitened residuals and Jacobians of one table at one state; not yet robustly weighted."""

    residual: Floats
    """(M, d)."""
    by_first: Floats
    """(M, d, B)."""
    by_second: Floats
    """(M, d, B), for landmarks (M, d, 2); zeros and unused for factors of one keyframe."""
    by_calibration: Floats
    """(M, d, G_table)."""

    @property
    def squared(self) -> Floats:
        """Return the (M,) squared norms of the whitened residuals."""
        return np.asarray(np.einsum("md,md->m", self.residual, self.residual))


def linearise(
    table: FactorTable, states: Floats, calibration: Floats, landmarks: Floats | None = None
) -> Linearised:
    """Linearise all factors of a table at (K, B) states and the whole calibration vector. O(M).

    `landmarks` (L, 2) are what the table's `second` counts; raises FglocError if they are missing.
    """
    m, d, b = table.first.size, table.dimension, states.shape[1]
    g = calibration[table.calibration]
    others, second = states, table.first + 1 if table.pairwise else table.first
    if table.second is not None:
        second = table.second
    if table.sees_landmarks:
        if landmarks is None:
            raise FglocError(f"{table.sensor}: this table sees landmarks, but none were given")
        others = np.ascontiguousarray(landmarks)
    out = Linearised(
        np.zeros((m, d)),
        np.zeros((m, d, b)),
        np.zeros((m, d, others.shape[1])),
        np.zeros((m, d, g.size)),
    )
    _linearise(
        int(table.kind),
        table.pairwise or table.links,
        table.first,
        second,
        table.measurements,
        table.sqrt_information,
        table.slot,
        states,
        others,
        np.ascontiguousarray(g),
        out.residual,
        out.by_first,
        out.by_second,
        out.by_calibration,
    )
    return out


def residuals(
    table: FactorTable, states: Floats, calibration: Floats, landmarks: Floats | None = None
) -> Floats:
    """Return the (M, d) residuals in units (not whitened) at a state."""
    # Copies, not a broadcast view: numba would compile the loop again for a read-only array.
    plain = np.tile(np.eye(table.dimension), (table.first.size, 1, 1))
    unwhitened = replace(table, sqrt_information=plain)
    return linearise(unwhitened, states, calibration, landmarks).residual


@compiled
def evaluate_kernel(
    kind: int,
    xi: Floats,
    xj: Floats,
    g: Floats,
    m: Floats,
    slot: int,
    r: Floats,
    ji: Floats,
    jj: Floats,
    jg: Floats,
) -> None:
    """Call the kernel of `kind`; numba cannot cache a loop that takes the kernel as an argument."""
    if kind == 0:
        wheel_odometry(xi, xj, g, m, slot, r, ji, jj, jg)
    elif kind == 1:
        yaw(xi, xj, g, m, slot, r, ji, jj, jg)
    elif kind == 2:
        yaw_rate(xi, xj, g, m, slot, r, ji, jj, jg)
    elif kind == 3:
        zero_walk(xi, xj, g, m, slot, r, ji, jj, jg)
    elif kind == 4:
        zero_prior(xi, xj, g, m, slot, r, ji, jj, jg)
    elif kind == 5:
        camera_odometry(xi, xj, g, m, slot, r, ji, jj, jg)
    elif kind == 6:
        position_fix(xi, xj, g, m, slot, r, ji, jj, jg)
    elif kind == 7:
        pose_fix(xi, xj, g, m, slot, r, ji, jj, jg)
    elif kind == 8:
        state_prior(xi, xj, g, m, slot, r, ji, jj, jg)
    elif kind == 9:
        wall(xi, xj, g, m, slot, r, ji, jj, jg)
    elif kind == 10:
        range_bearing(xi, xj, g, m, slot, r, ji, jj, jg)
    elif kind == 11:
        calibration_walk(xi, xj, g, m, slot, r, ji, jj, jg)
    elif kind == 12:
        zero_velocity(xi, xj, g, m, slot, r, ji, jj, jg)
    elif kind == 13:
        wheel_slip(xi, xj, g, m, slot, r, ji, jj, jg)
    elif kind == 14:
        slip_prior(xi, xj, g, m, slot, r, ji, jj, jg)
    elif kind == 15:
        slip_walk(xi, xj, g, m, slot, r, ji, jj, jg)
    elif kind == 16:
        slip_side(xi, xj, g, m, slot, r, ji, jj, jg)
    elif kind == 17:
        wheel_redundancy(xi, xj, g, m, slot, r, ji, jj, jg)
    elif kind == 18:
        scan_match(xi, xj, g, m, slot, r, ji, jj, jg)
    else:
        landmark_prior(xi, xj, g, m, slot, r, ji, jj, jg)


@compiled
def whiten(s: Floats, values: Floats, scratch: Floats) -> None:
    """Replace `values` (d, n) by s·values, using `scratch` of at least d entries."""
    d = s.shape[0]
    for col in range(values.shape[1]):
        for a in range(d):
            scratch[a] = values[a, col]
        for a in range(d):
            total = 0.0
            for b in range(d):
                total += s[a, b] * scratch[b]
            values[a, col] = total


@compiled
def _linearise(
    kind: int,
    joins: bool,
    first: Stamps,
    second: Stamps,
    measurements: Floats,
    sqrt_information: Floats,
    slot: int,
    states: Floats,
    others: Floats,
    g: Floats,
    residual: Floats,
    by_first: Floats,
    by_second: Floats,
    by_calibration: Floats,
) -> None:
    """Evaluate and whiten every factor of a table into the (zeroed) outputs.

    `others` is where `second` counts: the states again, or the landmarks. `joins` is False for
    factors of one state, whose `by_second` stays zero.
    """
    scratch = np.empty(residual.shape[1])
    for k in range(first.size):
        r = residual[k]
        evaluate_kernel(
            kind,
            states[first[k]],
            others[second[k]],
            g,
            measurements[k],
            slot,
            r,
            by_first[k],
            by_second[k],
            by_calibration[k],
        )
        s = sqrt_information[k]
        whiten(s, r.reshape(r.size, 1), scratch)
        whiten(s, by_first[k], scratch)
        if joins:
            whiten(s, by_second[k], scratch)
        whiten(s, by_calibration[k], scratch)
