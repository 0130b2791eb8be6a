"""`csail`: a recorded building by wheels and laser, against the published corrected poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fgloc.core.drive import Drive
from fgloc.core.evaluation import Evaluation
from fgloc.core.measurements import Floats, Scans
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError
from fgloc.experiments.experiment import Context, Experiment
from fgloc.report.experiment_report import Cell, Column, Figure, Report, Row, Table

DRIVE = "csail:0"
"""The recording."""
METHODS = ("model1", "ekf-slam", "online", "batch")
"""Who takes part; Model 1 shows what the odometry alone is worth."""
POSITION_M, HEADING_DEG, SECONDS = 0.30, 1.5, 60.0
"""What batch is to reach at most."""
DIFFERENT_DEG = 5.0
"""Scans whose published heading, from the scan before, differs by more are looked at singly."""
ON_M = 0.05
"""A point of one scan lies on another scan if one of its points is this near [m]."""


@dataclass(frozen=True)
class Score:
    """What a method made of the drive."""

    method: str
    """Method id."""
    reason: str = ""
    """Why the method could not run; empty if it could."""
    errors: Evaluation | None = None
    """Errors against the published poses."""
    seconds: float = 0.0
    """Time taken."""
    walls: int = 0
    """Walls in the map."""
    trajectory: Trajectory | None = None
    """The path."""


@dataclass(frozen=True)
class Dispute:
    """Two consecutive scans whose relative heading is another here than published."""

    second: int
    """Index of the later scan."""
    published_deg: float
    """Turn between them as published."""
    found_deg: float
    """Turn between them by batch."""
    on_published: float
    """Share of the later scan's points that lie on the earlier scan at the published poses."""
    on_found: float
    """The same at batch's."""


def run_method(job: tuple[str, Path | None]) -> Score:
    """Return the score of one method."""
    from fgloc.core.evaluation import evaluate
    from fgloc.datasets.registry import load_drive
    from fgloc.estimator import run
    from fgloc.experiments.methods import create

    method, data = job
    drive = load_drive(DRIVE, data)
    assert drive.truth is not None
    try:
        result = run(create(method), drive)
    except FglocError as error:
        return Score(method, str(error))
    walls = result.map.walls if result.map is not None else None
    return Score(
        method,
        errors=evaluate(result.trajectory, drive.truth),
        seconds=result.seconds,
        walls=0 if walls is None else int(walls.normal.size),
        trajectory=result.trajectory,
    )


def disputes(drive: Drive, trajectory: Trajectory) -> list[Dispute]:
    """Return where published and estimated poses disagree about two consecutive scans."""
    import numpy as np

    from fgloc.core.geometry import between, wrap
    from fgloc.lidar.scan import cloud

    assert drive.truth is not None
    (scans,) = drive.each(Scans)
    truth = drive.truth.trajectory
    both = np.isin(scans.stamps_ns, truth.stamps_ns) & np.isin(
        scans.stamps_ns, trajectory.stamps_ns
    )
    index = np.flatnonzero(both)
    stamps = scans.stamps_ns[index]
    published = truth.poses[np.searchsorted(truth.stamps_ns, stamps)]
    found = trajectory.poses[np.searchsorted(trajectory.stamps_ns, stamps)]
    steps = between(published[:-1], published[1:]), between(found[:-1], found[1:])
    apart = np.degrees(np.abs(wrap(steps[0][:, 2] - steps[1][:, 2])))
    points = cloud(scans)
    out = []
    for k in np.flatnonzero(apart > DIFFERENT_DEG).tolist():
        a, b = index[k], index[k + 1]
        one, other = points.points[a][points.valid[a]], points.points[b][points.valid[b]]
        out.append(
            Dispute(
                int(b),
                float(np.degrees(wrap(steps[0][k, 2]))),
                float(np.degrees(wrap(steps[1][k, 2]))),
                *(share_on(one, other, step[k]) for step in steps),
            )
        )
    return out


def share_on(one: Floats, other: Floats, relative: Floats) -> float:
    """Return the share of points (Q, 2), seen from a pose (3,), that lie on points (P, 2)."""
    import numpy as np
    from scipy.spatial import cKDTree

    c, s = np.cos(relative[2]), np.sin(relative[2])
    moved = other @ np.array([[c, s], [-s, c]]) + relative[:2]
    distance, _ = cKDTree(one).query(moved)
    return float(np.mean(distance < ON_M))


