"""Slip of each wheel (or side) in each interval: wheel odometry with it, and what is usual of it.

The slip s of a wheel is 1 - way over ground / way rolled: 0.2 for a driven wheel that spins a
fifth too fast, below 0 for a braked one that drags. A keyframe holds the slips of the interval
that ENDS at it, one state column a wheel, so that a new keyframe comes with its own slips; those
of the first keyframe belong to no interval. See `fgloc.factors.slip` for the tables.
"""

from __future__ import annotations

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.geometry import Floats, wrap_scalar
from fgloc.factors.kernels.wheel import wheel_odometry

ROUND = 0.01
"""Slip over which the slope of the one-sided prior changes: no corner for an optimiser to
stick at, and well below any slip that matters."""


@compiled
def wheel_slip(
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
    """Residual between xi⁻¹ ∘ xj and D + J g + E s, what wheels predict that slip by s.

    m = [D (3), J (3 × G row by row), E (3 × S row by row)]: displacement, its derivative by the
    calibration in solver units and by the slips, columns `slot` to slot + S of xj.
    """
    wheel_odometry(xi, xj, g, m, slot, r, ji, jj, jg)
    start = 3 + 3 * g.size
    n = (m.size - start) // 3
    for a in range(3):
        for k in range(n):
            d = m[start + a * n + k]
            r[a] -= d * xj[slot + k]
            jj[a, slot + k] = -d
    # Slip takes turn away; wrap again, as the first wrap did not know of it.
    r[2] = wrap_scalar(r[2])


@compiled
def wheel_redundancy(
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
    """Residual C·w: by how much wheels contradict each other that roll w = way·f·(1 - s).

    m = [C (n × W row by row), way (W), index (W)]: the conditions that ways over ground fulfil,
    what each wheel rolled in the interval that ends at xj at the nominal radius [m], and which of
    g is the logarithm of its radius over nominal (-1 for none); slips are columns `slot` to
    slot + W of xj. f = exp(g - mean g) is a wheel's radius relative to the others': a contradiction
    tells which wheel is the larger one, but must not shrink by making all wheels smaller. Where the
    radius of one is known, f = exp(g).
    """
    n = r.size
    wheels = m.size // (n + 2)
    mean, known = 0.0, False
    for w in range(wheels):
        index = int(m[(n + 1) * wheels + w])
        if index >= 0:
            mean += g[index] / wheels
        else:
            known = True
    if known:
        mean = 0.0
    for w in range(wheels):
        index = int(m[(n + 1) * wheels + w])
        rolled = m[n * wheels + w]
        if index >= 0:
            rolled *= np.exp(g[index] - mean)
        for a in range(n):
            c = m[a * wheels + w] * rolled
            r[a] += c * (1.0 - xj[slot + w])
            jj[a, slot + w] = -c
            if index >= 0:
                jg[a, index] += c * (1.0 - xj[slot + w])
    if not known:
        for w in range(wheels):
            index = int(m[(n + 1) * wheels + w])
            for a in range(n):
                jg[a, index] -= r[a] / wheels


@compiled
def slip_prior(
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
    """Residual s of the slip in column `slot`: none is usual; m is unused."""
    ji[0, slot] = 1.0
    r[0] = xi[slot]


@compiled
def slip_side(
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
    """Residual of a slip s in column `slot` on the side that the wheel's torque speaks against.

    m = [side]: 1 for a wheel that speeds up (overspeed is likely), -1 for one that is braked, 0
    where nothing is known, or between. r = |side|·(sqrt(s² + e²) - e)/2 - side·s/2 with e = ROUND:
    about nothing on the likely side, about |s| on the other.
    """
    s = xi[slot]
    size = 0.5 * abs(m[0])
    root = np.sqrt(s * s + ROUND * ROUND)
    r[0] = size * (root - ROUND) - 0.5 * m[0] * s
    ji[0, slot] = size * s / root - 0.5 * m[0]


@compiled
def slip_walk(
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
    """Residual s_j - k·s_i of the slip in column `slot`; m = [k], the part that lasts, 0 to 1."""
    ji[0, slot], jj[0, slot] = -m[0], 1.0
    r[0] = xj[slot] - m[0] * xi[slot]
