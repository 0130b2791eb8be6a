"""The batch smoother: a whole drive at once, trajectory and calibration together."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.geometry import rotate_covariance
from fgloc.core.trajectory import Trajectory
from fgloc.estimator import DOWN_WEIGHTED, Result, SensorCount, SensorResiduals, calibration_of
from fgloc.factors.tables import COMPONENTS, Kind, residuals
from fgloc.smoothing.mapping import map_of
from fgloc.smoothing.optimise import Solution
from fgloc.smoothing.problem import HIDDEN, Problem
from fgloc.smoothing.scene import Scene
from fgloc.smoothing.settings import Settings
from fgloc.smoothing.slip import seen_by_others, slips_of
from fgloc.smoothing.slip_report import slip_notes
from fgloc.smoothing.trust import STRAINED, solve_with_trust, strain

OF_SCANS = (Kind.WALL, Kind.SCAN_MATCH)
"""Tables of which a scan has several factors."""
AT_ODDS = 0.2
"""A larger share of down-weighted factors is worth a note: sensors contradict each other."""


class BatchSmoother:
    """Smooths a drive: wheels with calibration variables and whatever else was measured."""

    def __init__(self, settings: Settings | None = None) -> None:
        self.settings = settings if settings is not None else Settings()

    @property
    def method(self) -> str:
        """Return "batch"."""
        return "batch"

    def estimate(self, drive: Drive) -> Result:
        """Return keyframe poses with covariances, calibration, residuals and counts.

        Raises FglocError where the drive cannot be smoothed (no overlap, undetermined wheels,
        numbers so far apart that nothing can be computed from them).
        """
        problem, solution, left_out = solve_with_trust(drive, self.settings)
        return _result(self.method, drive, problem, solution, left_out)


def _result(
    method: str,
    drive: Drive,
    problem: Problem,
    solution: Solution,
    left_out: Mapping[str, str],
) -> Result:
    """Turn a solution into the public result."""
    poses = solution.point.states[:, :3]
    covariances = None
    if solution.covariance is not None:
        covariances = rotate_covariance(solution.covariance[:, :3, :3], poses[:, 2])
        covariances = 0.5 * (covariances + covariances.swapaxes(1, 2))
    sizes = {s.sensor: s.stamps_ns.size for s in drive.sensors}
    unused = {name: SensorCount(0, 0, sizes[name]) for name in left_out}
    slips = slips_of(problem, solution)
    told = slip_notes(slips, int(problem.keyframes_ns[0]), seen_by_others(problem))
    notes = [*problem.notes, *left_out.values(), *told]
    missed = strain(solution)
    if missed > STRAINED:
        notes.append(
            f"the fixes are missed by more than their noise allows (mean cost {missed:.3g}, 0.5 "
            "is right): their noise or clock is wrong, or this is not the best minimum; more "
            "fixes at the start or a better nominal calibration (--robot) tell"
        )
    counts = _counts(problem, solution)
    used = tuple(name for name, c in counts.items() if c.accepted + c.down_weighted > 0)
    for name, c in counts.items():
        if c.down_weighted > AT_ODDS * (c.accepted + c.down_weighted):
            notes.append(
                f"{c.down_weighted} of {c.accepted + c.down_weighted} factors of {name} were given "
                "up because the others contradict them; which of them is right, only fixes tell"
            )
    calibration, calibration_covariance = calibration_of(
        problem.parameters, solution.point.u, solution.calibration_covariance
    )
    return Result(
        method=method,
        drive=drive.name,
        trajectory=Trajectory(problem.keyframes_ns, poses, covariances),
        sensors_used=used,
        calibration=calibration,
        residuals=_residuals(problem, solution),
        counts={**counts, **unused},
        convergence=_convergence(solution),
        slips=slips,
        notes=tuple(notes),
        calibration_covariance=calibration_covariance,
        map=map_of(problem, solution),
    )


def _convergence(solution: Solution) -> str:
    """Return iterations, cost, why the optimiser stopped and what another step would move."""
    ended = "converged" if solution.converged else "did NOT converge"
    cost = solution.point.cost
    text = f"{ended} after {solution.iterations} iterations, cost {cost:.6g}: {solution.stopped}"
    if solution.next_step is not None:
        text += f", the next step is {solution.next_step:.1g} sigma at most"
    return text


def _residuals(problem: Problem, solution: Solution) -> tuple[SensorResiduals, ...]:
    """Return the residuals of every sensor at the solution."""
    return tuple(
        SensorResiduals(
            sensor=table.sensor,
            components=COMPONENTS[table.kind],
            stamps_ns=problem.keyframes_ns[table.first],
            values=residuals(
                table, solution.point.states, solution.point.u, solution.point.landmarks
            ),
            normalised=rows.residual,
            weights=weight,
        )
        for table, rows, weight in zip(
            solution.point.tables, solution.point.linear, solution.point.weights, strict=True
        )
        if table.kind not in HIDDEN
    )


def _counts(problem: Problem, solution: Solution) -> dict[str, SensorCount]:
    """Return how each sensor's measurements were used; a lidar's are its scans."""
    counts = {
        name: SensorCount(used, 0, rejected) for name, (used, rejected) in problem.counts.items()
    }
    for table, weight in zip(solution.point.tables, solution.point.weights, strict=True):
        if table.kind in (*HIDDEN, *OF_SCANS) or table.sensor not in counts:
            continue
        down = int(np.sum(weight < DOWN_WEIGHTED))
        before = counts[table.sensor]
        counts[table.sensor] = SensorCount(before.accepted - down, down, before.rejected)
    if problem.scene is not None:
        counts[problem.scene.scans.sensor] = _scan_count(problem, problem.scene, solution)
    return counts


def _scan_count(problem: Problem, scene: Scene, solution: Solution) -> SensorCount:
    """Return how a lidar's scans were used.

    A scan is down-weighted where every wall and every match of it is, rejected where it has none.
    """
    best = np.full(problem.keyframes_ns.size, -1.0)
    for table, weight in zip(solution.point.tables, solution.point.weights, strict=True):
        if table.kind in OF_SCANS:
            np.maximum.at(best, table.first, weight)
        if table.kind == Kind.SCAN_MATCH and table.second is not None:
            np.maximum.at(best, table.second, weight)
    told = best[scene.at]
    silent, down = int(np.sum(told < 0.0)), int(np.sum((told >= 0.0) & (told < DOWN_WEIGHTED)))
    left_out = problem.counts[scene.scans.sensor][1]
    return SensorCount(told.size - silent - down, down, left_out + silent)
