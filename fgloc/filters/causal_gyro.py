"""What a gyro has turned up to a moment, as it is known at that moment."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fgloc.core.measurements import Floats, Stamps, YawRate

SILENCE_S = 0.5
"""A rate is held for no longer than this [s]; after that the gyro is silent."""


def turned_so_far(gyro: YawRate, cuts_ns: Stamps) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Return the (C-1,) angles [rad] a gyro turned between cuts, and where it was heard.

    Up to the last reading before a cut the rate is integrated by the trapezoid rule, from there on
    the last rate is held: nothing after the cut is needed, and what the held rate missed is in the
    next interval. A gyro is not heard in an interval that touches a silence of more than SILENCE_S.
    O(C log M).
    """
    stamps = gyro.stamps_ns
    n = cuts_ns.size - 1
    if stamps.size == 0:
        return np.zeros(n), np.zeros(n, dtype=np.bool_)
    limit = round(SILENCE_S * 1e9)
    gaps = np.diff(stamps)
    long = gaps > limit
    # Over a silence only what was held counts, so that the angle has no leap after it.
    steps = np.where(
        long,
        gyro.rate[:-1] * SILENCE_S,
        0.5 * (gyro.rate[1:] + gyro.rate[:-1]) * gaps * 1e-9,
    )
    total = np.concatenate([[0.0], np.cumsum(steps)])
    silences = np.concatenate([[0], np.cumsum(long)])
    last = np.searchsorted(stamps, cuts_ns, side="right") - 1
    at = np.maximum(last, 0)
    age = cuts_ns - stamps[at]
    angle = total[at] + gyro.rate[at] * np.minimum(age, limit) * 1e-9
    fresh = (last >= 0) & (age <= limit)
    heard = fresh[1:] & fresh[:-1] & (silences[at[1:]] == silences[at[:-1]])
    return np.diff(angle), heard
