"""Methods in simulated rooms: one job is one world, one seed and one entrant."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.measurements import Floats, Scans, Stamps
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError
from fgloc.estimator import Estimator, Result
from fgloc.lidar.segments import Segments
from fgloc.lidar.walls import Walls

LEAST_M = 1.0
"""Walls that share less than this with the true one [m] are short: 0.3° is 3 mm over half a metre,
and the side of a cupboard is seen in a handful of scans. They stand in columns of their own."""
SHOWN = 20
"""A true wall that so many scans show at least, by the default extractor, belongs in the map."""


@dataclass(frozen=True)
class Entrant:
    """One method as it takes part."""

    id: str
    """Row key."""
    title: str
    """What it is, for the tables."""
    method: str
    """Method id."""


ENTRANTS: tuple[Entrant, ...] = (
    Entrant("model1", "wheels alone", "model1"),
    Entrant("ekf-slam-ransac", "EKF-SLAM, the seed's RANSAC", "ekf-slam"),
    Entrant("ekf-slam", "EKF-SLAM, default extractor", "ekf-slam"),
    Entrant("batch", "batch", "batch"),
    Entrant("online", "online", "online"),
)
"""Everyone, in the order of the tables."""


@dataclass(frozen=True)
class Job:
    """One entrant on one simulated drive."""

    world: str
    """Name of the simulated drive and its world."""
    seed: int
    """Seed of its noise and of its robot."""
    entrant: str
    """Id of the entrant."""
    keep: bool = False
    """Whether path and map are handed back."""

    @property
    def drive(self) -> str:
        """Return the drive's id, as any command takes it."""
        return f"sim:{self.world}?seed={self.seed}"


@dataclass(frozen=True)
class MapScore:
    """How far a map is from the true walls."""

    walls: int
    """Walls in the map."""
    unmatched: int
    """Those that are no true wall."""
    missing: int
    """True lines that the scans show and the map lacks."""
    overlap_m: tuple[float, ...]
    """Length that it shares with the true wall [m], of every wall that is one."""
    middle_m: tuple[float, ...]
    """Distance from the true line at the middle of what both have [m]."""
    end_m: tuple[float, ...]
    """The same at the further end."""
    direction_deg: tuple[float, ...]
    """Angle to the true line [deg]."""
    beyond_m: tuple[float, ...]
    """How far it reaches where there is no true wall [m]."""
    used: int
    """Pieces of wall given to walls of the map."""
    wrong: int
    """Those of another true line than most of that wall's pieces."""
    spurious: int
    """Those that lie on no true wall."""


@dataclass(frozen=True)
class Score:
    """What an entrant made of a drive."""

    job: Job
    """What was asked."""
    reason: str = ""
    """Why the method could not run; empty if it could."""
    ate_m: float = math.nan
    """Root mean square position error, not aligned [m]."""
    heading_deg: float = math.nan
    """Root mean square heading error [deg]."""
    end_m: float = math.nan
    """Position error at the end [m]."""
    nees: float = math.nan
    """Mean normalised squared error, NaN without covariances."""
    seconds: float = math.nan
    """Time taken."""
    duration_s: float = math.nan
    """Length of the drive [s]."""
    map: MapScore | None = None
    """The map's errors; None without walls."""
    trajectory: Trajectory | None = None
    """The path, where it was to be kept."""
    walls: Walls | None = None
    """The map, where it was to be kept."""


def build(entrant: Entrant) -> Estimator:
    """Return the estimator of an entrant."""
    from fgloc.experiments.methods import create

    if entrant.id == "ekf-slam-ransac":
        from fgloc.filters.ekf_slam import EkfSlam
        from fgloc.filters.ekf_slam_settings import EkfSlamSettings

        return EkfSlam(EkfSlamSettings(extractor="ransac"))
    return create(entrant.method)


