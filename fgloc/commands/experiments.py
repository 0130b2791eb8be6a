"""`fgloc experiments`: list and run the experiments that reproduce published numbers."""

from __future__ import annotations

import argparse
import time

from fgloc import __version__
from fgloc.atomic import write_text
from fgloc.commands.places import check_file, check_folder
from fgloc.errors import FglocError
from fgloc.experiments.experiment import Context, Experiment
from fgloc.experiments.registry import every, find
from fgloc.experiments.warm_up import DRIVE, ROOM, compile_kernels
from fgloc.report.cells import new_table
from fgloc.report.experiment_files import write_experiment
from fgloc.report.experiment_json import report_json
from fgloc.report.experiment_report import Report
from fgloc.report.experiment_text import print_report
from fgloc.report.printing import print_parts
from fgloc.report.progress import ProgressLines, telling_of_compilation
from fgloc.report.results_json import dumps


def run(args: argparse.Namespace) -> int:
    """List the experiments, or run one; return 0."""
    check_file(args.json)
    check_folder(args.out)
    if args.experiments_command == "list":
        _list(args)
    else:
        _run(args)
    return 0


def _list(args: argparse.Namespace) -> None:
    """Print every experiment, and what it lacks on this machine; write --json."""
    found = [(e, e.missing(args.data)) for e in every()]
    table = new_table(False)
    for name in ("experiment", "can run here", "what it shows"):
        table.add_column(name, no_wrap=True)
    for experiment, missing in found:
        table.add_row(experiment.id, "yes" if missing is None else "no", experiment.summary)
    print_parts(lambda fancy: [table])
    for experiment, missing in found:
        if missing is not None:
            print(f"{experiment.id}: {missing}")
    if args.json is not None:
        document = {
            "fgloc_version": __version__,
            "experiments": [
                {"id": e.id, "summary": e.summary, "needs": list(e.needs), "missing": missing}
                for e, missing in found
            ],
        }
        write_text(args.json, dumps(document))


def _run(args: argparse.Namespace) -> None:
    """Run one experiment, write --json and --out, print the report."""
    experiment = find(args.name)
    missing = experiment.missing(args.data)
    if missing is not None:
        raise FglocError(f"{experiment.id} cannot run: {missing}")
    begin = time.perf_counter()
    with ProgressLines(experiment.id) as progress, telling_of_compilation(progress.say):
        # Compiled here if need be, or every worker would compile them for itself.
        compile_kernels(DRIVE, ROOM)
        context = Context(args.data, args.processes, args.seeds, progress.step)
        report = experiment.run(context)
    seconds = time.perf_counter() - begin
    _deliver(args, experiment, report)
    print(f"Took {seconds:.0f} s in {args.processes} process{'es' * (args.processes != 1)}.")


def _deliver(args: argparse.Namespace, experiment: Experiment, report: Report) -> None:
    """Write --json and --out, print the report and where files are.

    The report is printed even if a file cannot be written: the work is done by then.
    """
    written: list[str] = []
    try:
        if args.json is not None:
            write_text(args.json, dumps(report_json(experiment.id, report)))
            written.append(f"All numbers: {args.json}")
        if args.out is not None:
            arguments = {
                "data": None if args.data is None else str(args.data),
                "seeds": args.seeds,
                "processes": args.processes,
            }
            with ProgressLines("drawing") as progress:
                folder = write_experiment(experiment.id, report, args.out, arguments, progress.step)
            number = len(report.figures)
            figures = f"{number} figure{'s' * (number != 1)}"
            written.append(f"Report and {figures}: {folder}/report.html")
    finally:
        print_report(report)
    if written:
        print()
    for line in written:
        print(line)
