"""The recorded datasets that this package can read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fgloc.core.drive import Drive
from fgloc.datasets import (
    borealtc_husky,
    breezyslam,
    censi_calibration,
    csail,
    jackal_jackass,
    optiodom,
    penn_skidsteer,
    polimi_mecanum,
    robot_localization_bags,
    turtlebot3_db3,
    utias_mrclam,
    vitko_swerve,
)
from fgloc.io.bag_drive import BagDrive
from fgloc.io.topics import TopicMap


@dataclass(frozen=True)
class Dataset:
    """A family of recordings that this package can read."""

    name: str
    """Name in ids and of the folder below a data folder."""
    robot: str
    """What drove, for the user."""
    licence: str
    """Terms of the recordings."""
    origin: str
    """Where it is published."""
    example: str
    """One run, for messages."""
    runs: Callable[[Path], list[str]]
    """Lists the runs in the dataset's folder."""
    load: Callable[[Path, str, str], Drive] | None
    """Reads (folder, run, id of the drive); None: runs are bags."""
    load_bag: Callable[[Path, str, str, TopicMap], BagDrive] | None = None
    """Reads (folder, run, id of the drive, topic map) where runs are bags."""


DATASETS: dict[str, Dataset] = {
    d.name: d
    for d in (
        Dataset(
            vitko_swerve.NAME,
            "four-wheel-steer wall climber",
            "none stated; research data",
            "https://github.com/JakVit/4WIS4WID_parameter_calibration",
            "1",
            vitko_swerve.runs,
            vitko_swerve.load,
        ),
        Dataset(
            optiodom.NAME,
            "differential, omni-3, mecanum, tricycle",
            "MIT",
            "https://github.com/sousarbarb/optiodom",
            "diff/circular/250620202251/01",
            optiodom.runs,
            optiodom.load,
        ),
        Dataset(
            jackal_jackass.NAME,
            "Clearpath Jackal, skid-steer",
            "MIT (stated in its README)",
            "https://github.com/LeoBrizi/jackass-calibrator",
            "0",
            jackal_jackass.runs,
            jackal_jackass.load,
        ),
        Dataset(
            polimi_mecanum.NAME,
            "mecanum platform, ROS 1 bags",
            "none stated; course data",
            "https://github.com/gabrieleginestroni/ros-robotics-2022",
            "bag3",
            polimi_mecanum.runs,
            None,
            polimi_mecanum.load,
        ),
        Dataset(
            robot_localization_bags.NAME,
            "Husky, Jackal, Mustang, ROS 1 bags",
            "BSD",
            "https://github.com/cra-ros-pkg/robot_localization",
            "husky_test1",
            robot_localization_bags.runs,
            None,
            robot_localization_bags.load,
        ),
        Dataset(
            turtlebot3_db3.NAME,
            "TurtleBot3, ROS 2 bag",
            "none stated; research data",
            "https://github.com/BoltonAthitDavies/fibo_mobilerobot",
            "0",
            turtlebot3_db3.runs,
            None,
            turtlebot3_db3.load,
        ),
        Dataset(
            csail.NAME,
            "odometry and a SICK laser",
            "none stated; public benchmark",
            "https://github.com/xiaofeng419/SLAM-2D-LIDAR-SCAN",
            "0",
            csail.runs,
            csail.load,
        ),
        Dataset(
            utias_mrclam.NAME,
            "iRobot Creates that see barcodes",
            "educational use; cite Leung et al., IJRR 2011",
            "http://asrl.utias.utoronto.ca/datasets/mrclam/",
            "6/1",
            utias_mrclam.runs,
            utias_mrclam.load,
        ),
        Dataset(
            breezyslam.NAME,
            "differential, URG-04LX laser",
            "LGPL-3.0",
            "https://github.com/simondlevy/BreezySLAM",
            "exp2",
            breezyslam.runs,
            breezyslam.load,
        ),
        Dataset(
            censi_calibration.NAME,
            "Khepera III, differential, a laser's matched scans",
            "none stated; research data",
            "https://github.com/AndreaCensi/calibration",
            "lmov",
            censi_calibration.runs,
            censi_calibration.load,
        ),
        Dataset(
            borealtc_husky.NAME,
            "Clearpath Husky, skid-steer, several grounds",
            "CC0-1.0",
            "https://github.com/norlab-ulaval/BorealTC",
            "ASPHALT/00",
            borealtc_husky.runs,
            borealtc_husky.load,
        ),
        Dataset(
            penn_skidsteer.NAME,
            "four-wheel skid-steer, indoors",
            "none stated; course data",
            "https://github.com/zweedao/Robot-Mapping",
            "20",
            penn_skidsteer.runs,
            penn_skidsteer.load,
        ),
    )
}
"""All readable datasets by name."""
