"""Part of a drive: `cut:DRIVE?begin=10&end=60` is what its wheels did from 10 to 60 s.

The wheels' packets between the two times are kept. Everything else stays: what was measured before
the first wheel stamp or after the last is outside of a drive anyway.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from fgloc.core.drive import Drive
from fgloc.errors import FglocError

PREFIX = "cut"
"""Prefix of the ids of cut drives."""


@dataclass(frozen=True)
class Cut:
    """Where a drive is cut, in seconds since its first wheel stamp or in parts of its duration."""

    begin: float = 0.0
    """Where it begins."""
    end: float = math.inf
    """Where it ends; inf: at its end."""
    relative: tuple[bool, bool] = (False, False)
    """Whether begin and end are parts of the duration, not seconds."""


def parse(query: str) -> Cut:
    """Return the cut of "begin=10&end=60" (seconds) or "end=33%".

    Raises FglocError for an unknown key, a value that is no time, or an end before the beginning.
    """
    values, relative = {"begin": 0.0, "end": math.inf}, {"begin": False, "end": False}
    for item in query.split("&") if query else []:
        key, _, text = item.partition("=")
        percent = text.endswith("%")
        try:
            value = float(text.removesuffix("%")) / (100.0 if percent else 1.0)
        except ValueError:
            value = math.nan
        if key not in values or not value >= 0.0:
            raise FglocError(
                f"{PREFIX}: {item!r} is not known; write begin=S and end=S in seconds or percent, "
                "e.g. cut:jackal-jackass:0?begin=10&end=50%"
            )
        values[key], relative[key] = value, percent
    if relative["begin"] == relative["end"] and not values["begin"] < values["end"]:
        raise FglocError(f"{PREFIX}: the end of {query!r} is not after its beginning")
    return Cut(values["begin"], values["end"], (relative["begin"], relative["end"]))


def cut(drive: Drive, where: Cut, name: str) -> Drive:
    """Return part of a drive under a name of its own. Raises FglocError where nothing is left."""
    wheels = drive.wheels
    seconds = (wheels.stamps_ns - wheels.stamps_ns[0]) * 1e-9
    begin, end = (
        value * float(seconds[-1]) if relative else value
        for value, relative in zip((where.begin, where.end), where.relative, strict=True)
    )
    inside = np.flatnonzero((seconds >= begin) & (seconds <= end))
    if inside.size < 2:
        raise FglocError(
            f"{name}: fewer than two wheel packets between {begin:g} and {end:g} s; the drive "
            f"lasts {seconds[-1]:.1f} s"
        )
    return replace(drive, name=name, wheels=wheels.between(int(inside[0]), int(inside[-1])))
