"""Which sensors to believe: one whose absence lets all others agree is left out, and named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.kinematics import Parameter
from fgloc.core.measurements import CameraPoses, Floats, Yaw, YawRate
from fgloc.core.start import trim_to_truth
from fgloc.errors import FglocError
from fgloc.factors.tables import FactorTable, Kind
from fgloc.smoothing.build import build_problem
from fgloc.smoothing.front import Front, look_around
from fgloc.smoothing.leaps import without_leaps
from fgloc.smoothing.mapping import solve_with_walls
from fgloc.smoothing.optimise import Solution, optimise
from fgloc.smoothing.problem import Problem
from fgloc.smoothing.settings import Settings
from fgloc.smoothing.slip import look_for_slip

STRAINED = 2.0
"""Strain (see `strain`) that calls for a trial."""
STRETCHED = 3.5
"""Prior sigmas at which an observed calibration is not believed."""
OBSERVED = 0.5
"""Part of a parameter's prior sigma below which it is observed."""
HALF = 0.5
"""Robust weight below which a factor is doubted."""
AT_ODDS = 0.2
"""Share of doubted factors of fixes and cameras that calls for a trial."""
STRANGE = 6.0
"""Prior sigmas at which a sensor's own drift is not believed."""
SAME = 0.05
"""Strain that may be more without a sensor that is strange for itself."""
GAIN = 0.3
"""A sensor is left out if the strain falls below this fraction without it."""
FREE_SCALE = 0.3
"""Prior sigma of the scale of a camera that contradicts the wheels beyond all priors."""
ARBITERS = (Kind.POSITION_FIX, Kind.POSE_FIX, Kind.CAMERA)
"""Sensors that can tell who is right: they see neither magnetic fields nor the wheels."""


def tells(kind: Kind, sensor: str) -> bool:
    """Return True for the factors of a sensor that can tell who is right."""
    return kind in ARBITERS and sensor != "start"


def strain(solution: Solution) -> float:
    """Return the mean robust cost per residual component of the fixes and cameras; 0 without any.

    About 0.5 where the noise models are right. Wheels do not count: they slip, and what they
    lose by it must not be held against the sensor that shows it.
    """
    cost, count = 0.0, 0
    for table, rows in zip(solution.point.tables, solution.point.linear, strict=True):
        if tells(table.kind, table.sensor):
            cost += float(np.sum(table.loss.cost(rows.squared)))
            count += rows.residual.size
    return cost / max(count, 1)


def doubted(tables: Sequence[FactorTable], weights: Sequence[Floats]) -> float:
    """Return the share of the factors of fixes and cameras with less than half their weight.

    `weights` holds the (M,) robust weights of every table; 0 without such factors.
    """
    told = [w for table, w in zip(tables, weights, strict=True) if tells(table.kind, table.sensor)]
    count = sum(w.size for w in told)
    return sum(int(np.sum(w < HALF)) for w in told) / count if count else 0.0


def bent(parameter: str, parameters: Sequence[Parameter], u: Floats) -> float:
    """Return how many prior sigmas a parameter was pulled away; 0 where there is none."""
    for k, p in enumerate(parameters):
        if p.name == parameter:
            return abs(float(u[k])) / p.solver_sigma
    return 0.0


def _doubted(solution: Solution) -> float:
    """Return `doubted` of a solution."""
    return doubted(solution.point.tables, solution.point.weights)


def stretch(problem: Problem, solution: Solution) -> float:
    """Return how many prior sigmas the robot's own calibration was pulled away, at most.

    Only parameters that the drive observes count: the others are pulled by noise, a track by that
    of the encoders on a straight run.
    """
    return pulled(
        problem.parameters[: len(problem.free)],
        solution.point.u,
        solution.calibration_covariance,
    )


def pulled(parameters: Sequence[Parameter], u: Floats, covariance: Floats | None) -> float:
    """Return the largest |u|/prior sigma of the observed of F parameters; 0 without any.

    `u` and `covariance` hold these and perhaps more in front; without one, all count.
    """
    pulls = [
        abs(float(u[k])) / p.solver_sigma
        for k, p in enumerate(parameters)
        if covariance is None or np.sqrt(covariance[k, k]) < OBSERVED * p.solver_sigma
    ]
    return max(pulls, default=0.0)


def _solve(drive: Drive, settings: Settings, front: Front | None) -> tuple[Problem, Solution]:
    """Solve a drive with all its sensors, without slip."""
    problem = build_problem(drive, settings, front)
    if front is not None:
        return solve_with_walls(problem, front, settings)
    return problem, optimise(problem, settings)


def solve_with_trust(drive: Drive, settings: Settings) -> tuple[Problem, Solution, dict[str, str]]:
    """Solve a drive, and where its sensors contradict each other, without each heading sensor.

    Returns the problem and solution without what was left out, and a note for each sensor left
    out, by its name. Wheels that slip are looked for before a heading sensor is doubted that only
    the wheels contradict, and after one that fixes or camera contradict. Costs one more solve a
    heading sensor, and only in a strained drive. Raises FglocError where the drive cannot be
    smoothed (no overlap, undetermined wheels, numbers so far apart that nothing can be computed
    from them).
    """
    try:
        return _solve_with_trust(drive, settings)
    except np.linalg.LinAlgError:
        raise FglocError(
            f"{drive.name} cannot be smoothed: a measurement or a sigma is off by orders of "
            "magnitude, so that rounding errors outweigh the rest; look for leaps in the data "
            "and for sigmas near zero"
        ) from None


