"""Which places of a drive may be the same, given how far it may have drifted between them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.lidar.icp import Indices

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

CLOSED = 0.5
"""Length of way [m] that a closure counts for."""
LONGEST = 1000.0
"""Longest way between two places that are compared [m]."""


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
    shorten the way from place to place; `tried` is left out. Where the drift may be more than the
    widest window, nothing is proposed. O(P log P) for each of P places within reach.
    """
    from scipy.spatial import cKDTree

    if nodes.size < 2:
        return
    model = settings.uncertainty
    graphs = _graphs(nodes, travelled, covariance, closed, model)
    tree = cKDTree(poses[nodes, :2])
    for j in range(nodes.size):
        position, heading = _drift(graphs, j, settings)
        near = np.array(
            tree.query_ball_point(poses[nodes[j], :2], settings.near + settings.widest[0]), np.int64
        )
        near = near[travelled[nodes[near]] < travelled[nodes[j]] - settings.separation]
        apart = np.hypot(*(poses[nodes[near], :2] - poses[nodes[j], :2]).T)
        usable = position[near] <= settings.widest[0]
        usable &= (heading[near] <= settings.widest[1]) & (apart < settings.near + position[near])
        near, apart = near[usable], apart[usable]
        for i in near[np.argsort(apart + 0.5 * position[near], kind="stable")][
            : settings.candidates
        ]:
            pair = (int(nodes[i]), int(nodes[j]))
            if pair not in tried:
                half = max(float(position[i]), model.least[0])
                yield (*pair, np.array([half, half, max(float(heading[i]), model.least[1])]))


def _graphs(
    nodes: Indices,
    travelled: Floats,
    covariance: Floats,
    closed: tuple[Indices, Indices],
    model: Uncertainty,
) -> tuple[csr_matrix, csr_matrix, csr_matrix]:
    """Return the places as graphs of ways: lengths [m], position [m²] and heading [rad²] of each.

    Variances of a stretch are those of its displacements, but at least the model's for its length.
    A closure is a short way.
    """
    from scipy.sparse import csr_matrix

    length = np.diff(travelled)
    wide = np.linalg.eigvalsh(covariance[:, :2, :2])[:, 1]
    position = np.maximum(wide, model.position**2 * length)
    heading = np.maximum(covariance[:, 2, 2], model.heading**2 * length)
    at = np.searchsorted(nodes, closed[0]), np.searchsorted(nodes, closed[1])
    k = np.arange(nodes.size - 1)
    rows, columns = np.concatenate([k, at[0]]), np.concatenate([k + 1, at[1]])
    graphs = []
    for values, short in (
        (length, CLOSED),
        (position, model.position**2 * CLOSED),
        (heading, model.heading**2 * CLOSED),
    ):
        total = np.concatenate([[0.0], np.cumsum(values)])[nodes]
        # Zero would be no way at all.
        weights = np.concatenate([np.maximum(np.diff(total), 1e-12), np.full(at[0].size, short)])
        graphs.append(csr_matrix((weights, (rows, columns)), shape=(nodes.size, nodes.size)))
    return graphs[0], graphs[1], graphs[2]


def _drift(
    graphs: tuple[csr_matrix, csr_matrix, csr_matrix], j: int, settings: _Settings
) -> tuple[Floats, Floats]:
    """Return how far (P,) [m] and [rad] every place may have drifted from place j; inf: too far.

    A heading that walks at random moves the end of a way of length L by L/√3 of itself.
    """
    from scipy.sparse.csgraph import dijkstra

    sigmas = settings.uncertainty.sigmas
    limits = (
        LONGEST,
        (settings.widest[0] / sigmas) ** 2,
        (settings.widest[1] / sigmas) ** 2,
    )
    length, position, heading = (
        dijkstra(graph, directed=False, indices=j, limit=limit)
        for graph, limit in zip(graphs, limits, strict=True)
    )
    return sigmas * np.sqrt(position + heading * length**2 / 3.0), sigmas * np.sqrt(heading)
