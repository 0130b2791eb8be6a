"""Faults of a simulated drive: wheels that slip, and samples that get lost.

A slipping wheel turns faster than the ground passes under it. Slip changes what the encoder
counts, never the motion of the base: the seed's definition (motors in open loop, the slipping
wheel overspeeds while the others carry the vehicle).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fgloc.core.measurements import Floats, Stamps
from fgloc.errors import FglocError


@dataclass(frozen=True)
class Slip:
    """One stretch of time in which some wheels turn faster than they roll."""

    wheels: tuple[str, ...]
    """Names of the wheels that slip, e.g. ("fl",)."""
    start_s: float
    """Begin of the slip after the start of the drive [s], exclusive."""
    end_s: float
    """End of the slip [s]; the interval that ends here is the last one that slips."""
    factor: float = 1.0
    """Turned angle over rolled angle; 1.2 is the seed's "20 % faster"."""
    extra_rate: float = 0.0
    """Additional rotation in the wheel's direction of motion [rad/s]; a wheel at rest gets none."""


def apply_slip(
    angles: Floats, boundaries_ns: Stamps, wheels: Sequence[str], slips: Sequence[Slip]
) -> Floats:
    """Return wheel angles (N, W) [rad] with the slips added; the input is not changed.

    `boundaries_ns` (N+1,) are the interval boundaries since the start of the drive. An interval
    slips when its END lies in (start, end]. Raises FglocError for a wheel that does not exist.
    """
    slipped = angles.copy()
    ends = boundaries_ns[1:]
    seconds = np.diff(boundaries_ns) * 1e-9
    for slip in slips:
        begin, stop = round(slip.start_s * 1e9), round(slip.end_s * 1e9)
        first, last = np.searchsorted(ends, [begin, stop], side="right")
        rows = slice(int(first), int(last))
        for name in slip.wheels:
            if name not in wheels:
                raise FglocError(f"slip: there is no wheel {name}; use one of {', '.join(wheels)}")
            k = list(wheels).index(name)
            rolled = angles[rows, k]
            extra = slip.extra_rate * np.sign(rolled) * seconds[rows]
            slipped[rows, k] += (slip.factor - 1.0) * rolled + extra
    return slipped


def parse_slips(text: str, wheels: Sequence[str], tick: float, rate: float) -> tuple[Slip, ...]:
    """Return the slips of a query value `WHEEL:START:END:AMOUNT[,…]`.

    AMOUNT is a factor like 1.2, or +N for N more encoder counts per packet; `tick` [rad] is the
    size of a count and `rate` [Hz] the packets per second. WHEEL may name several: `fl+rl`.
    Raises FglocError for anything else.
    """
    slips = []
    for part in text.split(","):
        fields = part.split(":")
        try:
            names, begin, end, amount = fields
            start_s, end_s, number = float(begin), float(end), float(amount)
        except ValueError:
            raise FglocError(
                f"slip={part}: write off, on, or WHEEL:START:END:AMOUNT with times in seconds and "
                "AMOUNT a factor like 1.2 or +N encoder counts per packet, e.g. fl:3:5:1.2"
            ) from None
        chosen = tuple(names.split("+"))
        unknown = [n for n in chosen if n not in wheels]
        if unknown:
            raise FglocError(
                f"slip={part}: there is no wheel {unknown[0]}; use one of {', '.join(wheels)}"
            )
        if amount.startswith("+"):
            slips.append(Slip(chosen, start_s, end_s, extra_rate=number * tick * rate))
        else:
            slips.append(Slip(chosen, start_s, end_s, factor=number))
    return tuple(slips)


def describe(slips: Sequence[Slip]) -> tuple[str, ...]:
    """Return one sentence for each slip, for the notes of a drive."""
    sentences = []
    for slip in slips:
        who = (
            "Wheel " + slip.wheels[0]
            if len(slip.wheels) == 1
            else "Wheels " + ", ".join(slip.wheels)
        )
        verb = "turns" if len(slip.wheels) == 1 else "turn"
        how = []
        if slip.factor != 1.0:
            how.append(
                f"{abs(slip.factor - 1.0):.0%} too {'fast' if slip.factor > 1.0 else 'slow'}"
            )
        if slip.extra_rate != 0.0:
            how.append(f"{slip.extra_rate:.3g} rad/s too fast")
        amount = " and ".join(how)
        sentences.append(f"{who} {verb} {amount} from {slip.start_s:.1f} to {slip.end_s:.1f} s.")
    return tuple(sentences)


def keep(count: int, dropout: float, rng: np.random.Generator) -> npt.NDArray[np.bool_]:
    """Return a (count,) mask of the samples that arrive; the first and the last always do."""
    mask = rng.random(count) >= dropout
    mask[[0, -1]] = True
    return mask
