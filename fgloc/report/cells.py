"""The cells of the printed tables: columns with units, numbers as text, the table's style."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from fgloc.report.outcomes import MethodOutcome

if TYPE_CHECKING:
    from rich.table import Table

NONE = "-"
"""What stands for a number that does not exist."""
COLUMNS = (
    "position RMSE [m]",
    "aligned RMSE [m]",
    "heading RMSE [deg]",
    "end error [m]",
    "end error [deg]",
    "max x [m]",
    "max y [m]",
    "max heading [deg]",
    "NEES (ideal 3)",
    "time [s]",
)
"""Numbers of one method on one drive, with units."""
END_COLUMNS = (
    "path [m]",
    "end x [m]",
    "end y [m]",
    "end heading [deg]",
    "±σ x [m]",
    "±σ y [m]",
    "±σ heading [deg]",
    "time [s]",
)
"""Numbers of one method on one drive without truth, with units."""


def score_cells(found: MethodOutcome) -> list[str]:
    """Return the numbers of one method on one drive."""
    seconds = f"{found.result.seconds:.2f}"
    e = found.evaluation
    if e is None:
        return [NONE] * 9 + [seconds]
    return [
        f"{e.ate_rmse_m:.4f}",
        f"{e.ate_aligned_rmse_m:.4f}",
        f"{e.ate_heading_rmse_deg:.2f}",
        f"{e.end_position_m:.4f}",
        f"{e.end_heading_deg:.2f}",
        f"{e.e_max.x:.4f}",
        f"{e.e_max.y:.4f}",
        f"{math.degrees(e.e_max.theta):.2f}",
        NONE if e.nees is None else f"{e.nees:.2f}",
        seconds,
    ]


def end_cells(found: MethodOutcome) -> list[str]:
    """Return where one method ends on one drive and how certain it is of that."""
    import numpy as np

    trajectory = found.result.trajectory
    steps = np.diff(trajectory.poses[:, :2], axis=0)
    x, y, heading = (float(v) for v in trajectory.poses[-1])
    sigmas = [NONE] * 3
    if trajectory.covariances is not None:
        ends = np.sqrt(np.maximum(np.diag(trajectory.covariances[-1]), 0.0))
        sigmas = [f"{ends[0]:.4f}", f"{ends[1]:.4f}", f"{math.degrees(ends[2]):.2f}"]
    return [
        f"{np.hypot(steps[:, 0], steps[:, 1]).sum():.3f}",
        fixed(x, 4),
        fixed(y, 4),
        fixed(math.degrees(heading), 2),
        *sigmas,
        f"{found.result.seconds:.2f}",
    ]


def fixed(value: float, digits: int) -> str:
    """Return a number with so many decimals, zero without a sign."""
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def stacked(name: str) -> str:
    """Return a column name on two lines, the unit below, to keep columns narrow."""
    head, _, unit = name.rpartition(" [")
    if head:
        return f"{head}\n[{unit}"
    return name.replace(" (", "\n(")


def new_table(fancy: bool) -> Table:
    """Return an empty table in the style of a terminal or of a pipe."""
    from rich import box
    from rich.table import Table

    return Table(
        box=box.SIMPLE_HEAD if fancy else None,
        pad_edge=False,
        padding=(0, 1) if fancy else (0, 2, 0, 0),
        show_edge=False,
        header_style="bold" if fancy else "",
    )
