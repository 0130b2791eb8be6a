"""Stamps that go back, packets that come twice, and clocks that are set."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgloc.core.drive import Drive
from fgloc.datasets.simulator import load_sim
from fgloc.online.clock import PERSISTENT, REMEMBERED, Clock
from fgloc.online.replay import Packet, packets

from .driving import counted, engine_for, run, without_truth

S = 1_000_000_000


def test_a_single_stamp_in_the_past_is_refused_and_forgotten() -> None:
    clock = Clock()
    assert [clock.admit(t) for t in (0, 10, 20, 15, 30, 40)] == [True] * 3 + [False] + [True] * 2
    assert clock.shifts == []
    assert clock.time(50) == 50


def test_a_clock_set_back_goes_on_at_the_distance_of_its_packets() -> None:
    clock = Clock()
    for t in range(0, 110, 10):
        assert clock.admit(t)
    back = [10 + 10 * k for k in range(PERSISTENT)]
    assert [clock.admit(t - 1000) for t in back] == [False] * (PERSISTENT - 1) + [True]
    # The last admitted time was 100; the packet that settles it follows by 10.
    assert clock.time(back[-1] - 1000) == 110
    assert clock.shifts == [110 - (back[-1] - 1000)]
    assert clock.admit(back[-1] - 990)
    assert clock.time(back[-1] - 990) == 120


def test_a_jump_ahead_is_believed() -> None:
    clock = Clock()
    assert clock.admit(0)
    assert clock.admit(3600 * S)
    assert clock.time(3600 * S) == 3600 * S
    assert not clock.doubtful


def test_doubt_lasts_until_a_stamp_is_admitted() -> None:
    clock = Clock()
    for t, doubt in ((0, False), (10, False), (5, True), (6, True), (20, False)):
        clock.admit(t)
        assert clock.doubtful is doubt


def test_only_recent_packets_of_the_same_content_are_repeats() -> None:
    clock = Clock()
    for t in range(REMEMBERED + 1):
        assert not clock.repeats(t, b"a")
        clock.admit(t)
    assert clock.repeats(REMEMBERED, b"a")
    assert clock.repeats(1, b"a")
    assert not clock.repeats(5, b"b")
    assert not clock.repeats(0, b"a")  # forgotten


@pytest.fixture(scope="module")
def drive() -> Drive:
    """Return a drive with fixes that only a wrong stamp can contradict."""
    return load_sim("random?robot=differential&duration=40&rate=20&yaw=off&fix_every=0.1&seed=4")


@pytest.mark.parametrize("late", [0, 1, 7])
def test_packets_that_come_twice_change_nothing(drive: Drive, late: int) -> None:
    sent = list(packets(drive))
    twice = sorted(
        [*enumerate(sent), *((k + late + 0.5, p) for k, p in enumerate(sent))],
        key=lambda one: one[0],
    )
    once, both = engine_for(drive), engine_for(drive)
    run(once, sent, every=100)
    again = [p for _, p in twice]
    run(both, again, every=100)
    np.testing.assert_array_equal(both.propagation.state, once.propagation.state)
    assert both.tally["wheels"].rejected == {
        "a second one with the same stamp": sum(not p.sensor for p in sent)
    }
    counted(both, again)


def set_clock(sent: list[Packet], at_ns: int, step_ns: int) -> list[Packet]:
    """Return the packets with all clocks set by a step at some time."""
    return [replace(p, stamp_ns=p.stamp_ns + step_ns * (p.stamp_ns >= at_ns)) for p in sent]


@pytest.mark.parametrize("step", [-5 * S, -5_030_000_000, -3600 * S, 3600 * S])
def test_all_clocks_may_be_set(drive: Drive, step: int) -> None:
    """The path afterwards is that of a drive whose clock went on, as well as fixes tell it."""
    sent = list(packets(drive))
    begin, end = sent[0].stamp_ns, sent[-1].stamp_ns
    stepped = set_clock(sent, (begin + end) // 2, step)
    plain, hit = engine_for(drive), engine_for(drive)
    expected = run(plain, sent, every=100)
    poses = run(hit, stepped, every=100)
    apart = np.hypot(*(poses - expected)[-200:, :2].T)
    assert apart.max() < 0.1, apart.max()
    counted(hit, stepped)
    # One may come between the step and the wheels' first packet behind it.
    assert hit.tally["fixes"].down_weighted <= 1


def test_a_start_unknown_survives_a_set_clock(drive: Drive) -> None:
    sent = list(packets(drive))
    stepped = set_clock(sent, sent[0].stamp_ns + S // 2, -5 * S)
    engine = engine_for(without_truth(drive))
    run(engine, stepped, every=20)
    assert drive.truth is not None
    final = drive.truth.trajectory.poses[-1]
    assert np.hypot(*(engine.propagation.state[:2] - final[:2])) < 0.2
    counted(engine, stepped)
