"""The run folder of a calibration: robot file, numbers, report, figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from fgloc import __version__
from fgloc.atomic import write_text
from fgloc.calibration.result import CalibrationReport
from fgloc.calibration.robot_toml import calibration_toml
from fgloc.core.drive import Drive
from fgloc.report.calibration_json import calibration_json
from fgloc.report.calibration_report import calibration_text
from fgloc.report.plot_calibration import (
    plot_correlations,
    plot_open_loop,
    plot_open_loop_errors,
    plot_parameters,
)
from fgloc.report.results_json import dumps
from fgloc.report.rundir import RunDir

README = """\
settings.json      what was asked for
report.txt         what was printed
report.json        all numbers
robot.toml         the calibrated robot, for --robot
parameters.png     every parameter before and after, in sigmas of its prior
correlations.png   correlation of what was found
paths.png          wheels alone before and after, against the truth
errors.png         their errors over time
"""


def write_calibration(
    report: CalibrationReport,
    drives: Sequence[Drive],
    out: str | Path,
    arguments: Mapping[str, Any],
    tell: Callable[[int, int, str], None] | None = None,
) -> Path:
    """Write a run folder below `out` and return it; it appears whole, or not at all.

    `drives` are drawn: those evaluated. Raises FglocError if it cannot be written.
    """
    known = [d for d in drives if d.truth is not None]
    with RunDir.create(out) as run:
        settings = {"fgloc_version": __version__, "command": "calibrate", **arguments}
        write_text(run.file("settings.json"), dumps(settings))
        write_text(run.file("README.txt"), README)
        write_text(run.file("report.txt"), calibration_text(report))
        write_text(run.file("report.json"), dumps(calibration_json(report)))
        write_text(run.file("robot.toml"), calibration_toml(report))
        figures: list[Callable[[], Path]] = [
            lambda: plot_parameters(report, run.file("parameters.png")),
            lambda: plot_correlations(report, run.file("correlations.png")),
        ]
        if known:
            figures += [
                lambda: plot_open_loop(known, report, run.file("paths.png")),
                lambda: plot_open_loop_errors(known, report, run.file("errors.png")),
            ]
        for k, draw in enumerate(figures, 1):
            path = draw()
            if tell is not None:
                tell(k, len(figures), path.stem)
    return run.path
