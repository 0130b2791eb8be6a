"""How large the dimensions of a wheeled robot can be, to find values in a wrong unit."""

from __future__ import annotations

import math

LARGEST = {"m": 10.0, "rad": 2.0 * math.pi}
"""Largest magnitude of a parameter's value or sigma, by its unit."""
LARGEST_RADIUS_M = 2.0
"""Largest wheel radius [m]."""


def dimension_problem(name: str, unit: str, value: float) -> str | None:
    """Return what is implausible about a parameter's value or sigma; None if nothing is.

    The text continues a sentence that begins with the parameter's name. The bounds are wide: any
    robot passes, while a radius in millimetres or an angle of a turn in degrees does not.
    """
    largest = LARGEST_RADIUS_M if name.startswith("wheel_radius") else LARGEST.get(unit, math.inf)
    if abs(value) <= largest:
        return None
    wrong = "degrees" if unit == "rad" else "millimetres or centimetres"
    return f"is {value:g}, more than {largest:.3g} {unit}: is it in {wrong}? write it in {unit}"
