"""A ROS 2 bag (sqlite3) of TurtleBot3 robots: wheel odometry beside two estimates, no truth.

Source: https://github.com/BoltonAthitDavies/fibo_mobilerobot, `results/comparison`. Two robots
published under the same topic names.
"""

from __future__ import annotations

from pathlib import Path

from fgloc.io.bag_drive import BagDrive, read_bag
from fgloc.io.topics import TopicMap

NAME = "turtlebot3-db3"
FILE = "comparison_0.db3"
TOPICS = TopicMap(base={"name": "TurtleBot3"})
"""What is known beside the content."""


def runs(folder: Path) -> list[str]:
    """Return the one run, if it is there."""
    return ["0"] if (folder / FILE).is_file() else []


def load(folder: Path, run: str, name: str, given: TopicMap) -> BagDrive:
    """Return the run; raises FglocError for a bag or a topic map that cannot be used."""
    del run
    return read_bag(folder / FILE, name, given.over(TOPICS))
