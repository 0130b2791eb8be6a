"""What can be typed: every command with its options and examples. Imports no numpy."""

from __future__ import annotations

import argparse
from pathlib import Path

from fgloc import __version__
from fgloc.argument_types import count, lag, positive, recording_file
from fgloc.usage_options import (
    Commands,
    command,
    common,
    fix_options,
    map_options,
    robot_option,
    save_option,
    selection_option,
    topics_option,
)

METHODS = "model1,model2,model3,pose-ekf,rl-ekf,ekf-slam,batch,online"
"""Methods compared unless others are asked for: all available ones (a test holds this to it)."""
INTEGRATORS = ("exact", "midpoint", "euler")
"""Steps of Model 1; `fgloc.core.geometry.INTEGRATORS`, which cannot be imported without numpy."""

DRIVE = (
    "a recording (path), DATASET:RUN, sim:NAME?key=value, semi:DRIVE?seed=N, "
    "or cut:DRIVE?begin=S&end=S"
)


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line; option names are attribute names."""
    parser = argparse.ArgumentParser(
        prog="fgloc",
        description="Factor-graph localisation of wheeled ground robots: a drive goes in, "
        "a trajectory with its uncertainty and the robot's calibration come out.",
        epilog="A DRIVE is " + DRIVE + ". `fgloc COMMAND --help` shows a command's options.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"fgloc {__version__}")
    parser.add_argument("--debug", action="store_true", help="show where an error came from")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    _smooth(commands)
    _localise(commands)
    _compare(commands)
    _simulate(commands)
    _datasets(commands)
    _experiments(commands)
    _view(commands)
    _doctor(commands)
    return parser


def _smooth(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `fgloc smooth`."""
    parser = command(
        commands,
        "smooth",
        "estimate the trajectory of one drive, and calibrate",
        "fgloc smooth run.log --save track.tum",
        "fgloc smooth csail:0 --map csail-map",
        "fgloc smooth 'optiodom:diff/circular/250620202251/01' --fixes 10:0.002 --out runs",
    )
    parser.add_argument("drive", metavar="DRIVE", help=DRIVE)
    fix_options(parser)
    save_option(parser)
    map_options(parser)
    robot_option(parser)
    selection_option(parser)
    topics_option(parser)
    common(parser, "data", "json", "out")


