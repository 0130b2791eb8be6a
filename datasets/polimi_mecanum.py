"""The mecanum robot of the Politecnico di Milano's robotics course, under motion capture.

Source: https://github.com/gabrieleginestroni/ros-robotics-2022, `project1/bags/bag<N>.bag`, ROS 1.
`/wheel_states` (sensor_msgs/JointState, 49 Hz) has encoder counts of the motors as positions and
their speed as velocities, `/robot/pose` is OptiTrack (169 Hz). The counts of a revolution are
stated as 42, and 38 fit the recordings: the wheels' common scale is what there is to calibrate.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from fgloc.core.drive import Drive
from fgloc.core.kinematics import WheeledBase
from fgloc.io.bag_drive import BagDrive, read_bag
from fgloc.io.topics import TopicMap, TruthTable, WheelsTable

NAME = "polimi-mecanum"
TOPICS = TopicMap(
    base={
        "kind": "mecanum",
        "name": "PoliMi mecanum",
        "radius": 0.07,
        "half_length": 0.2,
        "half_width": 0.169,
        "order": ["fl", "fr", "rl", "rr"],
    },
    wheels=WheelsTable(
        topic="/wheel_states",
        field="position",
        joints=("front_left", "front_right", "rear_left", "rear_right"),
        counts_per_revolution=42.0,
        gear=5.0,
    ),
    truth=TruthTable(
        topic="/robot/pose", sigma=(0.003, 0.003, 0.03), mount_sigma=(0.03, 0.03, 0.06)
    ),
)
"""What the course says of its robot. The tracked body was aligned by eye; its orientation jitters
by a few degrees, in tilt as in heading."""
COUNTS_PRIOR = 0.1
"""Relative sigma of what a count is worth: stated as 1/42 of a revolution, fitted as 1/38."""


def runs(folder: Path) -> list[str]:
    """Return the runs that are there, `bag1`, `bag3` and so on."""
    return sorted(p.stem for p in (folder / "bags").glob("bag*.bag"))


def load(folder: Path, run: str, name: str, given: TopicMap) -> BagDrive:
    """Return one run; what `given` says of topics and robot replaces what the course says.

    Raises FglocError for a bag that cannot be read or a topic map that does not fit it.
    """
    found = read_bag(folder / "bags" / f"{run}.bag", name, given.over(TOPICS))
    return replace(found, drive=_finished(found.drive, stated=given.base is None))


def _finished(drive: Drive, *, stated: bool) -> Drive:
    """Return the drive with the truth's name, and the prior of counts that are only stated."""
    truth = None if drive.truth is None else replace(drive.truth, sensor="optitrack")
    robot = drive.robot
    notes = [
        *drive.notes,
        "The truth's heading jitters by 2 degrees; where the body is not seen, its last pose is "
        "repeated.",
    ]
    if stated:
        robot = replace(robot, base=_with_counts_prior(robot.base))
        notes.append(
            "The counts of a revolution are stated as 42 and were fitted as 38: the radii have a "
            f"prior of {COUNTS_PRIOR:.0%} for that."
        )
    return replace(drive, robot=robot, truth=truth, notes=tuple(notes))


def _with_counts_prior(base: WheeledBase) -> WheeledBase:
    """Return the base with radii whose common scale is as uncertain as the counts."""
    parameters = []
    for p in base.parameters:
        if p.family == "wheel_radius":
            # What one wheel differs by from the others is as usual: 1 % each.
            own = p.prior_sigma**2 * (1.0 - p.correlation)
            variance = (COUNTS_PRIOR * p.nominal) ** 2 + own
            p = replace(p, prior_sigma=variance**0.5, correlation=1.0 - own / variance)
        parameters.append(p)
    return replace(base, parameters=tuple(parameters))
