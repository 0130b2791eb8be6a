"""First guess: dead reckoning, turned by the best heading sensor, aligned to the fixes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.geometry import compose
from fgloc.core.measurements import Floats, PoseFixes, PositionFixes, Stamps, Yaw, YawRate
from fgloc.core.preintegration import Preintegrated
from fgloc.core.start import start_pose
from fgloc.smoothing.keyframes import absolute_fixes, turned_angle, yaw_at

ORIGIN_SIGMA = 1e-4
"""Sigma [m, rad] of a start that defines the map frame itself."""
FEWEST = 3
"""At least so many fixes are aligned, where there are as many."""
TELLING = 20.0
"""Fixes this many sigmas apart tell the heading to some degrees."""


@dataclass(frozen=True)
class Guess:
    """Where the optimiser starts, and what is known of the first keyframe."""

    poses: Floats
    """(K, 3) base poses."""
    start: Floats
    """(3,) measured pose of the reference (or the base, without one) at the first keyframe."""
    start_sigma: Floats
    """(3,) its standard deviations [m, m, rad]."""
    turn: Floats
    """(K-1,) turned angles by yaw sensor or gyro [rad]; NaN where only the wheels know."""
    turn_spread: Floats
    """(K-1, 2) how far they may be off: variance [rad²] that adds up, sigma [rad] of one sign."""
    notes: tuple[str, ...] = ()
    """What the user should know."""


def first_guess(drive: Drive, keyframes_ns: Stamps, pre: Preintegrated) -> Guess:
    """Return dead-reckoned poses at the keyframes from the drive's start. O(K).

    Headings come from yaw or gyro where there is one: the nominal track of a skidding robot may
    be wrong by half, and a heading off by radians is beyond any local optimiser.
    """
    turn = np.full(keyframes_ns.size - 1, np.nan)
    spread = np.zeros((turn.size, 2))
    seconds = np.diff(keyframes_ns) * 1e-9
    for gyro in drive.each(YawRate)[:1]:
        angle, known = turned_angle(gyro, keyframes_ns)
        turn[known] = angle[known]
        both = np.stack([gyro.density**2 * seconds, gyro.bias_sigma * seconds], axis=1)
        spread[known] = both[known]
    for yaw in drive.each(Yaw)[:1]:
        reading, valid = yaw_at(yaw, keyframes_ns)
        known = valid[1:] & valid[:-1]
        turn[known] = np.diff(reading)[known]
        steady = yaw.drift_rate_sigma * seconds
        both = np.stack([yaw.drift_sigma**2 * seconds, steady], axis=1)
        spread[known] = both[known]
    poses = dead_reckon(pre.displacement, turn)
    if drive.truth is not None:
        start = start_pose(drive)
        measured = compose(start, np.array(drive.truth.mount, dtype=np.float64))
        return Guess(compose(start, poses), measured, np.array(drive.truth.sigma), turn, spread)
    fixes = absolute_fixes(drive)
    usable = sum(int(np.isin(f.stamps_ns, keyframes_ns).sum()) for f in fixes)
    if usable == 0:
        return Guess(poses, np.zeros(3), np.full(3, ORIGIN_SIGMA), turn, spread)
    start, extent = _align(poses, keyframes_ns, fixes)
    note = "no truth to start from: the start was found by aligning dead reckoning to the fixes"
    sigma = np.array([extent + 10.0, extent + 10.0, np.pi])
    return Guess(compose(start, poses), start, sigma, turn, spread, (note,))


def dead_reckon(displacement: Floats, turn: Floats) -> Floats:
    """Return (K, 3) poses from the origin, moving by the wheels' (K-1, 3) displacements.

    Where `turn` (K-1,) is not NaN it replaces the wheels' rotation.
    """
    wheel_turn = displacement[:, 2]
    turn = np.where(np.isnan(turn), wheel_turn, turn)
    heading = np.concatenate([[0.0], np.cumsum(turn)])
    # The chord of an arc points along the mean heading: turn it by half of the correction.
    along = heading[:-1] + 0.5 * (turn - wheel_turn)
    c, s = np.cos(along), np.sin(along)
    x = np.cumsum(c * displacement[:, 0] - s * displacement[:, 1])
    y = np.cumsum(s * displacement[:, 0] + c * displacement[:, 1])
    return np.stack([np.append(0.0, x), np.append(0.0, y), heading], axis=1)


def _align(
    poses: Floats, keyframes_ns: Stamps, fixes: tuple[PoseFixes | PositionFixes, ...]
) -> tuple[Floats, float]:
    """Return the start pose that brings dead reckoning closest to the first fixes; their extent."""
    indices, points, sigmas = [], [], []
    for fix in fixes:
        inside = np.isin(fix.stamps_ns, keyframes_ns)
        xy = fix.poses[:, :2] if isinstance(fix, PoseFixes) else fix.positions
        indices.append(np.searchsorted(keyframes_ns, fix.stamps_ns[inside]))
        points.append(xy[inside])
        sigmas.append(fix.sigma[inside, 0])
    order = np.argsort(np.concatenate(indices), kind="stable")
    a = poses[np.concatenate(indices)[order], :2]
    b, sigma = np.concatenate(points)[order], np.concatenate(sigmas)[order]
    enough = telling(b, sigma) or a.shape[0]
    return align(a[:enough], b[:enough])


def telling(fixes: Floats, sigma: Floats) -> int:
    """Return how many of the first fixes (N, 2), sigmas (N,), tell the heading; 0 if all do not.

    No more than needed are of use, since dead reckoning bends with time.
    """
    far = np.flatnonzero(np.hypot(*(fixes - fixes[0]).T) > TELLING * sigma)
    return min(max(FEWEST, int(far[0]) + 1), fixes.shape[0]) if far.size else 0


def align(points: Floats, fixes: Floats) -> tuple[Floats, float]:
    """Return the pose (3,) that brings points (N, 2) closest to fixes (N, 2), and their extent.

    Closed form (rigid alignment in the plane). Lever arms, small beside the drive, are left to
    the optimiser.
    """
    ma, mb = points.mean(axis=0), fixes.mean(axis=0)
    da, db = points - ma, fixes - mb
    cross = float(np.sum(da[:, 0] * db[:, 1] - da[:, 1] * db[:, 0]))
    dot = float(np.sum(da * db))
    angle = float(np.arctan2(cross, dot)) if points.shape[0] > 1 else 0.0
    c, s = np.cos(angle), np.sin(angle)
    origin = mb - np.array([c * ma[0] - s * ma[1], s * ma[0] + c * ma[1]])
    return np.array([origin[0], origin[1], angle]), float(np.abs(db).max(initial=0.0))
