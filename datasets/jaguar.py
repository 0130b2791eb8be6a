"""Text logs of the DrRobot Jaguar 4x4: encoders of four wheels, yaw, acceleration, GPS.

Lines carry no time. The IMU lines count modulo 256 at 50 Hz: the unwrapped counter times 20 ms is
the time base, every other packet has the stamp of the last IMU line before it, and valid GPRMC
lines anchor the whole to UTC. A loss of 256 or more packets cannot be seen in the counter; where
GPS time shows one, the missing turns of the counter are put back. The right motors are mounted
mirrored: forward, their counts decrease. The log is read into memory, O(lines).
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fgloc.core.bases import skid_steer
from fgloc.core.drive import Drive
from fgloc.core.measurements import (
    Acceleration,
    Floats,
    PositionFixes,
    Sensor,
    Stamps,
    WheelIncrements,
    Yaw,
)
from fgloc.core.robot import Robot
from fgloc.datasets.geodesy import to_east_north
from fgloc.datasets.jaguar_lines import Packets, parse
from fgloc.datasets.text import (
    BACKWARD,
    REPEATED,
    TRUNCATED,
    Integers,
    Mask,
    count,
    forward_stamps,
    read_lines,
)
from fgloc.errors import FglocError

WHEELS = ("fl", "fr", "rl", "rr")
RADIUS = 0.135
"""Nominal wheel radius [m]."""
TRACK = 0.48
"""Nominal distance between left and right wheels [m]; the effective track is larger."""
TICKS = 300
"""Encoder counts per wheel revolution."""
TICK_NS = 20_000_000
"""Time between IMU lines [ns]."""
TURN = 256
"""IMU lines per turn of the counter."""
FASTEST = 2.0 * 11.0 / 3.6
"""Twice the top speed [m/s]: beyond it a wheel's count difference is not believed."""
PAIR_TICKS = 5
"""Front and rear counts at most this many IMU lines apart belong together."""
YAW_RESOLUTION = 0.01
"""Quantisation of the yaw [rad]."""
YAW_SIGMA = math.hypot(0.01, YAW_RESOLUTION / math.sqrt(12.0))
"""White noise of the yaw, of the measured order, with its quantisation [rad]."""
YAW_WALK = 0.0005
"""Random walk of the yaw's zero [rad/sqrt(s)]."""
YAW_DRIFT = 0.002
"""Sigma of the yaw's constant drift [rad/s]: at rest it was seen to be 0.01 rad in 7 s."""
COUNT_TO_ACCELERATION = 9.81 / 255.0
"""Acceleration of one count [m/s²]: 255 counts are about 1 g."""
LOST = "lost IMU packet"
UNPAIRED = "encoder packet of one board only"
JUMP = "implausible encoder count"


@dataclass(frozen=True)
class JaguarOptions:
    """What a log does not say."""

    antenna: tuple[float, float] = (0.0, 0.0)
    """Nominal position of the GPS antenna on the robot: x, y [m]."""
    antenna_sigma: tuple[float, float] = (0.2, 0.2)
    """Prior standard deviations of that position [m]."""
    gps_sigma: float = 2.5
    """Standard deviation of a GPS position along east and north [m]; GPRMC does not carry one."""


def robot() -> Robot:
    """Return the robot at its nominal dimensions."""
    base = skid_steer(("fl", "rl"), ("fr", "rr"), RADIUS, TRACK, order=WHEELS)
    return Robot.typical("Jaguar 4x4", base)


def load(path: Path, name: str | None = None, options: JaguarOptions | None = None) -> Drive:
    """Return the drive in a log. Raises FglocError if it holds no time base or no motion.

    Lines that cannot be read, lost packets, repeated and stray counters, and counts that no
    wheel can have turned are dropped and counted in `rejected`.
    """
    options = JaguarOptions() if options is None else options
    rejected: Counter[str] = Counter()
    lines = read_lines(path)
    count(rejected, TRUNCATED, int(bool(lines.rest.strip())))
    packets = parse(lines.text, rejected)
    if packets.counter.size < 2:
        raise FglocError("no IMU lines (#n,YAW,…) in this log, so nothing has a time", file=path)
    notes: list[str] = []
    if packets.first_unreadable:
        notes.append(f"The first unreadable line is line {packets.first_unreadable}.")
    keep, ticks = _time_base(packets, rejected, notes)
    stamps = ticks * TICK_NS
    if packets.fixes.size:
        # A fix arrives some time after it was valid; the median keeps single delays out.
        behind = packets.fixes[:, 1] - _at(ticks, packets.fixes[:, 0]) * (TICK_NS * 1e-9)
        stamps = stamps + round(float(np.median(behind)) * 1e3) * 1_000_000
    else:
        notes.append("No valid GPS time: the drive starts at time 0.")
    wheels = _wheels(packets, stamps, rejected, path)
    sensors: list[Sensor] = [
        Yaw(
            "yaw",
            stamps[keep],
            packets.imu[keep, 0],
            YAW_SIGMA,
            YAW_WALK,
            YAW_RESOLUTION,
            YAW_DRIFT,
        ),
        Acceleration("acc", stamps[keep], packets.imu[keep, 2] * COUNT_TO_ACCELERATION),
    ]
    if packets.fixes.size:
        sensors.append(_fixes(packets, options, rejected))
        notes.append("The map's axes are east and north, its origin the first valid GPS fix.")
    notes.append("The gyro is left out: the scale of its counts is not known.")
    return Drive(
        name if name is not None else str(path),
        robot(),
        wheels,
        tuple(sensors),
        rejected=dict(rejected),
        notes=tuple(notes),
    )


