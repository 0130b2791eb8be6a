"""Particle swarm optimisation by pymoo, the extra `search`."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from fgloc.calibration.optimisers.outcome import Outcome
from fgloc.calibration.optimisers.swerve_problem import SwerveProblem
from fgloc.errors import FglocError

PARTICLES = 25
"""Size of the swarm: pymoo's usual one."""
GENERATIONS = 200
"""How often it moves."""


def particle_swarm(problem: SwerveProblem, seed: int, generations: int = GENERATIONS) -> Outcome:
    """Return the best that a swarm found; the same for the same seed.

    Raises FglocError where pymoo is not installed.
    """
    try:
        from pymoo.algorithms.soo.nonconvex.pso import PSO
        from pymoo.core.problem import ElementwiseProblem
        from pymoo.optimize import minimize
    except ImportError:
        raise FglocError(
            "particle swarm optimisation needs pymoo: pip install 'fgloc[search]'"
        ) from None
    begin = time.perf_counter()

    class Pymoo(ElementwiseProblem):  # type: ignore[misc]
        """The problem as pymoo wants it."""

        def __init__(self) -> None:
            super().__init__(n_var=12, n_obj=1, xl=problem.low, xu=problem.high)

        def _evaluate(self, x: Any, out: Any, *_: Any, **__: Any) -> None:
            out["F"] = problem.cost(np.asarray(x, dtype=np.float64))

    found = minimize(
        Pymoo(), PSO(pop_size=PARTICLES), ("n_gen", generations), seed=seed, verbose=False
    )
    values = np.asarray(found.X, dtype=np.float64)
    evaluations = int(found.algorithm.evaluator.n_eval)
    return Outcome(values, problem.cost(values), evaluations, time.perf_counter() - begin)
