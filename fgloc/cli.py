"""The command line: what can be typed, and how errors leave. Work is done in `fgloc.commands`.

Nothing here imports numpy: `fgloc --help` and a mistyped option answer at once.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import math
import os
import signal
import sys
import threading
import traceback
from collections.abc import Sequence
from pathlib import Path
from types import FrameType

from fgloc import __version__
from fgloc.errors import FglocError

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells report it."""
BROKEN_PIPE = 141
"""Exit status when the reader of a pipe went away, as shells report it."""
TERMINATED = 143
"""Exit status after SIGTERM, as shells report it."""

METHODS = "model1,model2,model3,pose-ekf,rl-ekf,batch,online"
"""Methods compared unless others are asked for: all available ones (a test holds this to it)."""
INTEGRATORS = ("exact", "midpoint", "euler")
"""Steps of Model 1; `fgloc.core.geometry.INTEGRATORS`, which cannot be imported without numpy."""

DRIVE = "a recording (path), DATASET:RUN, or sim:NAME?key=value"


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status: 0, 1 known error, 2 wrong usage, 130 Ctrl-C.

    `argv` are the arguments without the program's name, those of the process when None. Wrong
    usage and --help leave by SystemExit, as argparse does.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # A terminal that does not know σ shows a question mark; no reason to fail.
            stream.reconfigure(errors="replace")
    args = build_parser().parse_args(argv)
    if threading.current_thread() is threading.main_thread():
        # The default action ends the process on the spot and leaves temporary files behind.
        signal.signal(signal.SIGTERM, _terminate)
    try:
        handler = importlib.import_module(f"fgloc.commands.{args.command}")
        status: int = handler.run(args)
        sys.stdout.flush()
    except KeyboardInterrupt:
        _say("fgloc: interrupted")
        return INTERRUPTED
    except BrokenPipeError:
        # `fgloc … | head`: the rest is not wanted. The interpreter flushes once more at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except Exception as error:
        if args.debug:
            traceback.print_exc()
        _say(f"fgloc: error: {_message(error, debug=args.debug)}")
        return 1
    return status


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
        "fgloc smooth 'optiodom:diff/circular/250620202251/01' --fixes 10:0.002 --out runs",
    )
    parser.add_argument("drive", metavar="DRIVE", help=DRIVE)
    _fix_options(parser)
    _save_option(parser)
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
        type=_lag,
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
        type=_positive,
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
        type=_positive,
        default=1.0,
        help="seconds of the drive between two checkpoints (default: 1)",
    )
    parser.add_argument(
        "--resume", action="store_true", help="go on from the checkpoint, where there is one"
    )
    _fix_options(parser)
    _save_option(parser)
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
        "--seeds", metavar="N", type=_count, help="seeds to run over (default: the experiment's)"
    )
    run.add_argument(
        "--processes",
        metavar="N",
        type=_count,
        default=2,
        help="worker processes; results do not depend on it (default: 2)",
    )
    _common(run, "data", "json", "out")


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
        kind = _json_file if name == "json" else Path
        parser.add_argument(f"--{name}", metavar=metavar, type=kind, help=text)
    parser.set_defaults(**{name: None for name in helps if name not in names})


def _save_option(parser: argparse.ArgumentParser) -> None:
    """Add --save."""
    parser.add_argument(
        "--save",
        metavar="FILE",
        type=_trajectory_file,
        help="write the trajectory; .tum, .kitti, .g2o or .npz",
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
        type=_fixes,
        help="offer the recorded truth as sparse noisy position fixes, e.g. 10:0.002",
    )
    parser.add_argument(
        "--seed", metavar="N", type=_seed, default=0, help="seed of the fixes' noise (default: 0)"
    )


def _fixes(text: str) -> str:
    """Return the text of --fixes if it is one or two positive numbers; the handler reads it."""
    try:
        numbers = [float(word) for word in text.split(":")]
    except ValueError:
        numbers = []
    if not 1 <= len(numbers) <= 2 or not all(math.isfinite(n) and n > 0.0 for n in numbers):
        raise argparse.ArgumentTypeError(
            f"{text!r} is not EVERY_S[:SIGMA_M], one or two positive numbers such as 10:0.002"
        )
    return text


def _positive(text: str) -> float:
    """Return a positive number."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not (math.isfinite(number) and number > 0.0):
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
    return number


def _lag(text: str) -> str:
    """Return the text of --lag if it is a positive number or "full"; the handler reads it."""
    if text != "full":
        _positive(text)
    return text


def _seed(text: str) -> int:
    """Return a seed; it must not be negative."""
    if not text.isascii() or not text.isdigit():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 0")
    return int(text)


def _count(text: str) -> int:
    """Return a whole number of at least 1."""
    number = int(text) if text.isascii() and text.isdigit() else 0
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 1")
    return number


def _json_file(text: str) -> Path:
    """Return the path; "-" would make a file of that name instead of writing to the terminal."""
    if text == "-":
        raise argparse.ArgumentTypeError("give the name of a file; tables go to standard output")
    return Path(text)


def _trajectory_file(text: str) -> Path:
    """Return the path if its suffix names a trajectory format."""
    path = Path(text)
    if path.suffix not in (".tum", ".kitti", ".g2o", ".npz"):
        raise argparse.ArgumentTypeError(f"{text!r} must end in .tum, .kitti, .g2o or .npz")
    return path


def _message(error: Exception, *, debug: bool) -> str:
    """Return one line about an error: what is wrong, and what to do."""
    if isinstance(error, FglocError):
        text = str(error)
    elif isinstance(error, OSError) and error.filename is not None and error.strerror:
        text = f"{os.fsdecode(error.filename)}: {error.strerror}"
    elif isinstance(error, ImportError) and not str(error.name).startswith("fgloc"):
        text = f"a library cannot be imported: {error}; `fgloc doctor` shows what is missing"
    else:
        text = f"this is a defect of fgloc: {type(error).__name__}: {error}"
        if not debug:
            text += "; run again with --debug to see where"
    return " ".join(text.split())


def _say(line: str) -> None:
    """Print a line on stderr, and do not mind if nobody reads it."""
    with contextlib.suppress(BrokenPipeError):
        print(line, file=sys.stderr)


def _terminate(number: int, frame: FrameType | None) -> None:
    """Leave through the blocks that clean up."""
    raise SystemExit(TERMINATED)


if __name__ == "__main__":
    sys.exit(main())
