"""The line grammar of the Jaguar 4x4's packets, as it sends them over TCP and as logs keep them.

    #205,YAW,-0.44,GYRO,71,-26,56,ACC,28,1,269,ADC,132,138,8,4,     IMU, 50 Hz, 8-bit counter
    MM0 C=4761:-4718        encoder counts left:right; MM0 front, MM1 rear; ':' may be a space
    MM1 V=120 222 4899      other motor board data, read and left alone
    $GPRMC,083101.4,A,4446.47702,N,02028.10553,E,000.32,031.2,220126,004.2,E*5B

A line that fits no pattern (cut off, damaged, not a number) is counted, never guessed at.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.datasets.text import Integers, count

UNREADABLE = "unreadable line"
CHECKSUM = "wrong GPS checksum"
NO_FIX = "GPS without fix"
EARLY = "before the first IMU line"

_IMU = re.compile(
    r"#(\d{1,3}),YAW,(-?\d{1,18}(?:\.\d*)?),GYRO,(-?\d{1,18}),(-?\d{1,18}),(-?\d{1,18})"
    r",ACC,(-?\d{1,18}),(-?\d{1,18}),(-?\d{1,18}),ADC(?:,-?\d{1,18}){4},?\s*"
)
_BOARD = re.compile(r"MM([01]) ([A-Z]+)=(-?\d{1,18}(?:[: ]-?\d{1,18})*)\s*")
_GPS = re.compile(
    r"\$GPRMC,(\d{6}(?:\.\d*)?),([AV]),(?:(\d{4}\.\d*),([NS]),(\d{5}\.\d*),([EW]))?,*"
    r"[^,*]*,[^,*]*,(\d{6})(?:,[^*]*)?(?:\*([0-9A-Fa-f]{2}))?\s*"
)


@dataclass(frozen=True)
class Packets:
    """The content of a log by kind, in the order of the lines."""

    counter: Integers
    """(I,) 8-bit counters of the IMU lines."""
    imu: Floats
    """(I, 3) yaw [rad], third gyro value [counts], first acceleration value [counts]."""
    boards: tuple[Integers, Integers]
    """Front and rear board: (E, 3) IMU lines seen before, left count, right count."""
    fixes: Floats
    """(G, 4) IMU lines seen before, UTC [s since 1970], latitude [deg], longitude [deg]."""
    first_unreadable: int = 0
    """Number of the first line that fits no pattern; 0 if there is none."""


def looks_like(line: str) -> bool:
    """Return True if a line fits the grammar (used to guess a file's format)."""
    return any(pattern.fullmatch(line) for pattern in (_IMU, _BOARD, _GPS))


def parse(lines: Iterable[str], rejected: Counter[str]) -> Packets:
    """Return the packets in complete lines; whatever is left out is counted in `rejected`."""
    counters: list[int] = []
    imu: list[tuple[float, float, float]] = []
    boards: tuple[list[tuple[int, int, int]], list[tuple[int, int, int]]] = ([], [])
    fixes: list[tuple[float, float, float, float]] = []
    first = 0
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        if match := _IMU.fullmatch(line):
            sequence, yaw = int(match[1]), float(match[2])
            if sequence < 256 and abs(yaw) < 3.2:
                counters.append(sequence)
                imu.append((yaw, float(match[5]), float(match[6])))
                continue
        elif match := _BOARD.fullmatch(line):
            values = [int(v) for v in re.split("[: ]", match[3])]
            if match[2] != "C":
                continue
            if len(values) == 2:
                if counters:
                    boards[int(match[1])].append((len(counters), values[0], values[1]))
                else:
                    count(rejected, EARLY)
                continue
        elif match := _GPS.fullmatch(line):
            fix = _fix(line, match, rejected)
            if fix is not None and counters:
                fixes.append((len(counters), *fix))
            elif fix is not None:
                count(rejected, EARLY)
            continue
        first = first or number
        count(rejected, UNREADABLE)
    return Packets(
        np.array(counters, dtype=np.int64),
        np.array(imu, dtype=np.float64).reshape(-1, 3),
        (_table(boards[0]), _table(boards[1])),
        np.array(fixes, dtype=np.float64).reshape(-1, 4),
        first,
    )


def _table(rows: list[tuple[int, int, int]]) -> Integers:
    """Return (N, 3) integers."""
    return np.array(rows, dtype=np.int64).reshape(-1, 3)


def _fix(
    line: str, match: re.Match[str], rejected: Counter[str]
) -> tuple[float, float, float] | None:
    """Return UTC [s since 1970], latitude and longitude [deg] of a valid fix, else count it."""
    time, status, latitude, north, longitude, east, date, checksum = match.groups()
    if checksum is not None:
        total = 0
        for byte in line[line.index("$") + 1 : line.index("*")].encode():
            total ^= byte
        if total != int(checksum, 16):
            count(rejected, CHECKSUM)
            return None
    if status != "A" or latitude is None:
        count(rejected, NO_FIX)
        return None
    try:
        day = np.datetime64(f"20{date[4:]}-{date[2:4]}-{date[:2]}", "s").astype(np.int64)
    except ValueError:
        count(rejected, UNREADABLE)
        return None
    seconds = int(time[:2]) * 3600 + int(time[2:4]) * 60 + float(time[4:])
    phi = int(latitude[:2]) + float(latitude[2:]) / 60.0
    lam = int(longitude[:3]) + float(longitude[3:]) / 60.0
    return float(day) + seconds, phi if north == "N" else -phi, lam if east == "E" else -lam
