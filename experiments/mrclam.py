"""`mrclam`: point landmarks on recorded drives, with all, some and nothing known of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fgloc.core.drive import Drive
from fgloc.core.evaluation import Evaluation
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError
from fgloc.estimator import CalibrationEstimate, Result
from fgloc.experiments.experiment import Context, Experiment
from fgloc.report.experiment_report import Cell, Column, Figure, Report, Row, Table

DATASET = "utias-mrclam"
"""The recordings."""
METHODS = ("model1", "ekf-slam", "batch", "online")
"""Who takes part; Model 1 shows what the odometry alone is worth."""


@dataclass(frozen=True)
class Case:
    """What is known of the landmarks."""

    id: str
    """Key in the tables."""
    title: str
    """What it is, for the tables."""
    target: float | None
    """What the position error of batch is to be at most [m]; None: whatever it is."""
    aligned: bool
    """Whether the target is meant for the SE(2)-aligned error."""


CASES = (
    Case("surveyed", "surveyed positions, known identities", 0.06, False),
    Case("identities", "unknown positions, known identities", 0.10, True),
    Case("nothing", "unknown positions, unknown identities", None, True),
)
"""All cases, in the order of the table."""


@dataclass(frozen=True)
class Job:
    """One method on one run, with one knowledge of the landmarks."""

    run: str
    """Run of the data set."""
    case: str
    """Id of the case."""
    method: str
    """Method id."""
    data: Path | None
    """Folder that is searched first."""


@dataclass(frozen=True)
class Score:
    """What a method made of a job."""

    job: Job
    """What was asked."""
    reason: str = ""
    """Why the method could not run; empty if it could."""
    errors: Evaluation | None = None
    """Errors against the truth."""
    seconds: float = 0.0
    """Time taken."""
    marks: int = 0
    """Landmarks in the map."""
    marks_rms_m: float | None = None
    """Root mean square error of the map's landmarks against the survey [m], aligned where no
    position was known; None without identities or without a map."""
    calibration: tuple[CalibrationEstimate, ...] = ()
    """What was calibrated."""
    trajectory: Trajectory | None = None
    """The path."""


def drive_of(job: Job) -> tuple[Drive, Drive]:
    """Return a job's drive as it was recorded, and as it is given to the method."""
    from fgloc.datasets.registry import load_drive
    from fgloc.experiments.withheld import without_identity, without_survey

    whole = load_drive(f"{DATASET}:{job.run}", job.data)
    if job.case == "surveyed":
        return whole, whole
    unknown = without_survey(whole)
    return whole, without_identity(unknown) if job.case == "nothing" else unknown


def run_job(job: Job) -> Score:
    """Return the score of one method on one drive."""
    from fgloc.core.evaluation import evaluate
    from fgloc.estimator import run
    from fgloc.experiments.methods import create

    whole, drive = drive_of(job)
    try:
        result = run(create(job.method), drive)
    except FglocError as error:
        return Score(job, str(error))
    assert drive.truth is not None
    found = result.map.marks if result.map is not None else None
    return Score(
        job,
        errors=evaluate(result.trajectory, drive.truth),
        seconds=result.seconds,
        marks=0 if found is None else int(found.landmark.size),
        marks_rms_m=_marks_error(result, whole, job.case),
        calibration=result.calibration,
        trajectory=result.trajectory,
    )


def _marks_error(result: Result, whole: Drive, case: str) -> float | None:
    """Return how far the map's landmarks are from the survey, root mean square [m]."""
    import numpy as np

    from fgloc.core.evaluation import aligned_positions
    from fgloc.core.measurements import LandmarkSightings

    marks = result.map.marks if result.map is not None else None
    surveys = [s.survey for s in whole.each(LandmarkSightings) if s.survey is not None]
    if marks is None or case == "nothing" or not surveys:
        return None
    _, mine, theirs = np.intersect1d(marks.landmark, surveys[0].landmark, return_indices=True)
    if mine.size < 2:
        return None
    places, known = marks.positions[mine], surveys[0].positions[theirs]
    if case != "surveyed":
        places = aligned_positions(places, known)
    return float(np.sqrt(np.mean(np.sum((places - known) ** 2, axis=1))))


def describe(job: Job) -> str:
    """Return what a job was, for a line of progress."""
    return f"{job.run} {job.case} {job.method}"


