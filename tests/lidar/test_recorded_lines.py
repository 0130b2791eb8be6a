"""Walls in recorded scans: the MIT CSAIL floor, SICK scanner."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgloc.core.measurements import Scans
from fgloc.datasets.registry import load_drive
from fgloc.lidar.lines import extract
from fgloc.lidar.scan import Cloud, cloud
from fgloc.lidar.segments import Segments


@pytest.fixture
def recorded(data_dir: Path) -> tuple[Scans, Cloud, Segments]:
    """Return every fourth scan of the floor and what is found in it."""
    (scans,) = load_drive("csail:0", data_dir).each(Scans)
    some = replace(
        scans, stamps_ns=scans.stamps_ns[::4], ranges=np.ascontiguousarray(scans.ranges[::4])
    )
    return some, cloud(some), extract(cloud(some), some)


def test_most_of_what_is_seen_is_wall_and_each_once(
    recorded: tuple[Scans, Cloud, Segments],
) -> None:
    scans, points, found = recorded
    assert found.points.sum() > 0.5 * points.valid.sum()
    assert np.bincount(found.scan, minlength=len(scans.ranges)).mean() > 3.5
    assert 2 * (found.lengths > 3.0).sum() > len(scans.ranges)
    # No two of a scan lie on each other: farther apart than 5 cm where they overlap.
    tangent = np.stack([-np.sin(found.normal), np.cos(found.normal)], axis=1)
    normal = np.stack([np.cos(found.normal), np.sin(found.normal)], axis=1)
    twice = 0
    for i in range(found.scan.size):
        for j in range(i + 1, min(i + 20, found.scan.size)):
            if found.scan[i] != found.scan[j]:
                break
            ends = found.ends[j] - found.middle[i]
            at, off = ends @ tangent[i], ends @ normal[i]
            inside = min(at.max(), found.reach[i, 1]) - max(at.min(), found.reach[i, 0])
            twice += bool(np.abs(off).max() < 0.05 and inside > 0.2)
    assert twice <= 0.01 * found.scan.size


def test_beams_lie_on_the_segments(recorded: tuple[Scans, Cloud, Segments]) -> None:
    # Of the beams between the ends of a segment in direction most end on it, hardly any behind:
    # nothing is claimed where the scanner looked through.
    _, points, found = recorded
    behind = on = total = 0
    for m in range(found.scan.size):
        seen = points.points[found.scan[m]][points.valid[found.scan[m]]]
        n = np.array([np.cos(found.normal[m]), np.sin(found.normal[m])])
        angle = np.arctan2(seen[:, 1], seen[:, 0])
        low, high = np.sort(np.arctan2(found.ends[m, :, 1], found.ends[m, :, 0]))
        # Scans look ahead: no segment lies across the cut of the angle.
        within = (angle > low) & (angle < high)
        h = (seen[within] - found.middle[m]) @ n
        total += h.size
        on += int(np.sum(np.abs(h) < 0.1))
        behind += int(np.sum(h < -0.3))
    assert on > 0.85 * total
    assert behind < 0.02 * total