def _at(values: Integers, seen: Floats | Integers) -> Integers:
    """Return the value at the last IMU line before each packet, from the lines seen before it."""
    found: Integers = values[seen.astype(np.int64) - 1]
    return found


def _time_base(packets: Packets, rejected: Counter[str], notes: list[str]) -> tuple[Mask, Integers]:
    """Return which IMU lines are usable, and for all of them the unwrapped counter."""
    counter = packets.counter
    step = np.diff(counter) % TURN
    # A stray line counts back a little and is followed by one that goes on from before it.
    over = (counter[2:] - counter[:-2]) % TURN
    keep = np.ones(counter.size, dtype=np.bool_)
    keep[1:-1] &= ~((step[:-1] > TURN - 10) & (over >= 1) & (over <= 10))
    count(rejected, BACKWARD, int((~keep).sum()))
    used = np.flatnonzero(keep)
    again = np.diff(counter[used]) % TURN == 0
    count(rejected, REPEATED, int(again.sum()))
    keep[used[1:][again]] = False
    used = np.flatnonzero(keep)
    steps = np.diff(counter[used], prepend=counter[used[:1]]) % TURN
    count(rejected, LOST, int((steps[1:] - 1).sum()))
    _restore_turns(packets.fixes, used, steps, rejected, notes)
    unwrapped = np.cumsum(steps)
    # Lines that are not usable have the time of the one before them.
    return keep, unwrapped[
        np.maximum(np.searchsorted(used, np.arange(counter.size), "right") - 1, 0)
    ]


def _restore_turns(
    fixes: Floats, used: Integers, steps: Integers, rejected: Counter[str], notes: list[str]
) -> None:
    """Add to `steps` the whole turns of the counter that GPS time says were lost."""
    turn_s = TURN * TICK_NS * 1e-9
    if fixes.shape[0] < 2:
        notes.append("Losses of 256 IMU packets or more cannot be seen without GPS time.")
        return
    place = np.searchsorted(used, fixes[:, 0].astype(np.int64) - 1, "right") - 1
    elapsed = np.cumsum(steps)[place] * (TICK_NS * 1e-9)
    missing = np.diff(fixes[:, 1]) - np.diff(elapsed)
    turns = np.rint(missing / turn_s).astype(np.int64)
    clear = np.abs(missing - turns * turn_s) < 0.2 * turn_s
    restored = 0
    for k in np.flatnonzero((turns > 0) & clear):
        # The loss is where the counter jumps most between the two GPS lines.
        between = steps[place[k] + 1 : place[k + 1] + 1]
        if between.size:
            steps[place[k] + 1 + int(np.argmax(between))] += TURN * turns[k]
            restored += int(turns[k])
    if restored:
        count(rejected, LOST, TURN * restored)
        notes.append(f"{restored} lost turns of the packet counter were restored from GPS time.")
    unclear = int((~clear).sum())
    if unclear:
        count(rejected, "GPS time at odds with the packet counter", unclear)
        notes.append("GPS time and packet counter disagree: a long loss may be timed wrongly.")


