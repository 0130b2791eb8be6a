"""The incremental smoother's own copy of its window: what is needed to build the graph anew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.errors import FglocError
from fgloc.factors.gtsam_factors import Bundle, Row

STIFF = 1e-6
"""Smallest standard deviation of the calibration's walk over one segment, in solver units: a
parameter that does not wander still needs a factor between its segments."""


def frame_key(index: int) -> int:
    """Return the gtsam key of a keyframe, x<index>."""
    return (ord("x") << 56) + index


def segment_key(index: int) -> int:
    """Return the gtsam key of a calibration segment, c<index>."""
    return (ord("c") << 56) + index


def landmark_key(index: int) -> int:
    """Return the gtsam key of a landmark, l<index>."""
    return (ord("l") << 56) + index


@dataclass
class Frame:
    """A keyframe in the window."""

    stamp: float
    """Time [s] since the start."""
    segment: int
    """Its calibration segment."""
    guess: Floats
    """(B,) the state it entered with."""
    bundles: list[Bundle] = field(default_factory=list)
    """Bundles of which it is the oldest keyframe: they leave with it."""


@dataclass
class Segment:
    """A calibration variable in the window."""

    begin: float
    """Time [s] of its first keyframe."""
    stamp: float
    """Time [s] of its last keyframe so far."""
    guess: Floats
    """(G,) the value it entered with."""
    prior: Floats | None = None
    """(G, G) covariance of a prior about the guess; the first segment may have one."""
    walk: Floats | None = None
    """(G,) standard deviations of the walk from the segment before."""


@dataclass
class Landmark:
    """A landmark in the window."""

    stamp: float
    """Time [s] of the last keyframe that saw it."""
    begin: float
    """Time [s] when it entered."""
    guess: Floats
    """(2,) the value it entered with."""
    prior: Floats | None
    """(2, 2) covariance of a prior about the guess, None for none."""


class Window:
    """Keyframes, calibration segments and landmarks that are variables now. O(window) memory."""

    def __init__(self) -> None:
        self.frames: dict[int, Frame] = {}
        """By keyframe index, without gaps."""
        self.segments: dict[int, Segment] = {}
        """By number, without gaps; empty without calibration."""
        self.landmarks: dict[int, Landmark] = {}
        """By id."""
        self.oldest = self.newest = 0
        """First and last keyframe index."""

    def keys(self) -> set[int]:
        """Return the gtsam keys of all variables. O(window)."""
        keys = {frame_key(k) for k in self.frames}
        keys |= {segment_key(s) for s in self.segments}
        return keys | {landmark_key(i) for i in self.landmarks}

    def bundles(self) -> list[Bundle]:
        """Return all bundles, oldest keyframe first. O(window)."""
        return [b for k in sorted(self.frames) for b in self.frames[k].bundles]

    def segment_of(self, keyframe: int) -> int:
        """Return the gtsam key of a keyframe's calibration segment."""
        return segment_key(self.frames[keyframe].segment)

    def check(self, row: Row, newest: int) -> None:
        """Raise `FglocError` for a row that is not finite or outside the window up to `newest`."""
        table = row.table
        numbers = table.measurements[row.index], table.sqrt_information[row.index], row.weight
        if not all(np.isfinite(n).all() for n in numbers):
            raise FglocError(f"{table.sensor}: a measurement is not finite")
        first = int(table.first[row.index])
        if first < self.oldest or row.keyframe > newest:
            raise FglocError(f"{table.sensor}: keyframe {first} is not in the window")

    def attach(self, bundle: Bundle) -> None:
        """Give a bundle its factor and keep it until its oldest keyframe leaves."""
        keys = [frame_key(k) for k in range(bundle.first, bundle.last + 1)]
        last = self.frames[bundle.last]
        seen = [landmark_key(i) for i in bundle.landmarks]
        segment = self.segments.get(last.segment)
        g = 0 if segment is None else segment.guess.size
        bundle.attach(keys, segment_key(last.segment), seen, g)
        self.frames[bundle.first].bundles.append(bundle)

    def forget_before(self, stamp: float) -> None:
        """Drop what GTSAM marginalises: all variables older than a stamp [s], their bundles too.

        O(what goes), and O(landmarks) where there are any.
        """
        while self.oldest < self.newest and self.frames[self.oldest].stamp < stamp:
            self.drop_oldest()
        for s in sorted(self.segments):
            if self.segments[s].stamp >= stamp:
                break
            del self.segments[s]
        for i in [i for i, mark in self.landmarks.items() if mark.stamp < stamp]:
            del self.landmarks[i]

    def drop_oldest(self) -> None:
        """Drop the oldest keyframe with its bundles."""
        for bundle in self.frames.pop(self.oldest).bundles:
            bundle.factor = None
        self.oldest += 1


def bundled(rows: Sequence[Row]) -> list[Bundle]:
    """Return the rows as few bundles: one for a keyframe interval, one for the landmarks seen.

    Landmarks stay apart: changing the weight of a wheel row should not touch them all.
    """
    groups: dict[tuple[int, bool], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.keyframe, row.landmark >= 0), []).append(row)
    return [Bundle(group) for group in groups.values()]
