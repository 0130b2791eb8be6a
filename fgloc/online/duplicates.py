"""Walls that were met twice: which two are one, and what that says of both."""

from __future__ import annotations

import numpy as np

from fgloc.core.geometry import wrap_scalar
from fgloc.core.measurements import Floats
from fgloc.online.wall_matching import Candidates

ALIKE = 9.2
"""Normalised square of the difference of two walls that are one (two numbers, 1 %)."""
FLAT = np.array([2e-3, 3e-3])
"""One wall is as straight as this: direction [rad] and offset [m], one sigma."""
SHARP = np.array([0.03, 0.05])
"""The difference must be known this well [rad, m]: of vague walls nothing can be said."""
GAP_M = 2.0
"""Parts of one wall are no further apart along it [m]: the width of a door, and some more."""


def difference(walls: Candidates, a: int, b: int) -> tuple[Floats, Floats]:
    """Return how wall b lies beside wall a (2,), and its derivative (2, 4) by both walls.

    That is the turn of its normal [rad] and how far its foot is off a's line [m].
    """
    (angle, offset), (other, other_offset) = walls.lines[a], walls.lines[b]
    normal, tangent = _axes(angle)
    other_normal, other_tangent = _axes(other)
    away = walls.anchors[b] + other_offset * other_normal - walls.anchors[a]
    r = np.array([wrap_scalar(float(other - angle)), float(normal @ away - offset)])
    by = np.zeros((2, 4))
    by[0, 0], by[0, 2] = -1.0, 1.0
    by[1, 0], by[1, 1] = tangent @ away, -1.0
    by[1, 2], by[1, 3] = other_offset * (normal @ other_tangent), normal @ other_normal
    return r, by


def first_pair(walls: Candidates, joint: Floats) -> tuple[int, int] | None:
    """Return two walls that are one, None if there are none.

    `joint` (2W, 2W) is the covariance of all walls. O(W²), few pairs of which are looked at.
    """
    angles = walls.lines[:, 0]
    feet = walls.anchors + walls.lines[:, 1:] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    turn = np.abs((angles[:, None] - angles + np.pi) % (2.0 * np.pi) - np.pi)
    offset = np.abs(np.einsum("abk,ak->ab", feet[None] - feet[:, None], _normals(angles)))
    likely = (turn < 3.0 * SHARP[0]) & (offset < 6.0 * SHARP[1])
    for a, b in np.argwhere(np.triu(likely, 1)).tolist():
        if _is_one(walls, joint, a, b):
            return a, b
    return None


def _is_one(walls: Candidates, joint: Floats, a: int, b: int) -> bool:
    """Return True if two walls are parts of the same."""
    r, by = difference(walls, a, b)
    columns = np.array([2 * a, 2 * a + 1, 2 * b, 2 * b + 1])
    spread = by @ joint[np.ix_(columns, columns)] @ by.T
    if not (np.sqrt(np.maximum(np.diag(spread), 0.0)) < SHARP).all():
        return False
    _, tangent = _axes(walls.lines[a, 0])
    along = float(tangent @ (walls.anchors[b] - walls.anchors[a]))
    low, high = along + walls.reach[b, 0], along + walls.reach[b, 1]
    if low > walls.reach[a, 1] + GAP_M or high < walls.reach[a, 0] - GAP_M:
        return False
    return float(r @ np.linalg.solve(spread + np.diag(FLAT**2), r)) < ALIKE


def _axes(angle: float) -> tuple[Floats, Floats]:
    """Return a wall's normal and tangent."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c, s]), np.array([-s, c])


def _normals(angles: Floats) -> Floats:
    """Return the normals (W, 2) of walls."""
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)
