"""The fit to recorded truth: parameters with which wheels alone drive where the robot drove.

Least squares over all drives at once of open-loop paths against the truth (see
`fgloc.calibration.paths`), with the priors of all parameters. What a drive has for itself (how its
clocks differ) is eliminated drive by drive, so that the cost is linear in the drives.

What is left of a path is neither white nor as small as the truth's noise: it grows along the
drive, and it is alike along it. Its size is estimated together with the parameters, one number
for positions and one for headings; a drive counts as `EFFECTIVE` independent poses, however many
are compared; a drive that the others contradict is weighted down (Huber). Standard deviations are
the larger of two: those of the least squares, and those that the spread between the drives shows
(cluster-robust, one cluster a drive).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fgloc.calibration.paths import Path, PathData, path
from fgloc.core.kinematics import Parameter, prior_covariance
from fgloc.core.measurements import Floats
from fgloc.core.robot import Robot
from fgloc.errors import FglocError

EFFECTIVE = 4.0
"""Independent poses that the points of one path are worth."""
OFFSET_SIGMA_S = 1.0
"""Prior sigma of the offset between the clocks of wheels and reference [s], where it is free."""
RATE_SIGMA = 0.02
"""Prior sigma of the relative rate of the two clocks [1], where it is free."""
HUBER = 1.5
"""A drive whose root mean square normalised residual is larger is weighted down."""
BEGIN = np.array([0.05, 0.05, 0.05])
"""Sizes of what is left of a path, before they are estimated [m, m, rad]."""
ROUNDS = 30
"""Most steps of the least squares."""
DONE = 1e-3
"""Steps smaller than this part of a posterior sigma end the search."""
MIN_CLUSTERS = 4
"""Drives from which on the spread between them tells standard deviations."""


@dataclass(frozen=True)
class Model:
    """What is estimated."""

    robot: Robot
    """The robot with the base that is calibrated, at nominal values."""
    mount: tuple[Parameter, ...] = ()
    """Mounting of the reference: its x, y, yaw; empty where it is known."""
    offset: tuple[Parameter, ...] = ()
    """By how much the reference's stamps are late for all drives, `time_offset`; empty: by none."""
    clock: bool = False
    """Whether offset and rate of the clocks are estimated, drive by drive."""

    @property
    def free(self) -> tuple[int, ...]:
        """Return the indices of the robot's parameters that are estimated."""
        parameters = self.robot.base.parameters
        return tuple(i for i, p in enumerate(parameters) if p.prior_sigma > 0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Return the G shared parameters: the robot's free ones, mounting, time offset."""
        return (*(self.robot.base.parameters[i] for i in self.free), *self.mount, *self.offset)

    def values(self, u: Floats) -> Floats:
        """Return the robot's (P,) physical values at the solver's variables (G,)."""
        values = self.robot.base.nominal()
        for k, i in enumerate(self.free):
            values[i] = self.robot.base.parameters[i].to_value(float(u[k]))
        return values

    def mounting(self, u: Floats, data: PathData) -> Floats:
        """Return the (3,) mounting of a drive's reference at the solver's variables."""
        assert data.drive.truth is not None
        if not self.mount:
            return np.array(data.drive.truth.mount, dtype=np.float64)
        own = u[len(self.free) : len(self.free) + len(self.mount)]
        return np.array([p.to_value(float(v)) for p, v in zip(self.mount, own, strict=True)])

    def time_offset(self, u: Floats) -> float:
        """Return by how much later than the reference's stamps the wheels are looked at [s]."""
        return self.offset[0].to_value(float(u[-1])) if self.offset else 0.0


@dataclass(frozen=True)
class Rows:
    """One drive's residuals and their derivatives at one point, not yet weighted."""

    residual: Floats
    """(M, 3) open-loop error [m, m, rad]."""
    shared: Floats
    """(M, 3, G) derivative by the shared solver variables."""
    local: Floats
    """(M, 3, L) derivative by the drive's own variables, in units of their priors."""


@dataclass(frozen=True)
class PathFit:
    """What was found."""

    model: Model
    """What was estimated."""
    u: Floats
    """(G,) solver variables."""
    covariance: Floats
    """(G, G) their covariance."""
    local: tuple[Floats, ...]
    """A drive's own variables, in units of their priors."""
    local_sigma: tuple[Floats, ...]
    """Their standard deviations in the same units, with the shared variables known."""
    size: Floats
    """(3,) size of what is left of a path: x, y [m], heading [rad]."""
    weights: Floats
    """(D,) weights of the drives."""
    rows: tuple[Rows, ...]
    """Residuals of every drive at the solution."""
    evaluations: int
    """How often all paths were integrated."""
    converged: bool
    """Whether the last step was small enough."""
    information: tuple[Floats, ...]
    """(G, G) information of every drive about the shared variables."""
    gradient: tuple[Floats, ...]
    """(G,) gradient of every drive's cost by them."""


@dataclass(frozen=True)
class _Step:
    """One step, and what it is made of drive by drive."""

    shared: Floats
    """(G,) of the shared variables."""
    local: list[Floats]
    """(L,) of each drive's own."""
    information: list[Floats]
    """(G, G) information of each drive about the shared variables, its own eliminated."""
    gradient: list[Floats]
    """(G,) gradient of each drive's cost by them."""
    own: list[Floats]
    """(L, L) covariance of each drive's own variables, the shared ones known."""
    sigma: Floats
    """(G,) standard deviations of the shared variables by least squares."""


def rows_of(data: PathData, model: Model, u: Floats, local: Floats) -> Rows:
    """Return residuals and derivatives of one drive; see `Rows`. Raises FglocError as `path`."""
    clock = None
    if model.clock or model.offset:
        own = (local[0] * OFFSET_SIGMA_S, local[1] * RATE_SIGMA) if model.clock else (0.0, 0.0)
        clock = (own[0] + model.time_offset(u), own[1])
    found = path(data, model.robot, model.values(u), model.mounting(u, data), clock)
    return Rows(found.residual, _by_shared(found, model, u), _by_local(found, data, model))


def _by_shared(found: Path, model: Model, u: Floats) -> Floats:
    """Return the (M, 3, G) derivative by the shared solver variables."""
    columns = np.concatenate(
        [
            found.by_values[:, :, list(model.free)],
            found.by_mount[:, :, : len(model.mount)],
            found.by_time[:, :, None][:, :, : len(model.offset)],
        ],
        axis=2,
    )
    scale = [p.derivative(float(v)) for p, v in zip(model.parameters, u, strict=True)]
    return np.asarray(columns * np.array(scale))


def _by_local(found: Path, data: PathData, model: Model) -> Floats:
    """Return the (M, 3, L) derivative by the drive's own variables."""
    by_time = found.by_time[:, :, None]
    if not model.clock:
        return by_time[:, :, :0]
    late = data.seconds[:, None, None] * (RATE_SIGMA * by_time)
    return np.concatenate([by_time * OFFSET_SIGMA_S, late], axis=2)


def fit_paths(
    data: Sequence[PathData],
    model: Model,
    begin: Floats | None = None,
    most: int = ROUNDS,
    done: float = DONE,
) -> PathFit:
    """Return the parameters that fit all drives best; `begin` (G,) is where the search starts.

    It ends after `most` steps, or one of less than `done` posterior sigmas. Levenberg–Marquardt;
    sizes and weights are estimated anew after every step. O(N·P) an evaluation in compiled code,
    three to ten of them. Raises FglocError where the wheels do not determine the motion or
    nothing finite comes out.
    """
    prior = np.asarray(np.linalg.inv(prior_covariance(model.parameters)), dtype=np.float64)
    u = np.zeros(len(model.parameters)) if begin is None else begin.copy()
    local = [np.zeros(2 * model.clock) for _ in data]
    size, weights = BEGIN.copy(), np.ones(len(data))
    rows = [rows_of(d, model, u, v) for d, v in zip(data, local, strict=True)]
    damping, evaluations, converged = 0.0, 1, False
    for round_ in range(most):
        if round_ or begin is not None:
            size, weights = sizes(data, rows, weights)
        cost = _cost(rows, u, local, size, weights, prior)
        if not np.isfinite(cost):
            raise FglocError(
                "the wheels' paths cannot be computed with these values; check the robot's "
                "dimensions, or give better ones with --robot"
            )
        while True:
            found = _step(rows, u, local, size, weights, prior, damping)
            step = found.shared
            trial_u = u + step
            trial_local = [v + s for v, s in zip(local, found.local, strict=True)]
            trial = [rows_of(d, model, trial_u, v) for d, v in zip(data, trial_local, strict=True)]
            evaluations += 1
            after = _cost(trial, trial_u, trial_local, size, weights, prior)
            if after <= cost * (1.0 + 1e-12):
                break
            if damping > 1e6:
                # No way down: at the minimum, as well as rounding and clipped clocks let it be.
                trial_u, trial_local, trial, step = u, local, rows, np.zeros_like(u)
                break
            damping = max(10.0 * damping, 1e-3)
        u, local, rows = trial_u, trial_local, trial
        damping *= 0.1 if damping > 1e-6 else 0.0
        if round_ and np.max(np.abs(step) / found.sigma, initial=0.0) < done:
            converged = True
            break
    size, weights = sizes(data, rows, weights)
    last = _step(rows, u, local, size, weights, prior, 0.0)
    inverse = np.asarray(np.linalg.inv(prior + np.sum(last.information, axis=0)), dtype=np.float64)
    return PathFit(
        model,
        u,
        _covariance(inverse, prior, last.gradient),
        tuple(local),
        tuple(np.sqrt(np.diag(own)) for own in last.own),
        size,
        weights,
        tuple(rows),
        evaluations,
        converged,
        tuple(last.information),
        tuple(last.gradient),
    )


def sizes(data: Sequence[PathData], rows: Sequence[Rows], weights: Floats) -> tuple[Floats, Floats]:
    """Return the (3,) size of what is left of the paths, and the (D,) weights of the drives."""
    squares = np.array([np.mean(r.residual**2, axis=0) for r in rows])
    floor = np.max([np.array(d.drive.truth.sigma) for d in data if d.drive.truth], axis=0)
    for _ in range(10):
        mean = weights @ squares / np.sum(weights)
        position = 0.5 * (mean[0] + mean[1])
        size = np.maximum(np.sqrt(np.array([position, position, mean[2]])), floor)
        normalised = np.sqrt(np.mean(squares / size**2, axis=1))
        if len(rows) < MIN_CLUSTERS:
            break
        weights = np.minimum(1.0, HUBER / np.maximum(normalised, 1e-12))
    return size, weights


def _scale(size: Floats, weight: float, points: int) -> Floats:
    """Return (3,) factors that weight residuals of one drive."""
    return np.asarray(np.sqrt(weight * EFFECTIVE / points) / size)


def _cost(
    rows: Sequence[Rows],
    u: Floats,
    local: Sequence[Floats],
    size: Floats,
    weights: Floats,
    prior: Floats,
) -> float:
    """Return twice the negative logarithm of the posterior density, up to a constant."""
    total = float(u @ prior @ u)
    for r, v, w in zip(rows, local, weights, strict=True):
        total += float(np.sum((r.residual * _scale(size, w, len(r.residual))) ** 2) + v @ v)
    return total


def _step(
    rows: Sequence[Rows],
    u: Floats,
    local: Sequence[Floats],
    size: Floats,
    weights: Floats,
    prior: Floats,
    damping: float,
) -> _Step:
    """Return the Gauss–Newton step, damped, from a linearisation."""
    information, gradient, kept = [], [], []
    for r, v, w in zip(rows, local, weights, strict=True):
        scale = _scale(size, w, len(r.residual))
        e = (r.residual * scale).ravel()
        j = (r.shared * scale[:, None]).reshape(e.size, -1)
        k = (r.local * scale[:, None]).reshape(e.size, -1)
        own = np.asarray(np.linalg.inv(k.T @ k + np.eye(v.size)), dtype=np.float64)
        cross, right = j.T @ k, k.T @ e + v
        information.append(j.T @ j - cross @ own @ cross.T)
        gradient.append(j.T @ e - cross @ own @ right)
        kept.append((own, cross, right))
    h = prior + np.sum(information, axis=0)
    sigma = np.asarray(np.sqrt(np.diag(np.linalg.inv(h))), dtype=np.float64)
    h = h + damping * np.diag(np.diag(h))
    step = np.asarray(-np.linalg.solve(h, prior @ u + np.sum(gradient, axis=0)), dtype=np.float64)
    steps = [-own @ (right + cross.T @ step) for own, cross, right in kept]
    return _Step(step, steps, information, gradient, [own for own, _, _ in kept], sigma)


def _covariance(inverse: Floats, prior: Floats, gradient: Sequence[Floats]) -> Floats:
    """Return the covariance of the shared variables, by least squares or between drives.

    Between drives: H⁻¹ (P + Σ g gᵀ·D/(D-1)) H⁻¹ with each drive's gradient g; the larger sigma
    counts for each variable, with the correlations of the least squares.
    """
    if len(gradient) < MIN_CLUSTERS:
        return inverse
    g = np.array(gradient)
    meat = prior + g.T @ g * (len(g) / (len(g) - 1.0))
    robust = np.sqrt(np.diag(inverse @ meat @ inverse) / np.diag(inverse))
    # Whatever the drives say, a value is known as well as it was before.
    most = np.sqrt(np.diag(np.linalg.inv(prior)) / np.diag(inverse))
    grow = np.clip(robust, 1.0, np.maximum(most, 1.0))
    return np.asarray(inverse * np.outer(grow, grow))
