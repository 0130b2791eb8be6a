"""What is told of wheels that slipped: stretches of time, and sentences about them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from fgloc.core.measurements import Floats, Stamps
from fgloc.estimator import WheelSlip

MOST = 6
"""So many stretches of slip are named in a note."""


def runs(mask: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return begin and end of each stretch where `mask` (N,) is true."""
    edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def wheel_slips(
    names: Sequence[str],
    stamps_ns: Stamps,
    slips: Floats,
    sigmas: Floats,
    slipping: npt.NDArray[np.bool_],
) -> tuple[WheelSlip, ...]:
    """Return the stretches in which wheels slip, in order of time.

    `stamps_ns` (K,) bound the K-1 intervals of the (K-1, W) slips of wheels `names`, their sigmas
    and the mask `slipping`.
    """
    found = [
        WheelSlip(
            name,
            int(stamps_ns[begin]),
            int(stamps_ns[end]),
            float(slips[begin:end, w].mean()),
            float(sigmas[begin:end, w].mean()),
        )
        for w, name in enumerate(names)
        for begin, end in runs(slipping[:, w])
    ]
    return tuple(sorted(found, key=lambda s: (s.begin_ns, s.end_ns)))


def slip_notes(slips: Sequence[WheelSlip], start_ns: int, arbiter: bool) -> tuple[str, ...]:
    """Return what a user should know of slips that were found, and of those that cannot be.

    Times are told since `start_ns`; `arbiter`: camera or fixes saw the motion as well.
    """
    if not slips:
        return ()
    told: dict[tuple[float, float], list[str]] = {}
    for s in slips:
        key = (round((s.begin_ns - start_ns) * 1e-9, 1), round((s.end_ns - start_ns) * 1e-9, 1))
        told.setdefault(key, []).append(f"{s.wheel} by {s.slip:.0%}")
    shown = [f"{a} to {b} s: {', '.join(who)}" for (a, b), who in list(told.items())[:MOST]]
    more = f", and {len(told) - MOST} stretches more" if len(told) > MOST else ""
    found = f"wheels slip: {'; '.join(shown)}{more}"
    if arbiter:
        return (found,)
    return (
        found,
        "without camera or fixes a slip of all wheels alike cannot be seen, and which side slips "
        "is told only by driven wheels turning too fast and braked ones too slowly",
    )
