"""What is calibrated on what, and judged on what: one case is one fit.

Drives are named by patterns and halved by rules, so that whatever part of a recording family is on
a machine gives a case.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from fgloc.calibration.calibrate import CalibrationSettings, calibrate
from fgloc.calibration.result import CalibrationReport, DriveError
from fgloc.datasets.registry import expand, load_drive
from fgloc.errors import FglocError


@dataclass(frozen=True)
class Case:
    """One fit and what it is judged by."""

    group: str
    """Table that it belongs to."""
    title: str
    """What is fitted."""
    fit: tuple[str, ...]
    """Ids of the drives of the fit."""
    judged: tuple[str, ...]
    """Ids of the drives that it is judged on."""
    model: str | None = None
    """Model, None for the one that the drives choose."""


@dataclass(frozen=True)
class Outcome:
    """What came of a case."""

    case: Case
    """The case."""
    report: CalibrationReport
    """The calibration, with its errors on the drives it is judged on."""

    def of(self, motion: str | None = None) -> list[DriveError]:
        """Return the errors on drives of a motion, of all without one."""
        return [e for e in self.report.evaluation if motion is None or e.motion == motion]


def run_case(job: tuple[Case, Path | None]) -> Outcome:
    """Return what came of a case. Raises FglocError as `calibrate` does."""
    case, data = job
    fit = [load_drive(name, data) for name in case.fit]
    judged = [load_drive(name, data) for name in case.judged]
    return Outcome(case, calibrate(fit, judged, CalibrationSettings(model=case.model)))


def describe(job: tuple[Case, Path | None]) -> str:
    """Return what a case is, for a line of progress."""
    return f"{job[0].group}: {job[0].title}"


def swerve_cases(data: Path | None) -> list[Case]:
    """Return the swerve robot fitted on all repetitions but one, judged on that one."""
    from fgloc.datasets.vitko_swerve import REPETITIONS

    drives = expand(["vitko-swerve:*"], data)
    repetition = {d: (int(d.partition(":")[2]) - 1) % REPETITIONS + 1 for d in drives}
    found = []
    for out in sorted(set(repetition.values()), reverse=True):
        fit = tuple(d for d in drives if repetition[d] != out)
        judged = tuple(d for d in drives if repetition[d] == out)
        for model in ("fixed-steering", "geometry", None):
            title = f"without repetition {out}"
            if fit:
                found.append(Case("swerve", title, fit, judged, model))
    return found


def optiodom_cases(data: Path | None) -> list[Case]:
    """Return two robots fitted on squares, and the omni ones on half of the runs of every path."""
    found = []
    for robot in ("diff", "tricyc"):
        rest = _there([f"optiodom:{robot}/circular/*", f"optiodom:{robot}/free/*"], data)
        squares = _there([f"optiodom:{robot}/square/*"], data)
        if squares and rest:
            found.append(Case("optiodom", f"{robot}, fitted on squares", squares, rest))
    for robot in ("omni3", "omni4"):
        paths = (f"optiodom:{robot}/{path}/*" for path in ("circular", "square", "joystick"))
        numbered = [(k, r) for runs in (_there([p], data) for p in paths) for k, r in _places(runs)]
        for name, inside in HALVES.items():
            fit = tuple(r for k, r in numbered if inside(*k))
            judged = tuple(r for k, r in numbered if not inside(*k))
            if fit and judged:
                found.append(Case("optiodom", f"{robot}, fitted on {name} runs", fit, judged))
    return found


def _places(runs: Sequence[str]) -> list[tuple[tuple[int, int], str]]:
    """Return the runs of a path, each with its index and their number."""
    return [((k, len(runs)), run) for k, run in enumerate(runs)]


HALVES: dict[str, Callable[[int, int], bool]] = {
    "odd": lambda k, n: k % 2 == 0,
    "even": lambda k, n: k % 2 == 1,
    "the first": lambda k, n: 2 * k < n,
    "the last": lambda k, n: 2 * k >= n,
}
"""Ways to halve the runs of a path: index and number of runs to whether it is of the fit."""


def other_cases(data: Path | None) -> list[Case]:
    """Return the skid-steer robot on its one drive and on a third of it, and the mecanum robot."""
    jackal = "jackal-jackass:0"
    third, rest = f"cut:{jackal}?end=33.3%", f"cut:{jackal}?begin=33.3%"
    found = [
        Case("jackal", "whole drive, judged on itself", (jackal,), (jackal,)),
        Case("jackal", "first third, judged on the rest", (third,), (rest,)),
    ]
    bags = _there(["polimi-mecanum:*"], data)
    for fit in bags:
        for judged in bags:
            title = f"fitted on {fit.partition(':')[2]}, judged on {judged.partition(':')[2]}"
            found.append(Case("polimi", title, (fit,), (judged,)))
    return found


def sensor_cases(data: Path | None) -> list[Case]:
    """Return the robots without a truth: ground by ground, and two wheels with a laser."""
    found = []
    for ground in ("ASPHALT", "FLOORING", "ICE"):
        fit = _there([f"borealtc-husky:{ground}/*"], data)
        if fit:
            found.append(Case("surfaces", f"Husky, {ground.lower()}", fit, ()))
    for drive in _there(["penn-skidsteer:*"], data):
        found.append(Case("surfaces", f"Penn, run {drive.partition(':')[2]}", (drive,), ()))
    for run in ("lmov", "lstraight"):
        fit = _there([f"censi-calibration:{run}"], data)
        if fit:
            found.append(Case("censi", run, fit, ()))
    return found


def _there(patterns: Sequence[str], data: Path | None) -> tuple[str, ...]:
    """Return the drives of patterns; those without any are left out."""
    found: list[str] = []
    for pattern in patterns:
        try:
            found += expand([pattern], data)
        except FglocError:
            continue
    return tuple(found)