def _solve_with_trust(drive: Drive, settings: Settings) -> tuple[Problem, Solution, dict[str, str]]:
    """Do the work of `solve_with_trust`; raises LinAlgError too."""
    drive, leaps = without_leaps(trim_to_truth(drive))
    problem, solution, notes = _solve_all(drive, settings)
    counts = dict(problem.counts)
    for one in leaps:
        if one.sensor in counts:
            used, rejected = counts[one.sensor]
            counts[one.sensor] = (used, rejected + one.count)
    told = tuple(one.note for one in leaps)
    return replace(problem, counts=counts, notes=(*problem.notes, *told)), solution, notes


def _solve_all(drive: Drive, settings: Settings) -> tuple[Problem, Solution, dict[str, str]]:
    """Solve a drive without leaps; see `solve_with_trust`."""
    front = look_around(drive)
    problem, solution = _solve(drive, settings, front)
    notes: dict[str, str] = {}
    looked = False
    suspects = [s.sensor for s in drive.sensors if isinstance(s, Yaw | YawRate)]
    for suspect in suspects:
        believed = strain(solution) < STRAINED and _doubted(solution) < AT_ODDS
        if not looked and believed:
            problem, solution = look_for_slip(problem, solution, settings)
            looked = True
        before, far = strain(solution), stretch(problem, solution)
        lost = _doubted(solution)
        own = bent(f"{suspect}_drift", problem.parameters, solution.point.u)
        arbiter = any(tells(t.kind, t.sensor) for t in problem.tables)
        own = own if arbiter else 0.0
        if before < STRAINED and far < STRETCHED and lost < AT_ODDS and own < STRANGE:
            continue
        less = replace(drive, sensors=tuple(s for s in drive.sensors if s.sensor != suspect))
        other, trial = _solve(less, settings, front)
        after = strain(trial)
        if before >= STRAINED and after < GAIN * before:
            notes[suspect] = (
                f"{suspect} contradicts the absolute sensors and was left out: without it "
                f"their mean cost falls from {before:.3g} to {after:.3g} (0.5 is right)"
            )
        elif far >= STRETCHED and stretch(other, trial) < 0.5 * far:
            notes[suspect] = (
                f"{suspect} could only be right if the robot's calibration were {far:.1f} "
                "prior sigmas from nominal, and was left out; if the robot is like that, say so "
                "with --robot"
            )
        elif lost >= AT_ODDS and _doubted(trial) < GAIN * lost:
            notes[suspect] = (
                f"{suspect} contradicts the absolute sensors and was left out: without it "
                f"{_doubted(trial):.0%} of their factors are doubted, not {lost:.0%}"
            )
        elif own >= STRANGE and after <= before + SAME:
            notes[suspect] = (
                f"{suspect} could only be right if it drifted {own:.0f} prior sigmas fast, and was "
                "left out; if it does, say so in its noise"
            )
        if suspect in notes:
            drive, problem, solution = less, other, trial
            looked = False
    if not looked:
        problem, solution = look_for_slip(problem, solution, settings)
    freed = _with_free_scale(drive, settings, front, problem, solution)
    if freed is not None:
        problem, solution, note = freed
        problem = replace(problem, notes=(*problem.notes, note))
    return problem, solution, notes


def _with_free_scale(
    drive: Drive,
    settings: Settings,
    front: Front | None,
    problem: Problem,
    solution: Solution,
) -> tuple[Problem, Solution, str] | None:
    """Solve with a camera that may be off by a third in scale, where it bends the robot; or None.

    Wheels and a camera that disagree about distances by more than both their priors allow cannot
    both be right, and no gyro tells who is. A ruler measured the wheels; so it is taken to be the
    camera, and said that it may be otherwise. Where position fixes decide that it is, its prior is
    no longer believed: it would pull the scale back by several of its sigmas.
    """
    far = stretch(problem, solution)
    cameras = [s for s in drive.sensors if isinstance(s, CameraPoses) and s.scale_sigma > 0.0]
    scales = [f"{s.sensor}_scale" for s in cameras]
    own = [bent(name, problem.parameters, solution.point.u) for name in scales]
    if not cameras or max(far, *own) < STRETCHED:
        return None
    wide = tuple(
        replace(s, scale_sigma=max(s.scale_sigma, FREE_SCALE)) if s in cameras else s
        for s in drive.sensors
    )
    other, trial = _solve(replace(drive, sensors=wide), settings, front)
    other, trial = look_for_slip(other, trial, settings)
    if far >= STRETCHED and stretch(other, trial) > 0.5 * far:
        return None
    names = [p.name for p in other.parameters]
    values = [other.parameters[k].to_value(trial.point.u[k]) for k in map(names.index, scales)]
    told = ", ".join(f"{n} is {v:.3f}" for n, v in zip(scales, values, strict=True))
    who = " and ".join(s.sensor for s in cameras)
    if far >= STRETCHED:
        return other, trial, scale_note(who, far, told)
    return (
        other,
        trial,
        f"{who} measures ways {max(own):.0f} prior sigmas too long or too short; its scale was "
        f"freed, and {told}",
    )


def scale_note(who: str, far: float, told: str) -> str:
    """Return what a user should know of a camera whose scale was freed."""
    return (
        f"{who} could only be right in scale if the robot's calibration were {far:.1f} prior "
        f"sigmas from nominal; its scale was freed, and {told} if the wheels are as described; "
        "position fixes would tell"
    )
