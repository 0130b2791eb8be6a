"""Writes a drive as the text log of the Jaguar 4x4, so that its reader meets the real format.

Ten IMU lines (50 Hz, 8-bit sequence counter) come per encoder packet; a packet is one line for
the front motors (MM0) and one for the rear ones (MM1), left:right, the right counts mirrored.
Status lines fill the other slots; position fixes become GPRMC sentences at 5 Hz. Source: packet
format of seed A's appendix.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fgloc.atomic import write_text
from fgloc.core import geometry
from fgloc.core.drive import Drive
from fgloc.core.measurements import Acceleration, Floats, PositionFixes, Stamps, Yaw, YawRate
from fgloc.datasets.simulator.robots import JAGUAR_TICKS
from fgloc.errors import FglocError

Integers = npt.NDArray[np.int64]

IMU_NS = 20_000_000
"""Time between IMU lines [ns]."""
FIX_NS = 200_000_000
"""Time between GPRMC sentences [ns]."""
GYRO_COUNTS = 14.375 * 180.0 / math.pi
"""Counts per rad/s of the ITG3205 gyro: 14.375 per degree per second (its data sheet)."""
ACC_COUNTS = 255.0 / 9.81
"""Counts per m/s²: 255 are about 1 g."""
FIRST_COUNTS = (4761, -4718, 4644, -4906)
"""Encoder counters at the start (fl, fr, rl, rr), right ones mirrored: they never start at 0."""
WGS84_A = 6378137.0
WGS84_E2 = 6.69437999014e-3
STATUS = (
    "D=1",
    "FF=16",
    "P=0:0",
    "S=0:0",
    "T=29:26",
    "V=120:220:4895",
    "CR=0:0",
    "A=0:0",
    "AI=0:0:2118:2130:0:0",
)
"""Status lines of one board, one kind after each IMU line without encoder counts."""


@dataclass(frozen=True)
class LogSettings:
    """What a log holds that a drive does not, and how it was damaged."""

    latitude: float = 44.774617
    """Latitude of the map's origin [deg]."""
    longitude: float = 20.4684255
    """Longitude of the map's origin [deg]."""
    start: datetime = datetime(2026, 1, 22, 8, 31, 0, tzinfo=UTC)
    """UTC of stamp 0."""
    first_sequence: int = 205
    """Sequence number of the first IMU line, 0 to 255."""
    drop: float = 0.0
    """Probability that a line is missing."""
    truncate: bool = False
    """Whether the last line is cut off in the middle, without a line end."""


