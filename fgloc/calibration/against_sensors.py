"""Calibration against what a drive's own sensors measured, or its wheels against each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fgloc.calibration.censi import NAMES, displacements_of, solve
from fgloc.calibration.graph import Tell, fit_graph
from fgloc.calibration.models import GEOMETRY, choice
from fgloc.calibration.result import CalibrationReport, calibrated_robot
from fgloc.core.drive import Drive
from fgloc.core.measurements import CameraPoses
from fgloc.errors import FglocError
from fgloc.estimator import calibration_of
from fgloc.factors.slip import redundant

ALONE = "wheels alone"
"""The reference of drives without any sensor."""


def against_sensors(
    drives: Sequence[Drive], model: str | None, tell: Tell | None = None
) -> CalibrationReport:
    """Return the calibration from one graph of all drives and their sensors, not evaluated.

    `model` is the id of a kinematic model, None for the geometry: how far an open-loop path would
    be off is not known here, so that no choice is made. The search begins at the closed form of
    Censi et al. where there is one: two wheels and a camera or a matched laser. Raises FglocError
    where there is nothing to compare the wheels with, and as `fit_graph` does.
    """
    nominal = drives[0].robot
    made = choice(nominal, model or GEOMETRY)
    drives = [replace(d, robot=made.robot) for d in drives]
    start, condition, notes = _closed_form(drives)
    fit = fit_graph(drives, start=start, tell=tell)
    if not fit.sensors and not redundant(made.robot.base).size:
        raise FglocError(
            f"{drives[0].name} has nothing to compare its wheels with: no truth, camera, fixes, "
            "gyro or lidar, and no wheel that tells what another does; --fixes or --reference "
            "truth need a recorded truth"
        )
    estimates, covariance = calibration_of(fit.parameters, fit.u, fit.covariance)
    assert covariance is not None
    if not fit.converged:
        notes.append(f"the graph did not converge in {fit.rounds} rounds")
    return CalibrationReport(
        fit=tuple(d.name for d in drives),
        reference=", ".join(fit.sensors) or ALONE,
        model=made.id,
        nominal=nominal,
        robot=calibrated_robot(made.robot, estimates),
        parameters=estimates,
        covariance=covariance,
        residuals=fit.residuals,
        evaluation=(),
        closed_form=start,
        condition=condition,
        notes=(*notes, *fit.notes),
    )


def _closed_form(
    drives: Sequence[Drive],
) -> tuple[dict[str, float], float | None, list[str]]:
    """Return values by parameter name, the condition number, and why there are none, if so."""
    cameras = [d.each(CameraPoses) for d in drives]
    two = sorted(drives[0].robot.base.driven_names) == ["left", "right"]
    if not two or not all(cameras) or drives[0].robot.base.kind != "differential":
        return {}, None, []
    sensor = cameras[0][0].sensor
    try:
        parts = [displacements_of(d, sensor) for d in drives]
        angles, seconds, moved = (np.concatenate(p) for p in zip(*parts, strict=True))
        found = solve(angles, seconds, moved)
    except FglocError as error:
        return {}, None, [f"no closed form to begin with: {error}"]
    names = [n if "_" in n else f"{sensor}_{n}" for n in NAMES]
    values = dict(zip(names, (float(v) for v in found.values), strict=True))
    return values, found.condition, []
