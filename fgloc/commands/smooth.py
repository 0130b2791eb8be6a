"""`fgloc smooth`: the batch smoother on one drive, with calibration."""

from __future__ import annotations

import argparse

from fgloc.commands.compare import compare_with_progress, report
from fgloc.commands.places import check_file
from fgloc.core.trajectory_io import save_trajectory
from fgloc.datasets.registry import expand
from fgloc.errors import FglocError
from fgloc.report.map_files import check_mappable

METHOD = "batch"


def run(args: argparse.Namespace) -> int:
    """Smooth, write --save, --json, --out and --map, print the tables; return 0.

    Raises FglocError for a pattern that stands for several drives (`compare` takes those), and for
    --map where no sensor sees the surroundings.
    """
    check_file(args.save)
    drives = expand([args.drive], args.data)
    if len(drives) != 1:
        raise FglocError(
            f"{args.drive} stands for {len(drives)} drives and smooth takes one; use "
            f"fgloc compare {args.drive} --methods {METHOD}"
        )
    check = None if args.map is None else check_mappable
    comparison = compare_with_progress(args, drives, METHOD, title="smoothing", check=check)
    trajectory = comparison.drives[0].methods[METHOD].result.trajectory
    report(args, comparison, {"drive": args.drive, "methods": METHOD})
    if args.save is not None:
        save_trajectory(trajectory, args.save)
        print(f"Trajectory: {args.save}")
    return 0
