"""The Jaguar log reader, on lines in the published packet format."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fgloc.core.drive import Drive
from fgloc.core.measurements import Acceleration, PositionFixes, Yaw
from fgloc.datasets import jaguar
from fgloc.datasets.geodesy import FLATTENING, SEMI_MAJOR, to_east_north
from fgloc.datasets.registry import load_drive
from fgloc.errors import FglocError

TICK = 2 * math.pi / 300


def imu(k: int, yaw: float = 0.0, acc: int = 0) -> str:
    return f"#{k % 256},YAW,{yaw:.2f},GYRO,33,65,35,ACC,{acc},8,245,ADC,134,136,9,4, "


def gprmc(seconds: float, latitude: str = "4446.47702", longitude: str = "02028.10553") -> str:
    """Return a valid sentence at 08:31 plus seconds on 22 January 2026."""
    time = f"08{31 + int(seconds // 60):02d}{seconds % 60:04.1f}"
    body = f"GPRMC,{time},A,{latitude},N,{longitude},E,000.32,031.2,220126,004.2,E"
    return f"${body}*{np.bitwise_xor.reduce(np.frombuffer(body.encode(), np.uint8)):02X}"


def log(
    seconds: int, start: int = 250, counts: int = 10, front: int = 0, rear: int = 0
) -> list[str]:
    """Return a log of straight driving: `counts` per wheel and packet, a packet every 10 lines."""
    lines = []
    for k in range(50 * seconds + 1):
        lines.append(imu(start + k))
        if k % 10 == 0:
            n = counts * (k // 10)
            lines += [f"MM0 C={front + n}:{-front - n}", f"MM1 C={rear + n}:{-rear - n}"]
    return lines


def load(tmp_path: Path, lines: list[str], end: str = "\n") -> Drive:
    path = tmp_path / "drive.log"
    path.write_text("\n".join(lines) + end)
    return load_drive(str(path))


def test_the_published_packet(tmp_path: Path) -> None:
    lines = [
        "#158,YAW,0.28,GYRO,33,65,35,ACC,4,8,245,ADC,134,136,9,4, ",
        "MM1 FF=16 ",
        "$GPRMC,083101.4,A,4446.47702,N,02028.10553,E,000.32,031.2,220126,004.2,E*5B ",
        "MM0 S=0:0 ",
        "MM0 V=120:220:4895 ",
        "MM1 V=120 222 4899 ",
        "MM0 AI=0:0:2118:2130:0:0 ",
        "MM0 C=4761:-4718 ",
        "MM1 C=4644 -4906 ",
        "#159,YAW,-0.44,GYRO,71,-26,56,ACC,-51,1,269,ADC,132,138,8,4, ",
        "MM0 C=4764:-4722",
        "MM1 C=4645:-4908",
    ]
    drive = load(tmp_path, lines)
    assert drive.rejected == {}
    # The fix is of 2026-01-22T08:31:01.4 and came with the first IMU line.
    t0 = np.datetime64("2026-01-22T08:31:01.400", "ns").astype(np.int64)
    assert drive.wheels.stamps_ns.tolist() == [t0, t0 + 20_000_000]
    # fl +3, fr mirrored +4, rl +1, rr mirrored +2.
    assert drive.wheels.wheels == ("fl", "fr", "rl", "rr")
    np.testing.assert_allclose(drive.wheels.angles, [[3 * TICK, 4 * TICK, TICK, 2 * TICK]])
    assert drive.wheels.resolution == pytest.approx(TICK)
    assert drive.each(Yaw)[0].yaw.tolist() == [0.28, -0.44]
    # -51 counts of 255 per g.
    assert drive.each(Acceleration)[0].forward[1] == pytest.approx(-0.2 * 9.81)
    fixes = drive.each(PositionFixes)[0]
    assert fixes.positions.tolist() == [[0.0, 0.0]]
    assert fixes.stamps_ns.tolist() == [t0]


def test_the_counter_wraps_and_time_goes_on(tmp_path: Path) -> None:
    drive = load(tmp_path, log(12))
    assert drive.rejected == {}
    np.testing.assert_array_equal(drive.wheels.stamps_ns, np.arange(61) * 200_000_000)
    np.testing.assert_allclose(drive.wheels.angles, np.full((60, 4), 10 * TICK))
    assert drive.each(Yaw)[0].stamps_ns[-1] == 12_000_000_000


def test_lost_packets_are_counted_and_time_stays_right(tmp_path: Path) -> None:
    lines = [line for line in log(4) if line not in {imu(250 + k) for k in range(101, 105)}]
    drive = load(tmp_path, lines)
    assert drive.rejected == {jaguar.LOST: 4}
    np.testing.assert_array_equal(drive.wheels.stamps_ns, np.arange(21) * 200_000_000)


def test_a_lost_turn_of_the_counter_comes_back_from_gps_time(tmp_path: Path) -> None:
    # Packets 100 to 399 (6 s) are gone: the counter shows 300 - 256 = 44 of them.
    lines: list[str] = []
    for k in range(0, 601):
        if 100 <= k < 400:
            continue
        lines.append(imu(k))
        if k % 10 == 0:
            lines += [f"MM0 C={k}:{-k}", f"MM1 C={k}:{-k}", gprmc(0.02 * k)]
    drive = load(tmp_path, lines)
    assert drive.duration_s == pytest.approx(12.0)
    assert drive.rejected == {jaguar.LOST: 300}
    np.testing.assert_allclose(drive.wheels.angles.sum(axis=0), 600 * TICK)
    # Without GPS time the turn is lost, and the notes say that this can be.
    blind = load(tmp_path, [line for line in lines if not line.startswith("$")])
    assert blind.duration_s == pytest.approx(12.0 - 5.12)
    assert any("cannot be seen without GPS" in note for note in blind.notes)


def test_repeated_and_stray_counters_are_dropped(tmp_path: Path) -> None:
    lines = log(2)
    at = lines.index(imu(250 + 33))
    lines[at + 1 : at + 1] = [imu(250 + 33), imu(250 + 30)]
    drive = load(tmp_path, lines)
    assert drive.rejected == {"repeated stamp": 1, "time goes back": 1}
    assert drive.each(Yaw)[0].stamps_ns[-1] == 2_000_000_000
    assert drive.each(Yaw)[0].yaw.size == 101


@pytest.mark.parametrize("bits", [16, 32])
def test_wrapped_encoder_counters(tmp_path: Path, bits: int) -> None:
    def wrapped(n: int) -> int:
        return (n + 2 ** (bits - 1)) % 2**bits - 2 ** (bits - 1)

    lines, start = [], 2 ** (bits - 1) - 25
    for k in range(51):
        lines.append(imu(k))
        if k % 10 == 0:
            n = start + k
            lines += [f"MM0 C={wrapped(n)}:{wrapped(-n)}", f"MM1 C={wrapped(n)}:{wrapped(-n)}"]
    drive = load(tmp_path, lines)
    assert drive.rejected == {}
    np.testing.assert_allclose(drive.wheels.angles, np.full((5, 4), 10 * TICK))


def test_a_count_that_leaps_and_returns_is_dropped(tmp_path: Path) -> None:
    lines = [line.replace("MM0 C=50:-50", "MM0 C=9050:-50") for line in log(2)]
    drive = load(tmp_path, lines)
    assert drive.rejected == {jaguar.JUMP: 1}
    assert drive.wheels.angles.shape == (9, 4)
    np.testing.assert_allclose(drive.wheels.angles.sum(axis=0), 100 * TICK)


def test_a_board_that_restarts_costs_one_interval(tmp_path: Path) -> None:
    # The front board counts from 10,000 and starts again from 0 after packet 5.
    lines = log(1, front=10_000) + log(2, start=250 + 51, rear=50)
    drive = load(tmp_path, lines)
    assert drive.rejected == {jaguar.JUMP: 1}
    # That interval is one IMU line long: the front wheels get a tenth of 10 counts, the rear ones,
    # whose counts went on, what they counted.
    np.testing.assert_allclose(drive.wheels.angles[5], [TICK, TICK, 0, 0], atol=1e-12)
    np.testing.assert_allclose(drive.wheels.angles[[0, 4, 6, 14]], 10 * TICK)


def test_damaged_lines_are_counted_not_guessed(tmp_path: Path) -> None:
    lines = log(2)
    lines[20:20] = [
        "#12,YAW,nan,GYRO,33,65,35,ACC,4,8,245,ADC,134,136,9,4, ",
        "#13,YAW,0.28,GYRO,33,6",
        "MM0 C=47",
        "garbage",
        "MM0 C=99999999999999999999:1",
        "MM1 C=1:" + "9" * 5000,
        gprmc(1.0).replace("4446", "4447"),
        "$GPRMC,083101.4,V,,,,,,,220126,,",
    ]
    drive = load(tmp_path, lines, end="\nMM0 C=4761:-47")
    assert drive.rejected == {
        "unreadable line": 6,
        "wrong GPS checksum": 1,
        "GPS without fix": 1,
        "truncated line": 1,
    }
    assert "The first unreadable line is line 21." in drive.notes
    assert not drive.each(PositionFixes)
    np.testing.assert_allclose(drive.wheels.angles.sum(axis=0), 100 * TICK)


def test_an_encoder_line_of_one_board_alone_is_counted(tmp_path: Path) -> None:
    lines = [line for line in log(2) if line != "MM1 C=50:-50"]
    drive = load(tmp_path, lines)
    assert drive.rejected == {jaguar.UNPAIRED: 1}
    np.testing.assert_allclose(drive.wheels.angles.sum(axis=0), 100 * TICK)


def test_the_antenna_and_its_prior_are_passed_on(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_text("\n".join([*log(1), gprmc(1.0), gprmc(1.0), gprmc(0.8)]) + "\n")
    options = jaguar.JaguarOptions(antenna=(0.1, -0.2), antenna_sigma=(0.01, 0.02), gps_sigma=0.5)
    fixes = jaguar.load(path, options=options).each(PositionFixes)[0]
    assert (fixes.mount, fixes.mount_sigma) == ((0.1, -0.2), (0.01, 0.02))
    assert fixes.sigma.tolist() == [[0.5, 0.5]]


@pytest.mark.parametrize(
    ("lines", "what"),
    [
        (["MM0 C=1:1", "MM1 C=1:1"], "no IMU lines"),
        ([imu(1), imu(2), "MM0 C=1:1"], "both boards"),
        ([imu(1), "MM0 C=1:1", "MM1 C=1:1", imu(2)], "fewer than two"),
    ],
)
def test_logs_without_motion_or_time(tmp_path: Path, lines: list[str], what: str) -> None:
    with pytest.raises(FglocError, match=what) as error:
        load(tmp_path, lines)
    assert str(error.value).startswith(str(tmp_path / "drive.log"))


def test_east_north_against_the_radii_of_curvature() -> None:
    # One second of arc at latitude φ: north M(φ)·Δφ, east N(φ)·cos φ·Δλ, with the meridian and
    # prime vertical radii M = a(1-e²)/w³, N = a/w, w = sqrt(1 - e² sin²φ). Over 30 m the plane
    # and the ellipsoid differ by d²/2R < 0.1 mm.
    phi, step = math.radians(44.7746), math.radians(1 / 3600)
    squared = FLATTENING * (2 - FLATTENING)
    w = math.sqrt(1 - squared * math.sin(phi) ** 2)
    north = SEMI_MAJOR * (1 - squared) / w**3 * step
    east = SEMI_MAJOR / w * math.cos(phi) * step
    origin = (44.7746, 20.4684)
    found = to_east_north(
        np.array([origin[0] + 1 / 3600, origin[0]]),
        np.array([origin[1], origin[1] + 1 / 3600]),
        origin,
    )
    np.testing.assert_allclose(found, [[0, north], [east, 0]], atol=1e-3)
    # 30.9 m a second of latitude and 22.0 m a second of longitude at this place.
    assert north == pytest.approx(30.87, abs=0.01)
    assert east == pytest.approx(22.0, abs=0.05)


def test_what_the_simulator_writes_comes_back(tmp_path: Path) -> None:
    from fgloc.datasets.simulator import load_sim
    from fgloc.datasets.simulator.jaguar_log import LogSettings, write_log

    made = load_sim("figure-eight?seed=1&fix_every=1&gyro=on&acc=on")
    path = tmp_path / "j.log"
    write_log(made, path, LogSettings(), np.random.default_rng(0))
    read = load_drive(str(path))
    np.testing.assert_allclose(read.wheels.angles, made.wheels.angles, atol=1e-9)
    steps = np.diff(read.wheels.stamps_ns)
    np.testing.assert_array_equal(steps, np.diff(made.wheels.stamps_ns))
    shift = made.each(PositionFixes)[0].positions - read.each(PositionFixes)[0].positions
    # The log writes 1e-5 minutes: 1.9 cm a step in latitude, 1.3 cm in longitude.
    assert np.abs(shift - shift.mean(axis=0)).max() < 0.02
    assert set(read.rejected) == {"GPS without fix"}
