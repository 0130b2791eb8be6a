"""From samples at instants to increments over intervals, also where samples were rejected."""

from __future__ import annotations

from collections import Counter

import numpy as np

from fgloc.core.measurements import Floats, Stamps
from fgloc.datasets.text import NOT_A_NUMBER, finite_rows, forward_stamps


def trapezoid(stamps: Stamps, rates: Floats) -> Floats:
    """Return the (N-1, W) integral of (N, W) rates between consecutive stamps [unit·s]."""
    return 0.5 * (rates[1:] + rates[:-1]) * (np.diff(stamps)[:, None] * 1e-9)


def usable_increments(
    stamps: Stamps, increments: Floats, rejected: Counter[str]
) -> tuple[Stamps, Floats, Floats]:
    """Return stamps (M+1,), increments (M, W) and row weights without unusable rows.

    Row k of `increments` (N, W) happened between the stamp before and stamps[k]; row 0 has no
    stamp before it and only opens the first interval. A row whose stamp repeats or goes back, or
    that holds a value that is not finite, is dropped and counted. The robot moved all the same
    while a value was missing, so the interval that swallows such a row's time keeps the rate of
    its own row. The third array (M,) is that stretch, 1 where nothing was dropped.
    """
    opening = np.zeros_like(increments[:1])
    values = np.concatenate([opening, increments[1:]])
    forward = forward_stamps(stamps, rejected)
    stamps, values = stamps[forward], values[forward]
    good = finite_rows(values, rejected, f"wheels {NOT_A_NUMBER}")
    own = np.diff(stamps, prepend=stamps[:1])[good].astype(np.float64)
    stamps, values = stamps[good], values[good]
    stretch = np.ones(max(stamps.size - 1, 0))
    if not good.all():
        stretch = np.diff(stamps) / own[1:]
    return stamps, values[1:] * stretch[:, None], stretch
