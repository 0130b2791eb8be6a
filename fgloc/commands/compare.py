"""`fgloc compare`: run several methods on the same drives and score them."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fgloc.atomic import write_text
from fgloc.commands.places import check_file, check_folder
from fgloc.errors import FglocError
from fgloc.estimator import Estimator
from fgloc.experiments.compare import Step, compare
from fgloc.experiments.fixes import parse as parse_fixes
from fgloc.experiments.methods import create, resolved
from fgloc.experiments.methods import parse as parse_methods
from fgloc.filters.rl_ekf import RlEkf
from fgloc.io.ekf_yaml import load_ekf
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
) -> Comparison:
    """Return the comparison that the options common to `compare`, `smooth` and `localise` ask for.

    `estimators` are taken by method id in place of those with default settings; `ekf_file` is where
    one of them was configured, for the record.

    Raises FglocError before anything is read if --json or --out cannot be written.
    """
    check_file(args.json)
    check_folder(args.out)
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
        )


def report(
    args: argparse.Namespace,
    comparison: Comparison,
    arguments: dict[str, Any],
    estimators: Mapping[str, Estimator] | None = None,
) -> None:
    """Write --json and --out, print the tables and where files are.

    The tables are printed even if a file cannot be written: the work is done by then.
    """
    written: list[str] = []
    try:
        if args.json is not None:
            write_text(args.json, dumps(comparison_json(comparison)))
            written.append(f"All numbers: {args.json}")
        if args.out is not None:
            with ProgressLines("drawing") as progress:
                folder = write_run(
                    comparison,
                    args.out,
                    args.command,
                    {**arguments, **_common(args), "settings": _settings(comparison, estimators)},
                    progress.step,
                )
            written.append(f"Report, trajectories and figures: {folder} ({_figures(folder)})")
    finally:
        print_comparison(comparison)
    if written:
        print()
    for line in written:
        print(line)


def _common(args: argparse.Namespace) -> dict[str, Any]:
    """Return the options common to these commands as they are written to settings.json."""
    return {
        "fixes": args.fixes,
        "seed": args.seed,
        "robot": None if args.robot is None else str(args.robot),
        "topics": None if args.topics is None else str(args.topics),
        "encoder_selection": args.encoder_selection,
        "data": None if args.data is None else str(args.data),
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
