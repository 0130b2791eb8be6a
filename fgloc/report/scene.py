"""What a viewer shows of one estimate over time, with everything in map axes."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fgloc.core.drive import Drive
from fgloc.core.evaluation import interpolate_trajectory
from fgloc.core.measurements import Floats, Stamps
from fgloc.core.trajectory import Trajectory
from fgloc.estimator import Result, WheelSlip
from fgloc.lidar.walls import Map, Marks, Walls
from fgloc.report.map_figure import most_points
from fgloc.report.map_points import PlacedScans, placed_scans
from fgloc.report.map_segments import PlacedSegments, place_segments
from fgloc.report.map_truth import base_truth, surveyed, true_walls

Colour = tuple[int, int, int]

SHOWN_S = 1.0
"""Segments stay visible until others are seen, but no longer than this [s]: methods that use every
third scan, say, would have them flicker."""
UNASSOCIATED: Colour = (150, 150, 150)
"""Colour of a segment that belongs to no wall."""


@dataclass(frozen=True)
class Scene:
    """One drive as one method understood it."""

    drive: str
    """Id of the drive."""
    method: str
    """Id of the method."""
    begin_ns: int
    """Stamp of the drive's begin; viewers count seconds from it."""
    trajectory: Trajectory
    """Poses of base_link."""
    truth: Trajectory | None
    """The recorded truth as poses of base_link; None where there is none."""
    scans: tuple[PlacedScans, ...]
    """Scans of each lidar."""
    segments: PlacedSegments | None
    """Pieces of wall in the scans of the first lidar; None where none were extracted."""
    walls: Walls | None
    """Walls; None for methods that make none."""
    marks: Marks | None
    """Point landmarks; None for methods that make none."""
    surveyed: dict[int, tuple[float, float]]
    """Where landmarks are known to be [m], by identity."""
    true_walls: Floats
    """(W, 2, 2) ends of the walls of a simulated world [m]; empty where they are not known."""
    slips: tuple[WheelSlip, ...]
    """Which wheels slipped when."""

    def seconds(self, stamps_ns: Stamps) -> Floats:
        """Return stamps as seconds since the drive's begin."""
        return np.asarray((stamps_ns - self.begin_ns) * 1e-9)

    def truth_at(self, stamps_ns: Stamps) -> tuple[Floats, npt.NDArray[np.bool_]]:
        """Return the (N, 3) true poses at some stamps, and an (N,) mask of where they are known."""
        if self.truth is None:
            return np.full((stamps_ns.size, 3), np.nan), np.zeros(stamps_ns.size, np.bool_)
        return interpolate_trajectory(self.truth, stamps_ns)

    def box(self, points: Floats) -> Floats:
        """Return (2, 2) lowest and highest x, y [m] of what should be seen at first.

        That is the paths, the landmarks and nearly all of the (K, 2) scan points.
        """
        inside = [self.trajectory.poses[:, :2], most_points(points)]
        if self.truth is not None:
            inside.append(self.truth.poses[:, :2])
        if self.marks is not None:
            inside.append(self.marks.positions)
        everything = np.concatenate([*inside, self.true_walls.reshape(-1, 2)])
        return np.stack([everything.min(axis=0) - 0.5, everything.max(axis=0) + 0.5])


def make_scene(result: Result, drive: Drive) -> Scene:
    """Return the scene of one estimate; needs no lidar and no map. O(beams)."""
    scans = placed_scans(result, drive)
    found = result.map or Map()
    return Scene(
        drive.name,
        result.method,
        int(drive.wheels.stamps_ns[0]),
        result.trajectory,
        base_truth(result, drive),
        scans,
        place_segments(found, scans[0]) if scans else None,
        found.walls,
        found.marks,
        surveyed(drive),
        true_walls(drive),
        result.slips,
    )


def evenly(number: int, most: int) -> Stamps:
    """Return the indices of at most `most` of `number` things, evenly spaced, both ends kept."""
    return np.unique(np.linspace(0, max(number - 1, 0), min(number, most)).round().astype(np.int64))


def wall_colour(wall: int) -> Colour:
    """Return the colour of a wall, the same in every viewer; grey for -1, no wall.

    Hues a golden angle apart: neighbours in number differ most, and no two are the same.
    """
    if wall < 0:
        return UNASSOCIATED
    r, g, b = colorsys.hls_to_rgb(wall * 0.6180339887 % 1.0, 0.42, 0.85)
    return round(255 * r), round(255 * g), round(255 * b)
