"""A drive's wheels, scans and landmark sightings merged by time, as EKF-SLAM's loop takes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.measurements import Floats, LandmarkSightings, Scans, Stamps
from fgloc.core.preintegration import preintegrate, rounding_sigma, split_at
from fgloc.errors import FglocError
from fgloc.filters.ekf_slam_settings import EkfSlamSettings
from fgloc.filters.ekf_slam_streams import Stream, mark_stream, wall_stream
from fgloc.filters.ekf_slam_tables import Codes
from fgloc.filters.miscalibration import miscalibration


@dataclass(frozen=True)
class Events:
    """All measurements of a drive in the order of time."""

    cuts_ns: Stamps
    """(C,) moments at which something is seen or emitted, all wheel stamps among them."""
    steps: Floats
    """(C-1, 3) relative poses between cuts by the wheels."""
    step_covariances: Floats
    """(C-1, 3, 3) their covariances, in the axes of the earlier cut."""
    emit: Codes
    """(C,) number of the wheel stamp, -1 at cuts that are none."""
    streams: tuple[Stream, ...]
    """What sees landmarks, in the drive's order."""
    first_group: Codes
    """(C+1,) the first group at each cut: what one stream saw at one moment; the last is G."""
    group_stream: Codes
    """(G,) its stream."""
    group_first: Codes
    """(G+1,) its first sighting; the last entry is E."""
    group_row: Codes
    """(G,) where its scan's ranges begin in `ranges`; 0 for marks."""
    group_turn: Floats
    """(G,) how far the lidar turned during its scan [rad]."""
    stream_of: Codes
    """(E,) stream of each sighting."""
    reading_of: Codes
    """(E,) its number among the stream's sightings."""
    ranges: Floats
    """All scans' ranges [m], one after the other."""


def merge(drive: Drive, settings: EkfSlamSettings) -> Events:
    """Return the measurements inside the drive (cut to its truth already), merged by time.

    Raises FglocError if nothing sees landmarks or the wheels do not determine the motion.
    O((N + E) log (N + E)) and the extraction of walls.
    """
    sensors = [s for s in drive.sensors if isinstance(s, Scans | LandmarkSightings)]
    if not sensors:
        raise FglocError("ekf-slam needs scans or landmark sightings, and the drive has none")
    wheels = drive.wheels.stamps_ns
    rounding = rounding_sigma(drive.robot, drive.wheels.resolution)
    streams = tuple(
        wall_stream(s, drive, settings, rounding)
        if isinstance(s, Scans)
        else mark_stream(s, drive, rounding)
        for s in sensors
    )
    cuts = np.unique(np.concatenate([wheels, *(s.groups_ns for s in streams)]))
    moved = preintegrate(split_at(drive.wheels, cuts), drive.robot)
    wrong = miscalibration(
        drive.robot,
        moved.jacobian,
        np.diff(cuts) * 1e-9,
        settings.calibration,
        settings.horizon_s,
    )
    emit = np.full(cuts.size, -1, dtype=np.int64)
    emit[np.searchsorted(cuts, wheels)] = np.arange(wheels.size)
    at = np.concatenate([s.groups_ns for s in streams])
    order = np.argsort(at, kind="stable")
    begins = np.cumsum([0, *(s.ranges.size for s in streams)])
    rows = [begin + s.group_row for begin, s in zip(begins, streams, strict=False)]
    sizes = np.concatenate([s.group_size for s in streams])[order]
    firsts = np.concatenate([np.cumsum(s.group_size) - s.group_size for s in streams])[order]
    group_stream = np.repeat(np.arange(len(streams)), [s.groups_ns.size for s in streams])[order]
    group_first = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    # Sightings of a group stand one after the other in their stream.
    reading_of = np.arange(group_first[-1]) + np.repeat(firsts - group_first[:-1], sizes)
    return Events(
        cuts_ns=cuts,
        steps=moved.displacement,
        step_covariances=settings.process_noise**2 * (moved.covariance + wrong),
        emit=emit,
        streams=streams,
        first_group=np.searchsorted(at[order], np.append(cuts, cuts[-1] + 1)).astype(np.int64),
        group_stream=group_stream.astype(np.int64),
        group_first=group_first,
        group_row=np.concatenate(rows)[order].astype(np.int64),
        group_turn=np.concatenate([s.group_turn for s in streams])[order],
        stream_of=np.repeat(group_stream, sizes).astype(np.int64),
        reading_of=reading_of.astype(np.int64),
        ranges=_joined([s.ranges for s in streams]),
    )


def _joined(arrays: list[Floats]) -> Floats:
    """Return arrays one after the other; a single one is not copied."""
    filled = [a for a in arrays if a.size]
    if len(filled) == 1:
        return filled[0]
    return np.concatenate([np.zeros(0), *filled])
