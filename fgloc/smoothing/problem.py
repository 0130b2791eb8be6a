"""The graph of one drive: keyframes, calibration variables, factor tables, first guess."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.geometry import rotate_covariance
from fgloc.core.kinematics import Parameter, prior_covariance
from fgloc.core.measurements import Floats, Stamps
from fgloc.core.preintegration import Preintegrated, SplitIncrements, preintegrate
from fgloc.core.robot import Robot
from fgloc.estimator import SLIPPING
from fgloc.factors.robust import PLAIN, Loss
from fgloc.factors.slip import slip_effect
from fgloc.factors.tables import FactorTable, Kind
from fgloc.smoothing.scene import Scene

FIXES = (Kind.POSITION_FIX, Kind.POSE_FIX)
"""Factors that tell where the robot is in the map."""
HIDDEN = (
    Kind.ZERO_WALK,
    Kind.ZERO_PRIOR,
    Kind.STATE_PRIOR,
    Kind.WHEEL_REDUNDANCY,
    Kind.SLIP_PRIOR,
    Kind.SLIP_SIDE,
    Kind.SLIP_WALK,
    Kind.LANDMARK_PRIOR,
)
"""Tables that are a sensor's model or a prior, not measurements."""
SPINNING = 0.95
"""Slip up to which a displacement is followed exactly: a wheel that spins on the spot tells of
nothing, not even by how little its slip could be less."""


def physical_values(
    robot: Robot, free: Sequence[int], parameters: Sequence[Parameter], u: Floats
) -> Floats:
    """Return a robot's physical parameter values (P,) at solver variables u (G,).

    `free` are the indices of its parameters that are variables, the first of `parameters`.
    """
    values = robot.base.nominal()
    for k, index in enumerate(free):
        values[index] = parameters[k].to_value(float(u[k]))
    return values


