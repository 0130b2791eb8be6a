"""What may be set about EKF-SLAM; the defaults are those of seeds B and C where they print one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from fgloc.core.checks import check_noise
from fgloc.errors import FglocError

Extractor = Literal["lines", "ransac"]
EXTRACTORS: tuple[Extractor, ...] = ("lines", "ransac")


@dataclass(frozen=True)
class EkfSlamSettings:
    """Typed settings of the EKF-SLAM baseline."""

    extractor: Extractor = "lines"
    """What finds walls in a scan: "lines" is this project's default, "ransac" the seed's."""
    seed: int = 0
    """Seed of the RANSAC extractor's draws."""
    process_noise: float = 1.0
    """Factor on the standard deviations of the wheels' noise."""
    calibration: float = 1.0
    """Factor on the priors of radii, track and the like, which are part of the process noise since
    nothing of the robot is estimated; 0 takes the nominal robot to be exact."""
    horizon_s: float = 1.0
    """What is wrong with the robot stays wrong; the filter is told of it as white noise that adds
    up to the same in this time [s]. Landmarks show it soon, and with the 10 s of a pose filter the
    heading would be so uncertain that one linearisation too many spoils the map."""
    sightings: int = 5
    """A landmark enters the state at its sighting of this number, earlier ones only make it known
    (seed C). A landmark whose identity the sensor tells enters at once: it is no chance."""
    lives: int = 40
    """Scans in a row in which a landmark may be missed before it is forgotten. The seed prints no
    number."""
    forget_unseen: bool = False
    """Take a life for every scan in which a landmark is not matched, as the seed's letter has it,
    also if it is out of sight; by default only where it should have been seen."""
    gate_m: float = 0.5
    """Distance in the map [m] within which the nearest landmark is taken to be the seen one."""
    identity_gate: float = 5.0
    """A sighting with an identity that is further off than so many standard deviations (Mahalanobis
    distance) is rejected: a misread mark. inf takes all."""
    patience: int = 10
    """After so many rejections in a row of one landmark it is believed that the filter is wrong:
    the sighting is used."""
    wall_range_share: float = 0.01
    """Standard deviation of the distance to a wall's point as a share of it (seed C)."""
    wall_range_sigma: float = 0.1
    """What does not grow with the distance [m], added in squares. The point of a wall is off by
    more than a beam: a direction that is wrong by a degree moves it by centimetres, and both sides
    of a thin wall are one landmark. With 0.01 m the filter loses its way in every other drive of
    seed C's rooms."""
    wall_bearing_sigma: float = math.radians(1.0)
    """Standard deviation of the direction to a wall's point [rad] (seed C: about 1°)."""

    def __post_init__(self) -> None:
        if self.extractor not in EXTRACTORS:
            raise FglocError(
                f"ekf-slam: unknown extractor {self.extractor!r}; choose one of "
                f"{', '.join(EXTRACTORS)}"
            )
        for name in ("sightings", "lives", "patience"):
            if getattr(self, name) < 1:
                raise FglocError(f"ekf-slam: {name} must be at least 1, got {getattr(self, name)}")
        if self.seed < 0:
            raise FglocError(f"ekf-slam: the seed must not be negative, got {self.seed}")
        if not self.identity_gate > 0.0:
            raise FglocError(f"ekf-slam: identity_gate must be positive, got {self.identity_gate}")
        positive = ("process_noise", "gate_m", "wall_range_sigma", "wall_bearing_sigma")
        others = ("calibration", "horizon_s", "wall_range_share")
        check_noise(
            "ekf-slam",
            {name: getattr(self, name) for name in positive},
            {name: getattr(self, name) for name in others},
        )