def _wheels(
    packets: Packets, stamps: Stamps, rejected: Counter[str], path: Path
) -> WheelIncrements:
    """Return the wheel angles between paired packets of both motor boards."""
    front, rear = (_latest(board, rejected) for board in packets.boards)
    if not front.size or not rear.size:
        raise FglocError("no encoder lines (MM0 C=…, MM1 C=…) of both boards", file=path)
    nearest = np.clip(np.searchsorted(rear[:, 0], front[:, 0]), 0, rear.shape[0] - 1)
    before = np.maximum(nearest - 1, 0)
    closer = np.abs(rear[before, 0] - front[:, 0]) < np.abs(rear[nearest, 0] - front[:, 0])
    nearest = np.where(closer, before, nearest)
    pair = np.abs(rear[nearest, 0] - front[:, 0]) <= PAIR_TICKS
    paired = np.flatnonzero(pair)
    pair[paired[1:][np.diff(nearest[paired]) == 0]] = False
    count(rejected, UNPAIRED, front.shape[0] + rear.shape[0] - 2 * int(pair.sum()))
    front, rear = front[pair], rear[nearest[pair]]
    at = stamps[np.maximum(front[:, 0], rear[:, 0]) - 1]
    later = forward_stamps(at, rejected, "encoder ")
    at = at[later]
    counts = np.concatenate([front[later, 1:], rear[later, 1:]], axis=1)
    at, increments = _increments(at, counts, rejected)
    if at.size < 2:
        raise FglocError("fewer than two usable encoder packets in this log", file=path)
    mirrored = np.array([1.0, -1.0, 1.0, -1.0])
    resolution = 2.0 * math.pi / TICKS
    return WheelIncrements(
        "wheels", at, increments * mirrored * resolution, WHEELS, resolution=resolution
    )


def _latest(board: Integers, rejected: Counter[str]) -> Integers:
    """Return a board's counts with only the last of those that arrived between two IMU lines."""
    last = np.ones(board.shape[0], dtype=np.bool_)
    last[:-1] = np.diff(board[:, 0]) > 0
    count(rejected, f"encoder {REPEATED}", int((~last).sum()))
    return board[last]


def _limit(stamps: Stamps) -> Floats:
    """Return the largest believable count difference of each interval, (N-1, 1)."""
    per_second = FASTEST / (2.0 * math.pi * RADIUS) * TICKS
    return np.diff(stamps)[:, None] * (1e-9 * per_second)


def _unwrap(difference: Integers, limit: Floats) -> Integers:
    """Return differences with a 16- or 32-bit wrap undone where that makes them believable."""
    for bits in (16, 32):
        turned = (difference + 2 ** (bits - 1)) % 2**bits - 2 ** (bits - 1)
        helps = (np.abs(difference) > limit) & (np.abs(turned) <= limit)
        difference = np.where(helps, turned, difference)
    return difference


def _increments(stamps: Stamps, counts: Integers, rejected: Counter[str]) -> tuple[Stamps, Floats]:
    """Return stamps and count differences; what no wheel can have turned is replaced.

    A packet whose counts leap away and back is dropped: the interval across it is whole. Where
    counts leap and stay (the board restarted), that wheel is given the rate of its neighbouring
    intervals.
    """
    limit = _limit(stamps)
    leap = np.abs(_unwrap(np.diff(counts, axis=0), limit)) > limit
    wrong: Mask = np.any(leap, axis=1)
    reach = limit[1:] + limit[:-1]
    glitch = np.zeros(stamps.size, dtype=np.bool_)
    if stamps.size > 2:
        across = np.abs(_unwrap(counts[2:] - counts[:-2], reach))
        glitch[1:-1] = wrong[1:] & wrong[:-1] & np.all(across <= reach, axis=1)
    count(rejected, JUMP, int(glitch.sum()))
    stamps, counts = stamps[~glitch], counts[~glitch]
    limit = _limit(stamps)
    difference = _unwrap(np.diff(counts, axis=0), limit)
    bad: Mask = np.abs(difference) > limit
    count(rejected, JUMP, int(bad.any(axis=1).sum()))
    seconds = np.diff(stamps) * 1e-9
    increments = difference.astype(np.float64)
    for wheel in np.flatnonzero(bad.any(axis=0)):
        good = np.flatnonzero(~bad[:, wheel])
        lost = np.flatnonzero(bad[:, wheel])
        rate = np.interp(lost, good, increments[good, wheel] / seconds[good]) if good.size else 0.0
        increments[lost, wheel] = rate * seconds[lost]
    return stamps, increments


def _fixes(packets: Packets, options: JaguarOptions, rejected: Counter[str]) -> PositionFixes:
    """Return the GPS positions in metres east and north of the first one, at their own UTC."""
    _, utc, latitude, longitude = packets.fixes.T
    stamps = np.rint(utc * 1e3).astype(np.int64) * 1_000_000
    later = forward_stamps(stamps, rejected, "GPS ")
    positions = to_east_north(latitude[later], longitude[later], (latitude[0], longitude[0]))
    return PositionFixes(
        "gps",
        stamps[later],
        positions,
        np.full(positions.shape, options.gps_sigma),
        mount=options.antenna,
        mount_sigma=options.antenna_sigma,
    )
