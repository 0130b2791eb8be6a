"""The window solved by iSAM2 instead: for graphs that are no chain, and to check the chain's way.

It is given the same factors with the same weights. What it does without is what needs the whole
window at one point: other starting calibrations where fixes are missed, and the trial without a
heading sensor. Robust weights older than three seconds stay as they are.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import numpy as np

from fgloc.core.consistency import gate_threshold
from fgloc.core.geometry import rotate_covariance
from fgloc.core.measurements import Floats, Stamps
from fgloc.factors.tables import FactorTable, linearise
from fgloc.online.passes import Judged, judge
from fgloc.online.priors import Posterior, definite, prior_table
from fgloc.online.settings import OnlineSettings
from fgloc.online.smoother import SolverError
from fgloc.online.window import Window


class IncrementalSmoother:
    """Feeds the window's new factors to an incremental graph and reads the newest state."""

    def __init__(self, window: Window, settings: OnlineSettings) -> None:
        self.window = window
        self._settings = settings
        self._gates = {d: gate_threshold(settings.gate_probability, d) for d in (1, 2, 3)}
        self._posterior: Posterior | None = None
        self._fed: dict[int, int] = {}
        self._newest = -1
        self.calibration = np.zeros(len(window.layout.parameters))
        self.judged: list[Judged] = []
        self.holding = False
        self.smoothed_whole = False

    @property
    def posterior(self) -> Posterior:
        """Return what is known at the newest keyframe; there is one after `begin`."""
        assert self._posterior is not None
        return self._posterior

    @property
    def unsolved(self) -> int:
        """Return how many keyframes were made since the last update."""
        return self.window.newest - self._newest

    @property
    def rebuilds(self) -> int:
        """Return how often iSAM2 failed and was built anew from its window."""
        return self._graph.rebuilds

    def begin(self) -> None:
        """Make the graph of all that is in the window."""
        from fgloc.smoothing.isam import IncrementalGraph  # heavy: GTSAM
        from fgloc.smoothing.isam_settings import IncrementalSettings

        window, layout = self.window, self.window.layout
        assert window.prior is not None
        lag = self._settings.lag_s
        walk = np.zeros(len(layout.parameters))
        free = len(layout.free)
        sigma = np.array([p.solver_sigma for p in layout.parameters[:free]])
        walk[:free] = self._settings.calibration_walk * sigma
        self._graph = IncrementalGraph(
            layout.width, walk, IncrementalSettings(lag_s=lag if np.isfinite(lag) else None)
        )
        self._fed, self._newest = {}, window.base - 1
        self._feed(window.prior)

    def start_again(self) -> None:
        """Make a new graph of the window's factors; only while nothing has left it."""
        if self.window.base > 0:
            raise SolverError("the window's prior is inside iSAM2 and cannot be taken out")
        for live in self.window.tables.values():
            live.weight.view[:] = 1.0
        self.begin()

    def abandon(self, stamp_ns: int, state: Floats, joint: Floats) -> dict[str, Floats]:
        """Give up the window: all that is left is a keyframe of now; see `WindowSmoother`."""
        window = self.window
        dropped = window.drop(window.add_keyframe(stamp_ns, state))
        root, _ = definite(joint)
        window.prior = prior_table(state, self.calibration, root)
        self.begin()
        return dropped

    def update(self, dirty: int | None, joint: Floats, moved: Floats) -> dict[str, Floats]:
        """Solve with all new factors; arguments and result as `WindowSmoother.update` has them."""
        self._judge(joint, moved)
        self._feed(None)
        window = self.window
        oldest = min(self._graph.oldest, window.newest)
        if self.holding or oldest <= window.base:
            return {}
        return window.drop(oldest)

    def _judge(self, joint: Floats, moved: Floats) -> None:
        """Give new measurements their first weights."""
        window = self.window
        for live in window.tables.values():
            rows = np.flatnonzero(np.isinf(live.weight.view))
            if rows.size == 0:
                continue
            some = slice(int(rows[0]), len(live.first))
            linear = linearise(live.view(some, window.base), window.states.view, self.calibration)
            found = judge(live, some, linear, joint, moved, self._gates[live.dimension])
            if found is not None:
                self.judged.append(found)

    def _feed(self, prior: FactorTable | None) -> None:
        """Hand over keyframes and factors that the graph does not have, and solve."""
        from fgloc.factors.gtsam_factors import Row

        window, graph = self.window, self._graph
        new: dict[int, list[Row]] = defaultdict(list)
        if prior is not None:
            at_base = np.full(1, window.base, np.int64)
            new[window.base].append(Row(_renumbered(prior, at_base), 0))
        for key, live in enumerate(window.tables.values()):
            fresh = np.flatnonzero(live.serial.view > self._fed.get(key, 0))
            self._fed[key] = live.added
            if fresh.size == 0:
                continue
            table = _copied(live.view(slice(0, len(live.first)), 0), fresh)
            for k, weight in enumerate(live.weight.view[fresh].tolist()):
                row = Row(table, k, weight if np.isfinite(weight) else 1.0)
                new[max(row.keyframe, window.base)].append(row)
        for number in range(self._newest + 1, window.newest + 1):
            rows = new.pop(number, [])
            stamp, state = window.stamp(number) * 1e-9, window.state(number)
            if prior is not None and number == window.base:
                graph.start(stamp, number, state, rows, self.calibration)
            else:
                graph.add(stamp, number, state, rows)
        graph.add_rows([row for rows in new.values() for row in rows])
        graph.update()
        self._newest = window.newest
        self._read()

    def _read(self) -> None:
        """Take over the newest state and what is known of it."""
        window, graph = self.window, self._graph
        state = graph.state(window.newest)
        window.states.view[-1] = state
        self.calibration = graph.calibration()
        b, n = state.size, window.layout.size
        joint = np.zeros((n, n))
        joint[:b, :b] = graph.covariance(window.newest)
        turned = rotate_covariance(joint[:3, :3], -state[2])
        joint[:3, :3] = turned
        # iSAM2 gives marginals only: what pose and calibration have in common is left out of the
        # few centimetres to the next keyframe.
        joint[b:, b:] = graph.calibration_covariance()
        joint = 0.5 * (joint + joint.T)
        none = np.zeros((0, 0))
        self._posterior = Posterior(window.newest, self.calibration, none, joint)


def _copied(table: FactorTable, rows: Stamps) -> FactorTable:
    """Return some rows of a live table as arrays of their own."""
    return replace(
        table,
        first=table.first[rows].copy(),
        measurements=table.measurements[rows].copy(),
        sqrt_information=table.sqrt_information[rows].copy(),
    )


def _renumbered(table: FactorTable, first: Stamps) -> FactorTable:
    """Return a table at other keyframes."""
    return replace(table, first=first)
