"""Rows of factor tables as one gtsam.CustomFactor: one Python callback for all of an interval.

A call from GTSAM into Python costs several microseconds whatever it computes, and another for
every variable read. So all rows between the same variables, such as the wheels, the gyro and the
fix of one keyframe interval, become one factor whose residual and Jacobians one compiled call
evaluates with the kernels that the batch smoother uses.

Keyframe states are gtsam Vectors [x, y, theta, sensor zeros] with additive retraction in map
axes, landmarks Vectors of 2, the calibration a Vector of all G variables. The kernels'
Jacobians are by increments in body axes and are turned by R(theta)ᵀ here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np
import numpy.typing as npt

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats
from fgloc.errors import FglocError
from fgloc.factors.tables import FactorTable, evaluate_kernel, whiten

Ints = npt.NDArray[np.int64]

LANDMARK = 2
"""Variables of a landmark."""
FIRST, SECOND, BOTH = range(3)
"""Keyframes that a row touches."""


@dataclass(frozen=True)
class Row:
    """One factor of a table, with what only the incremental engine asks for."""

    table: FactorTable
    """The table it is from."""
    index: int
    """Its row there."""
    weight: float = 1.0
    """Robust weight it enters with."""

    @property
    def landmark(self) -> int:
        """Return the index of the landmark that it sees, -1 for none."""
        second = self.table.second
        return -1 if second is None else int(second[self.index])

    @property
    def keyframe(self) -> int:
        """Return the newest keyframe that the row touches."""
        return int(self.table.first[self.index]) + (1 if self.table.pairwise else 0)


def rows_of(table: FactorTable, weights: Floats | None = None) -> list[Row]:
    """Return all rows of a table with their robust weights (M,), 1 if not given."""
    m = table.first.size
    w = [1.0] * m if weights is None else weights.tolist()
    return [Row(table, k, w[k]) for k in range(m)]


class Bundle:
    """Rows between at most two neighbouring keyframes, the calibration and some landmarks.

    `weights` (M,) are the robust weights: whoever changes them must take `factor` out of GTSAM's
    graph and add it again, since iSAM2 keeps what it has linearised.
    """

    def __init__(self, rows: Sequence[Row]) -> None:
        newest = {row.keyframe for row in rows}
        if len(newest) != 1:
            raise FglocError(f"a bundle needs rows of one keyframe, got {sorted(newest)}")
        if any(row.table.links and not row.table.sees_landmarks for row in rows):
            raise FglocError("scans matched far apart are for the batch smoother")
        self.rows = tuple(rows)
        self.last = newest.pop()
        """Newest keyframe."""
        self.first = self.last - 1 if any(r.table.pairwise for r in rows) else self.last
        """Oldest keyframe."""
        self.landmarks = tuple(dict.fromkeys(r.landmark for r in rows if r.landmark >= 0))
        """Ids of the landmarks, in the order of their keys."""
        self.calibrated = any(r.table.calibration.stop > r.table.calibration.start for r in rows)
        """Whether the calibration is among the variables."""
        self.weights = np.array([r.weight for r in rows])
        """(M,) robust weights."""
        self.robust = any(r.table.loss.name != "none" for r in rows)
        """Whether any weight may change."""
        # A row: kernel, state column of the sensor's zero, calibration columns (2), where the
        # measurement begins and its length, residual dimension, where the square-root
        # information begins, first residual row, keyframes, place among the landmarks or -1.
        self._spec = np.empty((len(rows), 11), np.int64)
        pieces: list[Floats] = []
        at = self.dimension = 0
        for spec, row in zip(self._spec, rows, strict=True):
            table = row.table
            m, root = table.measurements[row.index], table.sqrt_information[row.index]
            d = root.shape[0]
            pieces += [m, root.ravel()]
            block = table.calibration
            alone = SECOND if self.first < self.last else FIRST
            seen = self.landmarks.index(row.landmark) if row.landmark >= 0 else -1
            spec[:] = (
                table.kind,
                table.slot,
                block.start,
                block.stop,
                at,
                m.size,
                d,
                at + m.size,
                self.dimension,
                BOTH if table.pairwise else alone,
                seen,
            )
            at += m.size + root.size
            self.dimension += d
        self._data = np.concatenate(pieces)
        self.factor: Any = None
        """The gtsam.CustomFactor, once `attach` has made it."""
        self.index = -1
        """Its place in GTSAM's graph, for whoever keeps one."""

    @property
    def finite(self) -> bool:
        """Return whether all measurements, square-root informations and weights are numbers."""
        return bool(np.isfinite(self._data).all() and np.isfinite(self.weights).all())

    def squared(self, xi: Floats, xj: Floats, u: Floats, landmarks: Floats) -> Floats:
        """Return the (M,) squared whitened residuals at a state, before weights.

        `xi`, `xj` (B,) are the oldest and the newest keyframe (the same if there is but one), `u`
        (G,) the calibration, `landmarks` (N, 2) those of `self.landmarks`.
        """
        out = Buffers(self.dimension, xi.size, u.size, len(self.landmarks))
        squared = np.empty(len(self.rows))
        _evaluate_rows(
            self._spec, self._data, self.weights, xi, xj, u, landmarks, *out.arrays, squared
        )
        return squared

    def new_weights(self, squared: Floats) -> Floats:
        """Return the (M,) weights that the losses give to squared whitened residuals (M,)."""
        weights = np.empty(len(self.rows))
        for k, row in enumerate(self.rows):
            loss = row.table.loss
            weights[k] = 1.0 if loss.name == "none" else float(loss.weight(squared[k]))
        return weights

    def attach(
        self, keyframe_keys: Sequence[int], calibration: int, landmarks: Sequence[int], g: int
    ) -> None:
        """Make the gtsam factor for the keys of these variables; `g` is the calibration's size.

        `keyframe_keys` are those of the oldest and the newest keyframe, one key if they are the
        same; `calibration` is not used by a bundle without calibration.
        """
        keys = [*keyframe_keys, *((calibration,) if self.calibrated else ()), *landmarks]
        unit = gtsam.noiseModel.Unit.Create(self.dimension)
        self.factor = gtsam.CustomFactor(unit, keys, self._callback(keys, g))

    def _callback(self, keys: list[int], g: int) -> Any:
        """Return GTSAM's error function: whitened, weighted residual and Jacobians.

        It must not refer to the bundle: the cycle would pass through C++, where Python's
        garbage collector does not see it, and no bundle would ever be freed.
        """
        pair, seen = self.first < self.last, len(self.landmarks)
        spec, data, weights = self._spec, self._data, self.weights
        first, second = keys[0], keys[1] if pair else keys[0]
        with_u = self.calibrated
        u_key = keys[2 if pair else 1] if with_u else 0
        landmark_keys = keys[len(keys) - seen :] if seen else []
        nobody, nothing = np.zeros(g), np.zeros((0, LANDMARK))
        squared = np.empty(len(self.rows))
        dimension = self.dimension
        out: Buffers | None = None

        def error(_: Any, values: Any, jacobians: Any) -> Floats:
            nonlocal out
            xi = values.atVector(first)
            xj = values.atVector(second) if pair else xi
            u = values.atVector(u_key) if with_u else nobody
            at = np.array([values.atVector(k) for k in landmark_keys]) if seen else nothing
            if out is None:
                out = Buffers(dimension, xi.size, g, seen)
            _evaluate_rows(spec, data, weights, xi, xj, u, at, *out.arrays, squared)
            if jacobians is not None:
                jacobians[0] = out.by_first
                n = 1
                if pair:
                    jacobians[1] = out.by_second
                    n = 2
                if with_u:
                    jacobians[n] = out.by_calibration
                    n += 1
                for k in range(seen):
                    jacobians[n + k] = out.by_landmark[:, LANDMARK * k : LANDMARK * k + LANDMARK]
            return out.residual

        return error


