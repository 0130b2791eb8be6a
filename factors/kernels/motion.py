"""What is known without a sensor: a robot that stands still, and calibration that hardly drifts."""

from __future__ import annotations

from fgloc.core.compiled import compiled
from fgloc.core.geometry import Floats, wrap_scalar
from fgloc.factors.kernels.wheel import relative_pose


@compiled
def zero_velocity(
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
    """Residual xi⁻¹ ∘ xj, heading wrapped, of a robot that did not move; m is unused.

    No calibration enters: wheels that stand say nothing of their radii.
    """
    relative_pose(xi, xj, r, ji, jj)
    r[2] = wrap_scalar(r[2])


@compiled
def calibration_walk(
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
    """Residual xj - xi of two calibration vectors (B,), one a segment of the drive; m is unused.

    Both are vectors in solver units and moved by adding, heading-like entries not wrapped.
    """
    for k in range(r.size):
        r[k] = xj[k] - xi[k]
        ji[k, k], jj[k, k] = -1.0, 1.0
