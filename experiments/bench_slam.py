"""Worlds of any size for the online benchmark: a ring road with boxes on both sides of it."""

from __future__ import annotations

import math
import tempfile
import time
from pathlib import Path

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.measurements import Floats
from fgloc.datasets.simulator import load_sim
from fgloc.online.engine import OnlineEngine
from fgloc.online.online import start_of
from fgloc.online.replay import packets
from fgloc.online.settings import OnlineSettings

FACES = 3
"""Faces of a box that are seen from the road."""
SPACING_M = 3.0
"""Mean distance between two boxes on one side of the road."""
SPEED = 0.5
"""Speed on the road [m/s]."""


def ring(walls: int, laps: int, seed: int = 0) -> str:
    """Return a world, as TOML, of about so many walls that are seen from a ring road."""
    rng = np.random.default_rng(seed)
    boxes = max(walls // FACES, 4)
    radius = max(boxes * SPACING_M / 2.0 / (2.0 * math.pi), 4.5)
    lines = ['description = "a ring road with boxes on both sides"']
    for k in range(boxes):
        side = 1.0 if k % 2 else -1.0
        angle = 2.0 * math.pi * (k + 0.3 * rng.uniform(-1.0, 1.0)) / boxes
        away = radius + side * rng.uniform(1.8, 2.6)
        middle = away * np.array([math.cos(angle), math.sin(angle)])
        turn = angle + rng.uniform(-0.5, 0.5)
        c, s = math.cos(turn), math.sin(turn)
        half = rng.uniform(0.35, 0.6, 2)
        corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * half
        points = (middle + corners @ np.array([[c, s], [-s, c]])).round(3).tolist()
        lines += ["[[walls]]", f"points = {points}", "closed = true"]
    count = max(round(2.0 * math.pi * radius / 2.0), 12)
    at = 2.0 * math.pi * np.arange(count) / count
    way = (radius * np.stack([np.cos(at), np.sin(at)], axis=1)).round(3).tolist()
    styles = ", ".join(['"along"'] * laps)
    lines += ["[course]", f"waypoints = {way}", f"speed = {SPEED}", f"laps = [{styles}]"]
    return "\n".join(lines) + "\n"


def ring_drive(walls: int, seconds: float) -> Drive:
    """Return a drive of that length on a ring road with about so many walls."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ring.toml"
        path.write_text(ring(walls, 1), "utf-8")
        return load_sim(f"office?world={path}&lidar=a2&duration={seconds:g}")


def localise_scans(drive: Drive) -> Floats:
    """Return the seconds (N,) that the engine took for each scan of a drive.

    Everything from one scan to the next is counted, wheels and poses with covariances included.
    """
    engine = OnlineEngine(
        drive.robot, drive.sensors, drive.truth, OnlineSettings(), drive.wheels.resolution
    )
    engine.begin(int(drive.wheels.stamps_ns[0]), start_of(drive))
    times = [0.0]
    for packet in packets(drive):
        begin = time.perf_counter()
        if packet.sensor:
            engine.reading(packet.sensor, packet.stamp_ns, packet.values, packet.extra)
            times.append(0.0)
        else:
            engine.wheels(packet.stamp_ns, packet.values, packet.extra)
            engine.propagation.covariance()
        times[-1] += time.perf_counter() - begin
    return np.array(times[1:])
