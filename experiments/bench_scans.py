"""Benchmark: how fast the simulated lidar scans a world.

`python -m fgloc.experiments.bench_scans [SECONDS]` drives that long (default 60) through every
world that comes with the package and prints scans per second of 400 beams, rays per second, and
how many times faster than real time that is; the kernels are compiled before. The fastest of three
runs counts: others share the machine.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

from fgloc.datasets.simulator.course import Course
from fgloc.datasets.simulator.drives import FINE_STEP_NS, NAMED
from fgloc.datasets.simulator.motions import Limits
from fgloc.datasets.simulator.rplidar import measure_scans
from fgloc.datasets.simulator.tour import plan
from fgloc.datasets.simulator.worlds import NAMES, load_world
from fgloc.errors import FglocError

REPEATS = 3
LIMITS = Limits(0.5, 0.8, 0.8, 1.5)


def measure(name: str, seconds: float, people: int) -> tuple[int, int, float]:
    """Return walls, scans and the time [s] that scanning a world took."""
    world = load_world(name)
    tour = plan(world, LIMITS, seconds)
    steps, start = tour.displacements(FINE_STEP_NS * 1e-9, round(seconds * 1e9 / FINE_STEP_NS))
    course = Course.follow(steps, FINE_STEP_NS, start)
    model = replace(NAMED[name].lidar, kind="a2")
    begin = time.perf_counter()
    scans, _ = measure_scans(course, world, model, people, 1)
    return world.walls.shape[0], scans.stamps_ns.size, time.perf_counter() - begin


def main(arguments: list[str]) -> int:
    """Print the table; FglocError for a duration that is none."""
    try:
        seconds = float(arguments[0]) if arguments else 60.0
    except ValueError:
        raise FglocError(f"{arguments[0]!r} is no duration in seconds") from None
    if not 1.0 <= seconds <= 3600.0:
        raise FglocError("from 1 to 3600 s can be simulated here")
    measure(NAMES[0], 1.0, 1)
    print(f"{'world':14}{'walls':>7}{'people':>8}{'scans/s':>10}{'rays/s':>11}{'real time':>11}")
    for name in NAMES:
        for people in (0, 3):
            runs = [measure(name, seconds, people) for _ in range(REPEATS)]
            walls, scans, took = min(runs, key=lambda run: run[2])
            rate = scans / took
            print(
                f"{name:14}{walls:7}{people:8}{rate:10.0f}{400 * rate:11.2e}{seconds / took:10.0f}×"
            )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
