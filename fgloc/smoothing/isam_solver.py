"""GTSAM's incremental fixed-lag smoother, held as it must be held: pinned, QR, slots reclaimed.

What was measured of GTSAM 4.3 (tests/smoothing/test_gtsam_facts.py) and is respected here:
callbacks get a copy of all variables unless the linearisation point is held; Cholesky fails on
healthy dead reckoning; freed factor slots must be used again; after any exception iSAM2 is
corrupt, so that a `Solver` that raised is only good for `salvage`.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, SupportsFloat, SupportsIndex, SupportsInt

import gtsam
import numpy as np

from fgloc.core.measurements import Floats
from fgloc.factors.gtsam_factors import Bundle
from fgloc.smoothing.isam_settings import IncrementalSettings

ENDLESS = 1e18
"""Lag [s] of a smoother that never forgets."""
NEVER = 1 << 30
"""Updates between relinearisations that nobody asked for."""
FAR = 1e9
"""An estimate beyond this (m, rad) is rounding noise of a variable that nothing determines."""


class UnhealthyError(RuntimeError):
    """The solver returned something that is not a number."""


class Solver:
    """One IncrementalFixedLagSmoother with a queue of what the next update brings.

    Variables are gtsam Vectors under integer keys. Not thread-safe: GTSAM calls back into Python
    in the middle of an update.
    """

    def __init__(self, settings: IncrementalSettings) -> None:
        params = gtsam.ISAM2Params()
        params.setFactorization("QR")
        params.setRelinearizeThreshold(settings.relinearize_threshold)
        params.relinearizeSkip = NEVER  # `update` is told when to
        params.findUnusedFactorSlots = True
        lag = ENDLESS if settings.lag_s is None else settings.lag_s
        self._smoother = gtsam.IncrementalFixedLagSmoother(lag, params)
        self._isam = self._smoother.getISAM2()
        self.held = self._isam.getLinearizationPoint()
        """iSAM2's own Values; held so that callbacks get this object. Read only."""
        self._nothing = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self._stamps: dict[SupportsInt | SupportsIndex, SupportsFloat | SupportsIndex] = {}
        self._clear()

    def _clear(self) -> None:
        self._graph = gtsam.NonlinearFactorGraph()
        self._values = gtsam.Values()
        self._removed: list[int] = []
        self.queued: list[Bundle | None] = []
        """What stands for each queued factor: its bundle, None for a factor that is no bundle."""

    def insert(self, key: int, value: Floats, stamp: float) -> None:
        """Queue a new variable with its first guess; it leaves a lag after its stamp [s]."""
        self._values.insert(key, value)
        self._stamps[key] = stamp

    def stamp(self, key: int, stamp: float) -> None:
        """Queue a new stamp [s] of a variable that is to stay longer."""
        self._stamps[key] = stamp

    def add(self, bundle: Bundle) -> None:
        """Queue a bundle that has its factor; the next `update` gives it an index."""
        self._graph.add(bundle.factor)
        self.queued.append(bundle)

    def replace(self, bundle: Bundle) -> None:
        """Queue linearising a bundle anew, since its weights have changed."""
        self._removed.append(bundle.index)
        self.add(bundle)

    def add_prior(self, key: int, mean: Floats, covariance: Floats) -> None:
        """Queue a Gaussian prior with mean (n,) and covariance (n, n)."""
        noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
        self.add_factor(gtsam.PriorFactorVector(key, mean, noise))

    def add_walk(self, before: int, after: int, sigma: Floats) -> None:
        """Queue a random walk with standard deviations (n,) from one variable to the next."""
        noise = gtsam.noiseModel.Diagonal.Sigmas(sigma)
        self.add_factor(gtsam.BetweenFactorVector(before, after, np.zeros(sigma.size), noise))

    def add_factor(self, factor: Any) -> None:
        """Queue any other gtsam factor."""
        self._graph.add(factor)
        self.queued.append(None)

    def update(
        self, relinearise: bool = False, fixed: Iterable[int] = (), forget: bool = True
    ) -> None:
        """Solve with all that is queued, and `forget` what is older than the lag.

        `relinearise` moves the linearisation points that are too far from the estimate, but not
        those of the `fixed` keys. Raises whatever GTSAM or a callback raises; this object is of
        no more use then, but for `salvage` and `marginals`.

        The smoother's own update would constrain the order of elimination so that variables that
        leave come first, and nothing else; the newest ones then end up anywhere, and updates
        eliminate half the window. So the inner iSAM2 takes the factors, which it orders with
        what they touch at the root, and the smoother is only called to marginalise.
        """
        keep = None
        if relinearise:
            keep = gtsam.KeyList()
            for key in fixed:
                keep.push_back(key)
        result = self._isam.update(
            self._graph, self._values, self._removed, None, keep, None, relinearise
        )
        indices = result.getNewFactorsIndices()
        if forget:
            self._smoother.update(*self._nothing, self._stamps)
            self._stamps = {}
        for bundle, index in zip(self.queued, indices, strict=True):
            if bundle is not None:
                bundle.index = index
        self._clear()

    def value(self, key: int) -> Floats:
        """Return a variable's estimate; raises `UnhealthyError` if it cannot be one."""
        value = _finite(self._smoother.calculateEstimateVector(key), "estimate")
        if np.abs(value).max() > FAR:
            raise UnhealthyError("iSAM2 returned an estimate out of this world")
        return value

    def covariance(self, key: int) -> Floats:
        """Return a variable's marginal covariance (n, n); raises `UnhealthyError`."""
        covariance = _finite(self._smoother.marginalCovariance(key), "covariance")
        return 0.5 * (covariance + covariance.T)

    def moved(self, key: int) -> float:
        """Return how far a variable's estimate is from where it was linearised, at most."""
        return float(np.abs(self.value(key) - self.held.atVector(key)).max())

    def knows(self, key: int) -> bool:
        """Return whether the variable is in the graph (queued ones are not yet)."""
        return bool(self._isam.valueExists(key))

    @property
    def pending(self) -> bool:
        """Return whether anything is queued."""
        return bool(self.queued) or self._values.size() > 0

    @property
    def queued_keys(self) -> set[int]:
        """Return the keys of the variables that are queued; after an exception, of its update."""
        return set(self._values.keys())

    def salvage(self, key: int) -> Floats | None:
        """Return where a variable was linearised, None if unknown; works after an exception too.

        What iSAM2 estimates after an exception is wrong, but the linearisation points are only
        ever moved as a whole.
        """
        if not self.held.exists(key):
            return None
        value = np.asarray(self.held.atVector(key), dtype=np.float64)
        return value if np.isfinite(value).all() else None

    def marginals(self) -> list[gtsam.LinearContainerFactor]:
        """Return what is left of variables that have gone: linear factors on those that stay.

        Works after an exception; O(factors).
        """
        graph = self._isam.getFactorsUnsafe()
        found = (graph.at(i) for i in range(graph.size()) if graph.exists(i))
        return [f for f in found if isinstance(f, gtsam.LinearContainerFactor)]


def _finite(array: Floats, what: str) -> Floats:
    """Return the array; raises `UnhealthyError` if an entry is not finite."""
    if not np.isfinite(array).all():
        raise UnhealthyError(f"iSAM2 returned an {what} that is not finite")
    return array
