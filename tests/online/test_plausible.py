"""Measurements that cannot be true are rejected, with their sensor's name and a reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgloc.core.drive import Drive
from fgloc.datasets.simulator import load_sim
from fgloc.online.online import notes
from fgloc.online.replay import packets

from .driving import engine_for, feed, run

BAD = (np.nan, np.inf, -np.inf, 1e300, -1e300)


@pytest.fixture(scope="module")
def drive() -> Drive:
    """Return ten seconds of a robot with every sensor the engine knows."""
    return load_sim("random?duration=6&rate=10&gyro=on&camera=on&fix_every=1")


@pytest.mark.parametrize("sensor", ["yaw", "gyro", "camera", "fixes"])
@pytest.mark.parametrize("bad", BAD)
def test_a_bad_value_is_rejected_by_name_and_changes_nothing(
    drive: Drive, sensor: str, bad: float
) -> None:
    sent = list(packets(drive))
    clean, hit = engine_for(drive), engine_for(drive)
    for k, packet in enumerate(sent):
        feed(clean, packet)
        feed(hit, packet)
        if packet.sensor == sensor and k > 100 and not hit.tally[sensor].rejected:
            values = packet.values.copy()
            values[-1] = bad
            feed(hit, replace(packet, values=values, stamp_ns=packet.stamp_ns + 1))
    reason = "larger than possible" if np.isfinite(bad) else "not finite"
    assert hit.tally[sensor].rejected == {reason: 1}
    assert f"1 measurement of {sensor} rejected: {reason}" in list(notes(hit))
    np.testing.assert_array_equal(hit.propagation.state, clean.propagation.state)


@pytest.mark.parametrize("sigma", [0.0, -1.0, np.nan, np.inf, 1e-300, 1e300, 1e-12])
def test_a_fix_of_impossible_sigma_is_rejected(drive: Drive, sigma: float) -> None:
    sent = list(packets(drive))
    clean, hit = engine_for(drive), engine_for(drive)
    run(clean, sent)
    for packet in sent:
        feed(hit, packet)
        if packet.sensor == "fixes":
            extra = np.array([0.05, sigma])
            feed(hit, replace(packet, extra=extra, values=packet.values + 5.0))
    assert sum(hit.tally["fixes"].rejected.values()) == sum(p.sensor == "fixes" for p in sent)
    assert all("sigma" in reason for reason in hit.tally["fixes"].rejected)
    np.testing.assert_array_equal(hit.propagation.state, clean.propagation.state)


@pytest.mark.parametrize("bad", [*BAD, 1e6, -1e6])
def test_a_bad_wheel_packet_is_rejected_and_the_next_one_spans_its_time(
    drive: Drive, bad: float
) -> None:
    sent = [p for p in packets(drive) if not p.sensor]
    engine = engine_for(drive)
    for packet in sent[:40]:
        feed(engine, packet)
    before = engine.propagation.state
    assert not engine.wheels(sent[40].stamp_ns, np.append(sent[40].values[:-1], bad))
    np.testing.assert_array_equal(engine.propagation.state, before)
    assert sum(engine.tally["wheels"].rejected.values()) == 1
    run(engine, sent[41:])
    assert engine.now_ns == sent[-1].stamp_ns


def test_a_spin_that_wheels_can_do_is_taken(drive: Drive) -> None:
    engine = engine_for(drive)
    assert engine.wheels(engine.now_ns + 2_000_000_000, np.full(4, 1900.0))


def test_readings_of_the_wrong_size_or_an_unknown_sensor_are_counted(drive: Drive) -> None:
    engine = engine_for(drive)
    now = engine.now_ns
    engine.reading("yaw", now, np.zeros(2), None)
    engine.reading("fixes", now, np.zeros(3), np.ones(3))
    engine.reading("fixes", now, np.zeros(2), np.ones(1))
    engine.reading("fixes", now, np.zeros(2), None)
    engine.reading("sonar", now, np.zeros(1), None)
    engine.wheels(now + 1, np.zeros(3))
    size, sigmas = "it has another number of values", "it has another number of sigmas"
    assert engine.tally["yaw"].rejected == {size: 1}
    assert engine.tally["fixes"].rejected == {size: 1, sigmas: 2}
    assert engine.tally["wheels"].rejected == {size: 1}
    assert engine.tally["unknown"].rejected == {"no such sensor": 1}
