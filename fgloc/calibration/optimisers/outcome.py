"""What an optimiser made of the published problem."""

from __future__ import annotations

from dataclasses import dataclass

from fgloc.core.measurements import Floats


@dataclass(frozen=True)
class Outcome:
    """Where an optimiser ended."""

    parameters: Floats
    """(12,) parameters [m], as `swerve_problem.PARAMETERS` names them."""
    cost: float
    """J there."""
    evaluations: int
    """How often J, or J with its derivatives, was computed."""
    seconds: float
    """Time taken [s]."""
