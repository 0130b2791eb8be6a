"""Straight walls in scans: the default extractor, deterministic and compiled.

Each scan is cut into straight pieces (`fgloc.lidar.splitting`), pieces of one wall are merged
(`fgloc.lidar.merging`) and fitted (`fgloc.lidar.fitting`), and what the beams do not show to be
straight is dropped (`fgloc.lidar.straightness`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats, Scans, Stamps
from fgloc.errors import FglocError
from fgloc.lidar.beams import Rules, gather, room
from fgloc.lidar.fitting import BEAMS, LEFT, MIDDLE_X, MIDDLE_Y, MISFIT, NORMAL, RIGHT, WIDTH
from fgloc.lidar.merging import Pieces, fit_pieces, floors, merge
from fgloc.lidar.scan import Cloud
from fgloc.lidar.segments import Segments
from fgloc.lidar.splitting import split
from fgloc.lidar.straightness import chi_square_bound, chords, neighbour, refine, straight

BLOCK = 4096
"""Segments that room is made for at a time."""


@dataclass(frozen=True)
class LineSettings:
    """What counts as a straight wall. The defaults hold for every lidar and drive here."""

    min_points: int = 10
    """Fewest beams that make a segment."""
    min_length_m: float = 0.5
    """Shortest segment [m]."""
    flatness_m: float = 0.003
    """How far a wall as seen is off a plane as a whole [m], one sigma: does not average out."""
    roughness_m: float = 0.003
    """How far a wall is off a plane from beam to beam [m], one sigma: averages out."""
    gap_m: float = 0.3
    """Pieces that are this close [m] are one wall, whatever is between them."""
    hidden_m: float = 1.5
    """Widest part of a wall [m] that something in front of it may hide."""
    most_missing: int = 4
    """Most beams in a row that may be missing inside a wall."""
    noise_margin: float = 1.5
    """How many times the stated noise a wall may have without being taken for clutter."""
    outlier: float = 4.0
    """Beams farther off their line than this many sigmas do not count."""
    curved: float = 3.0
    """A segment that bulges by more than this many sigmas (and by as many times the flatness) is
    no straight wall."""
    penalty: float = 25.0
    """Chi-square that one more piece has to save."""
    clutter: float = 12.0
    """Chi-square that leaving one beam out of all pieces has to save."""
    same: float = 13.8
    """Pieces whose lines differ by less (squared, normalised, two numbers) are one wall."""

    def __post_init__(self) -> None:
        if self.min_points < 4:
            raise FglocError(f"lines: min_points must be at least 4, got {self.min_points}")
        for name in ("noise_margin", "outlier", "curved", "penalty", "clutter", "same"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise FglocError(f"lines: {name} must be positive and finite")
        for name in ("min_length_m", "flatness_m", "roughness_m", "gap_m", "hidden_m"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise FglocError(f"lines: {name} must be finite and not negative")
        if self.most_missing < 0:
            raise FglocError(f"lines: most_missing must not be negative, got {self.most_missing}")


def extract(cloud: Cloud, scans: Scans, settings: LineSettings = LineSettings()) -> Segments:
    """Return the straight walls that the scans of a cloud show, in the order of their beams.

    The noise is that of `scans`. A scan without walls gives no segment; nothing that beams can be
    raises an error. Covariances hold for the noise stated plus the settings' flatness and
    roughness, and grow with a misfit that chance does not explain. About 0.3 ms a scan of 400
    beams, compiled.
    """
    n = cloud.ranges.shape[0]
    rules = _rules(scans, cloud.ranges.shape[1], settings)
    most = rules.beams // settings.min_points + 1
    points, valid = np.ascontiguousarray(cloud.points), np.ascontiguousarray(cloud.valid)
    parts: list[tuple[Stamps, Floats]] = [(np.empty(0, np.int64), np.empty((0, COLUMNS)))]
    start = 0
    while start < n:
        space = max(most, min(BLOCK, most * (n - start)))
        scan, found = np.empty(space, np.int64), np.empty((space, COLUMNS))
        start, filled = _extract(points, valid, start, rules, most, scan, found)
        parts.append((scan[:filled], found[:filled]))
    found = np.concatenate([part[1] for part in parts])
    covariance = np.zeros((found.shape[0], 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = found[:, 5], found[:, 6]
    return Segments(
        scan=np.concatenate([part[0] for part in parts]),
        normal=found[:, 0].copy(),
        middle=found[:, 1:3].copy(),
        reach=found[:, 3:5].copy(),
        covariance=covariance,
        points=found[:, 7].astype(np.int64),
    )


COLUMNS = 8
"""Of what `_extract` finds: normal, middle, reach, variance of normal and offset, beams."""


def _rules(scans: Scans, beams: int, settings: LineSettings) -> Rules:
    """Return what compiled code goes by."""
    increment = abs(scans.angle_increment)
    return Rules(
        beams=beams,
        increment=increment,
        turn=beams > 1 and abs(increment * beams - 2.0 * math.pi) < 1.5 * increment,
        range_sigma=float(scans.range_sigma),
        range_sigma_share=float(scans.range_sigma_share),
        bearing_sigma=float(scans.bearing_sigma),
        min_range=float(scans.min_range),
        max_range=float(scans.max_range),
        roughness_m=float(settings.roughness_m),
        flatness_m=float(settings.flatness_m),
        min_points=settings.min_points,
        min_length_m=float(settings.min_length_m),
        gap_m=float(settings.gap_m),
        hidden_m=float(settings.hidden_m),
        most_missing=settings.most_missing,
        noise_margin=float(settings.noise_margin),
        outlier=float(settings.outlier),
        curved=float(settings.curved),
        penalty=float(settings.penalty),
        clutter=float(settings.clutter),
        same=float(settings.same),
    )


@compiled
def _extract(
    points: Floats,
    valid: npt.NDArray[np.bool_],
    start: int,
    rules: Rules,
    most: int,
    scan: Stamps,
    found: Floats,
) -> tuple[int, int]:
    """Fill segments scan by scan until the room may not do; return the next scan and the count."""
    size = rules.beams
    space = room(size)
    work, before = np.empty((12, size + 1)), np.empty(size + 1, np.int64)
    next_to, keep = np.empty((size, 2), np.int64), np.empty(size, np.bool_)
    pieces = Pieces(
        np.empty(size, np.int64),
        np.empty(size, np.int64),
        np.empty(size, np.int64),
        np.empty((size, WIDTH)),
    )
    filled = 0
    while start < valid.shape[0] and filled + most <= scan.size:
        k = start
        start += 1
        beams = gather(points[k], valid[k], rules, space)
        if beams.r.size < rules.min_points:
            continue
        count = split(beams, rules.penalty, rules.clutter, work, before)
        left = merge(fit_pieces(count, rules, beams, pieces), rules, beams, pieces)
        for q in range(left):
            next_to[q, 0] = neighbour(q, -1, left, rules, beams, pieces)
            next_to[q, 1] = neighbour(q, 1, left, rules, beams, pieces)
        for q in range(left):
            keep[q] = refine(pieces.order[q], next_to[q, 0], next_to[q, 1], rules, beams, pieces)
        for q in range(left):
            a, fit = pieces.order[q], pieces.fits[pieces.order[q]]
            long = pieces.last[a] - pieces.first[a] + 1 >= rules.min_points
            if not (keep[q] and long and straight(fit, rules)):
                continue
            back, on = next_to[q, 0], next_to[q, 1]
            if back >= 0 and chords(back, a, rules, beams, pieces):
                continue
            if on >= 0 and chords(a, on, rules, beams, pieces):
                continue
            normal_variance, offset_variance = floors(fit, rules.flatness_m)
            # What the noise does not explain twice in a hundred scans makes it larger.
            grown = max(1.0, fit[MISFIT] / chi_square_bound(int(fit[BEAMS]) - 2, 2.0))
            scan[filled] = k
            found[filled, 0] = fit[NORMAL]
            found[filled, 1], found[filled, 2] = fit[MIDDLE_X], fit[MIDDLE_Y]
            found[filled, 3], found[filled, 4] = fit[RIGHT], fit[LEFT]
            found[filled, 5] = normal_variance * grown
            found[filled, 6] = offset_variance * grown
            found[filled, 7] = fit[BEAMS]
            filled += 1
    return start, filled
