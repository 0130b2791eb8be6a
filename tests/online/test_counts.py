"""Every measurement is counted once: accepted, down-weighted, or rejected with its reason."""

from __future__ import annotations

from dataclasses import replace

from fgloc.datasets.simulator import load_sim
from fgloc.online.replay import packets

from .driving import counted, engine_for, run


def test_factors_of_a_sensor_that_is_left_out_are_counted() -> None:
    drive = load_sim("random?robot=differential&duration=40&rate=10&fix_every=1")
    # A heading that turns the wrong way.
    sent = [replace(p, values=-p.values) if p.sensor == "yaw" else p for p in packets(drive)]
    engine = engine_for(drive)
    run(engine, sent, every=50)
    assert "yaw" in engine.left_out
    assert engine.tally["yaw"].rejected["found to contradict the others"] > 0
    counted(engine, sent)