@dataclass(frozen=True)
class Problem:
    """The graph of one drive: what the engines linearise and solve."""

    keyframes_ns: Stamps
    """(K,) stamps of the keyframes."""
    robot: Robot
    """Nominal robot."""
    split: SplitIncrements
    """Wheel increments cut at the keyframes."""
    free: tuple[int, ...]
    """Indices of the robot's parameters that are variables (prior sigma above zero)."""
    parameters: tuple[Parameter, ...]
    """All G calibration variables in solver order: the robot's free ones, then sensor blocks."""
    tables: tuple[FactorTable, ...]
    """All factors but the wheels', which depend on where the calibration is linearised."""
    states: Floats
    """(K, B) first guess: x, y, theta and the drifting sensor zeros."""
    counts: dict[str, tuple[int, int]]
    """Per sensor: how many measurements became factors, how many could not (outside, silent)."""
    wheel_loss: Loss
    """Loss of the wheel factors."""
    turn: Floats
    """(K-1,) angles turned between keyframes by yaw sensor or gyro, NaN where unknown."""
    turn_spread: Floats
    """(K-1, 2) how far they may be off: variance [rad²] that adds up, sigma [rad] of one sign."""
    notes: tuple[str, ...] = ()
    """What the user should know of how the graph was built."""
    slip_slot: int = -1
    """First of the state columns of the driven wheels' slips; -1 where none are modelled."""
    landmarks: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    """(L, 2) first guess of the landmarks, as their kernels mean them: points first, then walls."""
    scene: Scene | None = None
    """The lidar's segments, and which walls they are of; None without a lidar."""
    marks: Stamps = field(default_factory=lambda: np.zeros(0, np.int64))
    """(M,) identities of the point landmarks, in the order of `landmarks`."""

    def values(self, u: Floats) -> Floats:
        """Return the robot's physical parameter values at solver variables u (G,)."""
        return physical_values(self.robot, self.free, self.parameters, u)

    @property
    def prior_covariance(self) -> Floats:
        """Return the (G, G) covariance of the calibration prior in solver variables."""
        return prior_covariance(self.parameters)

    def fix_keyframes(self) -> Stamps:
        """Return the sorted keyframe indices that have an absolute fix, the start included."""
        fixes = [t.first for t in self.tables if t.kind in FIXES]
        return np.unique(np.concatenate(fixes)) if fixes else np.zeros(0, np.int64)

    def window(self, begin: int, end: int) -> Problem:
        """Return the problem of keyframes begin ≤ k < end, with the same calibration variables.

        Landmarks, and scans matched far apart, are left out: what is left is a chain.
        """
        tables = []
        for t in self.tables:
            if t.links:
                continue
            last = end - 1 if t.pairwise else end
            k = np.flatnonzero((t.first >= begin) & (t.first < last))
            tables.append(
                replace(
                    t,
                    first=t.first[k] - begin,
                    measurements=t.measurements[k],
                    sqrt_information=t.sqrt_information[k],
                )
            )
        pieces = slice(int(self.split.bounds[begin]), int(self.split.bounds[end - 1]))
        return replace(
            self,
            keyframes_ns=self.keyframes_ns[begin:end],
            split=replace(
                self.split,
                angles=self.split.angles[pieces],
                steering=self.split.steering[pieces],
                seconds=self.split.seconds[pieces],
                bounds=self.split.bounds[begin:end] - pieces.start,
                share=None if self.split.share is None else self.split.share[pieces],
            ),
            tables=tuple(tables),
            states=self.states[begin:end],
            turn=self.turn[begin : end - 1],
            turn_spread=self.turn_spread[begin : end - 1],
            landmarks=np.zeros((0, 2)),
            scene=None,
        )

    def with_state_prior(self, state: Floats, covariance: Floats) -> Problem:
        """Return the problem with a prior on its first keyframe's (B,) state, body axes (B, B)."""
        pose = np.concatenate([state[:3], np.zeros(3)])[None]
        turned = rotate_covariance(covariance[:3, :3], state[2])
        root = np.linalg.inv(np.linalg.cholesky(turned))[None]
        index, empty = np.zeros(1, np.int64), slice(0, 0)
        more = [FactorTable(Kind.POSE_FIX, "start", index, pose, root, empty)]
        for column in range(3, state.size):
            sigma = np.full((1, 1), np.sqrt(covariance[column, column]))
            mean = state[None, column : column + 1]
            more.append(
                FactorTable(
                    Kind.ZERO_PRIOR, "start", index, mean, diagonal(sigma), empty, slot=column
                )
            )
        return replace(self, tables=(*self.tables, *more))

    def slips(self, states: Floats) -> Floats:
        """Return the (K-1, W) slips of the driven wheels in every interval, where modelled."""
        wheels = len(self.robot.base.driven)
        return states[1:, self.slip_slot : self.slip_slot + wheels]

    def displacement(self, u: Floats) -> Floats:
        """Return the wheels' (K-1, 3) displacements at calibration u."""
        return preintegrate(self.split, self.robot, self.values(u)).displacement

    def wheel_table(
        self, u: Floats, whitening: Floats | None = None, states: Floats | None = None
    ) -> FactorTable:
        """Integrate the wheels at the calibration u and return their factor table.

        `whitening` (K-1, 3, 3) keeps the weights of an earlier table, so that costs compare. Where
        slips are modelled, they are those of `states` (K, B), or of the problem's own.
        """
        slips = len(self.robot.base.driven) if self.slip_slot >= 0 else 0
        if not slips:
            pre = preintegrate(self.split, self.robot, self.values(u))
        else:
            at = np.minimum(self.slips(self.states if states is None else states), SPINNING)
            pre, effect = slip_effect(self.split, self.robot, self.values(u), at)
        n, f = pre.displacement.shape[0], len(self.free)
        scale = np.array([self.parameters[k].derivative(float(u[k])) for k in range(f)])
        everything = f == pre.jacobian.shape[2]
        by_value = pre.jacobian if everything else pre.jacobian[:, :, list(self.free)]
        rows = np.empty((n, 3 + 3 * (f + slips)))
        jacobian = rows[:, 3 : 3 + 3 * f].reshape(n, 3, f)  # a view: one axis is cut in two
        np.multiply(by_value, scale, out=jacobian)
        # The kernel predicts D + J u + E s; shift D so that it is exact at the present u and s.
        np.subtract(pre.displacement, jacobian @ u[:f], out=rows[:, :3])
        if slips:
            rows[:, 3 + 3 * f :] = effect.reshape(n, -1)
            rows[:, :3] -= np.einsum("kaw,kw->ka", effect, at)
        return FactorTable(
            Kind.WHEEL_SLIP if slips else Kind.WHEEL,
            "wheels",
            np.arange(n, dtype=np.int64),
            rows,
            self.whitening(pre) if whitening is None else whitening,
            slice(0, f),
            self.wheel_loss,
            self.slip_slot,
        )

    @staticmethod
    def whitening(pre: Preintegrated) -> Floats:
        """Return (K-1, 3, 3) lower triangular square-root information of the displacements.

        Raises LinAlgError where a covariance is not positive definite.
        """
        out = np.zeros_like(pre.covariance)
        if not _inverse_cholesky(pre.covariance, out):
            raise np.linalg.LinAlgError("a wheel displacement's covariance is not positive")
        return out


