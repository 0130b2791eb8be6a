"""Wheel odometry: the preintegrated displacement between two keyframes against the poses."""

from __future__ import annotations

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.geometry import Floats, between_scalar, wrap_scalar


@compiled
def relative_pose(xi: Floats, xj: Floats, r: Floats, ji: Floats, jj: Floats) -> None:
    """Write xi⁻¹ ∘ xj (heading not wrapped) and its Jacobians by both retractions."""
    between_scalar(xi, xj, r)
    ji[0, 0], ji[0, 2] = -1.0, r[1]
    ji[1, 1], ji[1, 2] = -1.0, -r[0]
    ji[2, 2] = -1.0
    ct, st = np.cos(r[2]), np.sin(r[2])
    jj[0, 0], jj[0, 1] = ct, -st
    jj[1, 0], jj[1, 1] = st, ct
    jj[2, 2] = 1.0


@compiled
def wheel_odometry(
    xi: Floats,
    xj: Floats,
    g: Floats,
    m: Floats,
    slot: int,
    r: Floats,
    ji: Floats,
    jj: Floats,
    jg: Floats,
) -> None:
    """Residual between xi⁻¹ ∘ xj and the displacement D + J g that the wheels predict.

    m = [D (3), J (3 × G row by row)]; g are the calibration variables in solver units. The
    first-order correction in g is exact as long as the table was integrated near g.
    """
    relative_pose(xi, xj, r, ji, jj)
    n = g.size
    for a in range(3):
        r[a] -= m[a]
        for k in range(n):
            d = m[3 + a * n + k]
            r[a] -= d * g[k]
            jg[a, k] = -d
    r[2] = wrap_scalar(r[2])