def _localise(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `fgloc localise`."""
    parser = command(
        commands,
        "localise",
        "run the online engine on one drive, as it would have run live",
        "fgloc localise sim:demo --save track.tum",
        "fgloc localise run.log --realtime --checkpoint state --resume",
    )
    parser.add_argument("drive", metavar="DRIVE", help=DRIVE)
    parser.add_argument(
        "--lag",
        metavar="S",
        type=lag,
        default="30",
        help="seconds that can still be corrected, or full for the whole drive (default: 30)",
    )
    parser.add_argument(
        "--engine",
        choices=("chain", "isam2"),
        default="chain",
        help="what solves the window: this project's elimination, or iSAM2 (default: chain)",
    )
    parser.add_argument(
        "--realtime",
        metavar="SPEED",
        type=positive,
        nargs="?",
        const=1.0,
        help="hand measurements over when their time has come, SPEED times faster (default: 1)",
    )
    parser.add_argument(
        "--checkpoint", metavar="DIR", type=Path, help="save the state and the poses in DIR"
    )
    parser.add_argument(
        "--every",
        metavar="S",
        type=positive,
        default=1.0,
        help="seconds of the drive between two checkpoints (default: 1)",
    )
    parser.add_argument(
        "--resume", action="store_true", help="go on from the checkpoint, where there is one"
    )
    fix_options(parser)
    save_option(parser)
    map_options(parser)
    robot_option(parser)
    selection_option(parser)
    topics_option(parser)
    common(parser, "data", "json", "out")


def _compare(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `fgloc compare`."""
    parser = command(
        commands,
        "compare",
        "run several methods on the same drives and score them",
        "fgloc compare sim:demo --out runs",
        "fgloc compare vitko-swerve:1 vitko-swerve:2 --methods model1,batch --json out.json",
        "fgloc compare 'optiodom:diff/circular/*' --fixes 10:0.002",
        "fgloc compare robot.bag --ekf ekf.yaml --methods rl-ekf,pose-ekf,online",
    )
    parser.add_argument("drives", metavar="DRIVE", nargs="+", help=DRIVE)
    parser.add_argument(
        "--methods", metavar="A,B,C", default=METHODS, help="method ids (default: %(default)s)"
    )
    parser.add_argument(
        "--integrator",
        choices=INTEGRATORS,
        default="exact",
        help="step of model1 (default: exact on an arc of constant twist)",
    )
    parser.add_argument(
        "--ekf",
        metavar="FILE[:NODE]",
        help="configuration of rl-ekf: an ekf.yaml of robot_localization (default: made from the "
        "drive's sensors)",
    )
    fix_options(parser)
    robot_option(parser)
    selection_option(parser)
    topics_option(parser)
    common(parser, "data", "json", "out")
    parser.set_defaults(map=None, map_resolution=None)


def _simulate(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `fgloc simulate`."""
    parser = command(
        commands,
        "simulate",
        "make a drive with known truth and write it",
        "fgloc simulate demo --format jaguar --out runs",
        "fgloc simulate 'figure-eight?seed=1&slip=fl:3:5:1.2&gyro=on'",
    )
    parser.add_argument(
        "name",
        metavar="NAME",
        help="demo, figure-eight, square, random, corridor or one of seed A's drives, with options "
        "behind ?, separated by & (a wrong name or option lists all)",
    )
    parser.add_argument(
        "--format",
        choices=("npz", "csv", "jaguar"),
        default="npz",
        help="npz or csv of our own, or the Jaguar's text log (default: npz)",
    )
    common(parser, "json", "out")


def _datasets(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `fgloc datasets` and its own commands."""
    parser = command(commands, "datasets", "list, describe, fetch or convert recorded drives")
    inner = parser.add_subparsers(dest="datasets_command", metavar="WHAT", required=True)
    listing = command(inner, "list", "what is known, and what is on this machine")
    common(listing, "data", "json")
    info = command(inner, "info", "what a drive holds")
    info.add_argument("drive", metavar="DRIVE", help=DRIVE)
    topics_option(info)
    common(info, "data", "json")
    fetch = command(inner, "fetch", "download a dataset from its public origin, checked")
    fetch.add_argument("name", metavar="NAME", help="a dataset's name, see `fgloc datasets list`")
    fetch.add_argument("--to", metavar="DIR", type=Path, help="folder (default: the user's cache)")
    common(fetch)
    convert = command(
        inner,
        "convert",
        "write a drive in a format of our own",
        "fgloc datasets convert jackal-jackass:0 jackal.csv",
    )
    convert.add_argument("drive", metavar="DRIVE", help=DRIVE)
    convert.add_argument("file", metavar="FILE", type=Path, help="target; ends in .npz or .csv")
    topics_option(convert)
    common(convert, "data")


def _experiments(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `fgloc experiments` and its own commands."""
    parser = command(
        commands,
        "experiments",
        "list or run the experiments that put published numbers beside this program's",
        "fgloc experiments list",
        "fgloc experiments run seed-a-simulation --out runs",
    )
    inner = parser.add_subparsers(dest="experiments_command", metavar="WHAT", required=True)
    listing = command(inner, "list", "what there is, and what can run on this machine")
    common(listing, "data", "json")
    run = command(
        inner,
        "run",
        "run one experiment and print its tables",
        "fgloc experiments run seed-a-simulation --seeds 20 --json out.json",
    )
    run.add_argument("name", metavar="NAME", help="a name from `fgloc experiments list`")
    run.add_argument(
        "--seeds", metavar="N", type=count, help="seeds to run over (default: the experiment's)"
    )
    run.add_argument(
        "--processes",
        metavar="N",
        type=count,
        default=2,
        help="worker processes; results do not depend on it (default: 2)",
    )
    common(run, "data", "json", "out")


def _view(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `fgloc view`."""
    parser = command(
        commands,
        "view",
        "show an estimate over time: scans, walls, path, truth",
        "fgloc view csail:0",
        "fgloc view sim:demo --method online --html demo.html",
    )
    parser.add_argument("drive", metavar="DRIVE", help=DRIVE)
    parser.add_argument(
        "--method", metavar="ID", default="batch", help="method to show (default: batch)"
    )
    parser.add_argument(
        "--save",
        metavar="FILE",
        type=recording_file,
        help="write a recording (.rrd) for the rerun viewer instead of opening its window",
    )
    parser.add_argument(
        "--html",
        metavar="FILE",
        type=Path,
        help="write a page with a time slider for any browser; needs nothing installed",
    )
    fix_options(parser)
    robot_option(parser)
    selection_option(parser)
    topics_option(parser)
    common(parser, "data")
    parser.set_defaults(map=None, map_resolution=None)


def _doctor(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `fgloc doctor`."""
    parser = command(commands, "doctor", "check that everything needed is installed and works")
    common(parser, "data", "json")
