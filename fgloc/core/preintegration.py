"""Wheel increments between keyframes: one displacement, its covariance, its Jacobian.

Between two keyframes the body displacements of all encoder intervals are composed on SE(2). The
covariance and the derivative by every calibration parameter are carried along, so that a factor
between two poses costs the same however many encoder packets lie inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.geometry import exp_jacobian_scalar
from fgloc.core.kinematics import WheeledBase
from fgloc.core.kinematics_kernels import body_displacement
from fgloc.core.measurements import Floats, Stamps, WheelIncrements
from fgloc.core.robot import Robot, WheelNoise
from fgloc.errors import FglocError


@dataclass(frozen=True)
class SplitIncrements:
    """Wheel increments cut at the keyframes, ready to be integrated for any calibration."""

    angles: Floats
    """(M, D) wheel rotation of each piece [rad]."""
    steering: Floats
    """(M, D) steering angle during each piece [rad]."""
    seconds: Floats
    """(M,) duration of each piece [s]."""
    bounds: Stamps
    """(K,) index of the first piece after each keyframe; the last entry is M."""
    resolution: float
    """Encoder count [rad], 0 if continuous."""
    share: Floats | None = None
    """(M,) fraction of its encoder interval that each piece is; None if all are whole."""


@dataclass(frozen=True)
class Preintegrated:
    """Displacements between K keyframes at one calibration."""

    displacement: Floats
    """(K-1, 3) pose of keyframe k+1 seen from keyframe k [m, m, rad]."""
    covariance: Floats
    """(K-1, 3, 3) covariance of the displacement in the axes of keyframe k."""
    jacobian: Floats
    """(K-1, 3, P) derivative of the displacement by the physical parameter values."""


def split_at(wheels: WheelIncrements, keyframes_ns: Stamps) -> SplitIncrements:
    """Cut the increments at the keyframe stamps, assuming a constant rate inside an interval.

    Raises FglocError if a keyframe lies outside the recorded wheel data. O(N + K), vectorised.
    """
    stamps = wheels.stamps_ns
    if keyframes_ns[0] < stamps[0] or keyframes_ns[-1] > stamps[-1]:
        raise FglocError(f"{wheels.sensor}: a keyframe lies outside the recorded wheel increments")
    inside = stamps[(stamps >= keyframes_ns[0]) & (stamps <= keyframes_ns[-1])]
    cuts = np.union1d(inside, keyframes_ns)
    interval = np.searchsorted(stamps, cuts[1:], side="left") - 1
    whole = (stamps[1:] - stamps[:-1])[interval]
    fraction = np.diff(cuts) / whole
    steering = np.zeros_like(wheels.angles) if wheels.steering is None else wheels.steering
    return SplitIncrements(
        angles=np.ascontiguousarray(wheels.angles[interval] * fraction[:, None]),
        steering=np.ascontiguousarray(steering[interval]),
        seconds=np.diff(cuts) * 1e-9,
        bounds=np.searchsorted(cuts, keyframes_ns).astype(np.int64),
        resolution=wheels.resolution,
        share=fraction,
    )


def rounding_sigma(robot: Robot, resolution: float) -> Floats:
    """Return (3,) how far rounded counts put the base from where it is: x, y [m], heading [rad].

    Standard deviations in body axes for encoder counts of `resolution` [rad], 0 if continuous, at
    the nominal robot with its wheels straight. A count is off by up to a half at every keyframe
    anew, and what lengthens one increment shortens the next. That is no random walk: chained
    increments stay this close to the base for ever. So it is noise of whatever is measured at a
    keyframe, relative to the pose that the counts tell, and not noise of the increments.
    """
    gain = robot.base.displacements(np.eye(len(robot.base.driven)))
    return np.asarray(np.sqrt(np.sum(gain**2, axis=0) / 12.0) * resolution)


def preintegrate(
    split: SplitIncrements, robot: Robot, values: Floats | None = None
) -> Preintegrated:
    """Integrate the pieces between keyframes at the physical parameter `values` (nominal if None).

    O(M·P) in compiled code. Raises FglocError if the wheels do not determine the motion.
    """
    base: WheeledBase = robot.base
    kinds, rollers = base.codes()
    n, p = split.bounds.size - 1, len(base.parameters)
    out = Preintegrated(np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3, p)))
    ok = _preintegrate(
        split.angles,
        split.steering,
        split.seconds,
        split.bounds,
        base.primitives(values),
        kinds,
        rollers,
        np.array([base.rolling_weight, base.lateral_weight]),
        base.primitive_jacobian(),
        _noise_array(robot.noise),
        out.displacement,
        out.covariance,
        out.jacobian,
    )
    if not ok:
        raise FglocError(f"{base.kind}: these wheels do not determine the motion of the base")
    return out


@compiled
def _preintegrate(
    angles: Floats,
    steering: Floats,
    seconds: Floats,
    bounds: Stamps,
    primitives: Floats,
    kinds: Floats,
    rollers: Floats,
    weights: Floats,
    link: Floats,
    noise: Floats,
    displacement: Floats,
    covariance: Floats,
    jacobian: Floats,
) -> bool:
    """Fill displacement, covariance and jacobian of every keyframe interval."""
    w = kinds.size
    p = link.shape[1]
    rows = np.empty((2 * w, 8))
    gain = np.empty((3, 2 * w))
    by_primitive = np.empty((3, 4 * w))
    xi = np.empty(3)
    q = np.empty((3, 3))
    j = np.empty((3, p))
    moved = np.empty((3, 3))
    arc = np.empty((3, 3))
    for k in range(bounds.size - 1):
        pose, cov, jac = displacement[k], covariance[k], jacobian[k]
        for m in range(bounds[k], bounds[k + 1]):
            n = body_displacement(
                angles[m],
                steering[m],
                primitives,
                kinds,
                rollers,
                weights,
                rows,
                xi,
                gain,
                by_primitive,
                True,
            )
            if n == 0:
                return False
            _increment_covariance(rows, n, gain, xi, primitives, noise, seconds[m], q)
            # The step on the arc: pose' = pose ∘ exp(xi).
            exp_jacobian_scalar(xi, arc)
            sx = arc[0, 0] * xi[0] + arc[0, 1] * xi[1]
            sy = arc[1, 0] * xi[0] + arc[1, 1] * xi[1]
            c, s = np.cos(pose[2]), np.sin(pose[2])
            # e = d pose' / d xi, turned into the keyframe's axes.
            e00, e10 = c * arc[0, 0] - s * arc[1, 0], s * arc[0, 0] + c * arc[1, 0]
            e01, e11 = c * arc[0, 1] - s * arc[1, 1], s * arc[0, 1] + c * arc[1, 1]
            e02, e12 = c * arc[0, 2] - s * arc[1, 2], s * arc[0, 2] + c * arc[1, 2]
            # lever = d pose' / d pose heading.
            lx, ly = -(s * sx + c * sy), c * sx - s * sy
            for col in range(p):
                v0 = v1 = v2 = 0.0
                for i in range(4 * w):
                    if link[i, col] != 0.0:
                        v0 += by_primitive[0, i] * link[i, col]
                        v1 += by_primitive[1, i] * link[i, col]
                        v2 += by_primitive[2, i] * link[i, col]
                j[0, col], j[1, col], j[2, col] = v0, v1, v2
                jac[0, col] += lx * jac[2, col] + e00 * v0 + e01 * v1 + e02 * v2
                jac[1, col] += ly * jac[2, col] + e10 * v0 + e11 * v1 + e12 * v2
                jac[2, col] += v2
            # cov' = A cov Aᵀ + E q Eᵀ with A = [[1,0,lx],[0,1,ly],[0,0,1]].
            for col in range(3):
                cov[0, col] += lx * cov[2, col]
                cov[1, col] += ly * cov[2, col]
            for row in range(3):
                cov[row, 0] += lx * cov[row, 2]
                cov[row, 1] += ly * cov[row, 2]
            for col in range(3):
                moved[0, col] = e00 * q[0, col] + e01 * q[1, col] + e02 * q[2, col]
                moved[1, col] = e10 * q[0, col] + e11 * q[1, col] + e12 * q[2, col]
                moved[2, col] = q[2, col]
            for row in range(3):
                cov[row, 0] += moved[row, 0] * e00 + moved[row, 1] * e01 + moved[row, 2] * e02
                cov[row, 1] += moved[row, 0] * e10 + moved[row, 1] * e11 + moved[row, 2] * e12
                cov[row, 2] += moved[row, 2]
            pose[0] += c * sx - s * sy
            pose[1] += s * sx + c * sy
            pose[2] += xi[2]
    return True


@compiled
def _increment_covariance(
    rows: Floats,
    n: int,
    gain: Floats,
    xi: Floats,
    primitives: Floats,
    noise: Floats,
    seconds: float,
    out: Floats,
) -> None:
    """Write the covariance of one body displacement into `out`.

    Rolling rows: slip over the wheel's own path; lateral rows: side slip over the path of the
    wheel; heading: scrub over the turned angle, veering over the path; a floor over time. All
    variances grow with the path, so that the sampling rate does not matter. The rounding of counts
    does not grow with it and is not here: see `rounding_sigma`.
    """
    path = np.sqrt(xi[0] * xi[0] + xi[1] * xi[1])
    out[:] = 0.0
    for k in range(n):
        i = int(rows[k, 5])
        if rows[k, 6] == 0.0:
            variance = noise[0] * noise[0] * abs(rows[k, 3])
        else:
            arm = np.sqrt(primitives[i, 0] ** 2 + primitives[i, 1] ** 2)
            variance = noise[1] * noise[1] * (path + arm * abs(xi[2]))
        for a in range(3):
            for b in range(3):
                out[a, b] += gain[a, k] * variance * gain[b, k]
    out[0, 0] += noise[3] * noise[3] * seconds
    out[1, 1] += noise[3] * noise[3] * seconds
    out[2, 2] += noise[4] * noise[4] * seconds + noise[2] * noise[2] * abs(xi[2])
    out[2, 2] += noise[5] * noise[5] * path


class Integrator:
    """The same integration one increment at a time, for one open interval."""

    def __init__(self, robot: Robot) -> None:
        base = robot.base
        self._base = base
        self._kinds, self._rollers = base.codes()
        self._weights = np.array([base.rolling_weight, base.lateral_weight])
        self._link = base.primitive_jacobian()
        self._noise = _noise_array(robot.noise)
        self._bounds = np.array([0, 1], dtype=np.int64)
        self._displacement = np.zeros((1, 3))
        self._covariance = np.zeros((1, 3, 3))
        self._jacobian = np.zeros((1, 3, len(base.parameters)))
        self._primitives = base.primitives()

    @property
    def displacement(self) -> Floats:
        """Return the (3,) displacement since the restart, in the axes of its beginning."""
        out: Floats = self._displacement[0]
        return out

    @property
    def covariance(self) -> Floats:
        """Return its (3, 3) covariance in the same axes."""
        out: Floats = self._covariance[0]
        return out

    @property
    def jacobian(self) -> Floats:
        """Return its (3, P) derivative by the physical parameter values."""
        out: Floats = self._jacobian[0]
        return out

    def restart(self, values: Floats) -> None:
        """Begin a new interval at the physical parameter values (P,)."""
        self._primitives = self._base.primitives(values)
        for out in (self._displacement, self._covariance, self._jacobian):
            out[:] = 0.0

    def add(self, angles: Floats, steering: Floats, seconds: float) -> None:
        """Add one increment (D,) of wheel rotation and its steering; see `preintegrate`."""
        ok = _preintegrate(
            angles[None],
            steering[None],
            np.array([seconds]),
            self._bounds,
            self._primitives,
            self._kinds,
            self._rollers,
            self._weights,
            self._link,
            self._noise,
            self._displacement,
            self._covariance,
            self._jacobian,
        )
        if not ok:
            raise FglocError(
                f"{self._base.kind}: these wheels do not determine the motion of the base"
            )


def _noise_array(noise: WheelNoise) -> Floats:
    """Return the noise as the compiled integration takes it."""
    return np.array(
        [
            noise.rolling,
            noise.lateral,
            noise.turning,
            noise.standing,
            noise.standing_turn,
            noise.veering,
        ]
    )