@compiled
def _inverse_cholesky(covariance: Floats, out: Floats) -> bool:
    """Write L⁻¹ of each P = L Lᵀ (K, 3, 3) into `out` (zeros); False if one is not positive."""
    for k in range(covariance.shape[0]):
        p, w = covariance[k], out[k]
        l00 = np.sqrt(p[0, 0])
        l10, l20 = p[1, 0] / l00, p[2, 0] / l00
        l11 = np.sqrt(p[1, 1] - l10 * l10)
        l21 = (p[2, 1] - l20 * l10) / l11
        l22 = np.sqrt(p[2, 2] - l20 * l20 - l21 * l21)
        if not (l00 > 0.0 and l11 > 0.0 and l22 > 0.0 and l00 + l11 + l22 < np.inf):
            return False
        w[0, 0], w[1, 1], w[2, 2] = 1.0 / l00, 1.0 / l11, 1.0 / l22
        w[1, 0] = -l10 * w[0, 0] * w[1, 1]
        w[2, 1] = -l21 * w[1, 1] * w[2, 2]
        w[2, 0] = -(l20 * w[0, 0] + l21 * w[1, 0]) * w[2, 2]
    return True


def predicting(table: FactorTable, wheels: FactorTable, states: Floats, u: Floats) -> FactorTable:
    """Return a camera's table with what the wheels predict; others as they are.

    `wheels` holds one row a keyframe interval, in order; `states` (K, B) matter for slips only.
    """
    if table.kind != Kind.CAMERA:
        return table
    rows = table.measurements.copy()
    moved = predicted_displacement(wheels, u)
    if wheels.slot >= 0:
        effect = wheels.measurements[:, 3 + 3 * wheels.calibration.stop :].reshape(*moved.shape, -1)
        slips = states[1:, wheels.slot : wheels.slot + effect.shape[2]]
        # Slips that are no more than noise would bring the noise of the poses in.
        clear = np.where(np.abs(slips) > SLIPPING, slips, 0.0)
        moved += np.einsum("kaw,kw->ka", effect, clear)
    rows[:, 6:9] = moved[table.first - wheels.first[0]]
    return replace(table, measurements=rows)


def predicted_displacement(wheels: FactorTable, u: Floats) -> Floats:
    """Return the (M, 3) displacements of a wheel table at calibration u (G,), without slips."""
    f = wheels.calibration.stop
    m = wheels.measurements
    return np.asarray(m[:, :3] + m[:, 3 : 3 + 3 * f].reshape(-1, 3, f) @ u[:f])


def diagonal(sigma: Floats) -> Floats:
    """Return (M, d, d) square-root information of (M, d) independent standard deviations."""
    m, d = sigma.shape
    out = np.zeros((m, d, d))
    out[:, np.arange(d), np.arange(d)] = 1.0 / sigma
    return out


def without_loss(table: FactorTable) -> FactorTable:
    """Return the table with the plain quadratic loss."""
    return replace(table, loss=PLAIN)
