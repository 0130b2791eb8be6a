"""Loop closures: places that a drive came back to, found by what the walls look like there.

Small maps around places along the drive are compared with those of earlier passes, wherever the
drift so far allows them to be the same place: exhaustive correlation over that window, point-to-
line matching, and then what a wrong match cannot easily pass: no other pose in the window fits
nearly as well (one of many doors of a corridor), no map has walls where the other looked through,
and the closures agree with one another as loops. Accepted ones straighten the drive, which narrows
the windows for the next round.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from fgloc.core.geometry import between, chain, wrap
from fgloc.core.measurements import Floats
from fgloc.errors import FglocError
from fgloc.lidar.chain import guess_sigma, key_scans
from fgloc.lidar.consistency import NEIGHBOURS, accumulate, agreement, largest_agreeing, supported
from fgloc.lidar.correlative import Field, search
from fgloc.lidar.correlative import field as likelihood
from fgloc.lidar.icp import Indices
from fgloc.lidar.matching import MatchSettings, Reference, match, reference
from fgloc.lidar.proposals import Uncertainty, propose
from fgloc.lidar.relax import relax
from fgloc.lidar.submaps import Submap, around, inverse_of, seen_through, submap
from fgloc.lidar.surfaces import Mask, ScanPoints, thin


@dataclass(frozen=True)
class ClosureSettings:
    """How loop closures are looked for, and what is believed."""

    spacing: float = 2.5
    """Distance between places along the path [m]."""
    half: float = 3.0
    """A place's map is made of the scans within this much path [m] to both sides …"""
    scans: int = 9
    """… at most so many of them."""
    separation: float = 12.0
    """Two places are compared when at least this much path [m] lies between them."""
    near: float = 5.0
    """They may be this far apart [m], as far as is known, besides the drift."""
    candidates: int = 4
    """Most places that one is compared with in a round."""
    rounds: int = 6
    """Most rounds of looking, the drive being straightened between them."""
    widest: tuple[float, float] = (8.0, 0.6)
    """Widest search [m, rad] to both sides; where the drift may be more, it is not looked for."""
    least_score: float = 0.2
    """Least mean likelihood of the points in the correlation."""
    ambiguity: float = 0.9
    """Another pose of the window may score at most this share of the best."""
    least_overlap: float = 0.2
    """Least share of points with a partner, both ways."""
    most_through: float = 0.08
    """Largest share of points which the other map's beams passed through."""
    map_sigma: tuple[float, float, float] = (0.01, 0.01, 0.003)
    """What a place's map is distorted by [m, m, rad] beside the drift inside it."""
    walk: tuple[float, float, float] = (0.01, 0.01, 0.003)
    """Random walk of the drive [m, m, rad, each per √m], added to its own covariance."""
    uncertainty: Uncertainty = field(default_factory=Uncertainty)
    """How drift grows with the way from place to place."""
    lonely: float = 1.0
    """A closure with no companion is believed when drift cannot be more than this [m]."""
    matching: MatchSettings = field(default_factory=MatchSettings)
    """How points are matched at the end."""


@dataclass(frozen=True)
class Closures:
    """Scans of one drive that saw the same place, and how they lie to one another."""

    first: Indices
    """(C,) index of the earlier scan."""
    second: Indices
    """(C,) index of the later scan, non-decreasing."""
    relative: Floats
    """(C, 3) pose of the later scan in the earlier one's axes [m, m, rad]."""
    covariance: Floats
    """(C, 3, 3) of x, y [m] and heading [rad] in the earlier one's axes."""
    score: Floats
    """(C,) share of points with a partner, the smaller of both ways."""
    poses: Floats
    """(N, 3) the drive as the closures straighten it, from the origin."""
    compared: int
    """How many pairs of places were compared."""
    rejected: dict[str, int]
    """How many of these were dropped, by reason."""


