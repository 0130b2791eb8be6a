"""A first guess for long drives: smoothing from the start in overlapping windows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgloc.core.geometry import between, compose
from fgloc.core.measurements import Floats
from fgloc.smoothing.initial import dead_reckon
from fgloc.smoothing.minimise import CalibrationPrior, Point, linear_system, minimise
from fgloc.smoothing.network import step_of
from fgloc.smoothing.problem import Problem
from fgloc.smoothing.settings import Settings

BENT = 0.3
"""Heading sigma [rad] up to which a dead-reckoned path is close to its linearisation."""
ROUGH = 1e-2
"""Relative decrease at which a window of the sweep is good enough to go on."""
BEYOND = 6.0
"""A calibration that many prior sigmas away means that the sweep lost its way."""
TRIES = (0.0, -1.0, 1.0, -2.0, 2.0)
"""Starting calibrations of the first window [prior sigmas of what turns the heading]."""
TELLING = 4
"""So many fixes tell which of them is right."""
LOOK = 3000
"""How many keyframes a window of the sweep may add at most."""
OVERLAP = 4
"""How many fixes of the last window the next one sees again."""


def _turns(problem: Problem, u: Floats, sigma: Floats) -> tuple[Floats, Floats, Floats]:
    """Return how the heading is lost along the drive from its first keyframe.

    (K-1, F) derivatives by the F free robot parameters, (K-1,) variance that their covariance in
    `sigma` (G, G) means, (K-1,) variance of noise; where a yaw sensor or gyro gives the rotation
    only that sensor's drift counts. O(K).
    """
    wheels = problem.wheel_table(u)
    free = wheels.calibration.stop
    unknown = np.isnan(problem.turn)
    by_calibration = np.cumsum(
        wheels.measurements[:, 3 + 2 * free : 3 + 3 * free] * unknown[:, None], axis=0
    )
    covariance = np.linalg.inv(wheels.sqrt_information)
    variance = np.einsum("kb,kb->k", covariance[:, 2], covariance[:, 2])
    walk, steady = problem.turn_spread.T
    noise = np.cumsum(np.where(unknown, variance, walk)) + np.cumsum(steady) ** 2
    spread = np.einsum("kp,pq,kq->k", by_calibration, sigma[:free, :free], by_calibration)
    return by_calibration, spread, noise


def reach(problem: Problem, u: Floats, sigma: Floats, heading: float) -> int:
    """Return the number of keyframes over which dead reckoning keeps its heading.

    `sigma` (G, G) is the covariance of the calibration u, `heading` the heading variance at the
    first keyframe. The limit is where the predicted heading sigma exceeds BENT: there the path
    bends away from its linearisation. O(K).
    """
    _, spread, noise = _turns(problem, u, sigma)
    lost = np.flatnonzero(heading + noise + spread > BENT**2)
    return int(lost[0]) if lost.size else problem.states.shape[0]


def starting_calibrations(problem: Problem, mean: Floats, sigma: Floats) -> list[Floats]:
    """Return calibrations (G,) to try: the mean, and others along what turns the heading most."""
    by_calibration, spread, _ = _turns(problem, mean, sigma)
    most, free = by_calibration[int(np.argmax(spread))], by_calibration.shape[1]
    direction = np.zeros(sigma.shape[0])
    direction[:free] = sigma[:free, :free] @ most / np.sqrt(float(spread.max()) + 1e-300)
    return [mean + t * direction for t in TRIES]


def _first_window(
    problem: Problem, settings: Settings, prior: CalibrationPrior, sigma: Floats
) -> tuple[Point, int]:
    """Return the best solution of the first window over several starting calibrations.

    Where the heading is lost before the first fix, which turn it took is ambiguous; a few fixes
    together tell, but each wrong answer is a local minimum of its own.
    """
    best: Point | None = None
    iterations = 0
    for u in starting_calibrations(problem, prior.mean, sigma):
        states = problem.states.copy()
        path = dead_reckon(problem.displacement(u), problem.turn)
        states[:, :3] = compose(states[0, :3], path)
        point, count, _ = minimise(problem, settings, states, u, False, prior)
        iterations += count
        if best is None or point.cost < best.cost:
            best = point
    assert best is not None
    return best, iterations


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
    trusted = 1.0 / np.sqrt(np.diag(problem.prior_covariance))
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
        lost_at_once = done == 1 and end == least < total
        if lost_at_once:
            end = int(fixes[min(TELLING, fixes.size - 1)]) + 1
        window = problem.window(begin, end)
        path = dead_reckon(window.displacement(u), window.turn)
        near = done - 1 - begin
        states[done:end, :3] = compose(states[done - 1, :3], between(path[near], path[near + 1 :]))
        states[done:end, 3:] = states[done - 1, 3:]
        if begin > 0:
            window = window.with_state_prior(states[begin], 4.0 * marginals[begin - offset])
        # Plain first: a robust loss would rather give up a fix than turn the path towards it.
        if lost_at_once:
            point, count = _first_window(window, settings, prior, sigma)
        else:
            point, count, _ = minimise(window, settings, states[begin:end], u, False, prior)
        point, more, _ = minimise(window, settings, point.states, point.u, True, prior)
        iterations += count + more
        solution = step_of(linear_system(prior, point), with_covariance=True)
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
