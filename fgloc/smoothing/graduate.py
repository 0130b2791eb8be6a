"""A second look where fixes were given up or the wheels are torn: graduated non-convexity.

Robust losses have many minima. With a third of the fixes wild, plain least squares ends so far
away that from there a wrong one is nearest; worse, two wheel intervals given up, one before and
one after a wild fix, cost less than the fix. Here the losses of all sensors but the wheels are
made convex and then sharpened round by round (Yang et al. 2020), while the wheels stay quadratic,
so that nothing can be torn meanwhile; then the wheels' own loss follows. On simulated drives with
30 to 50 % of the fixes 5 m off, singly and in runs, this ends at the clean solution where the
plain start ends metres away. Graduating the wheels together with the rest does worse than no
graduation, and so does letting them slip (Huber): path and fixes then give each other up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fgloc.factors.robust import CONVEX, PLAIN, Graduated, Loss, graduated
from fgloc.smoothing.minimise import Point, minimise
from fgloc.smoothing.problem import FIXES, Problem
from fgloc.smoothing.settings import Settings

GIVEN_UP = 0.25
"""A factor whose robust weight is below this is given up."""
MANY = 0.1
"""A larger share of the fixes given up calls for a second look."""
TORN = 100.0
"""A wheel interval so many sigmas off calls for one too: a slip, or a wrong fix believed."""
SLIDING = Loss("huber", 2.0)
"""How solutions are judged: slip costs by its length, so that one leap is no bargain."""
ROUND = 3
"""Linearisations in a round of graduation at most."""
ROUGH = 1e-2
"""Relative decrease at which a round is over."""
BETTER = 0.5
"""Fraction of the judged cost that is worth changing one's mind for: in long slips, where both
minima tear the wheels, a small gain proves nothing."""
REPAIRS = 3
"""How often a solution is repaired by forbidding the wheels to be torn, at most."""
SETTLED = 1e-3
"""Relative decrease at which a graduated solution can be told from another one."""


def doubtful(point: Point) -> bool:
    """Return True if a robust solution may be a wrong minimum: fixes given up or wheels torn."""
    graduable = [t for t in point.tables[1:] if t.loss.name not in CONVEX]
    if not graduable:
        return False
    if float(point.linear[0].squared.max(initial=0.0)) > TORN**2:
        return True
    fixes = [
        w
        for table, w in zip(point.tables, point.weights, strict=True)
        if table.kind in FIXES and table.loss.name not in CONVEX
    ]
    weights = np.concatenate(fixes) if fixes else np.ones(1)
    return float(np.mean(weights < GIVEN_UP)) > MANY


def judged(point: Point) -> float:
    """Return the cost of a robust solution if slip is charged by its length."""
    squared = point.linear[0].squared
    paid = point.tables[0].loss.cost(squared)
    return point.cost + float(np.sum(SLIDING.cost(squared) - paid))


def second_look(
    problem: Problem, settings: Settings, plain: Sequence[Point], robust: Point
) -> tuple[Point | None, int]:
    """Return a far better robust solution, or None, and iterations.

    `plain` are least-squares solutions from which to graduate; `robust`, the solution in doubt, is
    itself repaired by forbidding the wheels to be torn. About thirty rounds of one or two
    iterations for each start, O(K) each.
    """
    rigid = replace(problem, wheel_loss=PLAIN)
    candidates = []
    iterations = 0
    for start in plain:
        point, count = _graduate(rigid, settings, start)
        point, more = _untorn(problem, rigid, settings, point)
        iterations += count + more
        candidates.append(point)
    best = min((robust, *candidates), key=judged)
    # What is still torn may be so for a wrong fix that it believes: one repair shows the next.
    for _ in range(REPAIRS):
        point, more = _untorn(problem, rigid, settings, best)
        iterations += more
        if not judged(point) < judged(best):
            break
        best = point
    return (best if judged(best) < BETTER * judged(robust) else None), iterations


def _untorn(
    problem: Problem, rigid: Problem, settings: Settings, start: Point
) -> tuple[Point, int]:
    """Solve from `start` first with quadratic wheels, then with their own loss; iterations too."""
    rough = replace(settings, tolerance=SETTLED)
    point, count, _ = minimise(rigid, rough, start.states, start.u, True, landmarks=start.landmarks)
    point, more, _ = minimise(
        problem, settings, point.states, point.u, True, landmarks=point.landmarks
    )
    return point, count + more


def _graduate(problem: Problem, settings: Settings, point: Point) -> tuple[Point, int]:
    """Sharpen the losses of all tables from nearly convex to their own; return iterations too."""
    settings = replace(settings, max_iterations=ROUND, tolerance=ROUGH)
    losses = [
        graduated(table.loss, rows.squared)
        for table, rows in zip(problem.tables, point.linear[1:], strict=True)
    ]
    iterations = 0
    while True:
        tables = [replace(t, loss=loss) for t, loss in zip(problem.tables, losses, strict=True)]
        stage = replace(problem, tables=tuple(tables))
        point, count, _ = minimise(
            stage, settings, point.states, point.u, True, landmarks=point.landmarks
        )
        iterations += count
        squared = [rows.squared for rows in point.linear[1:]]
        blunt = [
            isinstance(loss, Graduated) and not loss.finished(s)
            for loss, s in zip(losses, squared, strict=True)
        ]
        if not any(blunt):
            return point, iterations
        losses = [
            loss.sharper() if isinstance(loss, Graduated) and more else loss
            for loss, more in zip(losses, blunt, strict=True)
        ]
