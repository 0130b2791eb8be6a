"""A calibrated robot for every drive, fitted on other drives: open loop, against their truth.

The published calibrations were found on the drives that they are judged by, and the drives behind
Table 67 are not published. Here a robot is fitted on all repetitions of all motions but the one
that the drive itself is of, so that no drive sees its own truth. The fit is that of the
publication, least squares of x, y and heading of the wheels' path against the truth, with all 16
parameters (radii, places and steering offsets of four wheels) held by priors instead of bounds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.geometry import EXACT, integrate, interpolate
from fgloc.core.kinematics import Parameter, prior_covariance
from fgloc.core.measurements import Floats, Stamps
from fgloc.core.robot import Robot
from fgloc.core.start import start_pose, trim_to_truth

POINTS = 20
"""A path is compared with the truth at so many stamps, evenly over its wheel packets."""
SIGMA = 0.05
"""What a path may be off there whatever the parameters [m, rad]: about what is left after the fit.
A smaller one bends steering offsets to 0.1 rad for the sake of the spins, in which wheels behave as
no parameter says."""
ROUNDS = 8
"""Gauss–Newton steps; the paths are close to linear in the parameters."""
STEP = 1e-4
"""Step of the numerical derivative, in the solver's variables."""


@dataclass(frozen=True)
class Calibration:
    """Values found for a robot's parameters."""

    values: Mapping[str, float]
    """By parameter name."""
    sigmas: Mapping[str, float]
    """Their standard deviations, by name; those of the prior where that is smaller."""


def fit(drives: Sequence[Drive]) -> Calibration:
    """Return the robot that drives open loop where the truths of these drives are.

    The drives must be of one robot, with a truth each. Gauss–Newton with numerical derivatives: a
    few hundred path integrations a drive, O(N) each.
    """
    parameters = drives[0].robot.base.parameters
    root = np.linalg.inv(np.linalg.cholesky(prior_covariance(parameters)))
    drives = [trim_to_truth(d) for d in drives]
    starts = [start_pose(d) for d in drives]
    points = [_points(d) for d in drives]

    def residual(u: Floats) -> Floats:
        values = _physical(parameters, u)
        rows = [
            (_path(d, start, values)[at] - truth).ravel() / SIGMA
            for d, start, (at, truth) in zip(drives, starts, points, strict=True)
        ]
        return np.concatenate([*rows, root @ u])

    u = np.zeros(len(parameters))
    for _ in range(ROUNDS):
        r = residual(u)
        moved = [u + STEP * e for e in np.eye(u.size)]
        jacobian = np.stack([(residual(v) - r) / STEP for v in moved], axis=1)
        u = u - np.linalg.lstsq(jacobian, r, rcond=None)[0]
    sigma = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    found = _physical(parameters, u).tolist()
    spread = {
        p.name: min(float(s) * p.derivative(float(v)), p.prior_sigma)
        for p, s, v in zip(parameters, sigma, u, strict=True)
    }
    return Calibration({p.name: v for p, v in zip(parameters, found, strict=True)}, spread)


def apply(robot: Robot, calibration: Calibration) -> Robot:
    """Return the robot with the values as nominal and their sigmas as priors."""
    base = robot.base.with_values(dict(calibration.values))
    parameters = tuple(replace(p, prior_sigma=calibration.sigmas[p.name]) for p in base.parameters)
    return replace(robot, base=replace(base, parameters=parameters))


def _physical(parameters: Sequence[Parameter], u: Floats) -> Floats:
    """Return (P,) physical values of the solver's variables."""
    return np.array([p.to_value(float(v)) for p, v in zip(parameters, u, strict=True)])


def _path(drive: Drive, start: Floats, values: Floats) -> Floats:
    """Return the (N+1, 3) poses that the wheels alone give with these parameter values."""
    wheels = drive.wheels
    moved = drive.robot.base.displacements(wheels.angles, wheels.steering, values)
    return integrate(moved, start, EXACT)


def _points(drive: Drive) -> tuple[Stamps, Floats]:
    """Return which of a drive's wheel stamps are compared, and the truth there."""
    assert drive.truth is not None
    truth = drive.truth.trajectory
    stamps = drive.wheels.stamps_ns
    inside = np.flatnonzero(stamps <= truth.stamps_ns[-1])
    evenly = np.round(np.linspace(0, inside.size - 1, POINTS + 1)).astype(np.int64)[1:]
    at = inside[evenly].astype(np.int64)
    after = np.clip(np.searchsorted(truth.stamps_ns, stamps[at]), 1, len(truth) - 1)
    before, following = truth.stamps_ns[after - 1], truth.stamps_ns[after]
    part = (stamps[at] - before) / (following - before)
    poses = interpolate(truth.poses[after - 1], truth.poses[after], part)
    # Whole turns count: the heading goes on where the truth's does.
    poses[:, 2] = np.interp(stamps[at], truth.stamps_ns, np.unwrap(truth.poses[:, 2]))
    return at, poses
