"""Which places of a drive may be the same, given how far it may have drifted between them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.lidar.icp import Indices


@dataclass(frozen=True)
class Uncertainty:
    """How the drift of matched scans grows with the way between two places."""

    position: float = 0.03
    """Random walk of the position [m/√m]."""
    heading: float = 0.004
    """Random walk of the heading [rad/√m]."""
    least: tuple[float, float] = (0.3, 0.05)
    """What is searched at least [m, rad] to both sides."""
    sigmas: float = 3.0
    """How many standard deviations are searched."""


class _Settings(Protocol):
    """What `fgloc.lidar.closures.ClosureSettings` tells here."""

    @property
    def separation(self) -> float: ...
    @property
    def near(self) -> float: ...
    @property
    def candidates(self) -> int: ...
    @property
    def widest(self) -> tuple[float, float]: ...
    @property
    def uncertainty(self) -> Uncertainty: ...


def way_lengths(length: Floats, covariance: Floats, model: Uncertainty) -> Floats:
    """Return (N-1,) how much way [m] each displacement counts for.

    One that is known worse than the model says for its length, as where scans did not match,
    counts for as much way as would make it so uncertain.
    """
    position = np.linalg.eigvalsh(covariance[:, :2, :2])[:, 1] / model.position**2
    heading = covariance[:, 2, 2] / model.heading**2
    return np.asarray(np.maximum(length, np.maximum(position, heading)))


def propose(
    poses: Floats,
    nodes: Indices,
    travelled: Floats,
    covariance: Floats,
    closed: tuple[Indices, Indices],
    tried: set[tuple[int, int]],
    settings: _Settings,
) -> Iterator[tuple[int, int, Floats]]:
    """Yield (earlier scan, later scan, half widths (3,) of the window) of places to compare.

    `poses` (N, 3) the drive as it is known now; `nodes` the places; `travelled` (N,) path lengths
    [m]; `covariance` (N-1, 3, 3) of displacements; `closed` the scans of closures so far, which
    shorten the way from place to place; `tried` is left out. O(P log P) and the pairs in reach.
    """
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import dijkstra
    from scipy.spatial import cKDTree

    if nodes.size < 2:
        return
    model = settings.uncertainty
    way = np.concatenate([[0.0], np.cumsum(way_lengths(np.diff(travelled), covariance, model))])
    # Rotation drifts along, so that position grows with the way to the power of 3/2: the way at
    # which three sigmas fill the widest window is as far as it is looked for.
    ways = np.linspace(0.0, 2000.0, 2001)
    reach = model.sigmas * np.sqrt(model.position**2 * ways + model.heading**2 * ways**3 / 3.0)
    turn = model.sigmas * model.heading * np.sqrt(ways)
    farthest = float(ways[(reach <= settings.widest[0]) & (turn <= settings.widest[1])][-1])
    at = np.searchsorted(nodes, closed[0]), np.searchsorted(nodes, closed[1])
    k = np.arange(nodes.size - 1)
    rows = np.concatenate([k, at[0]])
    columns = np.concatenate([k + 1, at[1]])
    weights = np.concatenate([np.diff(way[nodes]) + 1e-6, np.full(closed[0].size, 0.5)])
    graph = csr_matrix((weights, (rows, columns)), shape=(nodes.size, nodes.size))
    tree = cKDTree(poses[nodes, :2])
    for j in range(nodes.size):
        distance = dijkstra(graph, directed=False, indices=j, limit=farthest)
        around = np.array(tree.query_ball_point(poses[nodes[j], :2], settings.near + 8.0))
        around = around[travelled[nodes[around]] < travelled[nodes[j]] - settings.separation]
        drift = np.interp(distance[around], ways, reach)
        apart = np.hypot(*(poses[nodes[around], :2] - poses[nodes[j], :2]).T)
        usable = np.isfinite(distance[around]) & (apart < settings.near + drift)
        order = np.argsort(apart[usable] + 0.5 * drift[usable], kind="stable")
        chosen = 0
        for i in around[usable][order]:
            if chosen == settings.candidates:
                break
            chosen += 1
            pair = (int(nodes[i]), int(nodes[j]))
            if pair in tried:
                continue
            half = max(float(np.interp(distance[i], ways, reach)), model.least[0])
            angle = max(float(np.interp(distance[i], ways, turn)), model.least[1])
            yield (*pair, np.array([half, half, angle]))
