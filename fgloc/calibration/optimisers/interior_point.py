"""The interior point method (scipy's trust-constr), as the publication's fmincon is one."""

from __future__ import annotations

import time
import warnings

import numpy as np

from fgloc.calibration.optimisers.outcome import Outcome
from fgloc.calibration.optimisers.swerve_problem import SwerveProblem
from fgloc.core.measurements import Floats

STEPS = 1000
"""Most steps."""
TOLERANCE = 1e-11
"""Tolerance of gradient and barrier: variables are ±1 at the bounds, J is 1 at nominal."""


def interior_point(problem: SwerveProblem) -> Outcome:
    """Return the optimum in the bounds, from the nominal parameters; deterministic.

    With exact gradients and BFGS for the second derivatives: with those themselves, which are not
    positive everywhere, its trust region shrinks and it takes ten times as long.
    """
    from scipy.optimize import BFGS, Bounds, minimize

    begin = time.perf_counter()
    scale = 0.5 * problem.width
    size, evaluations = problem.cost(problem.nominal), 0

    def cost(u: Floats) -> tuple[float, Floats]:
        nonlocal evaluations
        evaluations += 1
        total, gradient = problem.gradient(problem.nominal + scale * u)
        return total / size, gradient * scale / size

    with warnings.catch_warnings():
        # At the end steps are so small that the gradient stays the same to the last digit.
        warnings.simplefilter("ignore", UserWarning)
        found = minimize(
            cost,
            np.zeros(12),
            method="trust-constr",
            jac=True,
            hess=BFGS(),
            bounds=Bounds(-np.ones(12), np.ones(12)),
            options={
                "maxiter": STEPS,
                "gtol": TOLERANCE,
                "xtol": 0.1 * TOLERANCE,
                "barrier_tol": TOLERANCE,
            },
        )
    values = problem.nominal + scale * np.clip(found.x, -1.0, 1.0)
    return Outcome(values, problem.cost(values), evaluations, time.perf_counter() - begin)
