"""Truth, satellite fixes and laser scans from their messages."""

from __future__ import annotations

import math
from collections import Counter

import msgspec
import numpy as np

from fgloc.core.drive import Reference
from fgloc.core.measurements import Floats, PositionFixes, Scans
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.geodesy import to_east_north
from fgloc.datasets.text import NOT_A_NUMBER, count, finite_rows
from fgloc.io.messages import POSE_VARIANCE, Messages
from fgloc.io.odometry import poses_of
from fgloc.io.sources import one_source
from fgloc.io.stamps import stamps_of
from fgloc.io.topics import GpsTable, ScanTable, TruthTable

TRUTH_SIGMA = (0.005, 0.005, 0.01)
"""Standard deviations of a recorded truth where it says nothing: x, y [m], heading [rad]."""
TRUTH_BOUNDS = (1e-5, 0.5)
"""Standard deviations of a truth outside are placeholders [m], [rad]."""
GPS_SIGMA = 2.5
"""Standard deviation of a fix where it says nothing [m]: a single-frequency receiver."""
GPS_BOUNDS = (1e-3, 100.0)
"""Standard deviations of a fix outside are placeholders [m]."""

RANGE_SIGMA_M, RANGE_SHARE = 0.01, 0.01
"""Noise of a small lidar's range: what does not grow with it [m], and a share of it."""
LONGEST_RANGE_M = 1000.0
"""Longest range of a lidar that states none [m]."""


def read_truth(
    messages: Messages, given: TruthTable, rejected: Counter[str], notes: list[str]
) -> tuple[Reference | None, TruthTable]:
    """Return the recorded truth and the table as it was used; None without two usable poses."""
    stamps, index = stamps_of(messages, "truth", rejected, notes)
    stamps, index, poses = poses_of(messages, stamps, index, "truth", rejected)
    if stamps.size < 2:
        notes.append(f"{messages.topic} has fewer than two usable poses: there is no truth.")
        return None, given
    kept, _ = one_source(stamps, poses, messages.topic, "truth", rejected, notes)
    stamps, index, poses = stamps[kept], index[kept], poses[kept]
    # Unwrapped across what was dropped, the heading may have jumped by a turn.
    poses[:, 2] = np.unwrap(poses[:, 2])
    told = _pose_sigma(messages.table()[index][:, POSE_VARIANCE])
    truth = Reference(
        Trajectory(stamps, poses),
        "truth",
        given.sigma or told or TRUTH_SIGMA,
        given.mount or (0.0, 0.0, 0.0),
        given.mount_sigma or (0.05, 0.05, 0.05),
    )
    used = msgspec.structs.replace(
        given,
        topic=messages.topic,
        sigma=truth.sigma,
        mount=truth.mount,
        mount_sigma=truth.mount_sigma,
    )
    return truth, used


def _pose_sigma(variance: Floats) -> tuple[float, float, float] | None:
    """Return the sigmas of the median of sensible variances (N, 3), None where there are none."""
    sensible = variance[np.isfinite(variance).all(axis=1) & (variance > 0.0).all(axis=1)]
    if not sensible.size:
        return None
    x, y, heading = np.sqrt(np.median(sensible, axis=0)).tolist()
    low, high = TRUTH_BOUNDS
    return (x, y, heading) if all(low <= s <= high for s in (x, y, heading)) else None