def write_log(drive: Drive, path: Path, settings: LogSettings, rng: np.random.Generator) -> None:
    """Write a drive as a Jaguar log; complete or not at all.

    `rng` draws cosmetic readings and the missing lines. Raises FglocError for a drive that is not
    the Jaguar's: wheels fl fr rl rr, yaw, gyro and accelerometer, encoder stamps on the 20 ms grid
    of the IMU lines, position fixes on whole 0.2 s.
    """
    lines = list(log_lines(drive, settings, rng))
    if settings.drop > 0.0:
        kept = rng.random(len(lines)) >= settings.drop
        lines = [line for line, keep in zip(lines, kept, strict=True) if keep]
    text = "\n".join(lines) + "\n"
    if settings.truncate:
        text = text[: -1 - len(lines[-1]) // 2]
    write_text(path, text)


def log_lines(drive: Drive, settings: LogSettings, rng: np.random.Generator) -> Iterator[str]:
    """Yield the log's lines without line ends; see `write_log` for arguments and errors."""
    count = int(drive.wheels.stamps_ns[-1] // IMU_NS) + 1
    imu = _imu_lines(drive, count, settings.first_sequence, rng)
    packets = _packets(drive)
    fixes = _sentences(drive, settings, count)
    for k, line in enumerate(imu):
        yield line
        if k in packets:
            yield from packets[k]
        else:
            status = STATUS[(k - 1) % 10 % len(STATUS)]
            yield f"MM0 {status}"
            yield f"MM1 {status.replace(':', ' ')}"
        if k in fixes:
            yield fixes[k]


def _sampled(stamps: Stamps, values: Floats, count: int) -> Floats:
    """Return values on the grid of the IMU lines, linear in between."""
    grid = np.arange(count, dtype=np.int64) * IMU_NS
    return np.interp(grid.astype(np.float64), stamps.astype(np.float64), values)


def _imu_lines(drive: Drive, count: int, first: int, rng: np.random.Generator) -> list[str]:
    """Return the IMU lines. Raises FglocError if the drive lacks a sensor they hold."""
    yaws, gyros, accs = drive.each(Yaw), drive.each(YawRate), drive.each(Acceleration)
    if not (yaws and gyros and accs):
        raise FglocError(
            f"{drive.name}: a Jaguar log needs yaw, gyro and accelerometer; "
            "add yaw=on&gyro=on&acc=on"
        )
    heading = geometry.wrap(_sampled(yaws[0].stamps_ns, np.unwrap(yaws[0].yaw), count))
    turn = np.rint(GYRO_COUNTS * _sampled(gyros[0].stamps_ns, gyros[0].rate, count))
    ahead = np.rint(ACC_COUNTS * _sampled(accs[0].stamps_ns, accs[0].forward, count))
    # Readings that nobody uses scatter about those of the sample in the appendix.
    other = np.rint(rng.normal((33.0, 65.0, 8.0, 250.0), (2.0, 2.0, 1.0, 3.0), (count, 4)))
    sequence = (first + np.arange(count)) % 256
    columns = np.column_stack([sequence, turn, ahead, other]).astype(np.int64).tolist()
    return [
        f"#{n},YAW,{h:.2f},GYRO,{gx},{gy},{gz},ACC,{ax},{ay},{az},ADC,134,136,8,5,"
        for h, (n, gz, ax, gx, gy, ay, az) in zip(heading.tolist(), columns, strict=True)
    ]


def _packets(drive: Drive) -> dict[int, tuple[str, str]]:
    """Return the two encoder lines of each packet by the index of the IMU line before them."""
    wheels = drive.wheels
    known = set(wheels.wheels) == {"fl", "fr", "rl", "rr"}
    if drive.robot.base.kind != "skid-steer" or not known:
        raise FglocError(
            f"{drive.name}: a Jaguar log holds a skid-steer with wheels fl, fr, rl, rr; "
            "use robot=skid"
        )
    if bool(np.any(wheels.stamps_ns % IMU_NS)):
        raise FglocError(
            f"{drive.name}: encoder packets must fall on the 20 ms grid of the IMU lines; "
            "use rate=5, 10, 25 or 50"
        )
    order = [wheels.wheels.index(n) for n in ("fl", "fr", "rl", "rr")]
    turned = np.vstack([np.zeros(4), np.cumsum(wheels.angles[:, order], axis=0)])
    counts = np.rint(turned * (JAGUAR_TICKS / (2.0 * np.pi))).astype(np.int64)
    shown: Integers = counts * np.array([1, -1, 1, -1]) + np.array(FIRST_COUNTS)
    lines = {}
    for n, (k, row) in enumerate(zip(wheels.stamps_ns // IMU_NS, shown.tolist(), strict=True)):
        # The boards print a space for the colon now and then.
        mark = " " if n % 7 == 6 else ":"
        fl, fr, rl, rr = row
        lines[int(k)] = (f"MM0 C={fl}:{fr}", f"MM1 C={rl}{mark}{rr}")
    return lines


def _sentences(drive: Drive, settings: LogSettings, count: int) -> dict[int, str]:
    """Return GPRMC sentences by the index of the IMU line before them; none without fixes.

    Between fixes the receiver reports that it has no position (status V).
    """
    streams = drive.each(PositionFixes)
    if not streams:
        return {}
    fixes = streams[0]
    if bool(np.any(fixes.stamps_ns % FIX_NS)):
        raise FglocError(
            f"{drive.name}: position fixes must fall on whole 0.2 s, the rate of the receiver; "
            "choose another fix_every"
        )
    latitude, longitude = to_degrees(fixes.positions, settings.latitude, settings.longitude)
    where = dict(
        zip(
            (fixes.stamps_ns // IMU_NS).tolist(),
            zip(latitude.tolist(), longitude.tolist(), strict=True),
            strict=True,
        )
    )
    sentences = {}
    for k in range(0, count, FIX_NS // IMU_NS):
        at = settings.start + timedelta(microseconds=k * IMU_NS // 1000)
        clock = f"{at:%H%M%S}.{at.microsecond // 100_000}"
        if k in where:
            north, east = where[k]
            position = f"{_angle(north, 2)},{'NS'[north < 0]},{_angle(east, 3)},{'EW'[east < 0]}"
            body = f"GPRMC,{clock},A,{position},000.32,031.2,{at:%d%m%y},004.2,E"
        else:
            body = f"GPRMC,{clock},V,,,,,,,{at:%d%m%y},004.2,E"
        sentences[k] = f"${body}*{checksum(body):02X}"
    return sentences


def checksum(body: str) -> int:
    """Return the NMEA checksum of a sentence without `$` and `*`: XOR of its characters."""
    value = 0
    for character in body:
        value ^= ord(character)
    return value


def to_degrees(positions: Floats, latitude: float, longitude: float) -> tuple[Floats, Floats]:
    """Return latitudes and longitudes [deg] of (N, 2) map positions east, north [m].

    The map is the plane that touches WGS84 at the origin, scaled by its radii of curvature there:
    within 1 mm below 100 m from the origin.
    """
    phi = math.radians(latitude)
    root = math.sqrt(1.0 - WGS84_E2 * math.sin(phi) ** 2)
    meridian = WGS84_A * (1.0 - WGS84_E2) / root**3
    parallel = WGS84_A / root * math.cos(phi)
    north = latitude + np.degrees(positions[:, 1] / meridian)
    east = longitude + np.degrees(positions[:, 0] / parallel)
    return north, east


def _angle(degrees: float, width: int) -> str:
    """Return an angle as NMEA prints it: whole degrees, then minutes with five decimals."""
    units = round(abs(degrees) * 60.0 * 1e5)
    whole, minutes = divmod(units, 60 * 100_000)
    return f"{whole:0{width}d}{minutes / 1e5:08.5f}"
