"""Driving the engine packet by packet, and what must hold at every one of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.measurements import Floats
from fgloc.online.engine import OnlineEngine
from fgloc.online.online import start_of
from fgloc.online.replay import Packet
from fgloc.online.settings import OnlineSettings
from fgloc.smoothing.problem import HIDDEN


def engine_for(drive: Drive, settings: OnlineSettings | None = None) -> OnlineEngine:
    """Return an engine at the beginning of a drive."""
    engine = OnlineEngine(
        drive.robot,
        drive.sensors,
        drive.truth,
        OnlineSettings() if settings is None else settings,
        drive.wheels.resolution,
    )
    engine.begin(int(drive.wheels.stamps_ns[0]), start_of(drive))
    return engine


def feed(engine: OnlineEngine, packet: Packet) -> None:
    """Give the engine one packet."""
    if packet.sensor:
        engine.reading(packet.sensor, packet.stamp_ns, packet.values, packet.extra)
    else:
        engine.wheels(packet.stamp_ns, packet.values, packet.extra)


def run(engine: OnlineEngine, packets: Iterable[Packet], every: int = 1) -> Floats:
    """Feed packets; assert at every `every`-th that pose and covariance are sound.

    Returns the (N, 3) poses after each packet.
    """
    poses = []
    for k, packet in enumerate(packets):
        feed(engine, packet)
        poses.append(engine.propagation.state[:3])
        if k % every == 0:
            sound(engine)
    sound(engine)
    return np.array(poses).reshape(-1, 3)


def sound(engine: OnlineEngine) -> None:
    """Assert that pose and covariance are finite, the covariance one of some distribution."""
    state = engine.propagation.state
    covariance = engine.propagation.covariance()
    assert np.isfinite(state).all(), state
    assert np.isfinite(covariance).all(), covariance
    values = np.linalg.eigvalsh(covariance)
    assert values[0] > -1e-9 * values[-1], values
    assert (np.diag(covariance) > 0.0).all()


FACTORS_LOST = ("the solver broke over it", "found to contradict the others")
"""Reasons that are counted for factors, not for readings."""


def counted(engine: OnlineEngine, packets: Iterable[Packet]) -> None:
    """Finish, and assert that each fix, and each factor of the other sensors, was counted once."""
    sent: dict[str, int] = {}
    for packet in packets:
        sent[packet.sensor] = sent.get(packet.sensor, 0) + 1
    engine.finish()
    for name in engine.spots.fixes:
        count = engine.tally[name].count()
        total = count.accepted + count.down_weighted + count.rejected
        assert total == sent.get(name, 0), (name, engine.tally[name], sent)
    for table in engine.window.tables.values():
        if table.kind in HIDDEN or table.sensor not in engine.tally:
            continue
        tally = engine.tally[table.sensor]
        lost = sum(tally.rejected.get(reason, 0) for reason in FACTORS_LOST)
        total = tally.accepted + tally.down_weighted + lost
        assert total == table.added, (table.sensor, tally, table.added)


def without_truth(drive: Drive) -> Drive:
    """Return a drive that nobody knows the start of."""
    return replace(drive, truth=None)
