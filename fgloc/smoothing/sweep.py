"""A first guess for long drives: smoothing from the start in overlapping windows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgloc.core.geometry import between, compose
from fgloc.core.measurements import Floats
from fgloc.smoothing.arrow import solve
from fgloc.smoothing.initial import dead_reckon
from fgloc.smoothing.minimise import CalibrationPrior, minimise, normal_equations
from fgloc.smoothing.problem import Problem
from fgloc.smoothing.settings import Settings

BENT = 0.3
"""Heading sigma [rad] up to which a dead-reckoned path is close to its linearisation."""
ROUGH = 1e-2
"""Relative decrease at which a window of the sweep is good enough to go on."""
BEYOND = 6.0
"""A calibration that many prior sigmas away means that the sweep lost its way."""
LOOK = 3000
"""How many keyframes a window of the sweep may add at most."""
OVERLAP = 4
"""How many fixes of the last window the next one sees again."""


def reach(problem: Problem, u: Floats, sigma: Floats, heading: float) -> int:
    """Return the number of keyframes over which dead reckoning keeps its heading.

    `sigma` (G, G) is the covariance of the calibration u, `heading` the heading variance at the
    first keyframe. The limit is where the predicted heading sigma exceeds BENT: there the path
    bends away from its linearisation. Where a yaw sensor or gyro gives the rotation nothing
    grows. O(K).
    """
    wheels = problem.wheel_table(u)
    free = wheels.calibration.stop
    unknown = np.isnan(problem.turn)
    by_calibration = np.cumsum(wheels.measurements[:, 3 + 2 * free :] * unknown[:, None], axis=0)
    covariance = np.linalg.inv(wheels.sqrt_information)
    noise = np.cumsum(np.einsum("kb,kb->k", covariance[:, 2], covariance[:, 2]) * unknown)
    spread = np.einsum("kp,pq,kq->k", by_calibration, sigma[:free, :free], by_calibration)
    lost = np.flatnonzero(heading + noise + spread > BENT**2)
    return int(lost[0]) if lost.size else problem.states.shape[0]


def sweep(problem: Problem, settings: Settings) -> tuple[Floats, Floats, int]:
    """Return a first guess (K, B), (G,) smoothed piece by piece from the start, and iterations.

    Dead reckoning with nominal calibration may be turned by radians after minutes, which no local
    optimiser repairs. Each window reaches as far as the heading can be trusted, begins a few
    fixes earlier than the last one ended, and hands pose and calibration on with twice their
    sigma, since a few fixes are counted twice. All windows together cost about one full solve.
    """
    total = problem.states.shape[0]
    fixes = problem.fix_keyframes()
    prior = CalibrationPrior.of(problem)
    states, u = problem.states.copy(), prior.mean
    begin, done, iterations = 0, 1, 0
    trusted = np.sqrt(np.diag(prior.information))
    settings = replace(settings, solver="arrow", tolerance=ROUGH)
    sigma = problem.prior_covariance
    heading = 0.0
    marginals = np.zeros((0, states.shape[1], states.shape[1]))
    offset = 0
    while done < total:
        ahead = fixes[fixes >= done]
        least = int(ahead[0]) + 1 if ahead.size else total
        ahead_of = problem.window(done - 1, min(max(least, done + LOOK), total))
        end = min(max(least, done - 1 + reach(ahead_of, u, sigma, heading)), total)
        window = problem.window(begin, end)
        path = dead_reckon(window.displacement(u), window.turn)
        near = done - 1 - begin
        states[done:end, :3] = compose(states[done - 1, :3], between(path[near], path[near + 1 :]))
        states[done:end, 3:] = states[done - 1, 3:]
        if begin > 0:
            window = window.with_state_prior(states[begin], 4.0 * marginals[begin - offset])
        # Plain first: a robust loss would rather give up a fix than turn the path towards it.
        point, count, _ = minimise(window, settings, states[begin:end], u, False, prior)
        point, more, _ = minimise(window, settings, point.states, point.u, True, prior)
        iterations += count + more
        solution = solve(normal_equations(prior, point), 0.0, with_covariance=True)
        if solution is None or solution.covariance is None:
            break
        if np.abs(point.u * trusted).max(initial=0.0) > BEYOND:
            break  # lost: what follows could only be worse than dead reckoning from here
        states[begin:end], u = point.states, point.u
        marginals, offset = solution.covariance, begin
        sigma = np.asarray(solution.calibration_covariance)
        heading = float(marginals[-1, 2, 2])
        prior = CalibrationPrior.gaussian(u, 4.0 * sigma)
        behind = fixes[fixes < end]
        begin = int(behind[max(behind.size - OVERLAP, 0)]) if behind.size else 0
        begin = max(begin, offset)
        done = end
    return states, u, iterations
