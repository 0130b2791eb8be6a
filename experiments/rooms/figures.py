"""Figures of the simulated rooms: the maps of one seed over the true walls, errors over seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from fgloc.experiments.rooms.runs import ENTRANTS, Score
from fgloc.report.experiment_report import Figure
from fgloc.report.plot_rooms import Room, plot_rooms

Found = Mapping[str, Mapping[str, Sequence[Score]]]
"""Scores by world and entrant, one for each seed."""


def maps_figure(found: Found) -> Figure:
    """Return walls and paths of the first seed, a row of panels a world, a column an entrant."""

    def draw(path: Path) -> Path:
        from fgloc.datasets.registry import load_drive
        from fgloc.datasets.simulator.worlds import load_world

        rows = []
        for world, scores in found.items():
            walls = load_world(world).walls
            row = []
            for entrant in ENTRANTS:
                score = scores[entrant.id][0]
                if score.trajectory is None:
                    continue
                truth = load_drive(score.job.drive).truth
                assert truth is not None
                row.append(
                    Room(
                        f"{world}: {entrant.title}",
                        entrant.method,
                        walls,
                        truth.trajectory.poses,
                        score.trajectory.poses,
                        None if score.walls is None else score.walls.ends,
                    )
                )
            rows.append(row)
        return plot_rooms(rows, "Maps and paths, seed 1, nothing aligned", path)

    return Figure(
        "maps",
        "Maps and paths of seed 1; grey are the true walls and the true path. Walls of EKF-SLAM "
        "are the points of its state, as long as what was seen of them.",
        draw,
    )
