"""Encoder selection: of the encoders on a side, believe the one that the acceleration favours.

A driven wheel that loses its grip turns too fast, a braked one too slowly. So while a robot
accelerates or keeps its speed, the wheel of a side that went the shortest way is taken to grip,
while it brakes the one that went furthest. Source: seed A, equations 3.3 to 3.6.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from fgloc.core.drive import Drive
from fgloc.core.kinematics import WheeledBase, Y
from fgloc.core.measurements import Acceleration, Floats, Stamps
from fgloc.errors import FglocError

TRACK = "effective_track"


def select_encoders(drive: Drive) -> Drive:
    """Return the drive with one increment a side: every wheel of a side has the selected one's.

    Where the mean forward acceleration of a packet is not negative, that is the increment of
    smallest magnitude (of equal ones the first in column order), else the one of largest (the
    last). The mean is over the samples of the first `Acceleration` stream in (stamp k, stamp k+1];
    without samples the acceleration is taken as zero, and a note says for how many packets.

    The wheels stay as many as they were, with equal increments: a method that takes each wheel's
    noise as its own is told more than the one encoder knows. Raises FglocError unless the base is
    one whose wheels on a side turn alike (differential, skid-steer) with two encoders or more on
    each. O(N W + M), vectorised.
    """
    sides = wheel_sides(drive.robot.base)
    for name in ("left", "right"):
        if len(sides[name]) < 2:
            raise FglocError(
                f"{drive.name}: encoder selection needs two or more encoders on each side, "
                f"the {name} side has {len(sides[name])}; leave it out"
            )
    wheels = drive.wheels
    mean, known = packet_means(drive, wheels.stamps_ns)
    braking = mean < 0.0
    angles = wheels.angles.copy()
    changed = 0
    for columns in sides.values():
        angles[:, columns] = _selected(wheels.angles[:, columns], braking)[:, None]
        changed += int(np.any(angles[:, columns] != wheels.angles[:, columns], axis=1).sum())
    notes = (_note(changed, braking), *_missing(drive, known))
    return replace(drive, wheels=replace(wheels, angles=angles), notes=(*drive.notes, *notes))


def wheel_sides(base: WheeledBase) -> dict[str, list[int]]:
    """Return the columns of the encoders "left" and "right" of the middle of a base.

    Raises FglocError for a base without an effective track: its wheels do not form two sides that
    turn alike.
    """
    half = {wheel: c for name, wheel, column, c in base.links if (name, column) == (TRACK, Y)}
    if not half:
        raise FglocError(
            "encoder selection needs a base whose wheels on a side turn alike (differential, "
            f"skid-steer); a {base.kind} base is not one"
        )
    names = base.driven_names
    return {
        "left": [k for k, n in enumerate(names) if half.get(n, 0.0) > 0.0],
        "right": [k for k, n in enumerate(names) if half.get(n, 0.0) < 0.0],
    }


def packet_means(drive: Drive, stamps: Stamps) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Return the mean forward acceleration [m/s²] in (stamp k, stamp k+1], and where it is known.

    Of the drive's first accelerometer; N means for N+1 stamps, zero where there is no sample.
    """
    mean = np.zeros(stamps.size - 1)
    streams = drive.each(Acceleration)
    if not streams:
        return mean, np.zeros(mean.size, dtype=np.bool_)
    bounds = np.searchsorted(streams[0].stamps_ns, stamps, side="right")
    count = np.diff(bounds)
    known = count > 0
    if known.any():
        # Empty packets hold no samples between the others, so that sums run from start to start.
        sums = np.add.reduceat(streams[0].forward[: bounds[-1]], bounds[:-1][known])
        mean[known] = sums / count[known]
    return mean, known


def _selected(angles: Floats, braking: npt.NDArray[np.bool_]) -> Floats:
    """Return of each row of one side's increments (N, W) the one to believe (N,)."""
    size = np.abs(angles)
    last = angles.shape[1] - 1
    chosen = np.where(braking, last - np.argmax(size[:, ::-1], axis=1), np.argmin(size, axis=1))
    return np.take_along_axis(angles, chosen[:, None], axis=1)[:, 0]


def _note(changed: int, braking: npt.NDArray[np.bool_]) -> str:
    """Return the sentence that the selection was made, and what it did."""
    faster = int(braking.sum())
    return (
        f"Encoder selection: one encoder a side is believed, the faster one in {faster} of "
        f"{braking.size} packets (braking); those of a side differed {changed} times."
    )


def _missing(drive: Drive, known: npt.NDArray[np.bool_]) -> tuple[str, ...]:
    """Return the sentence about packets without an acceleration, or nothing."""
    if not drive.each(Acceleration):
        return ("Encoder selection: there is no accelerometer; acceleration is taken as zero.",)
    missing = int((~known).sum())
    if not missing:
        return ()
    return (
        f"Encoder selection: {missing} of {known.size} packets hold no acceleration; it is taken "
        "as zero there.",
    )
