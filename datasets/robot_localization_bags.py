"""The test bags of the ROS package robot_localization: odometry, IMU, GPS, no truth.

Source: https://github.com/cra-ros-pkg/robot_localization, `test/*.bag` (BSD). How the IMU of the
Husky is mounted, and that the odometries of the oldest bag have left-handed frames, is said in the
launch files of those tests (`test_ekf_localization_node_bag1.test`, groovy's `…_test_bag1.test`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from fgloc.io.bag_drive import BagDrive, read_bag
from fgloc.io.topics import ImuTable, TopicMap

NAME = "robot-localization-bags"


@dataclass(frozen=True)
class About:
    """What is known of one bag beside its content."""

    topics: TopicMap
    """Robot's name and mountings."""
    notes: tuple[str, ...] = ()
    """What a user should know."""


KNOWN = {
    "husky_test1": About(
        # Turned by 90 degrees about x, then by -90 about the vertical.
        TopicMap(base={"name": "Clearpath Husky"}, imu=ImuTable(axis="+y", forward="-z")),
        ("The IMU is known to be slightly broken.",),
    ),
    "jackal_test2": About(TopicMap(base={"name": "Clearpath Jackal"})),
    "groovy_wheel_vo_imu_test1": About(
        TopicMap(base={"name": "Mustang"}),
        (
            "Both odometries of this bag have left-handed frames according to its publishers, so "
            "the IMU turns against them. As a mirrored whole it is consistent with "
            'imu.axis = "-z" and imu.world = "ned" in a topic map.',
        ),
    ),
}


def runs(folder: Path) -> list[str]:
    """Return the bags that are there, without suffix."""
    return sorted(p.stem for p in folder.glob("*.bag"))


def load(folder: Path, run: str, name: str, given: TopicMap) -> BagDrive:
    """Return one run; what `given` says replaces what is known of it.

    Raises FglocError for a bag that cannot be read or a topic map that does not fit it.
    """
    about = KNOWN.get(run, About(TopicMap()))
    found = read_bag(folder / f"{run}.bag", name, given.over(about.topics))
    return replace(found, drive=replace(found.drive, notes=(*found.drive.notes, *about.notes)))
