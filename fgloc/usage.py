"""What can be typed: every command with its options and examples. Imports no numpy."""

from __future__ import annotations

import argparse
from pathlib import Path

from fgloc import __version__
from fgloc.argument_types import (
    count,
    fixes,
    json_file,
    lag,
    positive,
    recording_file,
    seed,
    trajectory_file,
)

METHODS = "model1,model2,model3,pose-ekf,rl-ekf,batch,online"
"""Methods compared unless others are asked for: all available ones (a test holds this to it)."""
INTEGRATORS = ("exact", "midpoint", "euler")
"""Steps of Model 1; `fgloc.core.geometry.INTEGRATORS`, which cannot be imported without numpy."""

DRIVE = "a recording (path), DATASET:RUN, sim:NAME?key=value, or semi:DRIVE?seed=N"


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


Commands = argparse._SubParsersAction  # the type that argparse gives and does not export


def _smooth(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `fgloc smooth`."""
    parser = _command(
        commands,
        "smooth",
        "estimate the trajectory of one drive, and calibrate",
        "fgloc smooth run.log --save track.tum",
        "fgloc smooth csail:0 --map csail-map",
        "fgloc smooth 'optiodom:diff/circular/250620202251/01' --fixes 10:0.002 --out runs",
    )
    parser.add_argument("drive", metavar="DRIVE", help=DRIVE)
    _fix_options(parser)
    _save_option(parser)
    _map_options(parser)
    _robot_option(parser)
    _selection_option(parser)
    _topics_option(parser)
    _common(parser, "data", "json", "out")


def _localise(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `fgloc localise`."""
    parser = _command(
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
    _fix_options(parser)
    _save_option(parser)
    _map_options(parser)
    _robot_option(parser)
    _selection_option(parser)
    _topics_option(parser)
    _common(parser, "data", "json", "out")


def _compare(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `fgloc compare`."""
    parser = _command(
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
    _fix_options(parser)
    _robot_option(parser)
    _selection_option(parser)
    _topics_option(parser)
    _common(parser, "data", "json", "out")
    parser.set_defaults(map=None, map_resolution=None)


def _simulate(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `fgloc simulate`."""
    parser = _command(
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
    _common(parser, "json", "out")


def _datasets(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `fgloc datasets` and its own commands."""
    parser = _command(commands, "datasets", "list, describe, fetch or convert recorded drives")
    inner = parser.add_subparsers(dest="datasets_command", metavar="WHAT", required=True)
    listing = _command(inner, "list", "what is known, and what is on this machine")
    _common(listing, "data", "json")
    info = _command(inner, "info", "what a drive holds")
    info.add_argument("drive", metavar="DRIVE", help=DRIVE)
    _topics_option(info)
    _common(info, "data", "json")
    fetch = _command(inner, "fetch", "download a dataset from its public origin, checked")
    fetch.add_argument("name", metavar="NAME", help="a dataset's name, see `fgloc datasets list`")
    fetch.add_argument("--to", metavar="DIR", type=Path, help="folder (default: the user's cache)")
    _common(fetch)
    convert = _command(
        inner,
        "convert",
        "write a drive in a format of our own",
        "fgloc datasets convert jackal-jackass:0 jackal.csv",
    )
    convert.add_argument("drive", metavar="DRIVE", help=DRIVE)
    convert.add_argument("file", metavar="FILE", type=Path, help="target; ends in .npz or .csv")
    _topics_option(convert)
    _common(convert, "data")


def _experiments(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `fgloc experiments` and its own commands."""
    parser = _command(
        commands,
        "experiments",
        "list or run the experiments that put published numbers beside this program's",
        "fgloc experiments list",
        "fgloc experiments run seed-a-simulation --out runs",
    )
    inner = parser.add_subparsers(dest="experiments_command", metavar="WHAT", required=True)
    listing = _command(inner, "list", "what there is, and what can run on this machine")
    _common(listing, "data", "json")
    run = _command(
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
    _common(run, "data", "json", "out")


def _view(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `fgloc view`."""
    parser = _command(
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
    _fix_options(parser)
    _robot_option(parser)
    _selection_option(parser)
    _topics_option(parser)
    _common(parser, "data")
    parser.set_defaults(map=None, map_resolution=None)


def _doctor(commands: Commands[argparse.ArgumentParser]) -> None:
    """Add `fgloc doctor`."""
    parser = _command(commands, "doctor", "check that everything needed is installed and works")
    _common(parser, "data", "json")


def _command(
    commands: Commands[argparse.ArgumentParser], name: str, text: str, *examples: str
) -> argparse.ArgumentParser:
    """Add a command described by `text` and return its parser; its help ends with `examples`."""
    parser = commands.add_parser(
        name,
        help=text,
        description=text[0].upper() + text[1:] + ".",
        epilog="\n  ".join(("examples:", *examples)) if examples else None,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    # Suppressed, else the default here would undo a --debug given before the command.
    parser.add_argument(
        "--debug",
        action="store_true",
        default=argparse.SUPPRESS,
        help="show where an error came from",
    )
    return parser


def _common(parser: argparse.ArgumentParser, *names: str) -> None:
    """Add those of --data, --json and --out that are named; others are None in the namespace."""
    helps = {
        "data": ("DIR", "look for recorded drives here first (then $FGLOC_DATA, the user's cache)"),
        "json": ("FILE", "write the results as JSON"),
        "out": ("DIR", "write figures, trajectories and settings into a run folder in DIR"),
    }
    for name in names:
        metavar, text = helps[name]
        kind = json_file if name == "json" else Path
        parser.add_argument(f"--{name}", metavar=metavar, type=kind, help=text)
    parser.set_defaults(**{name: None for name in helps if name not in names})


def _save_option(parser: argparse.ArgumentParser) -> None:
    """Add --save."""
    parser.add_argument(
        "--save",
        metavar="FILE",
        type=trajectory_file,
        help="write the trajectory; .tum, .kitti, .g2o or .npz",
    )


def _map_options(parser: argparse.ArgumentParser) -> None:
    """Add --map and --map-resolution."""
    parser.add_argument(
        "--map",
        metavar="DIR",
        type=Path,
        nargs="?",
        const=True,
        help="write the map (PNG, SVG, GeoJSON; of scans also PLY, PGM and YAML) into DIR "
        "(default: the run folder of --out, else ./map)",
    )
    parser.add_argument(
        "--map-resolution",
        metavar="M",
        type=positive,
        default=0.05,
        help="side of a cell of the map's occupancy grid in metres (default: 0.05)",
    )


def _robot_option(parser: argparse.ArgumentParser) -> None:
    """Add --robot."""
    parser.add_argument(
        "--robot",
        metavar="FILE",
        type=Path,
        help="TOML file with values, priors and noise of the robot",
    )


def _selection_option(parser: argparse.ArgumentParser) -> None:
    """Add --encoder-selection."""
    parser.add_argument(
        "--encoder-selection",
        action="store_true",
        help="of the encoders on a side believe one: the slowest, or the fastest when braking",
    )


def _topics_option(parser: argparse.ArgumentParser) -> None:
    """Add --topics."""
    parser.add_argument(
        "--topics",
        metavar="FILE",
        type=Path,
        help="TOML file that says which topic of a ROS bag is what (default: guessed)",
    )


def _fix_options(parser: argparse.ArgumentParser) -> None:
    """Add --fixes and --seed."""
    parser.add_argument(
        "--fixes",
        metavar="EVERY_S[:SIGMA_M]",
        type=fixes,
        help="offer the recorded truth as sparse noisy position fixes, e.g. 10:0.002",
    )
    parser.add_argument(
        "--seed", metavar="N", type=seed, default=0, help="seed of the fixes' noise (default: 0)"
    )
