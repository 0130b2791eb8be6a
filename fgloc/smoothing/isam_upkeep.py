"""What the incremental smoother looks after: linearisation points, robust weights, forgetting."""

from __future__ import annotations

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.factors.gtsam_factors import LANDMARK, Bundle
from fgloc.smoothing.isam_settings import IncrementalSettings
from fgloc.smoothing.isam_solver import Solver
from fgloc.smoothing.isam_window import Window, frame_key, landmark_key, segment_key

PROBES = 5
"""Older keyframes that are probed for having moved far."""
MORE_STEPS = 2
"""Further Gauss–Newton steps where the first was large."""


class Upkeep:
    """Decides, update by update, what to do besides adding measurements, at bounded cost."""

    def __init__(self, settings: IncrementalSettings) -> None:
        self._settings = settings
        self._turn = 0

    def settle(self, solver: Solver, window: Window) -> None:
        """Linearise anew and solve again while the newest keyframe is far from its guess.

        As after a fix that ends a long time without, or a late one: one linear step from a wrong
        heading may be off by more than its own sigma.
        """
        far = self._settings.relinearize_far * self._settings.relinearize_threshold
        for _ in range(MORE_STEPS):
            if solver.moved(frame_key(window.newest)) <= far:
                return
            solver.update(relinearise=True, forget=False)

    def forgets(self, updates: int, window: Window) -> bool:
        """Return whether this update drops what is older than the lag."""
        if self._settings.lag_s is None:
            return False
        return not window.landmarks or updates % self._settings.landmark_patience == 0

    def relinearisation(
        self, updates: int, forget: bool, solver: Solver, window: Window
    ) -> tuple[bool, list[int]]:
        """Return whether this update may move linearisation points, and keys that must stay.

        With landmarks all are looked at in the updates that forget: both eliminate most of the
        window, and once is enough.
        """
        settings = self._settings
        look = updates % settings.relinearize_skip == 0
        turn = updates % (settings.relinearize_skip * settings.relinearize_all) == 0
        if forget if window.landmarks else turn:
            return True, []
        if not look:
            return False, []
        since = window.frames[window.newest].stamp - settings.relinearize_s
        recent = window.newest
        while recent > window.oldest and window.frames[recent - 1].stamp >= since:
            recent -= 1
        far = settings.relinearize_far * settings.relinearize_threshold
        older = range(window.oldest, recent)
        samples = older[:: max(len(older) // PROBES, 1)]
        known = (key for key in map(frame_key, samples) if solver.knows(key))
        if any(solver.moved(key) > far for key in known):
            return True, []
        # What is tied to old keyframes moves little, and would take half the window along.
        keys = [frame_key(k) for k in older]
        keys += [segment_key(s) for s in window.segments if s < window.frames[recent].segment]
        marks = window.landmarks.items()
        return True, keys + [landmark_key(i) for i, mark in marks if mark.begin < since]

    def reweigh(self, solver: Solver, window: Window) -> None:
        """Queue recent bundles whose robust weights no longer fit, a few of them each time.

        The newest interval is looked at every time, since its guess was the poorest; the others
        in turn.
        """
        settings = self._settings
        since = window.frames[window.newest].stamp - settings.reweigh_s
        recent: list[Bundle] = []
        for k in range(window.newest, window.oldest - 1, -1):
            frame = window.frames[k]
            if frame.stamp < since:
                break
            recent += [b for b in frame.bundles if b.robust]
        if not recent:
            return
        head, others = recent[:2], recent[2:]
        more = min(max(settings.reweigh_bundles - len(head), 0), len(others))
        for n in range(more):
            head.append(others[(self._turn + n) % len(others)])
        self._turn += more
        for bundle in head:
            weights = bundle.new_weights(_squared(bundle, solver, window))
            change = np.abs(weights - bundle.weights)
            if np.any(change > settings.reweigh_change * np.maximum(weights, bundle.weights)):
                bundle.weights[:] = weights
                solver.replace(bundle)


def _squared(bundle: Bundle, solver: Solver, window: Window) -> Floats:
    """Return a bundle's squared whitened residuals (M,) at the present estimate."""
    xi = solver.value(frame_key(bundle.first))
    xj = xi if bundle.first == bundle.last else solver.value(frame_key(bundle.last))
    u = solver.value(window.segment_of(bundle.last)) if window.segments else np.zeros(0)
    seen = [solver.value(landmark_key(i)) for i in bundle.landmarks]
    return bundle.squared(xi, xj, u, np.array(seen) if seen else np.zeros((0, LANDMARK)))
