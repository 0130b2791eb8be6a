"""What the text of section 3.4.1 says of Model 1 on the ideal drives, reproduced."""

from __future__ import annotations

import math

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.report.experiment_report import Cell, Column, Row, Table


def ideal_table() -> Table:
    """Return the printed sentences as a table; five runs of Model 1."""
    straight = _model1("straight", 0.48)
    spin_narrow, spin = _model1("spin", 0.48), _model1("spin", 0.72)
    narrow, wide = _model1("circle", 0.48), _model1("circle", 0.9)
    radius = circumradius(wide)
    lines = (
        ("straight", 0.48, "end x [m]", "4.5239", straight[-1, 0]),
        ("spin", 0.48, "turned clockwise [deg]", "1080", -math.degrees(spin_narrow[-1, 2])),
        ("spin", 0.72, "turned clockwise [deg]", "720", -math.degrees(spin[-1, 2])),
        ("circle", 0.48, "turned clockwise [deg]", "675", -math.degrees(narrow[-1, 2])),
        ("circle", 0.48, "radius [m]", "0.962", circumradius(narrow)),
        ("circle", 0.9, "radius [m]", "1.801", radius),
        ("circle", 0.9, "path [m]", "11.317", 2.0 * math.pi * radius),
    )
    rows = tuple(
        Row(
            (case, f"{track:g}", what),
            {"model1": Cell(float(here), len(text.partition(".")[2]), float(text))},
        )
        for case, track, what, text, here in lines
    )
    return Table(
        "text-3.4.1",
        "Text of section 3.4.1: Model 1 without noise or slip",
        ("case", "track [m]", "what"),
        (Column("model1", "Model 1"),),
        rows,
        (
            "Radius and path are those of the circle through the corners of the recursion's "
            "polygon: it steps 0.226 m along the mean heading of a packet.",
        ),
    )


def circumradius(poses: Floats) -> float:
    """Return the radius [m] of the circle through three of the poses (N, 3)."""
    a, b, c = poses[0, :2], poses[len(poses) // 5, :2], poses[2 * len(poses) // 5, :2]
    sides = [float(np.hypot(*(p - q))) for p, q in ((a, b), (b, c), (c, a))]
    cross = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    return math.prod(sides) / (2.0 * abs(float(cross)))


def _model1(case: str, track: float) -> Floats:
    """Return Model 1's poses on an ideal drive with a track [m]."""
    from fgloc.datasets.registry import load_drive
    from fgloc.filters.model1 import Model1

    drive = load_drive(f"sim:seed-a-{case}-ideal?nominal_track={track:g}")
    return Model1("midpoint").estimate(drive).trajectory.poses
