"""Walls in the batch graph: from scans that lie on each other to walls seen again and again.

First the scans themselves hold the drive together: each matched to those before it, and to those
of an earlier visit where the robot came back. On the path that this gives segments are associated
to walls, and walls replace the matches wherever they tell as much: what is left of the drift then
goes, since a wall is one for the whole drive. Associating and solving alternate until they agree.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgloc.core.geometry import between, compose, inverse, rotate_covariance
from fgloc.core.measurements import Floats, Stamps
from fgloc.errors import FglocError
from fgloc.factors.robust import PLAIN
from fgloc.factors.tables import FactorTable, Kind
from fgloc.lidar.association import (
    Slack,
    associate,
    duplicates,
    hidden,
    lidar_poses,
    single_noise,
)
from fgloc.lidar.surfaces import Mask
from fgloc.lidar.walls import Map, Marks, Walls
from fgloc.smoothing.forward import placed
from fgloc.smoothing.front import Front
from fgloc.smoothing.minimise import Point, minimise
from fgloc.smoothing.optimise import Solution, finish, optimise
from fgloc.smoothing.problem import Problem
from fgloc.smoothing.scene import Scene
from fgloc.smoothing.settings import Settings

ROUNDS = (
    Slack(0.10, 0.015),
    Slack(0.05, 0.008),
    Slack(0.03, 0.005),
    Slack(0.02, 0.004),
    Slack(0.02, 0.004),
)
"""How far poses may be off while segments are associated, round by round."""
FEWEST = 3
"""A wall seen less often is none: a door that moved, a person."""
UNSURE = np.radians(1.0)
"""A wall whose direction is not known to this sigma [rad] is not drawn in the map."""
SURER = 1.5
"""A match of two scans is dropped unless it is so many times surer than the walls they share."""
BENT = 2.0
"""Closures are believed to so many of their sigmas: those of one place are bent alike."""
BESIDE = 3
"""Walls seen so many scans before or after count as seen around a place."""
CROSSING = 0.3
"""Sine of the angle at which two walls cross that tie two places together."""
WORST = 13.8
"""Squared normalised residual (99.9 % of two numbers) beyond which a sighting is given up."""
ROUGH = 1e-4
"""Relative decrease at which a round before the last is over."""


def solve_with_walls(
    problem: Problem, front: Front, settings: Settings
) -> tuple[Problem, Solution]:
    """Return the problem with walls, and its solution.

    Where scans show no walls, or what they tell cannot be solved, that of the other sensors, with a
    note. Raises FglocError where these cannot be solved either. O(N) a round but for the
    association, O(segments · walls).
    """
    why = f"its scans show no straight wall {FEWEST} times"
    try:
        found = _solve_with_walls(problem, front, settings)
    except (FglocError, np.linalg.LinAlgError):
        found, why = None, "no poses go with its scans and the other sensors alike"
    if found is not None:
        return found
    note = f"{front.scans.sensor} was not used: {why}"
    problem = replace(problem, notes=(*problem.notes, note))
    return problem, optimise(problem, settings)


def _solve_with_walls(
    problem: Problem, front: Front, settings: Settings
) -> tuple[Problem, Solution] | None:
    """Return the problem with matches and walls, and its solution; None if there is no wall.

    Scans that show none are not matched either: what is round, or a handful of beams, can be laid
    on itself in many ways, all of them exact. Raises FglocError or LinAlgError where the system is
    indeterminate.
    """
    scene = problem.scene
    assert scene is not None
    if not scene.segments.scan.size:
        return None
    rough = replace(settings, tolerance=ROUGH)
    strong = np.zeros(front.chain.relative.shape[0], bool)
    closed = np.zeros(front.closures.first.size, bool)
    matched = _with_matches(problem, front, scene, strong, closed, settings)
    states = _laid_out(problem, front, scene)
    u, marks = np.zeros(len(problem.parameters)), placed(problem, states)
    point, iterations, converged = minimise(
        matched, rough, states, u, settings.robust, landmarks=marks
    )
    graph, walls = matched, None
    wall = np.full(scene.segments.scan.size, -1, np.int64)
    for slack in ROUNDS:
        before = wall
        walls, wall = _associated(scene, point, slack, walls)
        if not walls.normal.size:
            if graph is matched:
                return None
            point, count, converged = minimise(
                graph, settings, point.states, point.u, settings.robust, landmarks=point.landmarks
            )
            iterations += count
            break
        now, landmarks = scene.with_walls(walls, wall)
        strong, closed = _told_by_walls(scene, front, point, walls, wall)
        graph = _with_matches(problem, front, scene, strong, closed, settings)
        graph = replace(
            graph,
            tables=(*graph.tables, now.table(settings.landmark_loss if settings.robust else PLAIN)),
            landmarks=np.concatenate([point.landmarks[: scene.first], landmarks]),
            scene=now,
        )
        settled = wall.size == before.size and bool(np.array_equal(wall, before))
        point, count, converged = minimise(
            graph,
            settings if settled or slack is ROUNDS[-1] else rough,
            point.states,
            point.u,
            settings.robust,
            landmarks=graph.landmarks,
        )
        iterations += count
        scene = now
        walls = scene.walls(point.landmarks, None, point.states[:, :3], point.u)
        if settled:
            break
    graph, pruned = _pruned(graph, point)
    if pruned:
        point, count, converged = minimise(
            graph, settings, point.states, point.u, settings.robust, landmarks=point.landmarks
        )
        iterations += count
    stopped = "the cost falls no further" if converged else "no step lowers the cost"
    return graph, finish(graph, settings, point, iterations, converged, stopped)


def _pruned(graph: Problem, point: Point) -> tuple[Problem, int]:
    """Return the graph without sightings that contradict their wall, and how many those were."""
    scene = graph.scene
    assert scene is not None
    of_walls = [k for k, t in enumerate(point.tables) if t.kind == Kind.WALL]
    if not of_walls:
        return graph, 0
    wrong = point.linear[of_walls[0]].squared > WORST
    wall = scene.wall.copy()
    wall[np.flatnonzero(wall >= 0)[wrong]] = -1
    left = np.bincount(wall[wall >= 0], minlength=scene.anchors.shape[0])
    # A wall that all its sightings contradict stays: it must be determined, and says how badly.
    wall = np.where((scene.wall >= 0) & (left[scene.wall] == 0), scene.wall, wall)
    if np.array_equal(wall, scene.wall):
        return graph, 0
    now = replace(scene, wall=wall)
    loss = point.tables[of_walls[0]].loss
    tables = [now.table(loss) if t.kind == Kind.WALL else t for t in graph.tables]
    return replace(graph, tables=tuple(tables), scene=now), int(np.sum(wall != scene.wall))


def map_of(problem: Problem, solution: Solution) -> Map | None:
    """Return what a solution says of the surroundings; None where no sensor saw any."""
    scene, point = problem.scene, solution.point
    marks = None
    if problem.marks.size:
        n = problem.marks.size
        covariance = solution.landmark_covariance
        seen = [np.asarray(t.second) for t in problem.tables if t.kind == Kind.RANGE_BEARING]
        marks = Marks(
            problem.marks,
            point.landmarks[:n],
            np.full((n, 2, 2), np.nan) if covariance is None else covariance[:n],
            np.bincount(np.concatenate(seen), minlength=n)[:n].astype(np.int64),
        )
    if scene is None:
        return None if marks is None else Map(marks=marks)
    covariance = solution.landmark_covariance
    walls = scene.walls(point.landmarks, covariance, point.states[:, :3], point.u)
    unsure = (walls.covariance[:, 0, 0] > UNSURE**2) | hidden(walls)
    # One more at the end for segments of no wall, -1.
    place = np.append(np.where(unsure, -1, np.cumsum(~unsure) - 1), -1)
    wall = place[scene.wall]
    walls = walls.select(np.flatnonzero(~unsure))
    # A map's segments say which of the drive's scans they are of, not which of those in use.
    segments = replace(scene.segments, scan=scene.numbers[scene.segments.scan])
    return Map(walls, segments, wall, marks)


def _laid_out(problem: Problem, front: Front, scene: Scene) -> Floats:
    """Return first states (K, B) along the matched scans, wheels between them."""
    states = problem.states.copy()
    mount = np.array(scene.scans.mount)
    start = compose(states[scene.at[0], :3], mount)
    base = compose(compose(start, front.closures.poses), inverse(mount))
    dead = states[:, :3].copy()
    nearest = np.searchsorted(scene.at, np.arange(states.shape[0]), side="right") - 1
    moved = nearest >= 0
    since = scene.at[nearest[moved]]
    states[moved, :3] = compose(base[nearest[moved]], between(dead[since], dead[moved]))
    return states


def _with_matches(
    problem: Problem,
    front: Front,
    scene: Scene,
    strong: Mask,
    closed: Mask,
    settings: Settings,
) -> Problem:
    """Return the problem with scan matches: not between `strong` steps, nor `closed` closures.

    Nor of scans without a segment: what they show may be a person and nothing else.
    """
    chain, closures = front.chain, front.closures
    straight = np.bincount(scene.segments.scan, minlength=scene.at.size) > 0
    steps = np.flatnonzero(chain.matched & ~strong & straight[:-1] & straight[1:])
    loops = np.flatnonzero(~closed & straight[closures.first] & straight[closures.second])
    first = np.concatenate([steps, closures.first[loops]]).astype(np.int64)
    second = np.concatenate([steps + 1, closures.second[loops]]).astype(np.int64)
    if not first.size:
        return problem
    relative = np.concatenate([chain.relative[steps], closures.relative[loops]])
    bent = BENT**2 * closures.covariance[loops]
    covariance = np.concatenate([chain.covariance[steps], bent])
    mount = np.broadcast_to(np.array(scene.scans.mount), (first.size, 3))
    table = FactorTable(
        Kind.SCAN_MATCH,
        scene.scans.sensor,
        scene.at[first],
        np.concatenate([relative, mount], axis=1),
        np.linalg.inv(np.linalg.cholesky(covariance)),
        scene.block,
        settings.landmark_loss if settings.robust else PLAIN,
        second=scene.at[second],
    )
    return replace(problem, tables=(*problem.tables, table))


def _associated(
    scene: Scene, point: Point, slack: Slack, known: Walls | None
) -> tuple[Walls, Stamps]:
    """Return walls and the one of each segment (M,), at a solution.

    Duplicates are joined, walls that were seen too seldom are dropped.
    """
    poses = lidar_poses(point.states[scene.at, :3], scene.mount(point.u))
    walls, wall = associate(scene.segments, poses, slack, known)
    noise = single_noise(scene.segments, wall, walls.normal.size)
    same = duplicates(walls, slack, noise)
    wall = np.where(wall >= 0, same[wall], -1)
    sightings = np.bincount(wall[wall >= 0], minlength=walls.normal.size)
    walls = replace(walls, sightings=sightings.astype(np.int64))
    kept = np.flatnonzero(sightings >= FEWEST)
    place = np.full(walls.normal.size, -1, np.int64)
    place[kept] = np.arange(kept.size)
    wall = np.where(wall >= 0, place[wall], -1)
    return walls.select(kept), wall


def _told_by_walls(
    scene: Scene, front: Front, point: Point, walls: Walls, wall: Stamps
) -> tuple[Mask, Mask]:
    """Return (N-1,), (C,): which matches of neighbours, and which closures, walls make needless.

    A match, where in no direction the displacement that shared walls tell is less certain than
    SURER times the match's sigma. A closure, where two walls that cross are seen around both
    places: small maps laid on each other are bent, and walls tell better how much.
    """
    poses = lidar_poses(point.states[scene.at, :3], scene.mount(point.u))
    information = _by_walls(scene, poses)
    used = np.flatnonzero(wall >= 0)
    order = used[np.argsort(scene.segments.scan[used], kind="stable")]
    ends = np.searchsorted(scene.segments.scan[order], np.arange(scene.at.size + 1))

    def told(i: int, j: int, match: Floats) -> bool:
        one, other = order[ends[i] : ends[i + 1]], order[ends[j] : ends[j + 1]]
        shared = np.intersect1d(wall[one], wall[other])
        if shared.size < 2:
            return False
        both = [information[seen[np.isin(wall[seen], shared)]].sum(axis=0) for seen in (one, other)]
        try:
            spread = np.linalg.inv(both[0]) + np.linalg.inv(both[1])
        except np.linalg.LinAlgError:
            return False
        root = np.linalg.inv(np.linalg.cholesky(rotate_covariance(match, poses[i, 2])))
        return bool(np.linalg.eigvalsh(root @ spread @ root.T)[-1] < SURER**2)

    steps = [told(k, k + 1, c) for k, c in enumerate(front.chain.covariance)]

    def around(i: int) -> Stamps:
        low, high = max(i - BESIDE, 0), min(i + BESIDE + 1, scene.at.size)
        return np.unique(wall[order[ends[low] : ends[high]]])

    def tied(i: int, j: int) -> bool:
        shared = walls.normal[np.intersect1d(around(i), around(j))]
        if shared.size < 2:
            return False
        return bool(np.abs(np.sin(shared[:, None] - shared[None])).max() > CROSSING)

    pairs = zip(front.closures.first.tolist(), front.closures.second.tolist(), strict=True)
    loops = [tied(i, j) for i, j in pairs]
    return np.array(steps, dtype=np.bool_), np.array(loops, dtype=np.bool_)


def _by_walls(scene: Scene, poses: Floats) -> Floats:
    """Return (M, 3, 3) what each segment tells of its lidar's pose: information in map axes."""
    segments = scene.segments
    turned = poses[segments.scan] * (0.0, 0.0, 1.0)
    x, y, normal = compose(turned, np.column_stack([segments.middle, segments.normal])).T
    nx, ny = np.cos(normal), np.sin(normal)
    rows = np.zeros((normal.size, 2, 3))
    rows[:, 0, 2] = 1.0
    rows[:, 1] = np.stack([nx, ny, ny * x - nx * y], axis=1)
    return np.asarray(rows.swapaxes(1, 2) @ np.linalg.inv(segments.covariance) @ rows)
