"""What a drive's streams cannot tell the smoother: sentences for the user."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.measurements import LandmarkSightings, Scans
from fgloc.smoothing.keyframes import MAX_GAP_S

SILENT_S, SILENT_PERIODS = 1.0, 5.0
"""Wheels are called silent beyond this [s], and beyond so many of their periods."""


def remarks(drive: Drive, counts: Mapping[str, tuple[int, int]]) -> tuple[str, ...]:
    """Return what the user should know: streams that could not be used, and silent wheels.

    `counts` holds how many measurements of each stream became factors, and how many could not.
    """
    stamps = drive.wheels.stamps_ns
    notes = []
    for sensor in drive.sensors:
        if counts.get(sensor.sensor, (1, 0))[0] > 0:
            continue
        inside = (sensor.stamps_ns >= stamps[0]) & (sensor.stamps_ns <= stamps[-1])
        if isinstance(sensor, Scans) and inside.any():
            reason = "one lidar can be used, and two of its scans are needed at least"
        elif isinstance(sensor, LandmarkSightings) and inside.any():
            reason = "it does not say which landmark it sees; ekf-slam can do without that"
        elif inside.any():
            reason = (
                f"readings are more than {MAX_GAP_S:g} s apart: what happens between them is not "
                "known"
            )
        else:
            reason = "no reading lies between the drive's first and last wheel stamp: check clocks"
        notes.append(f"{sensor.sensor} was not used: {reason}")
    gaps = np.diff(stamps) * 1e-9
    longest = int(np.argmax(gaps))
    if gaps[longest] > max(SILENT_S, SILENT_PERIODS * float(np.median(gaps))):
        since = float(stamps[longest] - stamps[0]) * 1e-9
        notes.append(
            f"the wheels are silent for {gaps[longest]:.3g} s, {since:.1f} s after the start: "
            "their motion in the gap is taken as steady"
        )
    return tuple(notes)
