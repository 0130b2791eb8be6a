"""Benchmark: how many scans a second line extraction takes, beside the seed's draws.

`python -m fgloc.experiments.bench_lines [SCANS]` makes that many scans (default 500) of 400 beams
at 1 % noise in a room and in an office floor, and prints, on one core and in one run,

- default: `fgloc.lidar.lines.extract`, from points to segments;
- ransac: `fgloc.lidar.ransac.extract_ransac` with its draws;
- found: segments a scan of both; the seed's draws find little beyond 1.5 m;
- one scan: milliseconds of one call of the default extractor with a single scan, as online;
- cloud: `fgloc.lidar.scan.cloud`, from ranges to points, with a motion to undo.

Times are of the processor: others may share the machine. The fastest of several runs counts.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from fgloc.core.measurements import Floats, Scans
from fgloc.datasets.simulator.rays import cast
from fgloc.datasets.simulator.worlds import load_world
from fgloc.lidar.lines import extract
from fgloc.lidar.ransac import extract_ransac
from fgloc.lidar.scan import Cloud, cloud
from fgloc.lidar.segments import Segments

SCANS = 500
BEAMS = 400
REPEATS = 7
ROOM = np.array([[-3, -2, 5, -2], [5, -2, 5, 3], [5, 3, -3, 3], [-3, 3, -3, -2]], dtype=np.float64)


def scans_along(walls: Floats, way: Floats, count: int) -> Scans:
    """Return scans of a lidar of 12 m and 1 % noise, from places along a way (K, 2) [m]."""
    rng = np.random.default_rng(0)
    at = np.linspace(0.0, len(way) - 1.0, count)
    places = np.stack([np.interp(at, np.arange(len(way)), way[:, a]) for a in range(2)], axis=1)
    angles = -math.pi + 2.0 * math.pi / BEAMS * np.arange(BEAMS)
    exact = cast(
        np.repeat(places, BEAMS, axis=0), np.tile(angles, count), BEAMS, walls, 12.0
    ).reshape(count, BEAMS)
    exact[~np.isfinite(exact)] = 0.0
    ranges = exact * (1.0 + 0.01 * rng.standard_normal(exact.shape))
    return Scans(
        "lidar",
        np.arange(count, dtype=np.int64) * 100_000_000,
        ranges,
        -math.pi,
        2.0 * math.pi / BEAMS,
        range_sigma=1e-3,
        range_sigma_share=0.01,
        max_range=12.0,
    )


def fastest(work: Callable[[], object], calls: int = 1) -> float:
    """Return the processor time [s] of a call in the fastest of several runs of `calls` calls.

    What must be compiled is so before.
    """
    work()
    seconds = []
    for _ in range(REPEATS):
        begin = time.process_time()
        for _ in range(calls):
            work()
        seconds.append(time.process_time() - begin)
    return min(seconds) / calls


def drawn(points: Cloud, scans: Scans) -> Segments:
    """Return the seed's segments, with the same draws at every call."""
    return extract_ransac(points, scans, np.random.default_rng(0))


def main(arguments: list[str]) -> int:
    """Print the table."""
    count = int(arguments[0]) if arguments else SCANS
    office = load_world("office")
    print(f"{count} scans of {BEAMS} beams")
    heads = ("default/s", "ransac/s", "ratio", "found", "by ransac", "one scan ms", "cloud/s")
    print(f"{'':8}" + "".join(f"{head:>12}" for head in heads))
    for name, walls, way in (
        ("room", ROOM, np.array([[-1.0, 0.0], [3.0, 1.0]])),
        ("office", office.walls, office.waypoints),
    ):
        scans = scans_along(walls, way, count)
        points = cloud(scans)
        motion = np.tile([0.05, 0.0, 0.02], (count, 1))
        one = Cloud(points.points[:1], points.ranges[:1], points.valid[:1])
        ours = count / fastest(partial(extract, points, scans))
        seed = count / fastest(partial(drawn, points, scans))
        single = fastest(partial(extract, one, scans), 100)
        make = count / fastest(partial(cloud, scans, motion))
        found = extract(points, scans).scan.size / count
        by_seed = drawn(points, scans).scan.size / count
        print(
            f"{name:8}{ours:12,.0f}{seed:12,.0f}{ours / seed:12.2f}{found:12.2f}{by_seed:12.2f}"
            f"{1e3 * single:12.3f}{make:12,.0f}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
