"""`fgloc localise`: the online engine on one drive, as it would have run live."""

from __future__ import annotations

import argparse
import math
import sys

from fgloc.commands.compare import compare_with_progress, report
from fgloc.commands.places import check_file, check_folder
from fgloc.core.trajectory_io import save_trajectory
from fgloc.datasets.registry import expand
from fgloc.errors import FglocError
from fgloc.estimator import Live, Spread
from fgloc.online.online import OnlineSmoother
from fgloc.online.session import ReplayOptions
from fgloc.online.settings import OnlineSettings
from fgloc.report.map_files import check_mappable

METHOD = "online"


def run(args: argparse.Namespace) -> int:
    """Localise, write --save, --json, --out and --map, print the tables and the times; return 0.

    Raises FglocError for a pattern that stands for several drives, for a checkpoint that does not
    belong to the drive, for --resume without --checkpoint, and for --map where no sensor sees the
    surroundings.
    """
    check_file(args.save)
    check_folder(args.checkpoint)
    if args.checkpoint is None and args.resume:
        raise FglocError("--resume needs --checkpoint DIR, the folder to go on from")
    drives = expand([args.drive], args.data)
    if len(drives) != 1:
        raise FglocError(
            f"{args.drive} stands for {len(drives)} drives and localise takes one; use "
            f"fgloc compare {args.drive} --methods {METHOD}"
        )
    settings = OnlineSettings(
        lag_s=math.inf if args.lag == "full" else float(args.lag), engine=args.engine
    )
    options = ReplayOptions(args.realtime, args.checkpoint, args.every, args.resume, _say)
    estimators = {METHOD: OnlineSmoother(settings, options)}
    comparison = compare_with_progress(
        args,
        drives,
        METHOD,
        title="localising",
        estimators=estimators,
        check=None if args.map is None else check_mappable,
    )
    result = comparison.drives[0].methods[METHOD].result
    arguments = {
        "drive": args.drive,
        "methods": METHOD,
        "lag": args.lag,
        "engine": args.engine,
        "realtime": args.realtime,
        "checkpoint": None if args.checkpoint is None else str(args.checkpoint),
        "every": args.every,
        "resume": args.resume,
    }
    report(args, comparison, arguments, estimators)
    if result.live is not None:
        print()
        for line in _times(result.live):
            print(line)
    if args.save is not None:
        save_trajectory(result.trajectory, args.save)
        print(f"Trajectory: {args.save}")
    return 0


def _say(text: str) -> None:
    """Print a line on stderr while the drive is replayed."""
    print(text, file=sys.stderr, flush=True)


def _times(live: Live) -> list[str]:
    """Return what the times were, a line each."""
    rows = [
        (f"{live.updates} updates took", live.update),
        ("Packets waited for the engine for", live.late),
        ("Checkpoints took", live.save),
    ]
    lines = [f"{text} {_milliseconds(spread)}" for text, spread in rows if spread is not None]
    if live.resumed_poses:
        lines.append(f"{live.resumed_poses} poses are from before the interruption.")
    return lines


def _milliseconds(of: Spread) -> str:
    """Return a spread in words."""
    median, p99, most = (1e3 * s for s in (of.median, of.p99, of.maximum))
    return f"{median:.2f} ms (median), {p99:.2f} ms (p99), {most:.2f} ms (max)."
