"""Straight walls in scans: the default extractor, deterministic and compiled.

Each scan is cut into straight pieces (`fgloc.lidar.splitting`), pieces of one wall are merged
(`fgloc.lidar.merging`) and fitted (`fgloc.lidar.fitting`), and what the beams do not show to be
straight is dropped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats, Scans, Stamps
from fgloc.errors import FglocError
from fgloc.lidar.fitting import (
    BEAMS,
    LEFT,
    MIDDLE_X,
    MIDDLE_Y,
    MISFIT,
    NORMAL,
    RIGHT,
    SAGITTA,
    SAGITTA_VARIANCE,
    WIDTH,
    fit_line,
)
from fgloc.lidar.merging import curved_pair, difference, floors, gap, open_between
from fgloc.lidar.scan import Cloud
from fgloc.lidar.segments import Segments
from fgloc.lidar.splitting import gather, prepare, split

BLOCK = 4096
"""Segments that room is made for at a time."""


@dataclass(frozen=True)
class LineSettings:
    """What counts as a straight wall. The defaults hold for every lidar and drive here."""

    min_points: int = 8
    """Fewest beams that make a segment."""
    min_length_m: float = 0.4
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
    n, beams = cloud.ranges.shape
    increment = scans.angle_increment
    turn = beams > 1 and abs(abs(increment) * beams - 2.0 * math.pi) < 1.5 * abs(increment)
    most = beams // settings.min_points + 1
    noise = np.array(
        [
            scans.range_sigma,
            scans.range_sigma_share,
            scans.bearing_sigma,
            settings.roughness_m,
        ]
    )
    limits = np.array(
        [
            settings.min_length_m,
            settings.flatness_m,
            settings.gap_m,
            settings.hidden_m,
            settings.noise_margin**2,
            settings.outlier,
            settings.curved,
            settings.penalty,
            settings.clutter,
            settings.same,
        ]
    )
    points = np.ascontiguousarray(cloud.points)
    valid = np.ascontiguousarray(cloud.valid)
    parts: list[tuple[Stamps, Floats]] = []
    start = 0
    while start < n:
        room = max(most, min(BLOCK, most * (n - start)))
        scan, found = np.empty(room, np.int64), np.empty((room, 8))
        start, filled = _extract(
            points,
            valid,
            start,
            turn,
            abs(increment),
            settings.min_points,
            settings.most_missing,
            noise,
            limits,
            most,
            scan,
            found,
        )
        parts.append((scan[:filled], found[:filled]))
    scan = np.concatenate([p[0] for p in parts]) if parts else np.empty(0, np.int64)
    found = np.concatenate([p[1] for p in parts]) if parts else np.empty((0, 8))
    covariance = np.zeros((scan.size, 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = found[:, 5], found[:, 6]
    return Segments(
        scan,
        found[:, 0].copy(),
        found[:, 1:3].copy(),
        found[:, 3:5].copy(),
        covariance,
        found[:, 7].astype(np.int64),
    )


@compiled
def chi_square_bound(dof: int, sigmas: float) -> float:
    """Return the quantile of chi-square at so many sigmas of a normal number (Wilson, Hilferty)."""
    if dof < 1:
        return 0.0
    share = 2.0 / (9.0 * dof)
    return dof * (1.0 - share + sigmas * np.sqrt(share)) ** 3


@compiled
def _extract(
    points: Floats,
    valid: npt.NDArray[np.bool_],
    start: int,
    turn: bool,
    increment: float,
    min_points: int,
    most_missing: int,
    noise: Floats,
    limits: Floats,
    most: int,
    scan: Stamps,
    found: Floats,
) -> tuple[int, int]:
    """Fill segments scan by scan until the room may not do; return the next scan and the count."""
    beams = valid.shape[1]
    beam = np.empty(beams, np.int64)
    label = np.empty(beams, np.int64)
    before = np.empty(beams + 1, np.int64)
    x, y, r = np.empty(beams), np.empty(beams), np.empty(beams)
    weight = np.empty(beams)
    breaks = np.empty(beams, np.bool_)
    work = np.empty((9, beams + 1))
    first, last, order = (
        np.empty(beams, np.int64),
        np.empty(beams, np.int64),
        np.empty(beams, np.int64),
    )
    fits = np.empty((beams, WIDTH))
    filled = 0
    while start < valid.shape[0] and filled + most <= scan.size:
        k = start
        start += 1
        n = gather(points[k], valid[k], turn, beam, x, y)
        if n < min_points:
            continue
        prepare(n, beam, x, y, beams, noise, most_missing, r, breaks, weight)
        pieces = split(n, x, y, r, breaks, weight, limits[7], limits[8], work, before, label)
        along, across, weights = work[0], work[1], work[2]
        left = _fit_pieces(
            pieces, n, label, x, y, r, noise, limits[5], along, across, weights,
            first, last, order, fits,
        )  # fmt: skip
        left = _merge(
            left, n, turn, beam, beams, label, x, y, r, increment, noise, limits, most_missing,
            along, across, weights, first, last, order, fits,
        )  # fmt: skip
        for q in range(left):
            a = order[q]
            if not _straight(
                a, n, label, x, y, r, noise, limits, min_points, along, across, weights,
                first, last, fits,
            ):  # fmt: skip
                continue
            if _chord(q, left, n, turn, label, x, y, weights, first, last, order, fits, limits):
                continue
            fit = fits[a]
            normal_variance, offset_variance = floors(fit, limits[1])
            dof = int(fit[BEAMS]) - 2
            grown = max(1.0, fit[MISFIT] / chi_square_bound(dof, 2.0))
            scan[filled] = k
            found[filled, 0] = fit[NORMAL]
            found[filled, 1], found[filled, 2] = fit[MIDDLE_X], fit[MIDDLE_Y]
            found[filled, 3], found[filled, 4] = fit[RIGHT], fit[LEFT]
            found[filled, 5] = normal_variance * grown
            found[filled, 6] = offset_variance * grown
            found[filled, 7] = fit[BEAMS]
            filled += 1
    return start, filled


@compiled
def _fit_pieces(
    pieces: int,
    n: int,
    label: Stamps,
    x: Floats,
    y: Floats,
    r: Floats,
    noise: Floats,
    outlier: float,
    along: Floats,
    across: Floats,
    weights: Floats,
    first: Stamps,
    last: Stamps,
    order: Stamps,
    fits: Floats,
) -> int:
    """Fit a line to every piece; those without one become clutter. Return how many are left."""
    for p in range(pieces):
        first[p], last[p] = -1, -1
    for k in range(n):
        p = label[k]
        weights[k] = 0.0
        if p >= 0:
            if first[p] < 0:
                first[p] = k
            last[p] = k
    left = 0
    for p in range(pieces):
        if last[p] - first[p] >= 3 and fit_line(
            first[p], last[p], p, n, label, x, y, r, noise, outlier, along, across, weights, fits[p]
        ):
            order[left] = p
            left += 1
        else:
            for k in range(first[p], last[p] + 1):
                label[k] = -1
    return left


@compiled
def _merge(
    left: int,
    n: int,
    turn: bool,
    beam: Stamps,
    beams: int,
    label: Stamps,
    x: Floats,
    y: Floats,
    r: Floats,
    increment: float,
    noise: Floats,
    limits: Floats,
    most_missing: int,
    along: Floats,
    across: Floats,
    weights: Floats,
    first: Stamps,
    last: Stamps,
    order: Stamps,
    fits: Floats,
) -> int:
    """Merge pieces of one wall, near ones first; return how many pieces are left in `order`."""
    trial = np.empty(WIDTH)
    step = 1
    while step <= 4 and step < left:
        q = 0
        merged = False
        while q < left:
            if q + step >= left and not turn:
                break
            if left <= step:
                break
            a, b = order[q], order[(q + step) % left]
            if not _mergeable(
                a, b, n, beam, beams, x, y, r, increment, limits, most_missing, first, last, fits
            ):
                q += 1
                continue
            end = last[b] if last[b] > last[a] else last[b] + n
            for i in range(first[b], last[b] + 1):
                if label[i % n] == b:
                    label[i % n] = a
            ok = fit_line(
                first[a], end, a, n, label, x, y, r, noise, limits[5],
                along, across, weights, trial,
            )  # fmt: skip
            allowed = fits[a, MISFIT] + fits[b, MISFIT] + 2.0 * limits[9]
            if ok and trial[MISFIT] <= allowed * limits[4]:
                last[a] = end
                for i in range(WIDTH):
                    fits[a, i] = trial[i]
                gone = (q + step) % left
                for i in range(gone, left - 1):
                    order[i] = order[i + 1]
                left -= 1
                merged = True
                if gone < q:
                    q -= 1
            else:
                for i in range(first[b], last[b] + 1):
                    j = i % n
                    # What b held lies outside of a's own beams.
                    if label[j] == a and not _inside(j, first[a], last[a], n):
                        label[j] = b
                q += 1
        step = 1 if merged and step > 1 else step + 1
    return left


@compiled
def _inside(k: int, first: int, last: int, n: int) -> bool:
    """Return whether beam k lies in the cyclic run first..last."""
    return first <= k <= last or first <= k + n <= last


@compiled
def _mergeable(
    a: int,
    b: int,
    n: int,
    beam: Stamps,
    beams: int,
    x: Floats,
    y: Floats,
    r: Floats,
    increment: float,
    limits: Floats,
    most_missing: int,
    first: Stamps,
    last: Stamps,
    fits: Floats,
) -> bool:
    """Return whether piece b, the next after a but for some, shows the same wall as a."""
    if a == b or difference(fits[a], fits[b], limits[1]) > limits[9]:
        return False
    begin = first[b] if first[b] > last[a] else first[b] + n
    better = fits[a] if fits[a, BEAMS] >= fits[b, BEAMS] else fits[b]
    other = fits[b] if fits[a, BEAMS] >= fits[b, BEAMS] else fits[a]
    wide = gap(better, other)
    i = last[a] % n
    cosine = abs(np.cos(better[NORMAL]) * x[i] + np.sin(better[NORMAL]) * y[i]) / r[i]
    spacing = r[i] * increment / max(cosine, 0.05)
    if wide <= max(limits[2], 3.0 * spacing):
        return True
    return wide <= limits[3] and not open_between(
        fits[a], fits[b], last[a] + 1, begin - 1, n, beam, beams, x, y, limits[2], most_missing
    )


@compiled
def _straight(
    a: int,
    n: int,
    label: Stamps,
    x: Floats,
    y: Floats,
    r: Floats,
    noise: Floats,
    limits: Floats,
    min_points: int,
    along: Floats,
    across: Floats,
    weights: Floats,
    first: Stamps,
    last: Stamps,
    fits: Floats,
) -> bool:
    """Fit a piece once more without its two end beams; return whether it is a straight wall.

    An end beam may have met a corner or an edge half, or the wall round the corner.
    """
    fit = fits[a]
    if fit[BEAMS] < min_points:
        return False
    head, tail = first[a] % n, last[a] % n
    label[head], label[tail] = -1, -1
    ok = fit_line(
        first[a], last[a], a, n, label, x, y, r, noise, limits[5], along, across, weights, fit
    )
    label[head], label[tail] = a, a
    if not ok:
        return False
    nx, ny = np.cos(fit[NORMAL]), np.sin(fit[NORMAL])
    for end in (head, tail):
        weights[end] = 0.0
        dx, dy = x[end] - fit[MIDDLE_X], y[end] - fit[MIDDLE_Y]
        s, h = dy * nx - dx * ny, nx * dx + ny * dy
        variance = noise[0] ** 2 + (noise[1] * r[end]) ** 2 + noise[3] ** 2
        if h * h <= limits[5] ** 2 * variance:
            fit[RIGHT], fit[LEFT] = min(fit[RIGHT], s), max(fit[LEFT], s)
    length = fit[LEFT] - fit[RIGHT]
    if fit[BEAMS] + 2 < min_points or length < limits[0]:
        return False
    if fit[MISFIT] > limits[4] * chi_square_bound(int(fit[BEAMS]) - 2, 3.0):
        return False
    bulge = abs(fit[SAGITTA])
    return bulge <= limits[6] * (np.sqrt(fit[SAGITTA_VARIANCE]) + limits[1])


@compiled
def _chord(
    q: int,
    left: int,
    n: int,
    turn: bool,
    label: Stamps,
    x: Floats,
    y: Floats,
    weights: Floats,
    first: Stamps,
    last: Stamps,
    order: Stamps,
    fits: Floats,
    limits: Floats,
) -> bool:
    """Return whether the q-th piece and a neighbour that it touches may be chords of one curve."""
    for side in range(2):
        i = q if side == 0 else q - 1
        if left < 2 or (not turn and (i < 0 or i + 1 >= left)):
            continue
        a, b = order[i % left], order[(i + 1) % left]
        begin = first[b] if first[b] > last[a] else first[b] + n
        if begin - last[a] > 3:
            continue
        p, s = last[a] % n, first[b] % n
        near = 0.0
        for c in (a, b):
            near += (fits[c, LEFT] - fits[c, RIGHT]) / max(fits[c, BEAMS] - 1.0, 1.0)
        if np.hypot(x[p] - x[s], y[p] - y[s]) > 2.0 * near:
            continue
        end = last[b] if last[b] > last[a] else last[b] + n
        if curved_pair(fits[a], fits[b], a, b, first[a], end, n, label, x, y, weights, limits[9]):
            return True
    return False
