"""What landmark sensors add to the graph: sightings of points, and the scene of a lidar."""

from __future__ import annotations

import numpy as np

from fgloc.core.measurements import LandmarkSightings
from fgloc.factors.robust import Loss
from fgloc.factors.tables import FactorTable, Kind
from fgloc.smoothing.builder import Builder
from fgloc.smoothing.front import Front
from fgloc.smoothing.problem import diagonal
from fgloc.smoothing.scene import Scene


def add_sightings(b: Builder, sensor: LandmarkSightings, loss: Loss) -> None:
    """Add one factor a sighting, a landmark for each identity, and what a survey says of it."""
    at = np.minimum(np.searchsorted(b.keyframes_ns, sensor.stamps_ns), b.keyframes_ns.size - 1)
    valid = (b.keyframes_ns[at] == sensor.stamps_ns) & (sensor.landmark >= 0)
    b.counts[sensor.sensor] = (int(valid.sum()), int((~valid).sum()))
    if not valid.any():
        return
    index = b.mark_numbers(sensor.landmark[valid])
    n = index.size
    mount = np.broadcast_to(np.array(sensor.mount), (n, 3))
    seen = np.stack([sensor.range_m[valid], sensor.bearing[valid]], axis=1)
    b.tables.append(
        FactorTable(
            Kind.RANGE_BEARING,
            sensor.sensor,
            at[valid].astype(np.int64),
            np.concatenate([seen, mount], axis=1),
            diagonal(np.tile([sensor.range_sigma, sensor.bearing_sigma], (n, 1))),
            b.mount(sensor.sensor, sensor.mount, sensor.mount_sigma),
            loss,
            second=index,
        )
    )
    survey = sensor.survey
    if survey is None:
        return
    known = np.isin(survey.landmark, sensor.landmark[valid])
    if known.any():
        b.tables.append(
            FactorTable(
                Kind.LANDMARK_PRIOR,
                sensor.sensor,
                np.zeros(int(known.sum()), np.int64),
                survey.positions[known],
                diagonal(survey.sigma[known]),
                slice(0, 0),
                second=b.mark_numbers(survey.landmark[known]),
            )
        )


def scene_of(b: Builder, front: Front) -> Scene:
    """Return the lidar's part of the graph, without walls yet."""
    scans = front.scans
    b.counts[scans.sensor] = (scans.stamps_ns.size, front.left_out)
    return Scene(
        scans=scans,
        numbers=front.numbers,
        segments=front.segments,
        at=np.searchsorted(b.keyframes_ns, scans.stamps_ns).astype(np.int64),
        block=b.mount(scans.sensor, scans.mount, scans.mount_sigma),
        first=len(b.marks),
        wall=np.full(front.segments.scan.size, -1, np.int64),
        anchors=np.zeros((0, 2)),
    )
