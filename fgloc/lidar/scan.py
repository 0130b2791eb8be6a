"""Scans as points: where each beam ended, with the motion during a turn undone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fgloc.core.compiled import compiled
from fgloc.core.geometry import arc_coefficients
from fgloc.core.measurements import Floats, Scans
from fgloc.errors import FglocError


@dataclass(frozen=True)
class Cloud:
    """N scans of B beams as points, each in the lidar's axes at the stamp of its first beam."""

    points: Floats
    """(N, B, 2) where each beam ended [m]; (0, 0) where it did not return."""
    ranges: Floats
    """(N, B) what was measured [m]; 0 where the beam did not return."""
    valid: npt.NDArray[np.bool_]
    """(N, B) whether a beam returned from between the sensor's shortest and longest range."""

    def __post_init__(self) -> None:
        if self.ranges.ndim != 2:
            raise FglocError("cloud: ranges must have one row a scan")
        shape = self.ranges.shape
        if self.points.shape != (*shape, 2) or self.valid.shape != shape:
            raise FglocError("cloud: points and valid must fit the ranges, beam by beam")


def cloud(scans: Scans, motion: Floats | None = None) -> Cloud:
    """Return where the beams of N scans ended; see `Cloud` for the axes.

    `motion` (N, 3) is the twist of the lidar times the time of one whole scan, B·beam_period:
    x, y [m] and heading [rad] in its own axes, constant over the scan, as
    `fgloc.lidar.motion.scan_motion` gives it. Beam b was then sent a share b/B of it later than
    the first, and is put where it ended seen from the first. None: the lidar stood still, or the
    scans are straight already. A beam is valid if its range is finite, above zero and in
    min_range ≤ range < max_range. Raises FglocError for a motion of another shape or not finite.
    O(N·B), compiled.
    """
    n, beams = scans.ranges.shape
    if motion is not None:
        if motion.shape != (n, 3):
            raise FglocError(f"{scans.sensor}: motion must have shape ({n}, 3), got {motion.shape}")
        if not bool(np.all(np.isfinite(motion))):
            raise FglocError(f"{scans.sensor}: the motion during a scan is not finite")
    ranges = np.array(scans.ranges, dtype=np.float64, order="C")
    points = np.zeros((n, beams, 2))
    valid = np.zeros((n, beams), dtype=np.bool_)
    angles = scans.angle_min + scans.angle_increment * np.arange(beams)
    _points(
        ranges,
        np.cos(angles),
        np.sin(angles),
        np.zeros((0, 3)) if motion is None else np.ascontiguousarray(motion, dtype=np.float64),
        scans.min_range,
        scans.max_range,
        points,
        valid,
    )
    return Cloud(points, ranges, valid)


@compiled
def _points(
    ranges: Floats,
    cosines: Floats,
    sines: Floats,
    motion: Floats,
    min_range: float,
    max_range: float,
    points: Floats,
    valid: npt.NDArray[np.bool_],
) -> None:
    """Fill points and valid, and set the ranges of other beams to zero; no motion: (0, 3)."""
    n, beams = ranges.shape
    for k in range(n):
        moves = motion.shape[0] > 0 and (
            motion[k, 0] != 0.0 or motion[k, 1] != 0.0 or motion[k, 2] != 0.0
        )
        for b in range(beams):
            r = ranges[k, b]
            # False for NaN as well.
            if not (r > 0.0 and r >= min_range and r < max_range and r < np.inf):
                ranges[k, b] = 0.0
                continue
            valid[k, b] = True
            x, y = r * cosines[b], r * sines[b]
            if moves:
                share = b / beams
                turn = share * motion[k, 2]
                along, across, _, _ = arc_coefficients(turn)
                dx, dy = share * motion[k, 0], share * motion[k, 1]
                c, s = np.cos(turn), np.sin(turn)
                x, y = (
                    along * dx - across * dy + c * x - s * y,
                    across * dx + along * dy + s * x + c * y,
                )
            points[k, b, 0], points[k, b, 1] = x, y
