"""Several methods on the same drives: same measurements, same start, same scores."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from fgloc.core.drive import Drive
from fgloc.core.encoder_selection import select_encoders
from fgloc.core.evaluation import evaluate
from fgloc.core.geometry import Integrator
from fgloc.core.start import trim_to_truth
from fgloc.core.totals import totals
from fgloc.datasets.registry import expand, load_drive
from fgloc.errors import FglocError
from fgloc.estimator import Estimator, calibrated_mount, run
from fgloc.experiments.fixes import FixSpec, with_fixes
from fgloc.experiments.methods import create, parse
from fgloc.io.topics import load_topics
from fgloc.report.outcomes import (
    Comparison,
    DriveOutcome,
    MethodOutcome,
    Settings,
)
from fgloc.robot_file import apply_robot_file


@dataclass(frozen=True)
class Step:
    """One finished piece of a comparison, for a progress display."""

    done: int
    """How many pairs of drive and method are finished."""
    total: int
    """How many there are."""
    drive: str
    """Id of the drive."""
    method: str
    """Id of the method; empty after reading a drive."""
    outcome: str
    """Time taken, or why the method was skipped."""


Progress = Callable[[Step], None]

WARM_UP = 50
"""Number of wheel increments that methods are tried on before the clock runs."""


def compare(
    drives: Iterable[str],
    methods: str | Sequence[str],
    *,
    fixes: FixSpec | None = None,
    seed: int = 0,
    robot_file: str | Path | None = None,
    encoder_selection: bool = False,
    integrator: Integrator = "exact",
    data: Path | None = None,
    topics_file: Path | None = None,
    progress: Progress | None = None,
    estimators: Mapping[str, Estimator] | None = None,
    ekf_file: str | None = None,
    check: Callable[[Drive], None] | None = None,
) -> Comparison:
    """Return the outcome of every method on every drive named.

    `drives` may hold patterns (see `fgloc.datasets.registry.expand`). Every drive is read once,
    all of them before the first method runs, so that a file that cannot be read is known at once.
    `fixes` adds sparse position fixes made from the truth; `robot_file` replaces the drives' own
    description; `encoder_selection` leaves one encoder a side to all methods (see
    `fgloc.core.encoder_selection`); `topics_file` says which topic of ROS bags is what; `progress`
    is told after each drive and method; `estimators` are taken by method id in place of those with
    default settings; `ekf_file` is where one of them was configured, for the record; `check` is
    called with each drive before the first method runs, to refuse it. Raises FglocError for a
    drive that cannot be read or whose encoders cannot be selected, a method that does not exist,
    or if no method can run on any drive.
    """
    ids = parse(methods)
    names = expand(list(drives), data)
    loaded: list[Drive] = []
    topics = None if topics_file is None else load_topics(topics_file)
    for name in names:
        drive = load_drive(name, data, topics)
        loaded.append(prepared(drive, robot_file, encoder_selection, fixes, seed))
        if check is not None:
            check(loaded[-1])
        if progress is not None:
            progress(Step(0, len(names) * len(ids), name, "", "read"))
    settings = Settings(
        integrator,
        None if fixes is None else (fixes.every_s, fixes.sigma_m),
        seed,
        None if robot_file is None else str(robot_file),
        None if topics_file is None else str(topics_file),
        ekf_file,
        encoder_selection,
    )
    return compare_drives(
        loaded, ids, settings, integrator=integrator, progress=progress, estimators=estimators
    )


def compare_drives(
    drives: Sequence[Drive],
    methods: Sequence[str],
    settings: Settings,
    *,
    integrator: Integrator = "exact",
    progress: Progress | None = None,
    estimators: Mapping[str, Estimator] | None = None,
) -> Comparison:
    """Return the outcome of every method on drives that are already read; see `compare`.

    A method that cannot run on a drive is skipped there with its reason.
    """
    usual = {method: create(method, integrator=integrator) for method in methods}
    if drives:
        _warm_up(list(usual.values()), drives[0])
    chosen = {**usual, **(estimators or {})}
    outcomes: list[DriveOutcome] = []
    done = 0
    for drive in drives:
        found: dict[str, MethodOutcome] = {}
        skipped: dict[str, str] = {}
        for method, estimator in chosen.items():
            try:
                result = run(estimator, drive)
            except FglocError as error:
                skipped[method] = str(error)
            else:
                if drive.truth is None:
                    found[method] = MethodOutcome(result, None)
                else:
                    mount = calibrated_mount(result.calibration, drive.truth)
                    scores = evaluate(result.trajectory, drive.truth, mount)
                    found[method] = MethodOutcome(result, scores, mount)
            done += 1
            if progress is not None:
                text = f"{found[method].result.seconds:.2f} s" if method in found else "skipped: "
                text += skipped.get(method, "")
                progress(Step(done, len(drives) * len(chosen), drive.name, method, text))
        outcomes.append(DriveOutcome(drive, found, skipped))
    if not any(o.methods for o in outcomes):
        raise FglocError(_reasons(outcomes))
    total = {}
    for method in methods:
        scored = [
            (o.drive.motion, o.methods[method].evaluation) for o in outcomes if method in o.methods
        ]
        rows = [(motion, e) for motion, e in scored if e is not None]
        if rows:
            total[method] = totals(rows)
    return Comparison(tuple(methods), tuple(outcomes), total, settings)


def _reasons(outcomes: Sequence[DriveOutcome]) -> str:
    """Return why no method could run, each reason once even if it names another drive."""
    reasons: dict[str, list[str]] = {}
    for outcome in outcomes:
        for reason in outcome.skipped.values():
            reasons.setdefault(reason.replace(outcome.drive.name, ""), []).append(reason)
    if not reasons:
        return "there is no drive to run on"
    return "; ".join(
        r[0] if len(r) == 1 else f"{r[0]} (so on {len(r)} drives)" for r in reasons.values()
    )


def _warm_up(estimators: Sequence[Estimator], drive: Drive) -> None:
    """Let each estimator load its libraries and kernels, so that the times are the methods' own."""
    try:
        trimmed = trim_to_truth(drive)
    except FglocError:
        return
    wheels = trimmed.wheels
    n = min(WARM_UP, wheels.angles.shape[0])
    short = wheels.between(0, n)
    for estimator in estimators:
        # Whatever goes wrong on such a short piece is no concern here; the real run will tell.
        with contextlib.suppress(Exception):
            estimator.estimate(replace(trimmed, wheels=short))


def prepared(
    drive: Drive,
    robot_file: str | Path | None,
    encoder_selection: bool,
    fixes: FixSpec | None,
    seed: int,
) -> Drive:
    """Return the drive with the robot file's description, encoders selected, and with fixes."""
    if robot_file is not None:
        drive = apply_robot_file(drive, robot_file)
    if encoder_selection:
        drive = select_encoders(drive)
    if fixes is not None:
        drive = with_fixes(drive, fixes.every_s, fixes.sigma_m, seed)
    return drive
