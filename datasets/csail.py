"""The MIT CSAIL building: one drive of a robot with a SICK laser, through corridors and rooms.

Source: public benchmark (Radish/Freiburg), here from
https://github.com/xiaofeng419/SLAM-2D-LIDAR-SCAN, `DataSet/RawData`. `csail.corrected.gfs` has
the raw odometry (5 Hz, 424 s, 374 m) and 406 scans of 361 beams; `csail.corrected.log` the poses
that a particle filter (gmapping) found for the scans. The raw odometry ends 21 m off them.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from fgloc.core.drive import Drive
from fgloc.datasets import carmen

NAME = "csail"
FILES = {"0": "csail.corrected.gfs"}


def runs(folder: Path) -> list[str]:
    """Return the runs that are there."""
    return [run for run, file in FILES.items() if (folder / file).is_file()]


def load(folder: Path, run: str, name: str) -> Drive:
    """Return one run; its truth are the corrected poses, if their log is there too.

    Raises FglocError naming file and line for what cannot be understood.
    """
    drive = carmen.load(folder / FILES[run], name)
    notes = (*drive.notes, "The truth are the published poses of a particle filter.")
    return drive if drive.truth is None else replace(drive, notes=notes)
