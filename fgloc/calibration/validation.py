"""How good a model is on drives that it was not fitted on: cross-validation over drives.

Every drive is left out in turn. The fit without it needs no search of its own: every drive's
information and gradient at the common solution are known, so that one step without the drive's
own share gives the parameters that the others alone want, and one product its error with them.
Paths are close to linear in their parameters, and the step is small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fgloc.calibration.path_fit import Model, PathFit, Rows, rows_of
from fgloc.calibration.paths import PathData
from fgloc.core.kinematics import prior_covariance
from fgloc.core.measurements import Floats

MIN_DRIVES = 3
"""Fewer drives cannot be left out in turn."""


@dataclass(frozen=True)
class Errors:
    """Open-loop errors of drives from their true starts."""

    position: Floats
    """(D,) root mean square of the distance from the truth [m]."""
    heading: Floats
    """(D,) root mean square of the heading error [rad]."""

    def shares(self, other: Errors) -> Floats:
        """Return (D,) these errors as shares of others': half position, half heading.

        A share is of the other's mean over all drives, so that drives on which the other happens
        to be right do not count for more than the rest.
        """
        position = self.position / max(float(np.mean(other.position)), 1e-12)
        heading = self.heading / max(float(np.mean(other.heading)), 1e-12)
        return np.asarray(0.5 * (position + heading))


def errors(rows: Sequence[Rows]) -> Errors:
    """Return the errors of paths."""
    squares = np.array([np.mean(r.residual**2, axis=0) for r in rows])
    return Errors(np.sqrt(squares[:, 0] + squares[:, 1]), np.sqrt(squares[:, 2]))


def open_loop(data: Sequence[PathData], model: Model, u: Floats) -> list[Rows]:
    """Return the paths of drives from their true starts, by the clocks as recorded."""
    none = np.zeros(2 * model.clock)
    return [rows_of(d, model, u, none) for d in data]


def held_out(data: Sequence[PathData], fit: PathFit) -> Errors:
    """Return the errors of every drive with the parameters that the others alone want.

    How its clocks differ is not known of a drive that was left out: it is compared by its clocks as
    recorded. One evaluation of all paths.
    """
    prior = np.linalg.inv(prior_covariance(fit.model.parameters))
    total = prior + np.sum(fit.information, axis=0)
    pull = prior @ fit.u + np.sum(fit.gradient, axis=0)
    moved = []
    for k, r in enumerate(open_loop(data, fit.model, fit.u)):
        without = np.linalg.solve(total - fit.information[k], pull - fit.gradient[k])
        moved.append(Rows(r.residual - r.shared @ without, r.shared, r.local))
    return errors(moved)
