"""Benchmark: EKF-SLAM with many landmarks against real time.

`python -m fgloc.experiments.bench_ekf_slam [LANDMARKS]` drives a simulated robot round in a ring of
that many point landmarks (default 200), which it sees ten at a time, ten times a second. All of
them are in the state from the start. Prints the time of one correction (one landmark, one range
and bearing) with that state, and how much faster than the robot's 10 Hz the filter is.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import numpy as np

from fgloc.core.bases import differential
from fgloc.core.drive import Drive
from fgloc.core.geometry import chain, exp, wrap
from fgloc.core.measurements import LandmarkSightings, Survey, WheelIncrements
from fgloc.core.robot import Robot
from fgloc.filters.ekf_slam import EkfSlam

LANDMARKS = 200
SEEN = 10
"""Landmarks in one picture."""
PERIOD_NS = 100_000_000
SECONDS = 60
REPEATS = 3
"""The fastest run counts: others share the machine."""


def ring(landmarks: int, seed: int) -> Drive:
    """Return a drive of 60 s in a circle of 3 m, all landmarks roughly surveyed on one of 6 m.

    The survey's sigma of 0.5 m puts every landmark into the state at once and leaves the filter
    all there is to find out.
    """
    rng = np.random.default_rng(seed)
    steps = SECONDS * 10
    base = differential(0.1, 0.1, 0.5)
    angles = np.tile([0.48, 0.56], (steps, 1))
    truth = chain(exp(base.displacements(angles)), np.zeros(3))
    angle = 2.0 * np.pi * np.arange(landmarks) / landmarks
    places = np.stack([6.0 * np.cos(angle), 3.0 + 6.0 * np.sin(angle)], axis=1)
    d = places[None] - truth[1:, None, :2]
    distance = np.hypot(d[..., 0], d[..., 1])
    nearest = np.argsort(distance, axis=1)[:, :SEEN]
    rows = np.arange(steps)[:, None]
    bearing = wrap(np.arctan2(d[..., 1], d[..., 0]) - truth[1:, None, 2])
    shape = nearest.shape
    stamps = np.arange(steps + 1, dtype=np.int64) * PERIOD_NS
    seen = LandmarkSightings(
        "marks",
        np.repeat(stamps[1:], SEEN),
        nearest.reshape(-1).astype(np.int64),
        (distance[rows, nearest] + 0.05 * rng.standard_normal(shape)).reshape(-1),
        (bearing[rows, nearest] + 0.01 * rng.standard_normal(shape)).reshape(-1),
        0.05,
        0.01,
        survey=Survey(np.arange(landmarks), places, np.full((landmarks, 2), 0.5)),
    )
    wheels = WheelIncrements("wheels", stamps, angles, base.driven_names)
    return Drive("ring", Robot.typical("robot", base), wheels, (seen,))


def seconds_of(drive: Drive) -> float:
    """Return the fastest time of the whole filter on a drive."""
    found = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        EkfSlam().estimate(drive)
        found.append(time.perf_counter() - begin)
    return min(found)


def main(arguments: list[str]) -> int:
    """Print the time of a correction and the ratio to real time."""
    landmarks = int(arguments[0]) if arguments else LANDMARKS
    if landmarks < SEEN:
        print(f"fgloc: error: at least {SEEN} landmarks are needed", file=sys.stderr)
        return 2
    drive = ring(landmarks, 0)
    EkfSlam().estimate(drive)
    whole = seconds_of(drive)
    (marks,) = drive.each(LandmarkSightings)
    silent = replace(
        marks,
        stamps_ns=marks.stamps_ns[:0],
        landmark=marks.landmark[:0],
        range_m=marks.range_m[:0],
        bearing=marks.bearing[:0],
    )
    without = seconds_of(replace(drive, sensors=(silent,)))
    updates = marks.stamps_ns.size
    print(f"EKF-SLAM, {landmarks} landmarks, {SEEN} corrections at each of {SECONDS * 10} stamps")
    print(f"one correction   {1e6 * (whole - without) / updates:10,.1f} µs")
    print(f"whole drive      {whole:10,.2f} s of {SECONDS} s")
    print(f"real time        {SECONDS / whole:10,.0f} times")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
