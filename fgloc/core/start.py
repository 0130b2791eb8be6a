"""Where and when every estimator starts: the recorded truth's first usable pose.

All methods of a comparison start alike. The clock starts at the first wheel stamp at which the
truth is known: at or between two recorded poses not more than 0.5 s apart. Wheel increments before
that stamp are left out (`trim_to_truth`), because nothing could be said of their start. Wheel
stamps hardly ever coincide with the truth's, so the start is interpolated on SE(2)
(`start_pose`) and mapped from the reference's frame to the base through the nominal mounting.
Where most recorded poses are further apart than that, so that a robot turns between them as it
likes, the clock starts at the first of them instead, and the increment around it is cut there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.geometry import compose, interpolate, inverse
from fgloc.core.measurements import Floats, Stamps
from fgloc.errors import FglocError

MAX_GAP_S = 0.5
"""Longest stretch between two recorded poses [s] over which the truth counts as known."""


def trim_to_truth(drive: Drive) -> Drive:
    """Return the drive with its wheels beginning at the first stamp where the truth is known.

    The drive itself is returned where there is no truth or nothing to leave out, so the function
    may be applied twice. Other streams are not cut: what lies before the first wheel stamp is
    outside the drive. Where no wheel stamp lies in a truth interval of at most 0.5 s (sparse
    truth), any interval will do. Raises FglocError if wheels and truth do not overlap by at least
    one increment. O(N log M).
    """
    if drive.truth is None:
        return drive
    stamps = drive.wheels.stamps_ns
    first = _first_known(stamps, drive.truth.trajectory.stamps_ns)
    known = drive.truth.trajectory.stamps_ns
    if known.size > 1 and float(np.median(np.diff(known))) > MAX_GAP_S * 1e9:
        inside = known[(known >= stamps[0]) & (known < stamps[-1])]
        if inside.size:
            return drive if inside[0] == stamps[0] else _cut(drive, int(inside[0]))
    if first < 0 or first >= stamps.size - 1:
        raise FglocError(
            f"{drive.name}: the recorded truth does not overlap the wheel stamps in time; "
            "check that both use the same clock"
        )
    if first == 0:
        return drive
    return replace(drive, wheels=drive.wheels.between(first, stamps.size - 1))


def start_pose(drive: Drive) -> Floats:
    """Return the (3,) base pose x, y [m], heading [rad] in the map at the first wheel stamp.

    This is the truth's pose at the first wheel stamp of `trim_to_truth(drive)`, base =
    truth ∘ mount⁻¹ with the nominal mounting; the origin where there is no truth. Raises
    FglocError if wheels and truth do not overlap.
    """
    if drive.truth is None:
        return np.zeros(3)
    truth = drive.truth.trajectory
    stamp = trim_to_truth(drive).wheels.stamps_ns[0]
    after = int(np.searchsorted(truth.stamps_ns, stamp))
    reference = truth.poses[after]
    if truth.stamps_ns[after] != stamp:
        gap = float(truth.stamps_ns[after] - truth.stamps_ns[after - 1])
        fraction = np.array(float(stamp - truth.stamps_ns[after - 1]) / gap)
        reference = interpolate(truth.poses[after - 1], truth.poses[after], fraction)
    return compose(reference, inverse(np.array(drive.truth.mount, dtype=np.float64)))


def _first_known(stamps: Stamps, truth: Stamps) -> int:
    """Return the index of the first of `stamps` at which `truth` is known; -1 if there is none."""
    if truth.size == 0:
        return -1
    after = np.searchsorted(truth, stamps)
    inside = after < truth.size
    following = truth[np.minimum(after, truth.size - 1)]
    hit = inside & (following == stamps)
    bracketed = hit | (inside & (after > 0))
    gap_ns = following - truth[np.maximum(after - 1, 0)]
    known = hit | (bracketed & (gap_ns <= MAX_GAP_S * 1e9))
    chosen = np.flatnonzero(known if known[:-1].any() else bracketed)
    return int(chosen[0]) if chosen.size else -1


def _cut(drive: Drive, stamp: int) -> Drive:
    """Return the drive with its wheels beginning at a stamp inside an increment."""
    stamps = drive.wheels.stamps_ns
    at = int(np.searchsorted(stamps, stamp, side="right")) - 1
    wheels = drive.wheels.between(at, stamps.size - 1)
    angles, left = wheels.angles.copy(), float(stamps[at + 1] - stamp)
    angles[0] *= left / float(stamps[at + 1] - stamps[at])
    begin = np.concatenate([[stamp], wheels.stamps_ns[1:]])
    return replace(drive, wheels=replace(wheels, stamps_ns=begin, angles=angles))
