"""How far line extraction sees: the seed's draws beside the default extractor.

`python -m fgloc.experiments.detection_range` prints for a wall that a lidar faces at some range,
beams 0.9° apart and a noise of 1 % of the range:

- chance: that at least 21 of 25 beams are within 15 mm of the wall, which the seed asks of a draw
  whose beams are all on the wall. 0.76 at 1 m and 0.06 at 1.5 m;
- draw: the share of such draws accepted in simulation. It is above the chance, since a line that
  is fitted to the beams is nearer to them than the wall is;
- ransac: the share of scans in which the seed's extractor finds a wall of 4 m in a full turn, with
  the draws that it makes in a scan;
- default: the same of the default extractor.
"""

from __future__ import annotations

import math
import sys

import numpy as np

from fgloc.core.measurements import Floats, Scans
from fgloc.datasets.simulator.rays import cast
from fgloc.lidar.lines import extract
from fgloc.lidar.ransac import RansacSettings, extract_ransac, inliers, least_squares
from fgloc.lidar.scan import cloud

SHARE = 0.01
INCREMENT = math.radians(0.9)
RANGES_M = (0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0)
DRAWS = 4000
SCANS = 300
HALF_WIDTH_M = 2.0


def chance(range_m: float) -> float:
    """Return the chance that enough beams of a draw are near a wall at this range [m]."""
    settings = RansacSettings()
    near = math.erf(settings.tolerance_m / (SHARE * range_m) / math.sqrt(2.0))
    n = settings.neighbours
    return sum(
        math.comb(n, k) * near**k * (1.0 - near) ** (n - k) for k in range(settings.inliers, n + 1)
    )


def accepted_share(range_m: float, draws: int, rng: np.random.Generator) -> float:
    """Return the share of simulated draws around the foot of the perpendicular that are accepted.

    Range noise is `SHARE` of the range at the foot for all 25 beams.
    """
    settings = RansacSettings()
    n = settings.neighbours
    angles = INCREMENT * (np.arange(n) - n // 2)
    chosen, found = np.arange(n), np.empty(n, np.int64)
    line = np.empty(5)
    accepted = 0
    for _ in range(draws):
        ranges = range_m / np.cos(angles) + SHARE * range_m * rng.standard_normal(n)
        points = np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=1)
        if least_squares(points, chosen, n, line):
            count = inliers(points, chosen, n, line, settings.tolerance_m, found)
            accepted += count >= settings.inliers
    return accepted / draws


def facing(range_m: float, count: int, rng: np.random.Generator) -> Scans:
    """Return scans of a full turn in which one wall of 4 m faces the lidar at a range [m]."""
    wall = np.array([[range_m, -HALF_WIDTH_M, range_m, HALF_WIDTH_M]])
    beams = round(2.0 * math.pi / INCREMENT)
    angles: Floats = -math.pi + INCREMENT * np.arange(beams, dtype=np.float64)
    exact = np.tile(cast(np.zeros((beams, 2)), angles, beams, wall, 100.0), (count, 1))
    exact[~np.isfinite(exact)] = 0.0
    ranges: Floats = exact * (1.0 + SHARE * rng.standard_normal(exact.shape))
    stamps = np.arange(count, dtype=np.int64) * 100_000_000
    return Scans(
        "lidar", stamps, ranges, -math.pi, INCREMENT, range_sigma=1e-3, range_sigma_share=SHARE
    )


def main() -> int:
    """Print the table."""
    rng = np.random.default_rng(0)
    attempts = RansacSettings().attempts
    print(f"noise {100 * SHARE:.0f} %, beams {math.degrees(INCREMENT):.1f}°, wall of 4 m")
    print(f"ransac: {attempts} draws a scan, {SCANS} scans a row")
    print(f"{'range m':>8}{'chance':>9}{'draw':>9}{'ransac':>9}{'default':>9}")
    for range_m in RANGES_M:
        scans = facing(range_m, SCANS, rng)
        points = cloud(scans)
        seed = np.unique(extract_ransac(points, scans, rng).scan).size / SCANS
        ours = np.unique(extract(points, scans).scan).size / SCANS
        draw = accepted_share(range_m, DRAWS, rng)
        print(f"{range_m:8.2f}{chance(range_m):9.3f}{draw:9.3f}{seed:9.3f}{ours:9.3f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
