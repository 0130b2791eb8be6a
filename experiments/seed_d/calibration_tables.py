"""Tables and figure of `seed-d-calibration`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fgloc.calibration.calibrate import CalibrationSettings, calibrate
from fgloc.calibration.optimisers.outcome import Outcome
from fgloc.calibration.optimisers.swerve_problem import (
    PARAMETERS,
    SwerveProblem,
    largest_errors,
    swerve_problem,
)
from fgloc.core.drive import Drive
from fgloc.core.measurements import Floats
from fgloc.experiments.seed_d.published import PARAMETERS_MM, STATIC
from fgloc.report.experiment_report import Cell, Column, Figure, Row, Table

BUDGET_S = 2.0
"""What bounded least squares may take on one core [s]."""
CLOSE = 1e-6
"""How far J of the interior point may be from that of least squares, relative."""
PLACE = 1e-3
"""How far its parameters may be, in widths of the bounds."""
TITLES = {
    "nominal": "nominal",
    "interior-point": "interior point",
    "least-squares": "bounded least squares",
    "genetic": "genetic algorithm",
    "swarm": "particle swarm",
}
"""Entrants by id."""
PRINTED_AS = {
    "nominal": "nominal",
    "interior-point": "fmincon (interior point)",
    "least-squares": "Levenberg–Marquardt",
    "genetic": "genetic algorithm",
    "swarm": "particle swarm",
}
"""The same in the publication."""


def total_error(problem: SwerveProblem, drives: Sequence[Drive], parameters: Floats) -> Floats:
    """Return (3,) the sums over motions of a run's mean largest error, as Table 42 has them."""
    groups: dict[str, list[Floats]] = {}
    for drive, one in zip(drives, problem.runs, strict=True):
        groups.setdefault(drive.motion or "", []).append(largest_errors(one, parameters))
    return np.asarray(sum(np.mean(errors, axis=0) for errors in groups.values()))


def _published(name: str) -> float:
    """Return the total error of an optimiser in Table 42."""
    return sum(STATIC[PRINTED_AS[name]])


def cost_table(
    outcomes: Mapping[str, Outcome], problem: SwerveProblem, drives: Sequence[Drive]
) -> Table:
    """Return what every optimiser reached, and at which cost."""
    best = outcomes["least-squares"]
    nominal = float(np.sum(total_error(problem, drives, problem.nominal)))
    rows = []
    for name, o in outcomes.items():
        errors = total_error(problem, drives, o.parameters)
        gap = (o.cost - best.cost) / best.cost
        off = float(np.max(np.abs(o.parameters - best.parameters) / problem.width))
        precise = name == "interior-point"
        rows.append(
            Row(
                (TITLES[name],),
                {
                    "cost": Cell(o.cost, 4),
                    "gap": Cell(gap, 9 if precise else 6, target=CLOSE if precise else None),
                    "off": Cell(off, 5, target=PLACE if precise else None),
                    "total": Cell(float(np.sum(errors)), 4),
                    "change": Cell(100.0 * (float(np.sum(errors)) / nominal - 1.0), 2),
                    "printed": Cell(100.0 * (_published(name) / _published("nominal") - 1.0), 2),
                    "evaluations": Cell(o.evaluations, 0),
                    "seconds": Cell(
                        o.seconds, 2, target=BUDGET_S if name == "least-squares" else None
                    ),
                    "active": ", ".join(problem.active(o.parameters, 1e-3)) or "none",
                },
            )
        )
    return Table(
        "optimisers",
        "Twelve parameters within 5 % of nominal: J = Σ x² + y² + θ² over all samples",
        ("optimiser",),
        (
            Column("cost", "J"),
            Column("gap", "J above the best, relative"),
            Column("off", "farthest parameter from the best, in widths of the bounds"),
            Column("total", "total error"),
            Column("change", "change", "%"),
            Column("printed", "Table 42, driven anew", "%"),
            Column("evaluations", "evaluations"),
            Column("seconds", "time", "s"),
            Column("active", "active bounds"),
        ),
        tuple(rows),
        (
            "Plain least squares with finite differences took 28 s for 30 runs, the publication "
            "twelve parallel processes.",
        ),
    )


