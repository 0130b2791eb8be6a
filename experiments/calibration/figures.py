"""Figures of the calibrations: paths before and after, and turns that spins and arcs ask for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fgloc.calibration.evaluate import before_and_after
from fgloc.datasets.registry import load_drive
from fgloc.experiments.calibration.cases import Outcome
from fgloc.report.experiment_report import Figure
from fgloc.report.plot_calibration import open_loop_panel, plot_panels
from fgloc.report.plot_experiment import Paths


def paths_figure(outcomes: Sequence[Outcome], data: Path | None) -> Figure:
    """Return the open-loop paths of the drive of median error of every fit that chose its model."""

    def draw(path: Path) -> Path:
        shown = [o for o in outcomes if o.case.model is None and o.report.evaluation]
        return plot_panels([_panel(o, data) for o in shown], path)

    return Figure(
        "paths",
        "Wheels alone on the judged drive of median error: nominal, calibrated, and the truth.",
        draw,
    )


def _panel(o: Outcome, data: Path | None) -> Paths:
    """Return the paths on the judged drive of median error after calibration."""
    order = sorted(o.report.evaluation, key=lambda e: e.value.ate_rmse_m)
    middle = order[len(order) // 2].drive
    title = f"{o.case.group}: {middle.partition(':')[2]}"
    return open_loop_panel(load_drive(middle, data), o.report, title)


def residual_figure(outcomes: Sequence[Outcome], data: Path | None) -> Figure:
    """Return how much more the swerve robot turns than its calibrated geometry says, by motion."""

    def draw(path: Path) -> Path:
        from fgloc.report.figures import new_figure, save

        figure = new_figure(7.0, 4.0)
        axes = figure.subplots()
        shown = [
            o
            for o in outcomes
            if o.case.group == "swerve"
            and o.case.title.endswith(" 3")
            and o.case.model != "fixed-steering"
        ]
        for k, o in enumerate(shown):
            ways, turns = [], []
            for name in o.case.judged:
                drive = load_drive(name, data)
                found = before_and_after(drive, o.report)["calibrated"]
                wheels, truth = found.trajectory, found.truth.trajectory.poses
                told = wheels.poses[-1, 2] - wheels.poses[0, 2]
                turned = np.unwrap(truth[:, 2])
                way = float(np.sum(np.hypot(*np.diff(wheels.poses[:, :2], axis=0).T)))
                if abs(told) > 1.0:
                    ways.append(way / abs(told))
                    turns.append(100.0 * ((turned[-1] - turned[0]) / told - 1.0))
            label = f"{o.report.model}"
            axes.plot(ways, turns, "os"[k % 2], label=label)
        axes.axhline(0.0, color="0.7", lw=0.8)
        axes.set_xlabel("radius of the path [m]")
        axes.set_ylabel("true turn more than told [%]")
        axes.set_title("Swerve robot, repetition 3: turns in spins and on arcs")
        axes.legend(frameon=False)
        return save(figure, path)

    return Figure(
        "turns",
        "How much more the swerve robot turned than its calibrated wheels say, spins at the left "
        "and circles at the right: one static geometry cannot have both.",
        draw,
    )
