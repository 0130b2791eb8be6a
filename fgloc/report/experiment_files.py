"""The files of one experiment: settings, report in three forms, figures, trajectories."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fgloc import __version__
from fgloc.atomic import write_text
from fgloc.core.trajectory_io import save_trajectory
from fgloc.report.experiment_html import html
from fgloc.report.experiment_json import report_json
from fgloc.report.experiment_report import Report
from fgloc.report.experiment_text import markdown
from fgloc.report.results_json import dumps
from fgloc.report.rundir import RunDir

README = """\
settings.json            what was asked for, and everything that determines the numbers
report.html, report.md   tables, explanations and figures
report.json              all numbers
figures/*.png            figures
trajectories/**/*.tum    trajectories of base_link: time, x, y, z, quaternion
"""


def write_experiment(
    name: str,
    report: Report,
    out: str | Path,
    arguments: Mapping[str, Any],
    tell: Callable[[int, int, str], None] | None = None,
) -> Path:
    """Write a run folder below `out` and return it; `tell` hears how many figures are drawn.

    The folder appears whole, or not at all. Raises FglocError if it cannot be written.
    """
    with RunDir.create(out) as run:
        settings = {
            "fgloc_version": __version__,
            "command": "experiments run",
            "experiment": name,
            **arguments,
            "settings": dict(report.settings),
        }
        write_text(run.file("settings.json"), dumps(settings))
        write_text(run.file("README.txt"), README)
        figures: list[tuple[str, str]] = []
        for k, figure in enumerate(report.figures, 1):
            path = f"figures/{figure.name}.png"
            figure.draw(run.file(path))
            figures.append((path, figure.caption))
            if tell is not None:
                tell(k, len(report.figures), figure.name)
        for key, trajectory in report.trajectories.items():
            save_trajectory(trajectory, run.file(f"trajectories/{key}.tum"))
        write_text(run.file("report.json"), dumps(report_json(name, report)))
        write_text(run.file("report.md"), markdown(report, figures))
        write_text(run.file("report.html"), html(report, figures, __version__))
    return run.path
