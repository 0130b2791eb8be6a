"""What a robot that is not quite the nominal one adds to a filter's process noise."""

from __future__ import annotations

import numpy as np

from fgloc.core.kinematics import prior_correlation
from fgloc.core.measurements import Floats
from fgloc.core.robot import Robot


def miscalibration(
    robot: Robot, jacobian: Floats, seconds: Floats, factor: float, horizon_s: float
) -> Floats:
    """Return what wrong radii, track and the like add to the covariance of every step (M, 3, 3).

    `jacobian` (M, 3, P) is that of the steps by the physical parameters, `seconds` (M,) their
    length, `factor` multiplies the priors. J Σ Jᵀ is right for one step, but the next is wrong the
    same way, so that errors and not variances add up: white noise of horizon / duration times as
    much does so over the horizon.
    """
    parameters = robot.base.parameters
    sigma = np.array([p.prior_sigma for p in parameters])
    prior = factor**2 * prior_correlation(parameters) * np.outer(sigma, sigma)
    longer = np.maximum(horizon_s / seconds, 1.0)
    once = np.einsum("mip,pq,mjq->mij", jacobian, prior, jacobian, optimize=True)
    return np.asarray(longer[:, None, None] * once)
