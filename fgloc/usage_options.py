"""Options that several commands have, each described once. Imports no numpy."""

from __future__ import annotations

import argparse
from pathlib import Path

from fgloc.argument_types import fixes, json_file, positive, seed, trajectory_file

Commands = argparse._SubParsersAction  # the type that argparse gives and does not export


def command(
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


def common(parser: argparse.ArgumentParser, *names: str) -> None:
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


def save_option(parser: argparse.ArgumentParser) -> None:
    """Add --save."""
    parser.add_argument(
        "--save",
        metavar="FILE",
        type=trajectory_file,
        help="write the trajectory; .tum, .kitti, .g2o or .npz",
    )


def map_options(parser: argparse.ArgumentParser) -> None:
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


def robot_option(parser: argparse.ArgumentParser) -> None:
    """Add --robot."""
    parser.add_argument(
        "--robot",
        metavar="FILE",
        type=Path,
        help="TOML file with values, priors and noise of the robot",
    )


def selection_option(parser: argparse.ArgumentParser) -> None:
    """Add --encoder-selection."""
    parser.add_argument(
        "--encoder-selection",
        action="store_true",
        help="of the encoders on a side believe one: the slowest, or the fastest when braking",
    )


def topics_option(parser: argparse.ArgumentParser) -> None:
    """Add --topics."""
    parser.add_argument(
        "--topics",
        metavar="FILE",
        type=Path,
        help="TOML file that says which topic of a ROS bag is what (default: guessed)",
    )


def fix_options(parser: argparse.ArgumentParser) -> None:
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
