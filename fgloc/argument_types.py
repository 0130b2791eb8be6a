"""What the values of options must look like; argparse shows the reason of what does not."""

from __future__ import annotations

import argparse
import math
from pathlib import Path


def fixes(text: str) -> str:
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


def positive(text: str) -> float:
    """Return a positive number."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not (math.isfinite(number) and number > 0.0):
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
    return number


def lag(text: str) -> str:
    """Return the text of --lag if it is a positive number or "full"; the handler reads it."""
    if text != "full":
        positive(text)
    return text


def seed(text: str) -> int:
    """Return a seed; it must not be negative."""
    if not text.isascii() or not text.isdigit():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 0")
    return int(text)


def count(text: str) -> int:
    """Return a whole number of at least 1."""
    number = int(text) if text.isascii() and text.isdigit() else 0
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 1")
    return number


def json_file(text: str) -> Path:
    """Return the path; "-" would make a file of that name instead of writing to the terminal."""
    if text == "-":
        raise argparse.ArgumentTypeError("give the name of a file; tables go to standard output")
    return Path(text)


def trajectory_file(text: str) -> Path:
    """Return the path if its suffix names a trajectory format."""
    path = Path(text)
    if path.suffix not in (".tum", ".kitti", ".g2o", ".npz"):
        raise argparse.ArgumentTypeError(f"{text!r} must end in .tum, .kitti, .g2o or .npz")
    return path


def recording_file(text: str) -> Path:
    """Return the path if it ends in .rrd, by which the rerun viewer knows its recordings."""
    path = Path(text)
    if path.suffix != ".rrd":
        raise argparse.ArgumentTypeError(f"{text!r} must end in .rrd")
    return path
