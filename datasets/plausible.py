"""Wrong units, found before anything is estimated: millimetres, degrees, ticks, seconds.

The bounds are wide: they let every wheeled robot pass and catch factors of 57 (degrees) and more.
A value inside them can still be wrong; then the results say how far estimates are from priors.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from fgloc.core.bounds import dimension_problem
from fgloc.core.drive import Drive
from fgloc.core.measurements import (
    Floats,
    PoseFixes,
    PositionFixes,
    Stamps,
    Yaw,
    YawRate,
)
from fgloc.errors import FglocError

FASTEST_M_S = 20.0
"""No wheeled ground robot that is meant here drives faster [m/s]."""
FASTEST_RAD_S = 20.0
"""None turns faster, in the middle over its turning intervals [rad/s]."""
SHORTEST_NS, LONGEST_NS = 200_000, 60_000_000_000
"""Bounds of the median time between encoder stamps: 5 kHz and one a minute [ns]."""
OVERFLOW_RAD = 1e6
"""No wheel turns further from one stamp to the next [rad]; a wrapped 32-bit counter does."""
LEAP_S = 86_400.0
"""No drive pauses for longer [s]."""
FACTOR = 20.0
"""Two measurements of the same motion that differ by more are not in the same unit."""
LITTLE_M, LITTLE_RAD = 0.5, 1.0
"""Motion below this is not compared: noise and mounting could explain it [m], [rad]."""
TURN = 2.0 * math.pi
"""A heading that turns less in all [rad] is not called wrong."""
DRIFT_RAD_S = 0.01
"""What a heading may drift [rad/s]: this much turning more is not compared."""


def check_plausible(drive: Drive) -> None:
    """Raise FglocError that names the drive, the stream and the likely unit if one is wrong.

    Compared are the robot's dimensions with those of any robot, stamps and speeds with what
    encoders and robots do, and every stream with the motion that the nominal wheels tell. O(N).
    """
    for p in drive.robot.base.parameters:
        for what, value in (("", p.nominal), (" prior sigma", p.prior_sigma)):
            problem = dimension_problem(p.name, p.unit, value)
            # An angle may be unknown altogether.
            if problem is not None and not (what and p.unit == "rad"):
                raise FglocError(f"the robot's {p.name}{what} {problem}", file=drive.name)
    for problem in _problems(drive):
        raise FglocError(problem, file=drive.name)


def _problems(drive: Drive) -> Iterator[str]:
    """Yield what is implausible about the measurements, the causes before their effects."""
    wheels = drive.wheels
    step = float(np.median(np.diff(wheels.stamps_ns)))
    if not SHORTEST_NS <= step <= LONGEST_NS:
        yield (
            f"{wheels.sensor}: the stamps are {step:.3g} ns apart: are they in another unit? "
            "write whole nanoseconds"
        )
    leap = int(np.argmax(np.diff(wheels.stamps_ns.astype(np.float64))))
    seconds = float(wheels.stamps_ns[leap + 1]) * 1e-9 - float(wheels.stamps_ns[leap]) * 1e-9
    if seconds > LEAP_S:
        yield (
            f"{wheels.sensor}: the stamps leap by {seconds:.3g} s after increment {leap}: was the "
            "clock set during the drive? cut the recording there"
        )
    row = int(np.argmax(np.abs(wheels.angles).max(axis=1)))
    turned_most = float(np.abs(wheels.angles[row]).max())
    if turned_most > OVERFLOW_RAD:
        yield (
            f"{wheels.sensor}: increment {row} turns a wheel by {turned_most:.3g} rad: did a "
            "counter overflow? undo the wrap or leave that row out"
        )
    try:
        moved = drive.robot.base.displacements(wheels.angles, wheels.steering)
    except FglocError as error:
        yield str(error)
        return
    lengths = np.hypot(moved[:, 0], moved[:, 1])
    # From second to second: a coarse encoder's single counts look fast.
    way = np.append(0.0, np.cumsum(lengths))
    speed = _typical(wheels.stamps_ns, way)[0]
    if speed > FASTEST_M_S and way[-1] > LITTLE_M:
        yield (
            f"{wheels.sensor}: the nominal wheels drive {speed:.3g} m/s: are the angles counts or "
            "degrees, or the radii millimetres? write rad and m"
        )
    path, turned = float(lengths.sum()), float(np.abs(moved[:, 2]).sum())
    for name, stamps, heading in _headings(drive):
        rate, total = _typical(stamps, heading)
        allowed = max(turned, LITTLE_RAD + DRIFT_RAD_S * drive.duration_s)
        # Within a turn in all, a short recording may hold one strange reading and nothing else.
        if total > TURN and (rate > FASTEST_RAD_S or total > FACTOR * allowed):
            yield (
                f"{name}: the heading turns by {total:.3g} rad in all where the nominal wheels "
                f"turn by {turned:.3g}: is it in degrees? write rad"
            )
    for name, stamps, positions in _positions(drive):
        if stamps.size < 2:
            continue
        span = float(np.hypot(*np.ptp(positions, axis=0)))
        during = (wheels.stamps_ns[1:] >= stamps[0]) & (wheels.stamps_ns[:-1] <= stamps[-1])
        rolled = float(lengths[during].sum())
        if span > FACTOR * max(path, LITTLE_M):
            yield (
                f"{name}: the positions span {span:.3g} m where the nominal wheels roll "
                f"{path:.3g} m: is one of the two in another unit? write m and rad"
            )
        if rolled > FACTOR * max(_coarse_path(stamps, positions), LITTLE_M):
            yield (
                f"{name}: the positions move by {_coarse_path(stamps, positions):.3g} m where the "
                f"nominal wheels roll {rolled:.3g} m: is one of the two in another unit (degrees "
                "of latitude, counts, degrees)? write m and rad"
            )


def _headings(drive: Drive) -> Iterator[tuple[str, Stamps, Floats]]:
    """Yield name, stamps and heading [rad] of everything that tells one, unwrapped."""
    for s in drive.each(Yaw):
        yield s.sensor, s.stamps_ns, np.unwrap(s.yaw)
    for g in drive.each(YawRate):
        steps = np.diff(g.stamps_ns, prepend=g.stamps_ns[:1]) * 1e-9
        yield g.sensor, g.stamps_ns, np.cumsum(g.rate * steps)
    if drive.truth is not None:
        truth = drive.truth.trajectory
        yield drive.truth.sensor, truth.stamps_ns, np.unwrap(truth.poses[:, 2])


def _positions(drive: Drive) -> Iterator[tuple[str, Stamps, Floats]]:
    """Yield name, stamps and positions (N, 2) of everything that tells them."""
    for f in drive.each(PositionFixes):
        yield f.sensor, f.stamps_ns, f.positions
    for p in drive.each(PoseFixes):
        yield p.sensor, p.stamps_ns, p.poses[:, :2]
    if drive.truth is not None:
        truth = drive.truth.trajectory
        yield drive.truth.sensor, truth.stamps_ns, truth.poses[:, :2]


def _typical(stamps: Stamps, course: Floats) -> tuple[float, float]:
    """Return the median rate of change from second to second [1/s] while it changes, and the sum.

    The sum is that of all changes without their signs; both are 0 where nothing changes.
    """
    chosen = _seconds(stamps)
    changes = np.abs(np.diff(course[chosen]))
    moving = changes > 0.0
    if not moving.any():
        return 0.0, 0.0
    seconds = np.diff(stamps[chosen])[moving] * 1e-9
    return float(np.median(changes[moving] / seconds)), float(changes.sum())


def _coarse_path(stamps: Stamps, positions: Floats) -> float:
    """Return the length [m] of the way through one position a second, so noise does not add up."""
    steps = np.diff(positions[_seconds(stamps)], axis=0)
    return float(np.hypot(steps[:, 0], steps[:, 1]).sum())


def _seconds(stamps: Stamps) -> Stamps:
    """Return the indices of samples about a second apart, first and last included."""
    if stamps.size == 0:
        return np.zeros(0, np.int64)
    # The first sample of each second, without a list of all seconds: a clock may leap by decades.
    _, first = np.unique(stamps // 1_000_000_000, return_index=True)
    return np.unique(np.append(first, stamps.size - 1)).astype(np.int64)
