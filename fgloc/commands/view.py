"""`fgloc view`: what one method makes of a drive, over time."""

from __future__ import annotations

import argparse

from fgloc.commands.compare import compare_with_progress
from fgloc.commands.places import check_file
from fgloc.datasets.registry import expand
from fgloc.errors import FglocError
from fgloc.experiments.methods import parse
from fgloc.lazy import import_rerun
from fgloc.report.scene import make_scene
from fgloc.report.view_html import save_page
from fgloc.report.viewer import save_recording, show


def run(args: argparse.Namespace) -> int:
    """Estimate, write --save and --html, or open a window if neither is given; return 0.

    Raises FglocError for several drives or methods, for a method that cannot run on the drive, and
    before the work begins where the viewer is needed and not installed.
    """
    check_file(args.save)
    check_file(args.html)
    if args.save is not None or args.html is None:
        import_rerun()
    methods = parse(args.method)
    if len(methods) != 1:
        raise FglocError(f"--method {args.method}: view shows one method at a time")
    drives = expand([args.drive], args.data)
    if len(drives) != 1:
        raise FglocError(
            f"{args.drive} stands for {len(drives)} drives and view shows one; name one of them"
        )
    comparison = compare_with_progress(args, drives, args.method, title="estimating")
    outcome = comparison.drives[0]
    scene = make_scene(outcome.methods[methods[0]].result, outcome.drive)
    if args.save is not None:
        save_recording(scene, args.save)
        print(f"Recording: {args.save} (open it with: rerun {args.save})")
    if args.html is not None:
        save_page(scene, args.html)
        print(f"Page: {args.html} (open it with any browser)")
    if args.save is None and args.html is None:
        show(scene)
    return 0
