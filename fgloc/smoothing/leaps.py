"""Headings that leap: what a heading sensor tells between leaps that nobody else saw.

A compass beside a steel door is wrong for seconds. To the graph each of its readings is a witness
of its own, and they outvote the two moments at which gyro, camera and wheels saw no turn. But it
is one event, and it shows in the increments: those of the heading against everybody else's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.geometry import between, wrap
from fgloc.core.measurements import CameraPoses, Floats, Stamps, Yaw, YawRate
from fgloc.core.preintegration import preintegrate, split_at
from fgloc.smoothing.keyframes import Mask, camera_at, turned_angle
from fgloc.smoothing.sensors import bias_sigma, camera_sigma, gyro_sigma

STEP_S = 0.1
"""Time over which increments are compared, at least [s]."""
LEAST = 0.1
"""Smallest leap that is looked for [rad]: less is within reach of delays between sensors."""
SIGMAS = 6.0
"""How many standard deviations a leap must be off, beside that."""
SCALE = 0.1
"""Part of a turn that gyro and camera may be off, by scale and by delay."""
SLIPPERY = 0.7
"""Part of a turn that wheels may be off, by an unknown track and by slip."""
MOST = 20
"""A sensor that leaps more often is wrong as a whole; see `fgloc.smoothing.trust`."""


@dataclass(frozen=True)
class Leaps:
    """What is left out of one heading sensor."""

    sensor: str
    """Its name."""
    count: int
    """Readings that are left out."""
    note: str
    """What a user should know."""


@dataclass(frozen=True)
class _Turns:
    """What somebody else says of the turns between some stamps."""

    turned: Floats
    """(K-1,) angles [rad]."""
    known: Mask
    """(K-1,) where there are any."""
    allowed: Floats
    """(K-1,) how far off they may be [rad]."""
    wheels: bool
    """Whether they are the wheels'."""


def without_leaps(drive: Drive) -> tuple[Drive, tuple[Leaps, ...]]:
    """Return the drive without readings of a leaping heading sensor, and what was left out. O(N).

    The heading leaps where its increment contradicts all gyros and cameras there and the wheels
    (with a gyro and a camera, those two will do). Stretches between leaps whose zero agrees with
    the longest share of the drive are kept.
    """
    sensors, found = [], []
    for sensor in drive.sensors:
        leaps = None
        if isinstance(sensor, Yaw):
            sensor, leaps = _cleared(drive, sensor)
        sensors.append(sensor)
        if leaps is not None:
            found.append(leaps)
    if not found:
        return drive, ()
    return replace(drive, sensors=tuple(sensors)), tuple(found)


def _cleared(drive: Drive, yaw: Yaw) -> tuple[Yaw, Leaps | None]:
    """Return a heading sensor without the readings between leaps, and what they were."""
    wheels = drive.wheels.stamps_ns
    inside = np.flatnonzero((yaw.stamps_ns >= wheels[0]) & (yaw.stamps_ns <= wheels[-1]))
    if inside.size < 3:
        return yaw, None
    median = max(float(np.median(np.diff(yaw.stamps_ns[inside]))) * 1e-9, 1e-9)
    at = inside[:: max(1, round(STEP_S / median))]
    stamps = yaw.stamps_ns[at]
    told = wrap(np.diff(yaw.yaw[at]))
    places, sizes = _leaps(told, list(_others(drive, stamps)), yaw.sigma)
    if not 0 < places.size <= MOST:
        return yaw, None
    # Readings up to the one before a leap are of the stretch before it, those from the one after
    # it on of the next, and what lies between is neither's.
    first = np.concatenate([[0], at[places + 1]])
    last = np.concatenate([at[places], [yaw.stamps_ns.size - 1]])
    zero = np.concatenate([[0.0], np.cumsum(sizes)])
    seconds = (yaw.stamps_ns[last] - yaw.stamps_ns[first]) * 1e-9
    alike = np.abs(zero[:, None] - zero) < LEAST
    shares = alike @ seconds
    kept = alike[int(np.argmax(shares))]
    if 2.0 * float(np.max(shares)) < float(np.sum(seconds)):
        return yaw, None
    keep = np.zeros(yaw.stamps_ns.size, np.bool_)
    for begin, end, good in zip(first, last, kept, strict=True):
        keep[begin : end + 1] = good
    count = int(np.sum(~keep))
    moments = ", ".join(
        f"{size:+.2f} rad at {(stamps[k] - wheels[0]) * 1e-9:.1f} s"
        for k, size in list(zip(places, sizes, strict=True))[:4]
    )
    more = f" and {places.size - 4} more times" if places.size > 4 else ""
    note = (
        f"{yaw.sensor} leaps by {moments}{more}, which nobody else saw; {count} readings between "
        "are left out"
    )
    less = replace(yaw, stamps_ns=yaw.stamps_ns[keep], yaw=yaw.yaw[keep])
    return less, Leaps(yaw.sensor, count, note)


def _leaps(told: Floats, others: list[_Turns], sigma: float) -> tuple[Stamps, Floats]:
    """Return the (L,) intervals in which a heading leaps, and by how much [rad]."""
    count = np.zeros(told.size, np.int64)
    seers, agree = np.zeros(told.size, np.int64), np.zeros(told.size, np.bool_)
    total = np.zeros(told.size)
    for other in others:
        off = wrap(told - other.turned)
        wrong = np.abs(off) > LEAST + SIGMAS * np.sqrt(2.0) * sigma + other.allowed
        count += wrong & other.known
        if not other.wheels:
            agree |= ~wrong & other.known
            seers += other.known
            total += np.where(other.known, off, 0.0)
    places = np.flatnonzero((count >= 2) & (seers > 0) & ~agree)
    return places, total[places] / seers[places]


def _others(drive: Drive, stamps: Stamps) -> Iterator[_Turns]:
    """Yield what gyros, cameras and wheels say of the turns between (K,) stamps."""
    seconds = np.diff(stamps) * 1e-9
    exact = np.zeros(3)
    for gyro in drive.each(YawRate):
        turned, known = turned_angle(gyro, stamps)
        sigma = np.hypot(gyro_sigma(gyro, seconds, exact), bias_sigma(gyro) * seconds)
        yield _Turns(turned, known, SIGMAS * sigma + SCALE * np.abs(turned), False)
    for camera in drive.each(CameraPoses):
        poses, valid = camera_at(camera, stamps)
        moved = between(poses[:-1], poses[1:])
        sigma = camera_sigma(camera, moved, exact)[:, 2]
        allowed = SIGMAS * sigma + SCALE * np.abs(moved[:, 2])
        yield _Turns(moved[:, 2], valid[1:] & valid[:-1], allowed, False)
    turned = preintegrate(split_at(drive.wheels, stamps), drive.robot).displacement[:, 2]
    yield _Turns(turned, np.ones(turned.size, np.bool_), SLIPPERY * np.abs(turned), True)
