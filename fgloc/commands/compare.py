"""`fgloc compare`: run several methods on the same drives and score them."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fgloc.atomic import write_text
from fgloc.commands.places import check_file, check_folder
from fgloc.core.drive import Drive
from fgloc.errors import FglocError
from fgloc.estimator import Estimator
from fgloc.experiments.compare import Step, compare
from fgloc.experiments.fixes import parse as parse_fixes
from fgloc.experiments.methods import create, resolved
from fgloc.experiments.methods import parse as parse_methods
from fgloc.filters.rl_ekf import RlEkf
from fgloc.io.ekf_yaml import load_ekf
from fgloc.report.map_files import MapFiles, write_map
from fgloc.report.outcomes import Comparison
from fgloc.report.progress import ProgressLines, telling_of_compilation
from fgloc.report.results_json import comparison_json, dumps
from fgloc.report.run_files import write_run
from fgloc.report.tables import print_comparison

RL_EKF = "rl-ekf"
"""Method that --ekf configures."""


def run(args: argparse.Namespace) -> int:
    """Compare, write --json and --out, print the tables; return 0."""
    arguments = {
        "drives": args.drives,
        "methods": args.methods,
        "integrator": args.integrator,
        "ekf": args.ekf,
    }
    estimators = _configured(args.ekf, args.methods)
    comparison = compare_with_progress(
        args,
        args.drives,
        args.methods,
        integrator=args.integrator,
        title="comparing",
        estimators=estimators,
        ekf_file=args.ekf,
    )
    report(args, comparison, arguments, estimators)
    return 0


def _configured(ekf: str | None, methods: str) -> dict[str, Estimator]:
    """Return the estimator that --ekf configures, by method id; none without the option."""
    if ekf is None:
        return {}
    if RL_EKF not in parse_methods(methods):
        raise FglocError(f"--ekf configures {RL_EKF}, which --methods leaves out; add it there")
    return {RL_EKF: RlEkf(load_ekf(ekf))}


def compare_with_progress(
    args: argparse.Namespace,
    drives: list[str],
    methods: str,
    *,
    title: str,
    integrator: Any = "exact",
    estimators: Mapping[str, Estimator] | None = None,
    ekf_file: str | None = None,
    check: Callable[[Drive], None] | None = None,
) -> Comparison:
    """Return the comparison that the options common to `compare`, `smooth` and `localise` ask for.

    `estimators` are taken by method id in place of those with default settings; `ekf_file` is where
    one of them was configured, for the record; `check` may refuse a drive before the work begins.

    Raises FglocError before anything is read if --json, --out or --map cannot be written.
    """
    check_file(args.json)
    check_folder(args.out)
    check_folder(map_folder(args))
    fixes = None if args.fixes is None else parse_fixes(args.fixes)
    with ProgressLines(title) as progress, telling_of_compilation(progress.say):

        def tell(step: Step) -> None:
            # A line for every drive read would say little: reading is quick.
            if step.method:
                text = f"{step.drive} {step.method} {step.outcome}"
                progress.step(step.done, step.total, text)

        return compare(
            drives,
            methods,
            fixes=fixes,
            seed=args.seed,
            robot_file=args.robot,
            encoder_selection=args.encoder_selection,
            integrator=integrator,
            data=args.data,
            topics_file=args.topics,
            progress=tell,
            estimators=estimators,
            ekf_file=ekf_file,
            check=check,
        )


def report(
    args: argparse.Namespace,
    comparison: Comparison,
    arguments: dict[str, Any],
    estimators: Mapping[str, Estimator] | None = None,
) -> None:
    """Write --json, --out and --map, print the tables and where files are.

    The tables are printed even if a file cannot be written: the work is done by then.
    """
    written: list[str] = []
    try:
        if args.json is not None:
            write_text(args.json, dumps(comparison_json(comparison)))
            written.append(f"All numbers: {args.json}")
        if args.out is not None:
            with ProgressLines("drawing") as progress:
                folder, maps = write_run(
                    comparison,
                    args.out,
                    args.command,
                    {**arguments, **_common(args), "settings": _settings(comparison, estimators)},
                    progress.step,
                    args.map_resolution if args.map is True else None,
                )
            written.append(f"Report, trajectories and figures: {folder} ({_figures(folder)})")
            written += [line for made in maps for line in _of_map(made)]
        place = map_folder(args)
        if place is not None:
            outcome = comparison.drives[0]
            result = next(iter(outcome.methods.values())).result
            written += _of_map(write_map(result, outcome.drive, place, args.map_resolution))
    finally:
        print_comparison(comparison)
    if written:
        print()
    for line in written:
        print(line)


def map_folder(args: argparse.Namespace) -> Path | None:
    """Return the folder that --map writes into; None without the option, or in the run folder."""
    if args.map is True:
        return None if args.out is not None else Path("map")
    place: Path | None = args.map
    return place


def _of_map(made: MapFiles) -> list[str]:
    """Return what was written of a map, and what to know of it, a line each."""
    return [f"Map: {made.folder} ({', '.join(made.names)})", *made.notes]


def _common(args: argparse.Namespace) -> dict[str, Any]:
    """Return the options common to these commands as they are written to settings.json."""
    return {
        "fixes": args.fixes,
        "seed": args.seed,
        "robot": None if args.robot is None else str(args.robot),
        "topics": None if args.topics is None else str(args.topics),
        "encoder_selection": args.encoder_selection,
        "data": None if args.data is None else str(args.data),
        "map": None if args.map is None else args.map is True or str(args.map),
        "map_resolution": args.map_resolution,
    }


def _settings(comparison: Comparison, estimators: Mapping[str, Estimator] | None) -> dict[str, Any]:
    """Return every setting of every method as it was used, defaults included."""
    integrator: Any = comparison.settings.integrator
    usual = {method: create(method, integrator=integrator) for method in comparison.methods}
    return {method: resolved(e) for method, e in {**usual, **(estimators or {})}.items()}


def _figures(folder: Path) -> str:
    """Return how many figures are in a run folder."""
    number = sum(1 for _ in folder.rglob("*.png"))
    return f"{number} figure{'' if number == 1 else 's'}"
