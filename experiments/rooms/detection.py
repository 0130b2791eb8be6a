"""How far off a wall may be for the seed's RANSAC to find it, and for the default extractor."""

from __future__ import annotations

import math

import numpy as np

from fgloc.core.measurements import Floats, Scans
from fgloc.report.experiment_report import Cell, Column, Row, Table

DISTANCES = (0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0, 4.0, 6.0)
"""Distances of the wall [m]."""
WIDTH_M = 2.0
"""Width of the wall [m]; nothing else returns a beam."""
BEAMS = 400
NOISE = 0.01
"""Range noise as a share of the range."""
TRIALS = 2000
"""Scans at every distance."""
EXPECTED = {1.0: 0.76, 1.5: 0.06}
"""What 25 draws of the noise give where at least 21 are to be within 15 mm, to two digits."""


def accepted(
    distance: float, share: float, neighbours: int, inliers: int, tolerance: float
) -> float:
    """Return the probability that enough of the neighbours are nearer to their wall than tolerated.

    Of the true wall, across which the noise of a wall straight ahead lies: a binomial number. The
    line that is fitted to the same beams lies a little better.
    """
    one = math.erf(tolerance / (share * distance * math.sqrt(2.0)))
    return sum(
        math.comb(neighbours, k) * one**k * (1.0 - one) ** (neighbours - k)
        for k in range(inliers, neighbours + 1)
    )


def wall_scans(distance: float, seed: int) -> Scans:
    """Return scans of a wall straight ahead, at rest, with range noise only."""
    rng = np.random.default_rng(seed)
    angle = 2.0 * math.pi * np.arange(BEAMS) / BEAMS - math.pi
    with np.errstate(divide="ignore"):
        clean = np.where(np.cos(angle) > 0.0, distance / np.cos(angle), np.inf)
    hit = np.abs(clean * np.sin(angle)) <= 0.5 * WIDTH_M
    noisy = clean * (1.0 + NOISE * rng.standard_normal((TRIALS, BEAMS)))
    ranges: Floats = np.where(hit & (np.cos(angle) > 0.0), noisy, 0.0)
    return Scans(
        "lidar",
        np.arange(TRIALS, dtype=np.int64) * 100_000_000,
        ranges,
        -math.pi,
        2.0 * math.pi / BEAMS,
        range_sigma=1e-3,
        range_sigma_share=NOISE,
        min_range=0.15,
        max_range=12.0,
    )


def draws_accepted(scans: Scans) -> float:
    """Return the share of scans in which one draw in the middle of the wall is accepted."""
    from fgloc.lidar.ransac import RansacSettings, inliers, least_squares
    from fgloc.lidar.scan import cloud

    settings = RansacSettings()
    points = cloud(scans).points
    first = (BEAMS - settings.neighbours) // 2
    chosen = np.arange(first, first + settings.neighbours, dtype=np.int64)
    line, found = np.empty(5), np.empty(settings.neighbours, dtype=np.int64)
    good = 0
    for scan in points:
        if least_squares(scan, chosen, chosen.size, line):
            n = inliers(scan, chosen, chosen.size, line, settings.tolerance_m, found)
            good += n >= settings.inliers
    return good / len(points)


def detection_table() -> Table:
    """Return by distance of a wall how likely a draw, and a whole scan, finds it."""
    from fgloc.lidar.lines import extract
    from fgloc.lidar.ransac import RansacSettings, extract_ransac
    from fgloc.lidar.scan import cloud

    settings = RansacSettings()
    rows = []
    for k, distance in enumerate(DISTANCES):
        scans = wall_scans(distance, k)
        straight = cloud(scans)
        drawn = extract_ransac(straight, scans, np.random.default_rng(k), settings)
        plain = extract(straight, scans)
        chance = accepted(
            distance, NOISE, settings.neighbours, settings.inliers, settings.tolerance_m
        )
        # A draw needs so many beams on the wall: further off it has fewer.
        enough = int(np.count_nonzero(scans.ranges[0])) >= settings.neighbours
        rows.append(
            Row(
                (f"{distance:g} m",),
                {
                    "chance": Cell(chance, 2, EXPECTED.get(distance)),
                    "draw": Cell(draws_accepted(scans) if enough else math.nan, 2),
                    "ransac": Cell(100.0 * np.unique(drawn.scan).size / TRIALS, 1),
                    "lines": Cell(100.0 * np.unique(plain.scan).size / TRIALS, 1),
                },
            )
        )
    return Table(
        "detection",
        f"A wall of {WIDTH_M:g} m straight ahead: how often it is found, range noise 1 %",
        ("distance",),
        (
            Column("chance", "P of a draw"),
            Column("draw", "a draw here"),
            Column("ransac", "RANSAC finds it", "%"),
            Column("lines", "default finds it", "%"),
        ),
        tuple(rows),
        (
            "P of a draw: that 21 of 25 beams are within 15 mm of the true wall. A draw here: of "
            "the line fitted to them, in the middle of the wall; - where fewer beams meet it.",
            f"Found: in how many of {TRIALS} scans there is a line, by {settings.attempts} draws "
            "among all beams, and by the default extractor.",
        ),
    )
