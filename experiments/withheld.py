"""Drives of which something is kept from the estimators: where and which landmarks are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.measurements import LandmarkSightings


def without_survey(drive: Drive) -> Drive:
    """Return the drive with nothing known of the positions of landmarks."""
    return replace(
        drive,
        sensors=tuple(
            replace(s, survey=None) if isinstance(s, LandmarkSightings) else s
            for s in drive.sensors
        ),
    )


def without_identity(drive: Drive) -> Drive:
    """Return the drive with sightings that do not say which landmark was seen."""
    return replace(
        drive,
        sensors=tuple(
            replace(s, landmark=np.full_like(s.landmark, -1))
            if isinstance(s, LandmarkSightings)
            else s
            for s in drive.sensors
        ),
    )
