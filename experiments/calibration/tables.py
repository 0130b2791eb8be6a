"""Tables of the calibrations: errors before and after, targets, models that were chosen."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence

from fgloc.calibration.result import DriveError
from fgloc.experiments.calibration.cases import Outcome
from fgloc.report.experiment_report import Cell, Column, Row, Table

SWERVE_TARGETS = {"fixed-steering": None, "geometry": 0.40, None: 0.22}
"""Largest total on repetition 3, by model: one static set, and a rotation scale that depends on
the motion."""
RATIOS = {
    ("diff", None): 0.33,
    ("tricyc", None): 0.13,
    ("omni3", "omni3/circular"): 0.20,
    ("omni4", "omni4/circular"): 0.50,
}
"""Largest ratio of the median error to nominal's, by robot and motion (None: all judged drives)."""
PUBLISHED_CM = {"diff/circular": 1.0, "tricyc/circular": 7.1}
"""Error of the published method on circles [cm], after 160 to 900 s (Sousa et al., optiodom)."""


def swerve_table(outcomes: Sequence[Outcome]) -> Table:
    """Return totals of the swerve robot, a repetition left out at a time."""
    rows = []
    for o in outcomes:
        before, after = o.report.total_nominal, o.report.total_value
        assert before is not None
        assert after is not None
        # Targets are stated for the third repetition, fitted on the first two.
        target = SWERVE_TARGETS[o.case.model] if o.case.title.endswith(" 3") else None
        off = [
            abs(p.value / p.nominal - 1.0)
            for p in o.report.parameters
            if p.name.startswith("wheel_")
        ]
        rows.append(
            Row(
                (o.case.title, f"{o.report.model}{'' if o.case.model else ', chosen'}"),
                {
                    "nominal": Cell(before.sum, 4),
                    "total": Cell(after.sum, 4, target=target),
                    "change": Cell(100.0 * (after.sum / before.sum - 1.0), 1),
                    "parameters": Cell(100.0 * max(off), 1),
                    "seconds": Cell(o.report.seconds, 2),
                },
            )
        )
    return Table(
        "swerve",
        "Swerve robot: fitted on all repetitions but one, total error on that one (as Table 42)",
        ("fit", "model"),
        (
            Column("nominal", "nominal"),
            Column("total", "calibrated"),
            Column("change", "change", "%"),
            Column("parameters", "farthest dimension", "% of nominal"),
            Column("seconds", "time", "s"),
        ),
        tuple(rows),
        (
            "Published on other drives, driven anew: −64.35 % (genetic algorithm), −77.5 % with "
            "camera and IMU.",
        ),
    )


def optiodom_table(outcomes: Sequence[Outcome]) -> Table:
    """Return medians of open-loop errors of the optiodom robots, path by path."""
    rows = []
    for o in outcomes:
        robot = o.case.title.partition(",")[0]
        motions = list(dict.fromkeys(e.motion for e in o.report.evaluation))
        for motion in (*motions, None) if len(motions) > 1 else motions:
            errors = o.of(motion)
            before, after = _medians(errors)
            target = RATIOS.get((robot, motion))
            published = PUBLISHED_CM.get(motion or "")
            rows.append(
                Row(
                    (o.case.title, o.report.model, motion or "all"),
                    {
                        "drives": Cell(len(errors), 0),
                        "nominal": Cell(100.0 * before, 2),
                        "error": Cell(100.0 * after, 2),
                        "ratio": Cell(after / before, 3, target=target),
                        "published": Cell(published, 1) if published else "",
                        "seconds": Cell(o.report.seconds, 2),
                    },
                )
            )
    return Table(
        "optiodom",
        "optiodom: open-loop position RMSE from the true start, median over the judged drives",
        ("fit", "model", "judged on"),
        (
            Column("drives", "drives"),
            Column("nominal", "nominal", "cm"),
            Column("error", "calibrated", "cm"),
            Column("ratio", "ratio"),
            Column("published", "published method", "cm"),
            Column("seconds", "time of the fit", "s"),
        ),
        tuple(rows),
        ("The published method took 160 to 900 s (resilient backpropagation on position error).",),
    )


