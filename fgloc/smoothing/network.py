"""One linear step of a graph that is more than a chain: landmarks, and scans matched far apart.

The wheels' chain stays as it is, one JacobianFactor a keyframe; every sighting and every match is
one more. GTSAM eliminates in an order that cuts time in two again and again, as cyclic reduction
does, the calibration last: with one calibration block in every factor COLAMD would be quadratic.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from fgloc.core.measurements import Floats, Stamps
from fgloc.factors.tables import FactorTable, Linearised
from fgloc.smoothing.arrow import ArrowSolution, ChainRows, solve, stack
from fgloc.smoothing.elimination import add_chain, add_damping, solve_with_gtsam
from fgloc.smoothing.marginals import sparse_marginals

if TYPE_CHECKING:
    import gtsam


@dataclass(frozen=True)
class Links:
    """Whitened, weighted rows that join a keyframe to a landmark or to another keyframe."""

    first: Stamps
    """(M,) keyframe."""
    second: Stamps
    """(M,) keyframe, or landmark counted on from the last keyframe."""
    by_first: Floats
    """(M, d, B)."""
    by_second: Floats
    """(M, d, B or 2)."""
    by_calibration: Floats
    """(M, d, G): all of them, or G = 0 where the factor has no calibration."""
    right: Floats
    """(M, d) negative residuals."""


@dataclass(frozen=True)
class NetworkRows:
    """All whitened, weighted rows of a linearised graph with landmarks or matches."""

    chain: ChainRows
    """What joins a keyframe and the next one at most, and the calibration's prior."""
    links: tuple[Links, ...]
    """Everything else, by table."""
    landmarks: int
    """L, the number of landmarks of two numbers each."""

    def squared_norms(self) -> list[Floats]:
        """Return the squared column norms of every variable: keyframes, landmarks, calibration."""
        by_keyframe, shared = self.chain.squared_norms()
        k = by_keyframe.shape[0]
        by_landmark = np.zeros((self.landmarks, 2))
        for link in self.links:
            np.add.at(by_keyframe, link.first, np.sum(link.by_first**2, axis=1))
            onto, at = (
                (by_landmark, link.second - k) if _to_marks(link, k) else (by_keyframe, link.second)
            )
            np.add.at(onto, at, np.sum(link.by_second**2, axis=1))
            if link.by_calibration.shape[2]:
                shared = shared + np.sum(link.by_calibration**2, axis=(0, 1))
        return [*by_keyframe, *by_landmark, *([shared] if shared.size else [])]


LinearSystem = ChainRows | NetworkRows
Weighted = Sequence[tuple[FactorTable, Linearised, Floats]]


def _to_marks(link: Links, keyframes: int) -> bool:
    """Return True if the links of a table go to landmarks."""
    return link.second.size > 0 and int(link.second[0]) >= keyframes


def gather(
    linear: Weighted, keyframes: int, width: int, landmarks: int, prior: Floats
) -> LinearSystem:
    """Return the rows of linearised tables with their robust weights (M,).

    `prior` (P, G + 1) are rows on the calibration alone. A chain where no table links more. O(N).
    """
    chain = stack([t for t in linear if not t[0].links], keyframes, width, prior)
    if len(linear) and not any(t.links for t, _, _ in linear) and not landmarks:
        return chain
    links = [
        _links(table, lin, weight, keyframes, prior.shape[1] - 1)
        for table, lin, weight in linear
        if table.links
    ]
    return NetworkRows(chain, tuple(links), landmarks)


def _links(
    table: FactorTable, lin: Linearised, weight: Floats, keyframes: int, calibration: int
) -> Links:
    """Return the weighted rows of one linking table."""
    assert table.second is not None
    root = np.sqrt(weight)
    used = table.calibration.stop - table.calibration.start
    by_calibration = np.zeros((weight.size, table.dimension, calibration if used else 0))
    if used:
        by_calibration[:, :, table.calibration] = root[:, None, None] * lin.by_calibration
    return Links(
        table.first,
        table.second + keyframes if table.sees_landmarks else table.second,
        root[:, None, None] * lin.by_first,
        root[:, None, None] * lin.by_second,
        by_calibration,
        -root[:, None] * lin.residual,
    )


def step_of(
    system: LinearSystem,
    damping: float = 0.0,
    with_covariance: bool = False,
    solver: str = "arrow",
) -> ArrowSolution | None:
    """Return the least-squares step of all rows; None if they do not determine it.

    `damping` adds damping·diag(JᵀJ); `with_covariance` adds the marginals of every variable.
    `solver` matters for chains without covariances only: "arrow" or "gtsam".
    """
    if isinstance(system, NetworkRows):
        return _solve_network(system, damping, with_covariance)
    if solver == "gtsam" and not with_covariance:
        return solve_with_gtsam(system, damping)
    return solve(system, damping, with_covariance)