def run_job(job: Job) -> Score:
    """Return the score of one entrant on one drive."""
    from fgloc.core.evaluation import evaluate
    from fgloc.datasets.registry import load_drive
    from fgloc.datasets.simulator.worlds import load_world
    from fgloc.estimator import run

    drive = load_drive(job.drive)
    assert drive.truth is not None
    entrant = next(e for e in ENTRANTS if e.id == job.entrant)
    try:
        result = run(build(entrant), drive)
    except FglocError as error:
        return Score(job, str(error))
    errors = evaluate(result.trajectory, drive.truth)
    walls = result.map.walls if result.map is not None else None
    return Score(
        job,
        ate_m=errors.ate_rmse_m,
        heading_deg=errors.ate_heading_rmse_deg,
        end_m=errors.end_position_m,
        nees=math.nan if errors.nees is None else errors.nees,
        seconds=result.seconds,
        duration_s=drive.duration_s,
        map=None if walls is None else score_map(result, drive, load_world(job.world).walls),
        trajectory=result.trajectory if job.keep else None,
        walls=walls if job.keep else None,
    )


def score_map(result: Result, drive: Drive, truth: Floats) -> MapScore:
    """Return the errors of a result's walls against the true ones (W, 4)."""
    from fgloc.experiments.map_error import judge_associations, line_of_each, wall_errors

    assert result.map is not None
    assert result.map.walls is not None
    errors = wall_errors(result.map.walls, truth)
    lines = line_of_each(truth)
    shown = seen_lines(drive, truth, lines)
    found = np.unique(lines[errors.truth[errors.truth >= 0]])
    matched = errors.truth >= 0
    used = wrong = spurious = 0
    if result.map.segments is not None and result.map.wall is not None:
        true_wall = true_walls(result.map.segments, drive, truth)
        counted = judge_associations(result.map.wall, true_wall, truth)
        used, wrong, spurious = counted.used, counted.wrong, counted.spurious
    return MapScore(
        walls=errors.truth.size,
        unmatched=int(np.count_nonzero(errors.truth < 0)),
        missing=int(np.setdiff1d(shown, found).size),
        overlap_m=tuple(errors.overlap_m[matched].tolist()),
        middle_m=tuple(errors.middle_m[matched].tolist()),
        end_m=tuple(errors.end_m[matched].tolist()),
        direction_deg=tuple(np.degrees(errors.direction_rad[matched]).tolist()),
        beyond_m=tuple(errors.beyond_m[matched].tolist()),
        used=used,
        wrong=wrong,
        spurious=spurious,
    )


def true_walls(segments: Segments, drive: Drive, truth: Floats) -> Stamps:
    """Return (M,) the true wall of every piece of wall, -1 where there is none."""
    from fgloc.core.evaluation import interpolate_trajectory, map_mount
    from fgloc.experiments.map_error import true_wall_of_each

    assert drive.truth is not None
    (scans,) = drive.each(Scans)
    known = drive.true_calibration or {}
    mount = [
        known.get(f"lidar_{a}", v) for a, v in zip(["x", "y", "yaw"], scans.mount, strict=True)
    ]
    lidar = map_mount(drive.truth.trajectory, (mount[0], mount[1], mount[2]))
    poses, inside = interpolate_trajectory(lidar, scans.stamps_ns)
    found = true_wall_of_each(segments, np.where(inside[:, None], poses, 0.0), truth)
    return np.where(inside[segments.scan], found, -1)


def seen_lines(drive: Drive, truth: Floats, lines: Stamps) -> Stamps:
    """Return the numbers of the true lines that at least `SHOWN` scans show."""
    from fgloc.lidar.lines import extract
    from fgloc.lidar.motion import scan_motion
    from fgloc.lidar.scan import cloud

    (scans,) = drive.each(Scans)
    segments = extract(cloud(scans, scan_motion(drive.wheels, drive.robot, scans)), scans)
    wall = true_walls(segments, drive, truth)
    counts = np.bincount(lines[wall[wall >= 0]], minlength=int(lines.max(initial=-1)) + 1)
    return np.flatnonzero(counts >= SHOWN)


def describe(job: Job) -> str:
    """Return what a job was, for a line of progress."""
    return f"{job.drive} {job.entrant}"