def jackal_table(outcomes: Sequence[Outcome]) -> Table:
    """Return open-loop errors of the skid-steer robot, its track and its lidar's mounting."""
    targets = {"whole drive, judged on itself": 0.20, "first third, judged on the rest": 1.3}
    rows = []
    for o in outcomes:
        (e,) = o.report.evaluation
        values = {p.name: p for p in o.report.parameters}
        rows.append(
            Row(
                (o.case.title, o.report.model),
                {
                    "nominal": Cell(e.nominal.ate_rmse_m, 2),
                    "error": Cell(e.value.ate_rmse_m, 3, target=targets[o.case.title]),
                    **{
                        name: f"{values[name].value:.3f} ± {values[name].sigma:.3f}"
                        for name in ("effective_track", "lidar_x", "lidar_y", "lidar_yaw")
                        if name in values
                    },
                },
            )
        )
    return Table(
        "jackal",
        "Jackal: open-loop wheel odometry, the lidar's mounting calibrated with the wheels",
        ("fit", "model"),
        (
            Column("nominal", "nominal", "m"),
            Column("error", "calibrated", "m"),
            Column("effective_track", "effective track", "m"),
            Column("lidar_x", "lidar x", "m"),
            Column("lidar_y", "lidar y", "m"),
            Column("lidar_yaw", "lidar yaw", "rad"),
        ),
        tuple(rows),
        ("The geometric track is 0.3756 m; 0.55 to 0.575 m are to be found.",),
    )


def polimi_table(outcomes: Sequence[Outcome]) -> Table:
    """Return open-loop errors of the mecanum robot, and what its drives do not observe."""
    rows = []
    for o in outcomes:
        (e,) = o.report.evaluation
        fitted, judged = o.case.fit[0], o.case.judged[0]
        target = None
        if fitted.endswith("bag3"):
            target = 0.04 if judged == fitted else 0.5 * e.nominal.ate_rmse_m
        missing = [p.name for p in o.report.parameters if not p.observed]
        rows.append(
            Row(
                (o.case.title, o.report.model),
                {
                    "nominal": Cell(e.nominal.ate_rmse_m, 3),
                    "error": Cell(e.value.ate_rmse_m, 3, target=target),
                    "missing": ", ".join(missing) or "none",
                },
            )
        )
    return Table(
        "polimi",
        "PoliMi mecanum robot: open-loop position RMSE",
        ("fit", "model"),
        (
            Column("nominal", "nominal", "m"),
            Column("error", "calibrated", "m"),
            Column("missing", "not observed"),
        ),
        tuple(rows),
    )


def surfaces_table(outcomes: Sequence[Outcome]) -> Table:
    """Return effective tracks against the gyro, ground by ground."""
    rows = []
    for o in outcomes:
        track = next(p for p in o.report.parameters if p.name == "effective_track")
        radius = next(p for p in o.report.parameters if p.name.startswith("wheel_radius"))
        k, r = o.report.parameters.index(track), o.report.parameters.index(radius)
        covariance = o.report.covariance
        # The radius is as unknown on one ground as on the next: it does not tell them apart.
        variance = (
            covariance[k, k] / track.value**2
            + covariance[r, r] / radius.value**2
            - 2.0 * covariance[k, r] / (track.value * radius.value)
        )
        rows.append(
            Row(
                (o.case.title,),
                {
                    "drives": Cell(len(o.case.fit), 0),
                    "track": Cell(track.value, 3),
                    "sigma": Cell(track.sigma, 3),
                    "apart": Cell(100.0 * math.sqrt(max(float(variance), 0.0)), 1),
                },
            )
        )
    return Table(
        "surfaces",
        "Effective track against the gyro, wheels and gyro in one graph",
        ("robot and ground",),
        (
            Column("drives", "drives"),
            Column("track", "effective track", "m"),
            Column("sigma", "±σ", "m"),
            Column("apart", "±σ beside another ground of the robot", "%"),
        ),
        tuple(rows),
        (
            "The Husky's stamps are row numbers; on them asphalt seems to have 1.4 m. With the "
            "wheels laid over the gyro the grounds differ by no more than runs on one of them do.",
        ),
    )