def read_gps(
    messages: Messages, given: GpsTable, rejected: Counter[str], notes: list[str]
) -> tuple[PositionFixes | None, GpsTable]:
    """Return the fixes in metres east and north of an origin and the table; None without any.

    Every fix has the sigma of its own covariance where that is known and sensible.
    """
    stamps, index = stamps_of(messages, "gps", rejected, notes)
    table = messages.table()[index]
    fixed = table[:, 2] >= 0.0
    count(rejected, "gps without fix", int((~fixed).sum()))
    stamps, table = stamps[fixed], table[fixed]
    good = finite_rows(table[:, :2], rejected, f"gps {NOT_A_NUMBER}")
    stamps, table = stamps[good], table[good]
    on_earth = (np.abs(table[:, 0]) <= 90.0) & (np.abs(table[:, 1]) <= 360.0)
    count(rejected, "gps off the earth", int((~on_earth).sum()))
    stamps, table = stamps[on_earth], table[on_earth]
    if not stamps.size:
        notes.append(f"{messages.topic} holds no valid fix.")
        return None, given
    latitude, longitude = table[:, 0], table[:, 1]
    origin = given.origin or (float(latitude[0]), float(longitude[0]))
    with np.errstate(invalid="ignore"):
        own = np.sqrt(table[:, 3:5])
    known = (table[:, 5:6] > 0.0) & (own >= GPS_BOUNDS[0]) & (own <= GPS_BOUNDS[1])
    sigma = np.where(known, own, GPS_SIGMA)
    if given.sigma is not None:
        sigma = np.full(own.shape, given.sigma)
    elif not known.all():
        notes.append(
            f"{int((~known).any(axis=1).sum())} of {stamps.size} fixes of {messages.topic} have no "
            f"usable covariance: σ {GPS_SIGMA} m is used."
        )
    where = "the first fix" if given.origin is None else f"{origin[0]}°, {origin[1]}°"
    notes.append(f"The map's axes are east and north, its origin is {where}.")
    fixes = PositionFixes(
        "gps",
        stamps,
        to_east_north(latitude, longitude, origin),
        sigma,
        mount=given.mount or (0.0, 0.0),
        mount_sigma=given.mount_sigma or (0.2, 0.2),
    )
    used = msgspec.structs.replace(
        given,
        topic=messages.topic,
        mount=fixes.mount,
        mount_sigma=fixes.mount_sigma,
        origin=origin,
    )
    return fixes, used


def read_scans(
    messages: Messages, given: ScanTable, rejected: Counter[str], notes: list[str]
) -> tuple[Scans | None, ScanTable]:
    """Return the scans and the table as it was used; None where there are none.

    Ranges that are not finite or outside the limits of their message are beams without return.
    Scans of another geometry than most are dropped and counted.
    """
    stamps, index = stamps_of(messages, "scan", rejected, notes)
    if not index.size:
        notes.append(f"{messages.topic} holds no scan.")
        return None, given
    rows = [messages.rows[k] for k in index]
    shapes = Counter((len(r[5]), round(r[0], 6), round(r[1], 9)) for r in rows)
    beams, angle_min, increment = shapes.most_common(1)[0][0]
    alike = [
        k
        for k, r in enumerate(rows)
        if (len(r[5]), round(r[0], 6), round(r[1], 9)) == (beams, angle_min, increment)
    ]
    count(rejected, "scan of another geometry", len(rows) - len(alike))
    if not beams or not math.isfinite(increment) or not math.isfinite(angle_min):
        notes.append(f"{messages.topic} has no beams and is left out.")
        return None, given
    ranges = np.stack([rows[k][5] for k in alike]).astype(np.float64)
    limits = np.array([rows[k][3:5] for k in alike], dtype=np.float64)
    low, high = limits[:, :1], limits[:, 1:]
    # Drivers that state no limits leave them at zero.
    high = np.where(high > low, high, np.inf)
    with np.errstate(invalid="ignore"):
        seen = np.isfinite(ranges) & (ranges >= low) & (ranges <= high) & (ranges > 0.0)
    first = rows[alike[0]]
    # The widest that any scan says: what each of them says was applied to its own ranges.
    longest = float(high[np.isfinite(high)].max(initial=0.0)) or LONGEST_RANGE_M
    shortest = float(max(0.0, low[np.isfinite(low)].min(initial=longest)))
    scans = Scans(
        "lidar",
        stamps[alike],
        np.where(seen, ranges, 0.0),
        angle_min=float(first[0]),
        angle_increment=float(first[1]),
        beam_period=max(0.0, float(first[2])),
        mount=given.mount or (0.0, 0.0, 0.0),
        mount_sigma=given.mount_sigma or (0.05, 0.05, 0.05),
        range_sigma=_given(given.range_sigma, RANGE_SIGMA_M),
        range_sigma_share=_given(given.range_sigma_share, RANGE_SHARE),
        bearing_sigma=_given(given.bearing_sigma, 0.25 * abs(float(first[1]))),
        min_range=shortest if shortest < longest else 0.0,
        max_range=longest,
    )
    used = msgspec.structs.replace(
        given,
        topic=messages.topic,
        mount=scans.mount,
        mount_sigma=scans.mount_sigma,
        range_sigma=scans.range_sigma,
        range_sigma_share=scans.range_sigma_share,
        bearing_sigma=scans.bearing_sigma,
    )
    return scans, used


def _given(value: float | None, otherwise: float) -> float:
    """Return a value if there is one."""
    return otherwise if value is None else value
