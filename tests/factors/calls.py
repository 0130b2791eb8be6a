"""How the tests call a kernel."""

from __future__ import annotations

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.factors.tables import COMPONENTS, KERNELS, Kind


def dimension(kind: Kind, width: int, g_size: int) -> int:
    """Return the number of residual components of a kind."""
    if kind == Kind.STATE_PRIOR:
        return width + g_size
    if kind == Kind.WHEEL_REDUNDANCY:
        return 2
    return width if kind == Kind.CALIBRATION_WALK else len(COMPONENTS[kind])


def evaluate(
    kind: Kind, xi: Floats, xj: Floats, g: Floats, m: Floats, slot: int
) -> tuple[Floats, Floats, Floats, Floats]:
    """Call a kernel with fresh, zeroed outputs."""
    d = dimension(kind, xi.size, g.size)
    r, jg = np.zeros(d), np.zeros((d, g.size))
    ji, jj = np.zeros((d, xi.size)), np.zeros((d, xj.size))
    KERNELS[kind](xi, xj, g, m, slot, r, ji, jj, jg)
    return r, ji, jj, jg