class Buffers:
    """Outputs of one bundle; GTSAM copies them, so they can be written again and again."""

    def __init__(self, d: int, b: int, g: int, landmarks: int) -> None:
        self.residual = np.zeros(d)
        self.by_first = np.zeros((d, b), order="F")
        self.by_second = np.zeros((d, b), order="F")
        self.by_calibration = np.zeros((d, g), order="F")
        self.by_landmark = np.zeros((d, LANDMARK * landmarks), order="F")
        self.arrays = (
            self.residual,
            self.by_first,
            self.by_second,
            self.by_calibration,
            self.by_landmark,
        )


@compiled
def _turn(jacobian: Floats, theta: float) -> None:
    """Turn the pose columns of a Jacobian (d, ≥ 3) by body increments into one by map axes."""
    c, s = np.cos(theta), np.sin(theta)
    for a in range(jacobian.shape[0]):
        forward, left = jacobian[a, 0], jacobian[a, 1]
        jacobian[a, 0] = c * forward - s * left
        jacobian[a, 1] = s * forward + c * left


@compiled
def _evaluate_rows(
    spec: Ints,
    data: Floats,
    weights: Floats,
    xi: Floats,
    xj: Floats,
    u: Floats,
    landmarks: Floats,
    residual: Floats,
    by_first: Floats,
    by_second: Floats,
    by_calibration: Floats,
    by_landmark: Floats,
    squared: Floats,
) -> None:
    """Evaluate all rows of a bundle: whitened, in map axes, weighted by sqrt(weights).

    `squared` (M,) receives the squared whitened residuals before weights. The blocks that no row
    ever writes stay as they are: zero.
    """
    b = xi.size
    for k in range(spec.shape[0]):
        kind, slot, begin, end = spec[k, 0], spec[k, 1], spec[k, 2], spec[k, 3]
        at, size, d, root = spec[k, 4], spec[k, 5], spec[k, 6], spec[k, 7]
        row, seen = spec[k, 8], spec[k, 10]
        second, pairwise = spec[k, 9] == SECOND, spec[k, 9] == BOTH
        r, ji, jg = np.zeros(d), np.zeros((d, b)), np.zeros((d, end - begin))
        g, m = u[begin:end], data[at : at + size]
        x = xj if second else xi
        if seen >= 0:
            other, jj = landmarks[seen], np.zeros((d, 2))
        else:
            other, jj = xj, np.zeros((d, b))
        evaluate_kernel(kind, x, other, g, m, slot, r, ji, jj, jg)
        s, scratch = data[root : root + d * d].reshape(d, d), np.empty(d)
        whiten(s, r.reshape(d, 1), scratch)
        whiten(s, ji, scratch)
        _turn(ji, x[2])
        if pairwise or seen >= 0:
            whiten(s, jj, scratch)
        if pairwise:
            _turn(jj, xj[2])
        whiten(s, jg, scratch)
        weight, total = np.sqrt(weights[k]), 0.0
        for a in range(d):
            total += r[a] * r[a]
            residual[row + a] = weight * r[a]
            for c in range(b):
                if second:
                    by_second[row + a, c] = weight * ji[a, c]
                else:
                    by_first[row + a, c] = weight * ji[a, c]
                if pairwise:
                    by_second[row + a, c] = weight * jj[a, c]
            for c in range(end - begin):
                by_calibration[row + a, begin + c] = weight * jg[a, c]
            if seen >= 0:
                for c in range(2):
                    by_landmark[row + a, 2 * seen + c] = weight * jj[a, c]
        squared[k] = total