def _solve_network(
    system: NetworkRows, damping: float, with_covariance: bool
) -> ArrowSolution | None:
    """Eliminate by GTSAM: Cholesky first, QR if that fails."""
    import gtsam  # heavy: imported when a step is asked for

    chain = system.chain
    k, b, g = chain.bounds.size - 1, chain.width, chain.calibration
    shared = k + system.landmarks
    graph = gtsam.GaussianFactorGraph()
    add_chain(graph, chain, shared)
    for link in system.links:
        _add_links(graph, link, shared)
    if damping > 0.0:
        add_damping(graph, system.squared_norms(), damping)
    pairs = _pairs(system)
    if not np.isin(np.arange(k, shared), pairs[:, 1]).all():
        return None  # a landmark that nothing saw
    ordering = _ordering(k, pairs, shared, g > 0)
    for function in ((), (gtsam.EliminateQR,)):
        try:
            tree = graph.eliminateMultifrontal(ordering, *function)
            flat = np.asarray(tree.optimize().vector(), dtype=np.float64)
        except RuntimeError:
            continue
        if not np.isfinite(flat).all() or flat.size != k * b + 2 * system.landmarks + g:
            continue
        ends = k * b, k * b + 2 * system.landmarks
        found = ArrowSolution(
            flat[: ends[0]].reshape(k, b),
            flat[ends[1] :],
            landmark_step=flat[ends[0] : ends[1]].reshape(-1, 2),
        )
        if not with_covariance:
            return found
        try:
            return _with_covariances(found, tree, shared)
        except RuntimeError:
            return _with_sparse_covariances(found, system)
    return None


def _add_links(graph: gtsam.GaussianFactorGraph, link: Links, shared: int) -> None:
    """Add one factor a link."""
    import gtsam

    unit = gtsam.noiseModel.Unit.Create(link.right.shape[1])
    first, second = link.first.tolist(), link.second.tolist()
    rows = zip(first, link.by_first, second, link.by_second, link.right, strict=True)
    # Spelled out: this loop is most of what a step costs.
    if link.by_calibration.shape[2]:
        for (i, a, j, c, r), s in zip(rows, link.by_calibration, strict=True):
            graph.add(i, a, j, c, shared, s, r, unit)
    else:
        for i, a, j, c, r in rows:
            graph.add(i, a, j, c, r, unit)


def _pairs(system: NetworkRows) -> Stamps:
    """Return the (P, 2) different pairs of keys that links join."""
    none = np.zeros((0, 2), np.int64)
    every = [np.stack([link.first, link.second], axis=1) for link in system.links]
    return np.unique(np.concatenate([none, *every]), axis=0)


def _ordering(keyframes: int, pairs: Stamps, shared: int, calibrated: bool) -> gtsam.Ordering:
    """Return every variable by the level at which time is cut in two there, the calibration last.

    Keyframes are cut as in cyclic reduction: by how often two divides their one-based number. A
    landmark goes with the cut that lies between its first and its last sighting, and so does the
    first keyframe of a match. METIS would do, but does not always return.
    """
    import gtsam

    number = np.arange(1, keyframes + 1)
    level = np.zeros(shared, np.int64)
    level[:keyframes] = number & -number
    begin, end = np.full(shared, keyframes + 1), np.zeros(shared, np.int64)
    begin[:keyframes] = end[:keyframes] = number
    to_marks = pairs[:, 1] >= keyframes
    seen_at = pairs[to_marks, 0] + 1
    np.minimum.at(begin, pairs[to_marks, 1], seen_at)
    np.maximum.at(end, pairs[to_marks, 1], seen_at)
    matched = pairs[~to_marks]
    for one, other in (matched.T, matched.T[::-1]):
        np.minimum.at(begin, one, other + 1)
        np.maximum.at(end, one, other + 1)
    # Only the earlier keyframe of a match is put off.
    begin[np.setdiff1d(matched[:, 1], matched[:, 0])] = 0
    spans = (begin > 0) & (begin <= end) & ((begin < end) | (np.arange(shared) >= keyframes))
    # The number in [begin, end] that two divides most often.
    differing = (begin[spans] - 1) ^ end[spans]
    high = np.floor(np.log2(differing)).astype(np.int64)
    cut = (end[spans] >> high) << high
    level[spans] = np.maximum(level[spans], cut & -cut)
    is_keyframe = np.arange(shared) < keyframes
    order = np.lexsort((is_keyframe, level)).tolist()
    return gtsam.Ordering([*order, shared] if calibrated else order)


def _with_sparse_covariances(found: ArrowSolution, system: NetworkRows) -> ArrowSolution | None:
    """Return the step with the marginals of every variable, not by GTSAM."""
    marginals = sparse_marginals(system)
    if marginals is None:
        return None
    by_keyframe, by_landmark, shared = marginals
    return replace(
        found,
        covariance=by_keyframe,
        landmark_covariance=by_landmark,
        calibration_covariance=shared,
    )


def _with_covariances(
    found: ArrowSolution, tree: gtsam.GaussianBayesTree, shared: int
) -> ArrowSolution:
    """Return the step with the marginals of every variable."""
    keyframes, landmarks = found.step.shape[0], found.landmark_step.shape[0]
    g = found.calibration_step.size
    return replace(
        found,
        covariance=np.array([tree.marginalCovariance(k) for k in range(keyframes)]),
        landmark_covariance=np.array(
            [tree.marginalCovariance(keyframes + k) for k in range(landmarks)]
        ).reshape(landmarks, 2, 2),
        calibration_covariance=np.asarray(tree.marginalCovariance(shared))
        if g
        else np.zeros((0, 0)),
    )
