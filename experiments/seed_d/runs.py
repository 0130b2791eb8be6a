"""Methods on seed D's recorded drives with semi-real sensors: one job is one run and one seed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from fgloc.core.drive import Drive
from fgloc.core.measurements import Floats
from fgloc.core.robot import Robot
from fgloc.core.trajectory import Trajectory
from fgloc.estimator import Estimator

DATASET = "vitko-swerve"
"""The recordings."""
FIRST_TRAINING_SEED = 10_001
"""First of the seeds that the EKF's noise is fitted on; those that are judged count from 1."""


@dataclass(frozen=True)
class Entrant:
    """One method as it takes part."""

    id: str
    """Row key."""
    title: str
    """What it is, for the tables."""
    method: str
    """Method id."""
    calibrated: bool = False
    """Whether it is given the robot calibrated on other repetitions, not the nominal one."""
    tuned: bool = False
    """Whether its noise was fitted on the training seeds."""
    drawn: bool = True
    """Whether it uses semi-real sensors, so that seeds matter."""


ENTRANTS: tuple[Entrant, ...] = (
    Entrant("model1", "wheels alone, nominal", "model1", drawn=False),
    Entrant("model1-calibrated", "wheels alone, calibrated", "model1", True, drawn=False),
    Entrant("pose-ekf", "nominal + EKF", "pose-ekf"),
    Entrant("pose-ekf-tuned", "nominal + EKF, tuned", "pose-ekf", tuned=True),
    Entrant("pose-ekf-calibrated", "calibrated + EKF", "pose-ekf", True),
    Entrant("pose-ekf-calibrated-tuned", "calibrated + EKF, tuned", "pose-ekf", True, True),
    Entrant("batch", "batch, calibrating itself from nominal", "batch"),
    Entrant("online", "online, calibrating itself from nominal", "online"),
    Entrant("batch-calibrated", "addition: batch, starting from calibrated", "batch", True),
)
"""Everyone, in the order of the tables."""

Noise = tuple[tuple[str, float], ...]
"""Tuned parameters by name."""


@dataclass(frozen=True)
class Job:
    """One run with the sensors of one seed."""

    run: str
    """Run of the data set."""
    seed: int | None
    """Seed of the semi-real sensors; None for the methods that use wheels alone."""
    calibration: Robot | None
    """Robot fitted on other repetitions; None where there are none."""
    noise: Mapping[str, Noise]
    """Tuned parameters by entrant."""
    data: Path | None = None
    """Folder that is searched first."""
    keep: bool = False
    """Whether to return trajectories."""


@dataclass(frozen=True)
class Score:
    """What one method made of one drive."""

    run: str
    """Run of the data set."""
    motion: str
    """Which motion."""
    seed: int | None
    """Seed; None where nothing is drawn."""
    e_max: tuple[float, float, float]
    """Largest absolute error of x, y [m] and heading [rad]."""
    nees: float
    """Mean normalised squared error, NaN without covariances."""
    seconds: float
    """Time taken."""
    trajectory: Trajectory | None = None
    """The path, where it was to be kept."""


def repetition(run: str) -> int:
    """Return which repetition of its motion a run is, from 0."""
    from fgloc.datasets.vitko_swerve import REPETITIONS

    return (int(run) - 1) % REPETITIONS


def run_job(job: Job) -> dict[str, Score]:
    """Return what every entrant makes of a job's drive, by entrant. Raises FglocError."""
    from fgloc.core.evaluation import evaluate
    from fgloc.estimator import run

    nominal = load(job.run, job.seed, job.data)
    assert nominal.truth is not None
    found = {}
    for entrant in ENTRANTS:
        if entrant.drawn != (job.seed is not None) or (
            entrant.calibrated and job.calibration is None
        ):
            continue
        drive = with_calibration(nominal, job.calibration) if entrant.calibrated else nominal
        result = run(build(entrant, job.noise.get(entrant.id, ())), drive)
        scores = evaluate(result.trajectory, nominal.truth)
        worst = (scores.e_max.x, scores.e_max.y, scores.e_max.theta)
        nees = math.nan if scores.nees is None else scores.nees
        path = result.trajectory if job.keep else None
        motion = nominal.motion or ""
        found[entrant.id] = Score(job.run, motion, job.seed, worst, nees, result.seconds, path)
    return found