CENSI = {
    "lmov": (
        (0.0414217, 0.0415888, 0.0883953, -0.00587095, -0.0387078, -1.86026),
        (5.94e-4, 5.77e-4, 1.2503e-3, 1.261e-3, 6.73e-4, 2.0873e-2),
    ),
    "lstraight": (
        (0.0417709, 0.0418957, 0.0890519, -0.00581279, 0.000185606, 0.00949588),
        (9.81e-5, 9.84e-5, 2.094e-4, 7.50e-5, 1.125e-4, 1.5624e-3),
    ),
}
"""Published answers: diameters left and right, axle [m], laser x, y [m], yaw [rad]; their sigmas
(the published covariance is in radii)."""


def censi_table(outcomes: Sequence[Outcome]) -> Table:
    """Return axle, diameters and laser pose beside the published ones."""
    rows = []
    for o in outcomes:
        values = {p.name: p for p in o.report.parameters}
        found = [
            2.0 * values["wheel_radius.left"].value,
            2.0 * values["wheel_radius.right"].value,
            *(values[n].value for n in ("effective_track", "laser_x", "laser_y", "laser_yaw")),
        ]
        sigmas = [
            2.0 * values["wheel_radius.left"].sigma,
            2.0 * values["wheel_radius.right"].sigma,
            *(values[n].sigma for n in ("effective_track", "laser_x", "laser_y", "laser_yaw")),
        ]
        names = ("left diameter", "right diameter", "axle", "laser x", "laser y", "laser yaw")
        published, spread = CENSI[o.case.title]
        for name, value, sigma, printed, allowed in zip(
            names, found, sigmas, published, spread, strict=True
        ):
            rows.append(
                Row(
                    (o.case.title, name),
                    {
                        "found": Cell(value, 5),
                        "sigma": Cell(sigma, 5),
                        "printed": Cell(printed, 5),
                        "spread": Cell(allowed, 5),
                        "off": Cell(abs(value - printed) / allowed, 2, target=3.0),
                    },
                )
            )
    return Table(
        "censi",
        "Khepera III: wheels and laser displacements alone, in m and rad",
        ("run", "parameter"),
        (
            Column("found", "found"),
            Column("sigma", "±σ"),
            Column("printed", "published value"),
            Column("spread", "published ±σ"),
            Column("off", "off, in published σ"),
        ),
        tuple(rows),
    )


def models_table(outcomes: Sequence[Outcome]) -> Table:
    """Return for every fit that chose what each model is worth on drives left out."""
    ids = list(dict.fromkeys(c.id for o in outcomes for c in o.report.candidates))
    rows = []
    for o in outcomes:
        if not o.report.candidates:
            continue
        cells: dict[str, Cell | str] = {}
        for c in o.report.candidates:
            mark = " *" if c.chosen else "" if c.identified else " (not identified)"
            cells[c.id] = f"{c.held_out:.3f} ± {c.spread:.3f}{mark}"
        rows.append(Row((o.case.group, o.case.title), cells))
    return Table(
        "models",
        "Error on drives left out in turn, as a share of nominal's (half position, half heading)",
        ("", "fit"),
        tuple(Column(i, i) for i in ids),
        tuple(rows),
        (
            "* chosen: the fewest parameters within a standard error of the best. Not identified: "
            "the drives do not observe what the model adds.",
        ),
    )


def _medians(errors: Sequence[DriveError]) -> tuple[float, float]:
    """Return the median position RMSE before and after [m]."""
    if not errors:
        return math.nan, math.nan
    return (
        statistics.median(e.nominal.ate_rmse_m for e in errors),
        statistics.median(e.value.ate_rmse_m for e in errors),
    )
