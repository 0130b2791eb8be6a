"""`fgloc calibrate`: calibrate a robot on some drives, and evaluate that on others."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

from fgloc.atomic import write_text
from fgloc.calibration.calibrate import CalibrationSettings, calibrate
from fgloc.calibration.models import same_robot
from fgloc.calibration.result import CalibrationReport
from fgloc.calibration.robot_toml import calibration_toml
from fgloc.commands.places import check_file, check_folder
from fgloc.core.drive import Drive
from fgloc.datasets.registry import expand, load_drive
from fgloc.errors import FglocError
from fgloc.experiments.compare import prepared
from fgloc.experiments.fixes import parse as parse_fixes
from fgloc.io.topics import load_topics
from fgloc.report.calibration_files import write_calibration
from fgloc.report.calibration_json import calibration_json
from fgloc.report.calibration_report import print_calibration
from fgloc.report.progress import ProgressLines, telling_of_compilation
from fgloc.report.results_json import dumps


def run(args: argparse.Namespace) -> int:
    """Calibrate, write --save, --json and --out, print the report; return 0.

    Without --evaluate, errors are those on the drives of the fit themselves, and said to be so.
    Raises FglocError before anything is read if a file cannot be written, for a drive that is both
    fitted and evaluated, and as `calibrate` does.
    """
    check_file(args.save)
    check_file(args.json)
    check_folder(args.out)
    fit, others = expand(args.fit, args.data), expand(args.evaluate, args.data)
    both = [name for name in others if name in fit]
    if both:
        raise FglocError(
            f"{both[0]} is among the drives to fit and to evaluate; a calibration is judged by "
            "drives that it has not seen"
        )
    with ProgressLines("calibrating") as progress, telling_of_compilation(progress.say):
        drives = _load(args, [*fit, *others], progress)
        used, judged = drives[: len(fit)], drives[len(fit) :]
        judged = judged or [d for d in used if d.truth is not None]
        settings = CalibrationSettings(args.reference, args.model)
        report = calibrate(used, judged, settings, progress.say)
        progress.step(len(drives) + 1, len(drives) + 1, f"fitted in {report.seconds:.2f} s")
    _deliver(args, report, judged)
    return 0


def _load(args: argparse.Namespace, names: Sequence[str], progress: ProgressLines) -> list[Drive]:
    """Return the drives, prepared as the options want them."""
    topics = None if args.topics is None else load_topics(args.topics)
    fixes = None if args.fixes is None else parse_fixes(args.fixes)
    drives = []
    for k, name in enumerate(names, 1):
        drive = load_drive(name, args.data, topics)
        drives.append(prepared(drive, args.robot, args.encoder_selection, fixes, args.seed))
        progress.step(k, len(names) + 1, f"{name} read")
    return drives


def _deliver(args: argparse.Namespace, report: CalibrationReport, judged: Sequence[Drive]) -> None:
    """Write what was asked for, print the report and where files are.

    The report is printed even if a file cannot be written: the work is done by then.
    """
    written: list[str] = []
    try:
        if args.save is not None:
            write_text(args.save, calibration_toml(report))
            written.append(f"Robot file, for --robot: {args.save}")
        if args.json is not None:
            write_text(args.json, dumps(calibration_json(report)))
            written.append(f"All numbers: {args.json}")
        if args.out is not None:
            drawn = same_robot(judged)[0] if judged else []
            with ProgressLines("drawing") as progress:
                folder = write_calibration(report, drawn, args.out, _arguments(args), progress.step)
            written.append(f"Report, robot file and figures: {folder}")
    finally:
        print_calibration(report)
    if written:
        print()
    for line in written:
        print(line)


def _arguments(args: argparse.Namespace) -> dict[str, Any]:
    """Return the options as they are written to settings.json."""
    files = ("robot", "topics", "data")
    names = ("fit", "evaluate", "reference", "model", "fixes", "seed", "encoder_selection")
    found = {name: getattr(args, name) for name in names}
    return {
        **found,
        **{n: None if getattr(args, n) is None else str(getattr(args, n)) for n in files},
    }