def load(run: str, seed: int | None, data: Path | None) -> Drive:
    """Return a run as recorded, or with the semi-real sensors of a seed."""
    from fgloc.datasets.registry import load_drive

    if seed is None:
        return load_drive(f"{DATASET}:{run}", data)
    return load_drive(f"semi:{DATASET}:{run}?seed={seed}", data)


def with_calibration(drive: Drive, calibration: Robot | None) -> Drive:
    """Return the drive of the calibrated robot; as it is without one."""
    return drive if calibration is None else replace(drive, robot=calibration)


def build(entrant: Entrant, noise: Noise = ()) -> Estimator:
    """Return the estimator; wheels alone take the publication's Euler step."""
    from fgloc.experiments.methods import create

    if noise:
        from fgloc.experiments.tunables import TUNABLE

        return TUNABLE[entrant.method][1](dict(noise))
    return create(entrant.method, integrator="euler")


def describe(job: Job) -> str:
    """Return what a job was, for a line of progress."""
    return f"run {job.run}" + ("" if job.seed is None else f" seed {job.seed}")


@dataclass(frozen=True)
class Training:
    """What the EKF's noise is fitted on."""

    entrant: Entrant
    """A tuned one of `ENTRANTS`."""
    runs: tuple[str, ...]
    """One run of each motion; their seed counts from `FIRST_TRAINING_SEED`."""
    calibrations: Mapping[int, Robot]
    """Robots by repetition; empty for the nominal robot."""
    budget: int
    """How many settings are tried."""
    data: Path | None = None
    """Folder that is searched first."""


def train(training: Training) -> Noise:
    """Return the tuned parameters; deterministic. About a minute."""
    from fgloc.experiments.tunables import tunable
    from fgloc.experiments.tuning import e_max, tune

    drives = []
    for k, run in enumerate(training.runs):
        drive = load(run, FIRST_TRAINING_SEED + k, training.data)
        if training.entrant.calibrated:
            drive = with_calibration(drive, training.calibrations.get(repetition(run)))
        drives.append(drive)
    tuned = tune(tunable(training.entrant.method, drives), drives, training.budget, objective=e_max)
    return tuple(tuned.values.items())


def describe_training(training: Training) -> str:
    """Return what was tuned, for a line of progress."""
    return f"tuning: {training.entrant.title}"


def fit_job(job: tuple[tuple[str, ...], Path | None]) -> Robot:
    """Return the robot calibrated on some runs, as `fgloc calibrate` does."""
    from fgloc.calibration.calibrate import calibrate

    runs, data = job
    return calibrate([load(run, None, data) for run in runs]).robot


def describe_fit(job: tuple[tuple[str, ...], Path | None]) -> str:
    """Return what was fitted, for a line of progress."""
    return f"calibration on {len(job[0])} runs"


def mean_errors(scores: Sequence[Score]) -> dict[str, Floats]:
    """Return by motion the (3,) mean over runs of each one's largest error (one seed)."""
    import numpy as np

    groups: dict[str, list[tuple[float, float, float]]] = {}
    for score in scores:
        groups.setdefault(score.motion, []).append(score.e_max)
    return {motion: np.mean(values, axis=0) for motion, values in groups.items()}


def own_stamps(run: str, data: Path | None) -> Score:
    """Return the error of the smoothed motion itself: what late messages of the truth alone make.

    No method can do better, but by chance.
    """
    import numpy as np

    from fgloc.core.evaluation import evaluate
    from fgloc.datasets.simulator.recorded_course import record

    drive = load(run, None, data)
    assert drive.truth is not None
    recorded = record(drive)
    stamps = drive.truth.trajectory.stamps_ns
    since = stamps - recorded.begin_ns
    inside = (since >= 0) & (since <= recorded.course.duration_ns)
    poses = recorded.course.poses_at(since[inside])
    found = evaluate(Trajectory(stamps[inside], poses), drive.truth).e_max
    return Score(run, drive.motion or "", None, (found.x, found.y, found.theta), float(np.nan), 0.0)
