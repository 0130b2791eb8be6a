"""Another ground: the effective track changes at once, and the window has to follow.

The calibration is one variable for the whole window, and it walks slowly from window to window:
tyres warm, floors change little. On another ground it is another one from one second to the next.
That shows in the wheels' residuals: on the new ground they all ask for the same change of the
track. Where the last seconds ask for it clearly, what came before is summed up at once, the track
is freed, and the window begins anew where the ground changed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.estimator import TURNING
from fgloc.factors.tables import linearise
from fgloc.online.window import Window

SPANS_S = (6.0, 9.0, 13.0)
"""Times since a change that are tried [s]: a ground lasts longer than a slip."""
PARTS = 3
"""Parts of that time that must each ask for it: a slip is in one of them."""
CLEAR = 4.5
"""How many sigmas the residuals since then must ask for a change."""
EACH = 0.5
"""Part of the change that every part must ask for at least, and not more than twice as much."""
LARGE = 0.05
"""Smallest change of the track that is one of the ground, relative."""
FREED = 0.3
"""By how much the track may then be another one: relative sigma."""
PAUSE_S = 4.0
"""After a change none is looked for so long [s]."""


@dataclass(frozen=True)
class Change:
    """Where the ground changed."""

    number: int
    """Keyframe at which it did."""
    walk: Floats
    """(F,) sigmas by which the robot's own parameters may differ from then on."""


class SurfaceWatch:
    """Looks for a change of the ground in a window of wheels, gyro, yaw, camera, fixes."""

    def __init__(self, window: Window) -> None:
        """Prepare for a window; without a free track nothing is ever found."""
        self._window = window
        free = window.layout.parameters[: len(window.layout.free)]
        names = [p.name for p in free]
        self._column = next((names.index(n) for n in TURNING if n in names), -1)
        self._size = len(free)
        self._until = 0

    def look(self, calibration: Floats) -> Change | None:
        """Return where the ground changed in the last seconds; None if it did not.

        Costs a linearisation of the wheels of a dozen seconds. A change of the track in its
        solver variable (the logarithm) is relative.
        """
        window, k = self._window, self._column
        newest = window.stamp(window.newest)
        if k < 0 or newest < self._until:
            return None
        begin = max(window.number_at(newest - int(SPANS_S[-1] * 1e9)), window.base)
        if window.newest - begin < 10:
            return None
        table = window.wheels.view(window.wheels.rows(begin, window.newest + 1), begin)
        rows = linearise(table, window.states.view[begin - window.base :], calibration)
        asked = rows.by_calibration[:, :, k]
        pull = np.sum(asked * rows.residual, axis=1)
        weight = np.sum(asked**2, axis=1)
        best, change = CLEAR, None
        for span in SPANS_S:
            first = window.number_at(newest - int(span * 1e9))
            if first <= begin and span > SPANS_S[0]:
                break
            shift, clear = _asked(pull[first - begin :], weight[first - begin :])
            if clear > best and abs(shift) > LARGE:
                walk = np.zeros(self._size)
                walk[k] = FREED
                best, change = clear, Change(first, walk)
        if change is not None:
            self._until = newest + int(PAUSE_S * 1e9)
        return change


def _asked(pull: Floats, weight: Floats) -> tuple[float, float]:
    """Return the change that intervals (M,) ask for, and how clearly, in sigmas.

    0 sigmas where they do not agree: parts of equal weight must ask for about the same.
    """
    total = float(np.sum(weight))
    if not total > 0.0:
        return 0.0, 0.0
    shift = -float(np.sum(pull)) / total
    part = np.minimum((np.cumsum(weight) / total * PARTS).astype(np.int64), PARTS - 1)
    sums = np.bincount(part, pull, PARTS), np.bincount(part, weight, PARTS)
    each = -sums[0] / np.maximum(sums[1], 1e-300)
    agree = np.all((each / shift > EACH) & (each / shift < 1.0 / EACH)) if shift else False
    return shift, abs(shift) * float(np.sqrt(total)) if agree else 0.0
