"""Figures of seed A's simulated cases; nothing is drawn before a figure is asked for."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fgloc.experiments.seed_a.published import CASES, POSITION, SCALES, TABLES
from fgloc.experiments.seed_a.runs import SMOOTHED_TRACK, Ends, Entrant, Scenario, drive_id
from fgloc.experiments.seed_a.start_scan import Start, plot_scan
from fgloc.experiments.seed_a.tables import TRUE_TRACK, values
from fgloc.report.experiment_report import Figure
from fgloc.report.plot_experiment import (
    Curves,
    Draws,
    Paths,
    plot_curves,
    plot_draws,
    plot_paths,
)


def draws_figure(noise: Scenario, who: Sequence[Entrant], ends: Ends) -> Figure:
    """Return the distributions of scenario 2 with the printed draws marked."""

    def draw(path: Path) -> Path:
        rows = []
        for printed in TABLES:
            if printed.scenario != "noise":
                continue
            shown = [e for e in who if e.id in (printed.method, "batch", "online")]
            rows.append(
                [
                    Draws(
                        f"{case}, {printed.id.replace('-', ' ')}",
                        {
                            e.id: values(ends[noise.key, case, e.id], POSITION, SCALES[case])
                            for e in shown
                        },
                        float(printed.cells[case, POSITION]),
                        printed.method,
                    )
                    for case in CASES
                ]
            )
        title = f"Scenario 2, noise of encoders and yaw: {noise.seeds} seeds"
        return plot_draws(rows, "m", title, path)

    return Figure(
        "noise-draws",
        "Scenario 2: each tick is a seed, the box holds half of them, the line 95 %; the printed "
        "number is one draw.",
        draw,
    )


def scenario5_figure(scenario: Scenario, who: Sequence[Entrant], ends: Ends) -> Figure:
    """Return the distributions of scenario 5."""

    def draw(path: Path) -> Path:
        row = [
            Draws(
                case,
                {e.id: values(ends[scenario.key, case, e.id], POSITION, SCALES[case]) for e in who},
            )
            for case in CASES
        ]
        title = f"Scenario 5, slip of 20 % with noise of encoders and yaw: {scenario.seeds} seeds"
        return plot_draws([row], "m", title, path)

    return Figure(
        "slip-noise-draws",
        "Scenario 5: slip of 20 % with noise; each tick is a seed.",
        draw,
    )


def paths_figure(
    scenarios: Sequence[tuple[Scenario, str]], who: Sequence[Entrant], ends: Ends
) -> Figure:
    """Return the paths of the drives with slip, by method."""

    def draw(path: Path) -> Path:
        from fgloc.datasets.registry import load_drive

        rows = []
        for scenario, name in scenarios:
            row = []
            for case in CASES:
                truth = load_drive(drive_id(scenario, case, 1, None)).truth
                assert truth is not None
                paths = {}
                for e in who:
                    found = ends[scenario.key, case, e.id][0].trajectory
                    if found is not None:
                        paths[e.id] = found.poses
                row.append(Paths(f"{case}, {name}", paths, truth.trajectory.poses))
            rows.append(row)
        return plot_paths(rows, "Paths with slipping wheels (online: as emitted)", path)

    return Figure(
        "slip-paths",
        "Paths by method where wheels slip: two wheels by 20 %, the same by 40 counts a packet, "
        "both left wheels by 20 %. Online is drawn as emitted: it jumps where slip is found.",
        draw,
    )


def track_figure(scenarios: Sequence[tuple[Scenario, str]], ends: Ends) -> Figure:
    """Return the effective track over time: Model 3 as it goes, batch for the whole drive."""

    def draw(path: Path) -> Path:
        from fgloc.datasets.registry import load_drive
        from fgloc.filters.model3 import Model3

        rows = []
        for scenario, name in scenarios:
            row = []
            for case in CASES:
                history = Model3().history(load_drive(drive_id(scenario, case, 1, SMOOTHED_TRACK)))
                seconds = (history.stamps_ns - history.stamps_ns[0]) * 1e-9
                batch = ends[scenario.key, case, "batch"][0]
                row.append(
                    Curves(
                        f"{case}, {name}",
                        seconds,
                        {"model3": history.track, "batch": np.array([batch.track])},
                        {"model3": history.track_sigma, "batch": np.array([batch.track_sigma])},
                        TRUE_TRACK[case],
                    )
                )
            rows.append(row)
        title = "Effective track, started at 0.48 m: Model 3 over time, batch for the whole drive"
        return plot_curves(rows, "effective track [m]", title, path)

    return Figure(
        "effective-track",
        "Effective track with ±2σ: Model 3 over time, batch for the whole drive; dashed is the "
        "truth.",
        draw,
    )


def scan_figure(starts: list[Start]) -> Figure:
    """Return the evidence on Model 3's circle."""
    return Figure(
        "model3-start",
        "Model 3 in the circle: each dot is one initial track (colour) and initial sigma (along a "
        "grey line, 0 to 0.5 m); the star is the printed pair of Tables 3.5 and 3.6.",
        functools.partial(plot_scan, starts),
    )
