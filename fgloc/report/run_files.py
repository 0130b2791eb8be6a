"""The files of one run: settings, robots, trajectories, figures, report as JSON and Markdown."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fgloc import __version__
from fgloc.atomic import write_text
from fgloc.config import robot_toml
from fgloc.core.trajectory_io import save_trajectory
from fgloc.report.map_files import MapFiles, write_map
from fgloc.report.outcomes import Comparison, DriveOutcome
from fgloc.report.results_json import comparison_json, dumps
from fgloc.report.rundir import RunDir
from fgloc.report.tables import markdown

README = """\
settings.json        what was asked for
report.md            tables and figures
report.json          all numbers
DRIVE/robot.toml     the robot as it was described before anything was estimated
DRIVE/METHOD.tum     trajectory of base_link: time, x, y, z, quaternion
DRIVE/truth.tum      the recorded truth, in its own frame
DRIVE/*.png          figures
DRIVE/map.*          with --map: figure, GeoJSON, scan points, occupancy grid
"""


def write_run(
    comparison: Comparison,
    out: str | Path,
    command: str,
    arguments: Mapping[str, Any],
    tell: Callable[[int, int, str], None] | None = None,
    map_resolution: float | None = None,
) -> tuple[Path, list[MapFiles]]:
    """Write a run folder below `out`; return it, and the maps in it.

    `tell` hears how many drives are written; with `map_resolution` (side of a cell [m]) the map of
    each drive's first method is written too. The folder appears whole, or not at all. Raises
    FglocError if it cannot be written, or a map cannot be made.
    """
    maps: dict[str, MapFiles] = {}
    names = folder_names([outcome.drive.name for outcome in comparison.drives])
    with RunDir.create(out) as run:
        settings = {"fgloc_version": __version__, "command": command, **arguments}
        write_text(run.file("settings.json"), dumps(settings))
        write_text(run.file("README.txt"), README)
        figures: list[str] = []
        for k, (name, outcome) in enumerate(zip(names, comparison.drives, strict=True), 1):
            _write_trajectories(outcome, run, name)
            drawn = draw_figures(outcome, run.file(f"{name}/trajectory.png").parent)
            figures += [f"{name}/{path.name}" for path in drawn]
            if map_resolution is not None and outcome.methods:
                result = next(iter(outcome.methods.values())).result
                folder = run.file(f"{name}/map.png").parent
                maps[name] = write_map(result, outcome.drive, folder, map_resolution)
                figures.append(f"{name}/map.png")
            if tell is not None:
                tell(k, len(names), f"{outcome.drive.name} figures")
        write_text(run.file("report.json"), dumps(comparison_json(comparison)))
        write_text(run.file("report.md"), markdown(comparison, f"fgloc {command}", figures))
    # The folder has got its final name.
    return run.path, [replace(made, folder=run.path / name) for name, made in maps.items()]


def draw_figures(outcome: DriveOutcome, folder: Path) -> list[Path]:
    """Draw all figures of one drive into `folder`, which exists; return what was drawn."""
    from fgloc.report.plot_estimate import plot_calibration, plot_residuals, plot_turning
    from fgloc.report.plot_trajectory import plot_errors, plot_trajectory

    drawn = [
        plot_trajectory(outcome, folder / "trajectory.png"),
        plot_errors(outcome, folder / "errors.png"),
        plot_turning(outcome, folder / "turning.png"),
    ]
    for method, found in outcome.methods.items():
        drawn.append(plot_calibration(found.result, folder / f"calibration-{method}.png"))
        drawn.append(plot_residuals(found.result, folder / f"residuals-{method}.png"))
    return [path for path in drawn if path is not None]


def folder_names(drives: Sequence[str]) -> list[str]:
    """Return a folder name for each drive id: safe characters, all different, none hidden."""
    names: list[str] = []
    for drive in drives:
        name = re.sub(r"[^A-Za-z0-9.=_-]+", "_", drive).strip("._") or "drive"
        # The end tells runs of one dataset apart; file systems allow 255 bytes.
        name = name[-150:]
        number, free = 2, name
        while free in names:
            free, number = f"{name}-{number}", number + 1
        names.append(free)
    return names


def _write_trajectories(outcome: DriveOutcome, run: RunDir, name: str) -> None:
    """Write the robot, the truth and every method's trajectory."""
    drive = outcome.drive
    write_text(run.file(f"{name}/robot.toml"), robot_toml(drive.robot))
    if drive.truth is not None:
        save_trajectory(drive.truth.trajectory, run.file(f"{name}/truth.tum"))
    for method, found in outcome.methods.items():
        save_trajectory(found.result.trajectory, run.file(f"{name}/{method}.tum"))