def find_closures(
    scans: list[ScanPoints],
    steps: Floats,
    covariance: Floats,
    settings: ClosureSettings = ClosureSettings(),
) -> Closures:
    """Return the loop closures of a drive of N scans, none where nothing is sure.

    `steps` (N-1, 3) are the displacements from scan to scan and `covariance` (N-1, 3, 3) theirs,
    in the axes of the first of two scans, as `fgloc.lidar.chain.match_chain` gives them; they are
    taken to be known at least as well as by poor wheels (`fgloc.lidar.chain.guess_sigma`). About
    20 ms for every pair of places, of which there are at most `candidates` for each place in each
    round. FglocError where the shapes do not fit.
    """
    count = len(scans)
    if steps.shape != (max(count - 1, 0), 3) or covariance.shape != (max(count - 1, 0), 3, 3):
        raise FglocError(
            f"closures: {count} scans need {max(count - 1, 0)} displacements (N-1, 3) with "
            f"covariances, got {steps.shape} and {covariance.shape}"
        )
    return _Search(scans, steps, covariance, settings).run()


@dataclass
class _Place:
    """What is needed of one place, made when it is first compared."""

    map: Submap
    coarse: ScanPoints
    reference: Reference
    likelihood: Field | None = None


class _Search:
    """One search through a drive."""

    def __init__(
        self, scans: list[ScanPoints], steps: Floats, covariance: Floats, settings: ClosureSettings
    ) -> None:
        self.scans, self.steps, self.settings = scans, steps, settings
        length = np.hypot(steps[:, 0], steps[:, 1])
        walked = np.diag(np.square(settings.walk)) * length[:, None, None]
        # Where scans leave a direction open, the displacement is the wheels' guess of it.
        spread = 1.0 / np.square(guess_sigma(steps))
        known = np.linalg.inv(covariance) + spread[:, :, None] * np.eye(3)
        self.covariance = np.linalg.inv(known) + walked
        start = np.zeros(3)
        self.chained = chain(steps, start) if len(scans) else np.zeros((0, 3))
        self.poses = self.chained
        self.travelled = np.concatenate([[0.0], np.cumsum(length)])
        self.nodes = key_scans(self.chained, settings.spacing, np.inf)
        self.path = accumulate(steps, self.covariance, self.chained)
        self.maps: dict[int, _Place] = {}
        self.tried: dict[tuple[int, int], Floats] = {}
        self.compared = 0
        self.found: list[tuple[int, int, Floats, Floats, float, float]] = []
        self.rejected = dict.fromkeys(
            ("weak", "ambiguous", "edge", "overlap", "through", "loop", "lonely"), 0
        )

    def run(self) -> Closures:
        """Return what a few rounds find."""
        kept = self._assemble(np.zeros(0, bool))
        for _ in range(self.settings.rounds):
            before = len(self.found)
            settled = self._settled()
            for a, b, half in propose(
                self.poses,
                self.nodes,
                self.travelled,
                self.covariance,
                (kept.first, kept.second),
                settled,
                self.settings,
            ):
                self._compare(a, b, half)
            if len(self.found) == before:
                break
            kept = self._believe()
        return replace(kept, compared=self.compared, rejected=dict(self.rejected))

    def _guess(self, a: int, b: int) -> Floats:
        """Return where scan b is to scan a, as far as is known now."""
        guess = between(self.poses[a], self.poses[b])
        guess[2] = wrap(guess[2])
        return np.asarray(guess)

    def _settled(self) -> set[tuple[int, int]]:
        """Return the pairs that another look would not help: found, or still where they were."""
        settled = {(c[0], c[1]) for c in self.found}
        for (a, b), before in self.tried.items():
            moved = np.abs(self._guess(a, b) - before)
            if moved[0] < 0.5 and moved[1] < 0.5 and moved[2] < 0.1:
                settled.add((a, b))
        return settled

    def _place(self, scan: int) -> _Place:
        """Return the map around a scan; its insides come from the chain, so it never changes."""
        if scan not in self.maps:
            members = around(self.travelled, scan, self.settings.half, self.settings.scans)
            local = submap(self.scans, self.chained, scan, members, 0.08)
            self.maps[scan] = _Place(local, thin(local.points, 0.3), reference(local.points))
        return self.maps[scan]

    def _distortion(self, scan: int) -> Floats:
        """Return (3, 3) how well the map around a scan is known from that scan.

        Its scans are half its reach away on average. A quarter of what drifts on the way there
        counts: scans that were matched to one local map drift less than their sum.
        """
        way, half = self.travelled, self.settings.half / 2.0
        low = np.searchsorted(way, way[scan] - half)
        high = np.searchsorted(way, way[scan] + half)
        drift = self.covariance[low:high].sum(axis=0) / 8.0
        position, heading = np.trace(drift[:2, :2]) / 2.0, drift[2, 2]
        return np.diag(np.square(self.settings.map_sigma)) + np.diag([position, position, heading])

    def _compare(self, a: int, b: int, half: Floats) -> None:
        """Compare two places, `half` (3,) being the window's half width [m, m, rad]."""
        settings, first, second = self.settings, self._place(a), self._place(b)
        if first.likelihood is None:
            first.likelihood = likelihood(first.map.points)
        guess = self._guess(a, b)
        self.tried[a, b] = guess
        self.compared += 1
        half, sigma = half.copy(), half / 2.0
        widest = np.array([settings.widest[0], settings.widest[0], settings.widest[1]])
        while True:
            pose, score = search(
                first.likelihood,
                second.coarse,
                guess,
                half,
                sigma=sigma,
                least=settings.least_score,
            )
            if score < 0.0:
                self.rejected["weak"] += 1
                return
            # The best pose of a window that is at its edge is not the best of all.
            edge = np.abs(pose - guess) > half - (0.2, 0.2, 0.03)
            if half[0] <= 1.0 or not edge.any():
                break
            if bool(np.all(half >= widest)):
                self.rejected["edge"] += 1
                return
            half = np.minimum(2.0 * half, widest)
        apart = np.array([*pose, 1.0, 0.15])
        limit = settings.ambiguity * score
        _, other = search(
            first.likelihood, second.coarse, guess, half, sigma=sigma, least=limit, apart=apart
        )
        if other >= 0.0:
            self.rejected["ambiguous"] += 1
            return
        found = match(first.reference, second.map.points, pose, settings.matching)
        back = match(
            second.reference, first.map.points, inverse_of(found.relative), settings.matching
        )
        overlap = min(found.overlap, back.overlap)
        if not found.converged or overlap < settings.least_overlap:
            self.rejected["overlap"] += 1
            return
        if seen_through(first.map, second.map, found.relative) > settings.most_through:
            self.rejected["through"] += 1
            return
        covariance = found.covariance + self._distortion(a) + self._distortion(b)
        self.found.append((a, b, found.relative, covariance, overlap, float(half[0])))

    def _believe(self) -> Closures:
        """Return the closures that agree; straighten the drive by them."""
        self.found.sort(key=lambda c: (c[1], c[0]))
        every = self._assemble(np.ones(len(self.found), bool))
        distance = agreement(
            self.chained,
            self.path,
            every.first,
            every.second,
            every.relative,
            every.covariance,
            NEIGHBOURS,
        )
        agreeing = largest_agreeing(distance)
        window = np.array([c[5] for c in self.found])
        both = agreeing[:, None] & np.ones(distance.shape[1], bool)
        k, d = np.nonzero(both)
        both[k, d] = agreeing[np.maximum(k - 1 - d, 0)] & (k - 1 - d >= 0)
        company = supported(
            np.where(both, distance, np.nan),
            self.travelled[every.first],
            self.travelled[every.second],
            10.0,
        )
        lonely = agreeing & ~company & (window > self.settings.lonely)
        self.rejected["loop"] = int((~agreeing).sum())
        self.rejected["lonely"] = int(lonely.sum())
        kept = agreeing & ~lonely
        for _ in range(2):
            closures = self._assemble(kept)
            self.poses, off = relax(
                self.poses,
                (self.steps, self.covariance),
                (closures.first, closures.second),
                (closures.relative, closures.covariance),
            )
            if bool(np.all(off < 5.0)):
                break
            self.rejected["loop"] += int((off >= 5.0).sum())
            kept[np.flatnonzero(kept)[off >= 5.0]] = False
        return self._assemble(kept)

    def _assemble(self, which: Mask) -> Closures:
        """Return some of what was found, as arrays."""
        chosen = [c for c, w in zip(self.found, which, strict=True) if w]
        return Closures(
            np.array([c[0] for c in chosen], np.int64),
            np.array([c[1] for c in chosen], np.int64),
            np.array([c[2] for c in chosen]).reshape(-1, 3),
            np.array([c[3] for c in chosen]).reshape(-1, 3, 3),
            np.array([c[4] for c in chosen]),
            self.poses,
            self.compared,
            dict(self.rejected),
        )
