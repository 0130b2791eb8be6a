"""Displacements between consecutive scans, each matched to a small map of those before it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fgloc.core.geometry import between, compose, wrap
from fgloc.core.measurements import Floats
from fgloc.lidar import correlative
from fgloc.lidar.icp import UNKNOWN, Indices
from fgloc.lidar.matching import Match, MatchSettings, match, reference
from fgloc.lidar.surfaces import Mask, ScanPoints, merge, thin

NOT_KNOWN = (UNKNOWN, UNKNOWN, np.pi)
"""Standard deviations [m, m, rad] of a displacement where scans did not match."""


def guess_sigma(steps: Floats) -> Floats:
    """Return standard deviations (M, 3) [m, m, rad] of displacements (M, 3) by unknown wheels.

    2 cm and a fifth of the way; 0.02 rad, 0.05 rad a metre and a fifth of the turn. That covers the
    worst recorded drive; wheels that are known better deserve less.
    """
    way, turn = np.hypot(steps[:, 0], steps[:, 1]), np.abs(wrap(steps[:, 2]))
    position = 0.02 + 0.2 * way
    return np.stack([position, position, 0.02 + 0.05 * way + 0.2 * turn], axis=1)


WIDER = 2.5
"""How much wider is searched where the best of the first window is far off or fits badly …"""
SURE = 0.6
"""… which is with less than this share of paired points …"""
BETTER = 0.1
"""… and how much more the new pose must score to be taken."""


@dataclass(frozen=True)
class ChainSettings:
    """How consecutive scans are matched."""

    scans: int = 12
    """Most scans in the map that the next one is matched to."""
    distance: float = 0.3
    """A scan enters the map when the lidar has moved this far [m] …"""
    turn: float = 0.2
    """… or turned this far [rad] since the last one that did."""
    cell: float = 0.05
    """The map keeps one point in a square of this side [m]."""
    near: float = 12.0
    """Points up to this distance [m] count in the correlation that comes before the matching."""
    least_overlap: float = 0.15
    """A match with a smaller share of paired points is not believed: the guess stands in."""
    matching: MatchSettings = field(default_factory=MatchSettings)
    """How points are matched at the end."""


@dataclass(frozen=True)
class Chain:
    """Displacements of the lidar from scan to scan."""

    relative: Floats
    """(N-1, 3) pose of each scan in the axes of the one before [m, m, rad]; the guess where the
    match failed."""
    covariance: Floats
    """(N-1, 3, 3) of x, y [m] and heading [rad] in those axes: of the match alone, the guess does
    not count in it. Large along a corridor, and where the match failed."""
    matched: Mask
    """(N-1,) whether the match held."""

    def fused(self, guess: Floats, sigma: Floats | None = None) -> tuple[Floats, Floats]:
        """Return displacements (N-1, 3) and covariances (N-1, 3, 3) with the guess's information.

        `guess` (N, 3) is the path that was given, `sigma` (N-1, 3) how well its displacements are
        known [m, m, rad], or (3,) for all of them; None: as `guess_sigma` says.
        """
        steps = between(guess[:-1], guess[1:])
        information = np.linalg.inv(self.covariance)
        weight = np.zeros(self.covariance.shape)
        spread = guess_sigma(steps) if sigma is None else np.asarray(sigma)
        weight[:, range(3), range(3)] = 1.0 / np.square(spread)
        covariance = np.linalg.inv(information + weight)
        off = steps - self.relative
        off[:, 2] = wrap(off[:, 2])
        change = np.einsum("nij,njk,nk->ni", covariance, weight, off)
        return np.asarray(self.relative + change), np.asarray(covariance)


def key_scans(poses: Floats, distance: float = 0.25, turn: float = 0.15) -> Indices:
    """Return the scans at which a path (N, 3) has gone on by `distance` [m] or `turn` [rad].

    Ten scans a second of a slow robot see the same: matching all of them costs more and adds up
    more errors than matching these. The first one is always among them. O(N).
    """
    chosen = [0] if len(poses) else []
    for k in range(1, len(poses)):
        moved = between(poses[chosen[-1]], poses[k])
        if np.hypot(moved[0], moved[1]) >= distance or abs(wrap(moved[2])) >= turn:
            chosen.append(k)
    return np.array(chosen, np.int64)


def match_chain(
    scans: list[ScanPoints],
    guess: Floats,
    sigma: Floats | None = None,
    settings: ChainSettings = ChainSettings(),
) -> Chain:
    """Return the displacement between consecutive scans, `guess` (N, 3) being a drifting path.

    Only the guess's displacements are used; `sigma` (N-1, 3) are their standard deviations [m, m,
    rad], `guess_sigma`'s where they are not known. Three of them are searched. About 5 ms a scan.
    """
    count = len(scans)
    steps = between(guess[:-1], guess[1:])
    steps[:, 2] = wrap(steps[:, 2])
    spread = guess_sigma(steps) if sigma is None else sigma
    poses = np.zeros((count, 3))
    relative, matched = steps.copy(), np.zeros(max(count - 1, 0), bool)
    covariance = np.zeros((max(count - 1, 0), 3, 3))
    kept = [0] if count else []
    for k in range(1, count):
        start = compose(poses[k - 1], steps[k - 1])
        local = merge([scans[i] for i in kept], between(poses[k - 1], poses[kept]), settings.cell)
        found = _to_map(local, scans[k], steps[k - 1], spread[k - 1], settings)
        if found is None:
            covariance[k - 1] = np.diag(np.square(NOT_KNOWN))
        else:
            relative[k - 1], covariance[k - 1] = found.relative, found.covariance
            matched[k - 1] = True
            start = compose(poses[k - 1], found.relative)
        poses[k] = start
        moved = between(poses[kept[-1]], poses[k])
        if np.hypot(moved[0], moved[1]) > settings.distance or abs(moved[2]) > settings.turn:
            kept = [*kept, k][-settings.scans :]
    return Chain(relative, covariance, matched)


def _to_map(
    local: ScanPoints, scan: ScanPoints, guess: Floats, sigma: Floats, settings: ChainSettings
) -> Match | None:
    """Return where a scan is in the map around it; None where it cannot be told."""
    near = np.hypot(scan.points[:, 0], scan.points[:, 1]) < settings.near
    coarse = thin(scan.select(near), 0.15)
    # Points far off say little of where the scan is that near ones do not, and cost a wide grid.
    around = np.hypot(*(local.points - guess[:2]).T) < settings.near + 1.0
    likelihood = correlative.field(thin(local.select(around), 0.1))
    target = reference(local)
    best: Match | None = None
    best_score = 0.0
    for widening in (1.0, WIDER):
        spread = widening * sigma
        half = np.maximum(3.0 * spread, (0.1, 0.1, 0.02))
        pose, score = correlative.search(likelihood, coarse, guess, half, sigma=spread)
        if score < (0.0 if best is None else best_score + BETTER):
            continue
        found = match(target, scan, guess, settings.matching, pose)
        if found.converged and found.overlap >= settings.least_overlap:
            best, best_score = found, score
        # Wheels that slipped: the pose may be outside of what was searched.
        central = bool(np.all(np.abs(pose - guess) < 0.5 * half))
        if best is not None and central and best.overlap > SURE:
            break
    return best
