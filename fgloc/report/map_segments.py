"""Pieces of wall in map axes, and which parts of the walls were seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.core.geometry import compose
from fgloc.core.measurements import Floats, Stamps
from fgloc.lidar.walls import Map, Walls
from fgloc.report.map_points import PlacedScans

GAP_M = 0.3
"""Parts of a wall that are closer than this were seen as one [m]: narrower than any door."""


@dataclass(frozen=True)
class PlacedSegments:
    """Pieces of wall as they were seen, where the robot was when it saw them."""

    row: Stamps
    """(M,) row of the placed scan that each was seen in, non-decreasing."""
    ends: Floats
    """(M, 2, 2) right and left end in map axes [m]."""
    wall: Stamps
    """(M,) the wall it was associated with; -1 for none."""


def place_segments(found: Map, scans: PlacedScans) -> PlacedSegments | None:
    """Return the map's segments in map axes, those of scans that could be placed; None without."""
    if found.segments is None:
        return None
    segments = found.segments
    wall = np.full(segments.scan.size, -1, np.int64) if found.wall is None else found.wall
    if not scans.scan.size:
        return PlacedSegments(np.zeros(0, np.int64), np.zeros((0, 2, 2)), np.zeros(0, np.int64))
    row = np.clip(np.searchsorted(scans.scan, segments.scan), 0, scans.scan.size - 1)
    there = scans.scan[row] == segments.scan
    row = row[there]
    # A point is a pose whose heading does not matter.
    ends = segments.ends[there]
    posed = np.concatenate([ends, np.zeros((*ends.shape[:2], 1))], axis=-1)
    moved = compose(scans.poses[row][:, None], posed)[..., :2]
    return PlacedSegments(row.astype(np.int64), np.ascontiguousarray(moved), wall[there])


def seen_parts(walls: Walls, segments: PlacedSegments) -> list[Floats]:
    """Return for each wall the (K, 2) parts of it that segments cover, right end and left end [m].

    Measured along the tangent from the anchor's foot, as `Walls.reach` is, in order and at least
    GAP_M apart: what lies between two of them, a door, was never seen to be wall. (0, 2) for a wall
    without segments. O(M log M).
    """
    normal = np.stack([np.cos(walls.normal), np.sin(walls.normal)], axis=1)
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    foot = walls.anchor + walls.offset[:, None] * normal
    own = segments.wall >= 0
    wall = segments.wall[own]
    away = segments.ends[own] - foot[wall][:, None]
    along = np.sort(np.einsum("mkd,md->mk", away, tangent[wall]), axis=1)
    parts: list[Floats] = []
    for k in range(walls.normal.size):
        seen = along[wall == k]
        seen = seen[np.argsort(seen[:, 0])]
        left = np.maximum.accumulate(seen[:, 1])
        first = np.ones(seen.shape[0], np.bool_)
        first[1:] = seen[1:, 0] > left[:-1] + GAP_M
        begins = np.flatnonzero(first)
        ends = np.append(begins[1:], seen.shape[0])[: begins.size] - 1
        parts.append(np.stack([seen[begins, 0], left[ends]], axis=1))
    return parts


def seen_lines(walls: Walls, segments: PlacedSegments) -> list[Floats]:
    """Return the (2, 2) ends in map axes [m] of every part of a wall that was seen.

    A wall without segments, as a filter may keep one, counts as seen from end to end.
    """
    lines: list[Floats] = []
    ends = walls.ends
    for k, parts in enumerate(seen_parts(walls, segments)):
        tangent = np.array([-np.sin(walls.normal[k]), np.cos(walls.normal[k])])
        right = ends[k, 0] - walls.reach[k, 0] * tangent
        lines += [ends[k]] if not parts.size else [right + np.outer(p, tangent) for p in parts]
    return lines
