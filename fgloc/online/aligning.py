"""A drive whose start is unknown: the first fixes tell where the wheels' path lies in the map."""

from __future__ import annotations

import numpy as np

from fgloc.core.geometry import compose, inverse
from fgloc.core.measurements import Floats
from fgloc.online.fixes import Fix
from fgloc.smoothing.initial import align, telling

ROOM = 10.0
"""The start may be this much further off than the fixes are apart [m]."""


class Aligner:
    """Collects fixes until they tell the start's position and heading."""

    def __init__(self, mounts: dict[str, Floats]) -> None:
        """`mounts` (3,) are the nominal mountings of the streams of fixes."""
        self._mounts = mounts
        self.fixes: list[tuple[int, Fix, Floats | None]] = []
        self._points: list[Floats] = []

    def add(self, number: int, fix: Fix, moved: Floats | None, pose: Floats) -> None:
        """Take a fix at a keyframe with a dead-reckoned pose (3,)."""
        self.fixes.append((number, fix, moved))
        # A copy: the pose is a view of the window, which moves on.
        here = pose.copy() if moved is None else compose(pose, moved)
        self._points.append(here)

    def prune(self, base: int) -> list[Fix]:
        """Forget fixes at keyframes that the window has left behind; return them."""
        gone = [fix for number, fix, _ in self.fixes if number < base]
        kept = [k for k, (number, _, _) in enumerate(self.fixes) if number >= base]
        self.fixes = [self.fixes[k] for k in kept]
        self._points = [self._points[k] for k in kept]
        return gone

    def start(self) -> tuple[Floats, Floats] | None:
        """Return the pose (3,) of the path's origin in the map and its sigmas; None if unknown."""
        for (_, fix, _), here in zip(self.fixes, self._points, strict=True):
            if fix.values.size == 3:
                base = compose(fix.values, inverse(self._mounts[fix.sensor]))
                return compose(base, inverse(here)), np.array([ROOM, ROOM, np.pi])
        order = sorted(range(len(self.fixes)), key=lambda k: self.fixes[k][1].stamp_ns)
        where = np.array([self.fixes[k][1].values for k in order]).reshape(-1, 2)
        sigma = np.array([self.fixes[k][1].sigma[0] for k in order])
        enough = telling(where, sigma) if len(order) > 1 else 0
        if enough == 0:
            return None
        points = np.array([self._points[k][:2] for k in order])
        pose, extent = align(points[:enough], where[:enough])
        return pose, np.array([extent + ROOM, extent + ROOM, np.pi])
