"""Figures of seed D: paths of one drive of each motion, bars of all errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fgloc.experiments.seed_d.runs import ENTRANTS, Score, load
from fgloc.experiments.seed_d.tables import AXES
from fgloc.report.experiment_report import Figure
from fgloc.report.plot_bars import Bars, plot_bars
from fgloc.report.plot_experiment import Paths, plot_paths

DRAWN = ("model1", "pose-ekf", "batch", "online")
"""Methods whose paths are drawn: those with the nominal robot."""
ACROSS = 3
"""Panels in a row."""


def paths_figure(scores: Mapping[str, Sequence[Score]], data: Path | None) -> Figure:
    """Return the paths of one drive of each motion."""

    def draw(path: Path) -> Path:
        panels = []
        kept = {
            name: {s.run: s.trajectory for s in scores[name] if s.trajectory is not None}
            for name in DRAWN
        }
        for run in kept["batch"]:
            drive = load(run, None, data)
            assert drive.truth is not None
            paths = {name: found[run].poses for name, found in kept.items() if run in found}
            title = f"{drive.motion}, run {run}"
            panels.append(Paths(title, paths, drive.truth.trajectory.poses))
        rows = [panels[k : k + ACROSS] for k in range(0, len(panels), ACROSS)]
        return plot_paths(rows, "Recorded drives, SEMI-REAL camera and gyro, seed 1", path)

    return Figure(
        "paths",
        "One drive of each motion with SEMI-REAL sensors of seed 1; all methods start from the "
        "nominal robot.",
        draw,
    )


def bars_figure(scores: Mapping[str, Sequence[Score]]) -> Figure:
    """Return the errors of every motion and method."""

    def draw(path: Path) -> Path:
        shown = [e for e in ENTRANTS if e.id in scores and e.method != "model1"]
        motions = list(dict.fromkeys(s.motion for s in scores["batch"]))
        panels = []
        for a, (key, unit) in enumerate(AXES):
            values = {e.title: [_by_seed(scores[e.id], m, a) for m in motions] for e in shown}
            panels.append(Bars(f"largest error of {key} [m{unit}]", values))
        shades = {e.title: (e.method, e.calibrated, e.tuned) for e in shown}
        title = "Largest errors by motion, SEMI-REAL: mean and central 95 % over seeds"
        return plot_bars(panels, motions, shades, title, path)

    return Figure(
        "motions",
        "Largest error of a run in every motion, mean over runs; bars are the mean over seeds, "
        "lines hold 95 % of them; pale bars start from the calibrated robot, the noise of hatched "
        "ones is tuned.",
        draw,
    )


def _by_seed(scores: Sequence[Score], motion: str, axis: int) -> np.ndarray:
    """Return (S,) mean largest errors over the runs of a motion, in thousandths."""
    seeds: dict[int | None, list[float]] = {}
    for score in scores:
        if score.motion == motion:
            seeds.setdefault(score.seed, []).append(1e3 * score.e_max[axis])
    return np.array([np.mean(values) for values in seeds.values()])
