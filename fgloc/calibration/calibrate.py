"""Calibrate a robot on some drives, and tell what that is worth on others."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from fgloc.calibration.advice import advice
from fgloc.calibration.against_sensors import against_sensors
from fgloc.calibration.evaluate import evaluate_drives
from fgloc.calibration.models import choice, choices, mounting, same_robot
from fgloc.calibration.path_fit import PathFit
from fgloc.calibration.paths import PathData, all_data
from fgloc.calibration.result import CalibrationReport, DriveResiduals, calibrated_robot
from fgloc.calibration.selection import Selected, select
from fgloc.core.drive import Drive
from fgloc.core.measurements import Floats
from fgloc.errors import FglocError
from fgloc.estimator import calibration_of

HEADINGS = ("heading [rad]", "turned angle [rad]")
"""First components of residuals that tell no distances."""
COMPONENTS = ("x [m]", "y [m]", "heading [rad]")
"""What is compared along an open-loop path."""


@dataclass(frozen=True)
class CalibrationSettings:
    """How to calibrate."""

    reference: Literal["auto", "truth", "sensors"] = "auto"
    """What the wheels are compared with: the recorded truth, the drive's own sensors, or the truth
    where all drives have one and the sensors otherwise."""
    model: str | None = None
    """Id of the model, e.g. "full-linear+rotation-scale"; None: the drives choose."""


def calibrate(
    fit: Sequence[Drive],
    evaluate: Sequence[Drive] = (),
    settings: CalibrationSettings | None = None,
    tell: Callable[[str], None] | None = None,
) -> CalibrationReport:
    """Return the robot of some drives, calibrated, and its errors on others.

    All drives must be of one robot. With a recorded truth, the wheels' open-loop paths are fitted
    to it (`fgloc.calibration.path_fit`), and the drives choose between the models that their base
    may have. Without one, or where the settings say so, it is their own sensors that the wheels are
    compared with, in one graph of all drives (`fgloc.calibration.graph`); `tell` hears of its
    progress. Raises FglocError for drives of different robots, without a reference, or whose
    wheels do not determine the motion.
    """
    settings = CalibrationSettings() if settings is None else settings
    if not fit:
        raise FglocError("no drive to calibrate on was given")
    drives, notes = same_robot([*fit, *evaluate])
    used, others = drives[: len(fit)], drives[len(fit) :]
    wanted = settings.reference
    if wanted == "auto":
        wanted = "truth" if all(d.truth is not None for d in used) else "sensors"
    begin = time.perf_counter()
    if wanted == "truth":
        report = _against_truth(used, settings)
    else:
        report = against_sensors(used, settings.model, tell)
    seconds = time.perf_counter() - begin
    # A gyro, a yaw sensor or the wheels alone tell of no distance.
    wheels = {d.wheels.sensor for d in used}
    places = wanted == "truth" or any(
        r.components[0] not in HEADINGS and r.sensor not in wheels for r in report.residuals
    )
    told = advice(report.robot, report.parameters, report.covariance, places=places)
    known = [d for d in others if d.truth is not None]
    for d in others:
        if d.truth is None:
            notes.append(f"{d.name} has no recorded truth, so nothing is evaluated on it")
    evaluation, before, after = evaluate_drives(known, report)
    return replace(
        report,
        advice=told,
        evaluation=evaluation,
        total_nominal=before,
        total_value=after,
        notes=(*notes, *report.notes),
        seconds=seconds,
    )


def _against_truth(drives: Sequence[Drive], settings: CalibrationSettings) -> CalibrationReport:
    """Return the calibration against recorded truth, not yet evaluated."""
    data = all_data(drives)
    robot = drives[0].robot
    offered = choices(robot) if settings.model is None else [choice(robot, settings.model)]
    mount = mounting([d.truth for d in drives if d.truth is not None])
    found = select(data, offered, mount)
    estimates, covariance = calibration_of(
        found.fit.model.parameters, found.fit.u, found.fit.covariance
    )
    assert covariance is not None
    began = {}
    if found.began is not None:
        model = found.fit.model
        values = model.values(found.began.u)
        began = {p.name: float(values[i]) for i, p in enumerate(model.robot.base.parameters)}
    return CalibrationReport(
        fit=tuple(d.name for d in drives),
        reference="truth",
        model=found.choice.id,
        nominal=robot,
        robot=calibrated_robot(found.choice.robot, estimates),
        parameters=estimates,
        covariance=covariance,
        residuals=_residuals(data, found.fit),
        evaluation=(),
        candidates=found.candidates,
        closed_form=began,
        condition=None if found.began is None else found.began.condition,
        clocks=found.clocks,
        notes=_notes(found),
    )


def _residuals(data: Sequence[PathData], fit: PathFit) -> tuple[DriveResiduals, ...]:
    """Return what is left of every path."""
    rows = []
    for d, r, weight in zip(data, fit.rows, fit.weights, strict=True):
        rms = np.sqrt(np.mean(r.residual**2, axis=0))
        assert d.drive.truth is not None
        rows.append(
            DriveResiduals(
                d.drive.name,
                d.drive.truth.sensor,
                COMPONENTS,
                _floats(rms),
                _floats(rms / fit.size),
                len(r.residual),
                float(weight),
            )
        )
    return tuple(rows)


def _floats(values: Floats) -> tuple[float, ...]:
    """Return an array as plain numbers."""
    return tuple(float(v) for v in values)


def _notes(found: Selected) -> tuple[str, ...]:
    """Return what a user should know of a fit."""
    notes = [*found.notes]
    if found.began is not None:
        notes += found.began.notes
    if not found.fit.converged:
        notes.append("the fit did not converge; give a better robot with --robot, or more drives")
    return tuple(notes)