def heading_without(drive: Drive, trajectory: Trajectory, found: Sequence[Dispute]) -> float:
    """Return the heading error, RMS [deg], without the scans that are wrong as published.

    A scan is wrong if fewer of its points lie on the scan before at the published poses, and on
    through scans that follow it until they agree again.
    """
    import numpy as np

    from fgloc.core.geometry import wrap

    assert drive.truth is not None
    (scans,) = drive.each(Scans)
    truth = drive.truth.trajectory
    stamps = np.intersect1d(truth.stamps_ns, trajectory.stamps_ns)
    off = np.degrees(
        wrap(
            trajectory.poses[np.searchsorted(trajectory.stamps_ns, stamps), 2]
            - truth.poses[np.searchsorted(truth.stamps_ns, stamps), 2]
        )
    )
    wrong = {int(scans.stamps_ns[d.second]) for d in found if d.on_published < d.on_found}
    keep = np.ones(stamps.size, dtype=bool)
    for k, stamp in enumerate(stamps.tolist()):
        before = off[k - 1] if k else 0.0
        if (stamp in wrong and abs(off[k]) > abs(before)) or (
            k and not keep[k - 1] and abs(off[k] - before) < DIFFERENT_DEG
        ):
            keep[k] = False
    return float(np.sqrt(np.mean(off[keep] ** 2)))


def run(context: Context) -> Report:
    """Return the report."""
    from fgloc.datasets.registry import load_drive

    drive = load_drive(DRIVE, context.data)
    order = sorted(METHODS, key=("batch", "online", "ekf-slam", "model1").index)
    found = context.map(run_method, [(m, context.data) for m in order], lambda job: job[0])
    scores = {s.method: s for s in found}
    batch = scores["batch"].trajectory
    listed = [] if batch is None else disputes(drive, batch)
    tables = [_errors(scores)]
    if batch is not None:
        tables.append(_disputes(listed, heading_without(drive, batch, listed)))
    return Report(
        "CSAIL: a recorded building, 374 m by wheels and laser",
        tuple(tables),
        (
            "The truth are the published poses of a particle filter with scan matching, not a "
            "measurement. Its first pose is all that ties an estimate to its frame: what that pose "
            "is off turns the whole map, which the aligned error does not see.",
            "All methods start there. Filters and online are scored on the pose as emitted, batch "
            "on the smoothed one.",
        ),
        (_paths(scores, drive),),
        {"drive": DRIVE, "methods": list(METHODS)},
        trajectories={m: s.trajectory for m, s in scores.items() if s.trajectory is not None},
    )


def _errors(scores: Mapping[str, Score]) -> Table:
    """Return the errors of all methods; targets are for batch."""
    rows = []
    for method in METHODS:
        score = scores[method]
        if score.errors is None:
            rows.append(Row((method,), {"ate": score.reason}))
            continue
        aim = method == "batch"
        e = score.errors
        cells: dict[str, Cell | str] = {
            "ate": Cell(e.ate_rmse_m, 3, target=POSITION_M if aim else None),
            "aligned": Cell(e.ate_aligned_rmse_m, 3),
            "heading": Cell(e.ate_heading_rmse_deg, 2, target=HEADING_DEG if aim else None),
            "end": Cell(e.end_position_m, 3),
            "seconds": Cell(score.seconds, 1, target=SECONDS if aim else None),
        }
        if score.walls:
            cells["walls"] = Cell(float(score.walls), 0)
        rows.append(Row((method,), cells))
    return Table(
        "errors",
        "Against the published poses",
        ("method",),
        (
            Column("ate", "position RMSE", "m"),
            Column("aligned", "aligned RMSE", "m"),
            Column("heading", "heading RMSE", "deg"),
            Column("end", "end error", "m"),
            Column("walls", "walls"),
            Column("seconds", "time", "s"),
        ),
        tuple(rows),
    )


def _disputes(found: Sequence[Dispute], without: float) -> Table:
    """Return where the published poses contradict their own scans."""
    rows = [
        Row(
            (str(d.second),),
            {
                "published": Cell(d.published_deg, 1),
                "batch": Cell(d.found_deg, 1),
                "on_published": Cell(100.0 * d.on_published, 0),
                "on_batch": Cell(100.0 * d.on_found, 0),
            },
        )
        for d in found
    ]
    return Table(
        "disputes",
        f"Turns from the scan before that differ by more than {DIFFERENT_DEG:g}°: who is right?",
        ("scan",),
        (
            Column("published", "published turn", "deg"),
            Column("batch", "batch's turn", "deg"),
            Column("on_published", "points on the scan before, published", "%"),
            Column("on_batch", "points on the scan before, batch", "%"),
        ),
        tuple(rows),
        (
            f"A point lies on the scan before if one of its points is within {100 * ON_M:g} cm. "
            "Without the scans that lie worse as published, the heading RMSE of batch is "
            f"{without:.2f}°.",
        ),
    )


def _paths(scores: Mapping[str, Score], drive: Drive) -> Figure:
    """Return the paths of all methods beside the published one."""

    def draw(path: Path) -> Path:
        from fgloc.report.plot_experiment import Paths, plot_paths

        assert drive.truth is not None
        lines = {m: s.trajectory.poses for m, s in scores.items() if s.trajectory is not None}
        panel = Paths(DRIVE, lines, drive.truth.trajectory.poses)
        return plot_paths([[panel]], "CSAIL: paths, not aligned", path)

    return Figure("paths", "Paths in the frame of the published poses.", draw)


EXPERIMENT = Experiment(
    "csail",
    "A recorded building by wheels and laser: batch, online and EKF-SLAM",
    ("csail",),
    run,
)
