"""Scans in the online engine: rooms with a truth, and what is no room at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fgloc.core.drive import Drive
from fgloc.core.evaluation import evaluate
from fgloc.core.measurements import Scans
from fgloc.estimator import Result
from fgloc.online.checkpoint import restore, save
from fgloc.online.online import OnlineSmoother
from fgloc.online.replay import packets
from fgloc.online.scans import SELDOM
from fgloc.online.settings import OnlineSettings

from .driving import engine_for, feed, run
from .mutations import bad_values
from .surroundings import room_drive, with_ranges

SECONDS = 25.0


@pytest.fixture(scope="module")
def drive() -> Drive:
    """Return the first part of seed B's tour: a room of 6 m by 5 m, pillar, cupboard."""
    return room_drive(SECONDS)


@pytest.fixture(scope="module")
def result(drive: Drive) -> Result:
    """Return the drive localised."""
    return OnlineSmoother().estimate(drive)


def test_a_room_is_mapped_while_the_robot_is_localised_in_it(drive: Drive, result: Result) -> None:
    """Centimetres, and as uncertain as it says (mean of 3 numbers squared)."""
    assert drive.truth is not None
    scored = evaluate(result.trajectory, drive.truth)
    assert scored.ate_rmse_m < 0.03
    assert scored.nees is not None
    assert scored.nees < 6.0
    assert result.map is not None
    assert result.map.walls is not None
    walls = result.map.walls
    # The outer walls of datasets/worlds/seed-b-room.toml: x = 0 and 6, y = 0 and 5, seen from
    # inside: normals 0, 180, 90 and -90 degrees; the feet of the lines in the map.
    for angle, at in ((0.0, 0.0), (np.pi, -6.0), (np.pi / 2, 0.0), (-np.pi / 2, -5.0)):
        turn = np.abs(np.angle(np.exp(1j * (walls.normal - angle))))
        normal = np.stack([np.cos(walls.normal), np.sin(walls.normal)], axis=1)
        offset = walls.offset + np.einsum("ka,ka->k", normal, walls.anchor)
        fits = (turn < np.radians(0.6)) & (np.abs(offset - at) < 0.03)
        assert fits.any(), (angle, at, np.degrees(walls.normal), offset)


def test_no_wall_is_mapped_twice(result: Result) -> None:
    """No two lines are the same within 5 cm and 3 degrees and overlap."""
    assert result.map is not None
    assert result.map.walls is not None
    walls = result.map.walls
    ends = walls.ends
    for a in range(walls.normal.size):
        for b in range(a):
            turn = abs(np.angle(np.exp(1j * (walls.normal[a] - walls.normal[b]))))
            normal = np.array([np.cos(walls.normal[a]), np.sin(walls.normal[a])])
            tangent = np.array([-normal[1], normal[0]])
            apart = np.abs((ends[b] - ends[a, 0]) @ normal).max()
            own, other = np.sort(ends[a] @ tangent), np.sort(ends[b] @ tangent)
            overlap = min(own[1], other[1]) - max(own[0], other[0])
            assert turn > 0.05 or apart > 0.05 or overlap < 0.2


def test_what_became_of_scans_is_said(result: Result) -> None:
    """How many were used, and why pieces were not."""
    assert any("scans of lidar were used" in note for note in result.notes)
    count = result.counts["lidar"]
    assert count.accepted > 20 * max(count.down_weighted, 1)


@pytest.mark.parametrize("fault", ["nothing", "noise", "nan"])
def test_without_walls_there_is_odometry(drive: Drive, fault: str) -> None:
    """Nothing in range, ranges without any wall in them, scans of NaNs: all the same poses."""
    (lidar,) = drive.each(Scans)
    rng = np.random.default_rng(0)
    ranges = np.zeros_like(lidar.ranges)
    if fault == "noise":
        ranges = rng.uniform(0.3, lidar.max_range - 1.0, ranges.shape)
    blind = with_ranges(drive, ranges)
    sent = list(packets(blind))
    if fault == "nan":
        for packet in sent:
            if packet.sensor:
                packet.values[:] = np.nan
    engine = engine_for(blind)
    poses = run(engine, sent, every=20)
    wheels = engine_for(drive)
    alone = run(wheels, [p for p in sent if not p.sensor], every=20)
    own = np.array([not p.sensor for p in sent])
    # Scans make keyframes; what is integrated between them is the same.
    np.testing.assert_allclose(poses[own], alone, atol=1e-6)
    engine.finish()
    tally = engine.tally["lidar"]
    assert tally.count().accepted == 0
    assert sum(tally.rejected.values()) > 0
    assert set(tally.rejected) <= {"no beam returned", "no wall in it", SELDOM}


def test_broken_beams_and_packets_are_survived(drive: Drive) -> None:
    """Single impossible numbers in scans and wheels; the robot stays where it is."""
    rng = np.random.default_rng(1)
    sent = bad_values(list(packets(drive)), rng)
    engine = engine_for(drive)
    run(engine, sent, every=10)
    assert drive.truth is not None
    at = drive.truth.trajectory
    end = at.poses[np.searchsorted(at.stamps_ns, engine.now_ns)]
    assert np.hypot(*(engine.propagation.state[:2] - end[:2])) < 0.3


def test_a_robot_that_was_pushed_finds_its_place_again(drive: Drive) -> None:
    """The wheels run half a metre on the spot; the walls say so, and the engine says it too."""
    sent = list(packets(drive))
    wheels = [k for k, p in enumerate(sent) if not p.sensor]
    per_metre = 1.0 / 0.0475  # one over the wheels' radius of datasets/worlds' mecanum robot
    for k in wheels[150:153]:
        sent[k].values[:] += 0.5 / 3.0 * per_metre
    engine = engine_for(drive)
    run(engine, sent, every=20)
    assert drive.truth is not None
    at = drive.truth.trajectory
    end = at.poses[np.searchsorted(at.stamps_ns, engine.now_ns)]
    assert np.hypot(*(engine.propagation.state[:2] - end[:2])) < 0.1


def test_a_restored_engine_goes_on_to_the_last_bit(drive: Drive, tmp_path: Path) -> None:
    """Walls, tentative ones and a scan that waits for the wheels included."""
    settings = OnlineSettings(lag_s=5.0)
    sent = list(packets(drive))[:420]
    engine = engine_for(drive, settings)
    for packet in sent[:280]:
        feed(engine, packet)
    save(engine, tmp_path / "state.npz")
    other = restore(
        tmp_path / "state.npz",
        drive.robot,
        drive.sensors,
        drive.truth,
        settings,
        drive.wheels.resolution,
    )
    for packet in sent[280:]:
        feed(engine, packet)
        feed(other, packet)
        assert np.array_equal(engine.propagation.state, other.propagation.state)
