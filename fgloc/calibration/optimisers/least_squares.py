"""Bounded least squares: a projected Newton method on exact gradients.

Gauss–Newton does not do here. What no parameters explain is large (spins) and several directions
are flat, so that the second derivatives of the residuals, which Gauss–Newton leaves out, outweigh
what it keeps by orders of magnitude; its steps run from bound to bound. The second derivatives are
differences of exact gradients, on a copy of the runs in which some intervals are merged: that is
close enough for the direction, while cost and gradient stay those of all samples.
"""

from __future__ import annotations

import time

import numpy as np
import numpy.typing as npt

from fgloc.calibration.optimisers.outcome import Outcome
from fgloc.calibration.optimisers.swerve_problem import MERGED, SwerveProblem
from fgloc.core.measurements import Floats

STEPS = 100
"""Most steps."""
DONE = 1e-9
"""A relative fall of J by less, in a full step, ends the search."""
NEAR = 1e-3
"""A variable so close to the bound that the gradient holds it at counts as being there."""
LONGEST = 1.0
"""Longest step of a variable."""


def bounded_least_squares(problem: SwerveProblem) -> Outcome:
    """Return the optimum in the bounds, from the nominal parameters; deterministic.

    Variables at or near a bound that the gradient holds there are taken apart from the others,
    whose second derivatives are made positive where they are not; the step is the minimum of that
    quadratic model in the box (BVLS, exact in finitely many exchanges), halved until J falls (a
    two-metric projection: Bertsekas, SIAM J. Control Optim. 20, 1982).
    """
    from scipy.optimize import lsq_linear

    begin = time.perf_counter()
    scale = 0.5 * problem.width
    coarse = problem.merged(MERGED)
    u, evaluations = np.zeros(12), 1
    cost, gradient = _scaled(problem, u, scale)
    for _ in range(STEPS):
        outward = np.where(gradient < 0.0, 1.0 - u, u + 1.0) < NEAR
        second = coarse.second_derivatives(_values(problem, u)) * MERGED
        model = _model(second * np.outer(scale, scale), ~outward)
        root = np.linalg.cholesky(model).T
        box = (np.maximum(-1.0 - u, -LONGEST), np.minimum(1.0 - u, LONGEST))
        box = (np.minimum(box[0], -1e-15), np.maximum(box[1], 1e-15))
        step = lsq_linear(root, np.linalg.solve(root.T, -gradient), box, method="bvls", tol=1e-15).x
        part = 1.0
        while part > 1e-6:
            trial = np.clip(u + part * step, -1.0, 1.0)
            after, following = _scaled(problem, trial, scale)
            evaluations += 1
            if after < cost + 1e-4 * part * float(gradient @ step):
                break
            part *= 0.5
        else:
            break
        fell, cost = cost - after, after
        u, gradient = trial, following
        if part == 1.0 and fell < DONE * cost:
            break
    return Outcome(_values(problem, u), cost, evaluations, time.perf_counter() - begin)


def _scaled(problem: SwerveProblem, u: Floats, scale: Floats) -> tuple[float, Floats]:
    """Return J and its gradient by variables that are ±1 at the bounds."""
    cost, gradient = problem.gradient(_values(problem, u))
    return cost, gradient * scale


def _model(h: Floats, free: npt.NDArray[np.bool_]) -> Floats:
    """Return a positive definite matrix: h among the free variables, apart from the others.

    Eigenvalues that are not positive are replaced by their sizes.
    """
    model = np.diag(np.maximum(np.abs(np.diag(h)), 1e-6 * np.max(np.abs(h))))
    at = np.ix_(free, free)
    values, vectors = np.linalg.eigh(h[at])
    size = np.maximum(np.abs(values), 1e-6 * np.max(np.abs(values), initial=0.0))
    model[at] = (vectors * size) @ vectors.T
    return model


def _values(problem: SwerveProblem, u: Floats) -> Floats:
    """Return parameters [m] of variables that are ±1 at the bounds."""
    return np.clip(problem.nominal + 0.5 * problem.width * u, problem.low, problem.high)