def parameter_table(outcomes: Mapping[str, Outcome], problem: SwerveProblem) -> Table:
    """Return the parameters of every optimiser beside the printed ones."""
    rows = []
    for k, name in enumerate(PARAMETERS):
        cells: dict[str, Cell | str] = {"nominal": Cell(1e3 * float(problem.nominal[k]), 2)}
        for entrant, o in outcomes.items():
            if entrant != "nominal":
                cells[entrant] = Cell(1e3 * float(o.parameters[k]), 2)
                cells[f"{entrant} printed"] = Cell(PARAMETERS_MM[PRINTED_AS[entrant]][k], 2)
        rows.append(Row((name,), cells))
    columns = [Column("nominal", "nominal")]
    for entrant in outcomes:
        if entrant != "nominal":
            columns.append(Column(entrant, TITLES[entrant]))
            columns.append(Column(f"{entrant} printed", "printed"))
    return Table(
        "parameters", "Parameters [mm], ours and printed", ("",), tuple(columns), tuple(rows)
    )


def printed_table(problem: SwerveProblem, drives: Sequence[Drive]) -> Table:
    """Return what the printed parameters are worth on these recordings."""
    rows = []
    nominal = float(np.sum(total_error(problem, drives, problem.nominal)))
    for name, title in PRINTED_AS.items():
        if title not in PARAMETERS_MM:
            continue
        parameters = 1e-3 * np.array(PARAMETERS_MM[title])
        errors = total_error(problem, drives, parameters)
        rows.append(
            Row(
                (title,),
                {
                    "cost": Cell(problem.cost(parameters), 3),
                    "total": Cell(float(np.sum(errors)), 4),
                    "change": Cell(100.0 * (float(np.sum(errors)) / nominal - 1.0), 2),
                    "printed": Cell(_published(name), 4),
                },
            )
        )
    return Table(
        "printed",
        "The parameters that the publication prints, on these recordings",
        ("optimiser",),
        (
            Column("cost", "J"),
            Column("total", "total error"),
            Column("change", "change", "%"),
            Column("printed", "Table 42, driven anew"),
        ),
        tuple(rows),
    )


def held_out_table(
    outcomes: Mapping[str, Outcome],
    fit: Sequence[Drive],
    judged: Sequence[Drive],
) -> Table:
    """Return what fits on all repetitions but the last are worth on that one."""
    problem = swerve_problem(judged)
    nominal = float(np.sum(total_error(problem, judged, problem.nominal)))
    totals = {
        TITLES[name]: float(np.sum(total_error(problem, judged, o.parameters)))
        for name, o in outcomes.items()
    }
    for title, model in (("fgloc calibrate, static", "geometry"), ("fgloc calibrate", None)):
        report = calibrate(fit, judged, CalibrationSettings(model=model))
        assert report.total_value is not None
        totals[title] = report.total_value.sum
    rows = [
        Row(
            (title,),
            {"total": Cell(total, 4), "change": Cell(100.0 * (total / nominal - 1.0), 1)},
        )
        for title, total in totals.items()
    ]
    return Table(
        "held-out",
        f"Fitted on {len(fit)} runs, total error on the {len(judged)} of the last repetition",
        ("",),
        (Column("total", "total error"), Column("change", "change", "%")),
        tuple(rows),
    )


def places_figure(outcomes: Mapping[str, Outcome], problem: SwerveProblem) -> Figure:
    """Return where every optimiser ended within the bounds."""

    def draw(path: Path) -> Path:
        from fgloc.report.figures import new_figure, save

        figure = new_figure(8.5, 4.0)
        axes = figure.subplots()
        marks = dict(zip(TITLES, "osD^v", strict=True))
        for shift, (name, o) in enumerate(outcomes.items()):
            u = (o.parameters - problem.nominal) / (0.5 * problem.width)
            places = np.arange(12) + 0.12 * (shift - 2)
            axes.plot(places, u, marks[name], ms=5, label=TITLES[name])
        axes.axhline(1.0, color="0.5", lw=0.8)
        axes.axhline(-1.0, color="0.5", lw=0.8)
        axes.set_xticks(range(12), PARAMETERS)
        axes.set_ylabel("place within the bounds (±1)")
        axes.set_title("Twelve parameters, four optimisers: the cost hardly knows some of them")
        axes.legend(frameon=False, fontsize=8, ncols=5, loc="upper center")
        axes.set_ylim(-1.15, 1.4)
        return save(figure, path)

    return Figure(
        "parameters",
        "Where each optimiser ended within the bounds; lines are the bounds.",
        draw,
    )
