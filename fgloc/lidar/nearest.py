"""Association as seeds B and C have it: the nearest landmark within a distance in the map."""

from __future__ import annotations

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats, Stamps


@compiled
def nearest(
    places: Floats, streams: Stamps, count: int, stream: int, px: float, py: float, gate: float
) -> tuple[int, float, float]:
    """Return the landmark nearest to a point of the map, its distance, that of the second nearest.

    `places` (≥count, 2) [m], `streams` (≥count,) says which sensor each one was seen by: only those
    of `stream` count. -1 and inf where none is within `gate` [m]. Euclidean: how uncertain pose and
    landmark are does not matter. O(count).
    """
    best = -1
    first = second = gate * gate
    found, other = np.inf, np.inf
    for k in range(count):
        if streams[k] != stream:
            continue
        dx, dy = places[k, 0] - px, places[k, 1] - py
        squared = dx * dx + dy * dy
        if squared <= first:
            if best >= 0:
                second, other = first, found
            best, first, found = k, squared, np.sqrt(squared)
        elif squared <= second:
            second, other = squared, np.sqrt(squared)
    return best, found, other
