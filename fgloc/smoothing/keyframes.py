"""Keyframes: where the graph has a pose, and what the continuous sensors say there."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fgloc.core.drive import Drive
from fgloc.core.geometry import interpolate, wrap
from fgloc.core.measurements import (
    CameraPoses,
    Floats,
    LandmarkSightings,
    PoseFixes,
    PositionFixes,
    Stamps,
    Yaw,
    YawRate,
)

MAX_GAP_S = 0.25
"""A continuous sensor is not interpolated over a longer silence."""

Mask = npt.NDArray[np.bool_]


def absolute_fixes(drive: Drive) -> tuple[PositionFixes | PoseFixes, ...]:
    """Return the drive's streams that tell where the robot is in the map, in recorded order."""
    return tuple(s for s in drive.sensors if isinstance(s, PositionFixes | PoseFixes))


def choose_keyframes(drive: Drive, period_s: float, scans: Stamps | None = None) -> Stamps:
    """Return (K,) keyframe stamps: wheel stamps about `period_s` apart and every fix stamp.

    A fix and a sighting get a keyframe of their own, so that nothing has to be interpolated to
    them; so does a yaw reading of a sensor too slow to interpolate, and so do the `scans` (N,) that
    are used. Wheel stamps within half a period of a scan are left out. O(N).
    """
    stamps = drive.wheels.stamps_ns
    # 5 % slack keeps a jittering sensor of the same rate from alternating between one and two.
    period = max(int(period_s * 0.95e9), 1)
    median = float(np.median(np.diff(stamps))) if stamps.size > 1 else 1.0
    stride = max(1, round(period_s * 1e9 / median))
    keep = stamps[::stride]
    long = np.flatnonzero(np.diff(keep) > 2 * period)
    if long.size:
        extra = [stamps[(stamps > keep[k]) & (stamps < keep[k + 1])] for k in long]
        keep = np.concatenate([keep, *extra])
    if scans is not None and scans.size:
        after = np.searchsorted(scans, keep)
        near = np.minimum(
            np.abs(keep - scans[np.maximum(after - 1, 0)]),
            np.abs(keep - scans[np.minimum(after, scans.size - 1)]),
        )
        keep = np.concatenate([keep[near > period // 2], scans])
    fixes = [f.stamps_ns for f in absolute_fixes(drive)]
    seen = [np.unique(m.stamps_ns) for m in drive.each(LandmarkSightings)]
    slow = [y.stamps_ns for y in drive.each(Yaw) if is_slow(y.stamps_ns)]
    inside = [f[(f >= stamps[0]) & (f <= stamps[-1])] for f in (*fixes, *slow, *seen)]
    return np.unique(np.concatenate([keep, stamps[[0, -1]], *inside]))


def is_slow(stamps: Stamps) -> bool:
    """Return True if most samples are too far apart to interpolate between them."""
    return stamps.size > 1 and float(np.median(np.diff(stamps))) > MAX_GAP_S * 1e9


def _bracket(stamps: Stamps, at: Stamps, max_gap_s: float) -> tuple[Stamps, Floats, Mask]:
    """Return the left sample, the fraction to the right one, and where both are near enough."""
    if stamps.size < 2:
        return np.zeros(at.size, np.int64), np.zeros(at.size), np.zeros(at.size, np.bool_)
    left = np.clip(np.searchsorted(stamps, at, side="right") - 1, 0, stamps.size - 2)
    gap = stamps[left + 1] - stamps[left]
    fraction = (at - stamps[left]) / gap
    exact = (at == stamps[left]) | (at == stamps[left + 1])
    near = (gap <= max_gap_s * 1e9) | exact
    valid = near & (at >= stamps[0]) & (at <= stamps[-1])
    return left.astype(np.int64), fraction, valid


def yaw_at(sensor: Yaw, keyframes_ns: Stamps) -> tuple[Floats, Mask]:
    """Return the (K,) unwrapped yaw at the keyframes and where it is known."""
    left, fraction, valid = _bracket(sensor.stamps_ns, keyframes_ns, MAX_GAP_S)
    if not valid.any():
        return np.zeros(keyframes_ns.size), valid
    readings = np.unwrap(sensor.yaw)
    step = wrap(readings[left + 1] - readings[left])
    return readings[left] + fraction * step, valid


def once_each(sensor: Yaw, keyframes_ns: Stamps, valid: Mask) -> Stamps:
    """Return the indices of `valid` keyframes, only the nearest one of each reading.

    Between two readings interpolation tells nothing new: a sensor slower than the keyframes would
    count several times over.
    """
    at = np.flatnonzero(valid)
    left, fraction, _ = _bracket(sensor.stamps_ns, keyframes_ns[at], MAX_GAP_S)
    reading = left + (fraction > 0.5)
    away = np.abs(sensor.stamps_ns[reading] - keyframes_ns[at])
    order = np.lexsort((away, reading))
    _, chosen = np.unique(reading[order], return_index=True)
    return np.sort(at[order[chosen]]).astype(np.int64)


def turned_angle(sensor: YawRate, keyframes_ns: Stamps) -> tuple[Floats, Mask]:
    """Return the (K-1,) angles a gyro turned between keyframes (trapezoid) and where it is known.

    An interval that contains a silence of more than MAX_GAP_S is not known.
    """
    stamps = sensor.stamps_ns
    if stamps.size < 2:
        n = keyframes_ns.size - 1
        return np.zeros(n), np.zeros(n, np.bool_)
    seconds = np.diff(stamps) * 1e-9
    steps = 0.5 * (sensor.rate[1:] + sensor.rate[:-1]) * seconds
    total = np.concatenate([[0.0], np.cumsum(steps)])
    silent = np.concatenate([[0], np.cumsum(seconds > MAX_GAP_S)])
    left, fraction, valid = _bracket(stamps, keyframes_ns, MAX_GAP_S)
    # Inside an interval the rate changes linearly, so the angle is quadratic in the fraction.
    width = seconds[left]
    inside = (
        width
        * fraction
        * (sensor.rate[left] + 0.5 * fraction * (sensor.rate[left + 1] - sensor.rate[left]))
    )
    angle = total[left] + inside
    right = np.searchsorted(stamps, keyframes_ns[1:]).clip(max=stamps.size - 1)
    known = valid[1:] & valid[:-1] & (silent[right] == silent[left[:-1]])
    return np.diff(angle), known


def camera_at(sensor: CameraPoses, keyframes_ns: Stamps) -> tuple[Floats, Mask]:
    """Return the (K, 3) camera poses at the keyframes, interpolated on SE(2), and where known."""
    left, fraction, valid = _bracket(sensor.stamps_ns, keyframes_ns, MAX_GAP_S)
    if not valid.any():
        return np.zeros((keyframes_ns.size, 3)), valid
    return interpolate(sensor.poses[left], sensor.poses[left + 1], fraction), valid