def run(context: Context) -> Report:
    """Return the report on whatever runs are on this machine. Raises FglocError if none is."""
    from fgloc.datasets.registry import list_drives

    runs = [name.partition(":")[2] for name in list_drives(DATASET, context.data)]
    # Wheels alone do not care what is known of landmarks; the slowest go first.
    jobs = [
        Job(name, case.id, method, context.data)
        for method in sorted(METHODS, key=("batch", "online", "ekf-slam", "model1").index)
        for name in runs
        for case in CASES
        if method != "model1" or case is CASES[0]
    ]
    scores = context.map(run_job, jobs, describe)
    table = {(s.job.case, s.job.run, s.job.method): s for s in scores}
    return Report(
        f"MRCLAM: point landmarks, {len(runs)} recorded drives",
        (*(_case_table(case, runs, table) for case in CASES), _calibration(runs, table)),
        (
            "Sightings of other robots are left out. The odometry is what the robot was told to "
            "do; its scales are calibrated by batch and online only.",
            "All methods start at the truth's first pose. Filters and online are scored on the "
            "pose as emitted, batch on the smoothed one.",
        ),
        (_paths(runs, table, context.data),),
        {"runs": runs, "methods": list(METHODS), "cases": {c.id: c.title for c in CASES}},
        trajectories={
            f"{run.replace('/', '-')}/{case}/{method}": score.trajectory
            for (case, run, method), score in table.items()
            if score.trajectory is not None
        },
    )


Scores = Mapping[tuple[str, str, str], Score]
"""What was found, by case, run and method."""


def _case_table(case: Case, runs: Sequence[str], scores: Scores) -> Table:
    """Return the errors with one knowledge of the landmarks."""
    rows = []
    for run in runs:
        for method in METHODS:
            score = scores.get((case.id, run, method))
            if score is not None and method != "model1":
                rows.append(Row((run, method), _cells(case, score)))
            elif method == "model1":
                rows.append(Row((run, method), _cells(case, scores[CASES[0].id, run, method])))
    return Table(
        case.id,
        f"Landmarks: {case.title}",
        ("run", "method"),
        (
            Column("ate", "position RMSE", "m"),
            Column("aligned", "aligned RMSE", "m"),
            Column("heading", "heading RMSE", "deg"),
            Column("nees", "NEES"),
            Column("marks", "landmarks"),
            Column("marks_rms", "landmark RMSE", "m"),
            Column("seconds", "time", "s"),
        ),
        tuple(rows),
        ("There are 15 landmarks.",) if case.id == "nothing" else (),
    )


def _cells(case: Case, score: Score) -> dict[str, Cell | str]:
    """Return one method's cells; a target is for batch."""
    if score.errors is None:
        return {"ate": score.reason}
    target = case.target if score.job.method == "batch" else None
    errors = score.errors
    cells: dict[str, Cell | str] = {
        "ate": Cell(errors.ate_rmse_m, 3, target=None if case.aligned else target),
        "aligned": Cell(errors.ate_aligned_rmse_m, 3, target=target if case.aligned else None),
        "heading": Cell(errors.ate_heading_rmse_deg, 2),
        "nees": Cell(errors.nees, 1),
        "seconds": Cell(score.seconds, 1),
    }
    if score.marks:
        cells["marks"] = Cell(float(score.marks), 0)
        cells["marks_rms"] = Cell(score.marks_rms_m, 3)
    return cells


def _calibration(runs: Sequence[str], scores: Scores) -> Table:
    """Return what batch made of the odometry's scales."""
    rows = []
    names: list[str] = []
    for run in runs:
        for case in CASES:
            for method in ("batch", "online"):
                score = scores[case.id, run, method]
                found = {c.name: c for c in score.calibration}
                names += [n for n in found if n not in names]
                cells: dict[str, Cell | str] = {
                    n: f"{c.value:.3f} ± {c.sigma:.3f}" for n, c in found.items()
                }
                rows.append(Row((run, case.id, method), cells))
    return Table(
        "calibration",
        "The odometry's calibration (m where a length)",
        ("run", "landmarks", "method"),
        tuple(Column(n, n) for n in names),
        tuple(rows),
    )


def _paths(runs: Sequence[str], scores: Scores, data: Path | None) -> Figure:
    """Return the paths, a row of panels a run, a column a case."""

    def draw(path: Path) -> Path:
        from fgloc.report.plot_experiment import Paths, plot_paths

        rows = []
        for run in runs:
            row = []
            for case in CASES:
                whole, _ = drive_of(Job(run, case.id, "", data))
                assert whole.truth is not None
                found = {
                    m: s.trajectory.poses
                    for m in METHODS
                    if m != "model1"
                    and (s := scores[case.id, run, m]).trajectory is not None
                    and s.trajectory is not None
                }
                row.append(Paths(f"{run}: {case.title}", found, whole.truth.trajectory.poses))
            rows.append(row)
        return plot_paths(rows, "MRCLAM: paths, not aligned (online: as emitted)", path)

    return Figure("paths", "Paths of every run with what is known of the landmarks.", draw)


EXPERIMENT = Experiment(
    "mrclam",
    "EKF-SLAM, batch and online with point landmarks on UTIAS MRCLAM: surveyed, known, unknown",
    (DATASET,),
    run,
)
