"""The genetic algorithm with the publication's settings."""

from __future__ import annotations

import time

import numpy as np

from fgloc.calibration.optimisers.outcome import Outcome
from fgloc.calibration.optimisers.swerve_problem import SwerveProblem
from fgloc.core.measurements import Floats

CHROMOSOMES = 12
"""Size of the population, as published."""
GENERATIONS = 600
"""Generations, as published."""
MUTATION = 0.1
"""Probability that a gene mutates; the publication does not print its own."""
SPREAD = 0.1
"""Standard deviation of a mutation, in widths of the bounds; likewise."""


def genetic(
    problem: SwerveProblem, rng: np.random.Generator, generations: int = GENERATIONS
) -> Outcome:
    """Return the best of some generations; the random numbers are those of `rng`.

    Roulette selection of parents by 1/J, crossover at one gene, mutation, and elitism: the best
    chromosome lives on unchanged, so that J never rises from one generation to the next.
    """
    begin = time.perf_counter()
    population = rng.uniform(problem.low, problem.high, (CHROMOSOMES, 12))
    costs = np.array([problem.cost(p) for p in population])
    evaluations = CHROMOSOMES
    for _ in range(generations):
        order = np.argsort(costs, kind="stable")
        elite, best = population[order[0]].copy(), float(costs[order[0]])
        children = _children(population, costs, problem, rng)
        found = np.array([problem.cost(p) for p in children])
        evaluations += children.shape[0]
        population = np.vstack([elite[None], children])
        costs = np.concatenate([[best], found])
    k = int(np.argmin(costs))
    return Outcome(population[k], float(costs[k]), evaluations, time.perf_counter() - begin)


def _children(
    population: Floats, costs: Floats, problem: SwerveProblem, rng: np.random.Generator
) -> Floats:
    """Return a new generation, less the elite."""
    fitness = 1.0 / costs
    wheel = fitness / np.sum(fitness)
    number = CHROMOSOMES - 1
    mothers = population[rng.choice(population.shape[0], number, p=wheel)]
    fathers = population[rng.choice(population.shape[0], number, p=wheel)]
    cuts = rng.integers(1, 12, number)
    children = np.where(np.arange(12)[None] < cuts[:, None], mothers, fathers)
    mutates = rng.random(children.shape) < MUTATION
    moved = children + SPREAD * problem.width * rng.normal(size=children.shape)
    return np.clip(np.where(mutates, moved, children), problem.low, problem.high)
