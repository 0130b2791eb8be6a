"""What is known at one keyframe of the window: posteriors, and priors made of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from fgloc.core.kinematics import prior_covariance
from fgloc.core.measurements import Floats
from fgloc.factors.tables import FactorTable, Kind
from fgloc.online.window import Window
from fgloc.smoothing.arrow import triangle

FLOOR = 1e-14
"""Smallest variance, beside those of the same window."""


@dataclass(frozen=True)
class Posterior:
    """What is known at a keyframe from everything up to now."""

    number: int
    """Keyframe."""
    border: Floats
    """(n,) calibration in solver variables, then the landmarks in use."""
    root: Floats
    """(B+n, B+n) square-root information of state (body axes) and border; (0, 0) where the
    solver has covariances only."""
    covariance: Floats
    """(B+n, B+n) their joint covariance."""


def prior_table(
    state: Floats, border: Floats, root: Floats, offset: Floats | None = None
) -> FactorTable:
    """Return the joint prior of a window's first keyframe and the border (n,).

    Its mean is `offset` (B+n) away from the state and border given.
    """
    offset = np.zeros(root.shape[0]) if offset is None else offset
    return FactorTable(
        Kind.STATE_PRIOR,
        "prior",
        np.zeros(1, np.int64),
        np.concatenate([state, border, offset])[None],
        np.ascontiguousarray(root)[None],
        slice(0, border.size),
    )


def first_prior(
    window: Window, state: Floats, root: Floats, sigmas: Mapping[str, float] | None = None
) -> FactorTable:
    """Return the prior of a state (B,) with square-root information (B, B), robot at nominal.

    `sigmas` are standard deviations of parameters, by name, that differ from the layout's.
    """
    layout = window.layout
    b, given = layout.width, sigmas or {}
    parameters = [
        replace(p, prior_sigma=given.get(p.name, p.prior_sigma)) for p in layout.parameters
    ]
    whole = np.zeros((layout.size, layout.size))
    whole[:b, :b] = root
    whole[b:, b:] = np.linalg.inv(np.linalg.cholesky(prior_covariance(parameters)))
    return prior_table(state, np.zeros(len(parameters)), whole)


def posterior_prior(window: Window, posterior: Posterior) -> FactorTable:
    """Return everything known at the posterior's keyframe as a prior on it."""
    state = window.states.view[posterior.number - window.base]
    return prior_table(state, posterior.border, posterior.root)


def carried_prior(window: Window, number: int) -> FactorTable | None:
    """Return what older keyframes tell of one as a prior; None where it cannot be told.

    The carried rows say S·step = right side at the point of linearisation.
    """
    if number == window.base:
        return window.prior
    row = number - window.base
    carry = window.carry.view[row]
    n = carry.shape[0]
    try:
        step = np.linalg.solve(carry[:, :n], carry[:, n])
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(step).all():
        return None
    return prior_table(
        window.linear_states.view[row],
        window.linear_border.view[row],
        carry[:, :n].copy(),
        step,
    )


def without_landmarks(prior: FactorTable, width: int, parameters: int) -> FactorTable:
    """Return what a prior says of state (B,) and calibration (G,) alone; `width` is B."""
    n = width + parameters
    root, row = prior.sqrt_information[0], prior.measurements[0]
    if root.shape[0] == n:
        return prior
    offset = row[root.shape[0] :]
    order = np.append(np.arange(n, root.shape[0]), np.arange(n))
    left = triangle(root[:, order])[root.shape[0] - n :, root.shape[0] - n :]
    return prior_table(row[:width], row[width:n], left, offset[:n])


def after_walk(prior: FactorTable, width: int, walk: Floats) -> tuple[FactorTable, Floats]:
    """Return a prior after the first F calibration variables were free to walk by `walk` (F,).

    With u' = u + walk, u is eliminated from the rows of the prior and of the walk; on rows, not on
    covariances, which would lose digits. `width` is that of the state, B. The second result are
    the rows (F, F+N) that tell u by state, u' and the rest of the border, about the prior's mean.
    """
    root = prior.sqrt_information[0]
    free, n, b = walk.size, root.shape[0], width
    own = slice(b, b + free)
    rows = np.zeros((free + n, free + n))
    rows[:free, :free] = np.diag(1.0 / walk)
    rows[:free, free + b : free + b + free] = -rows[:free, :free]
    rows[free:, :free] = root[:, own]
    rows[free:, free:] = root
    rows[free:, free + b : free + b + free] = 0.0
    whole = triangle(rows)
    left = np.ascontiguousarray(whole[free:, free:])
    return replace(prior, sqrt_information=left[None]), whole[:free]


def definite(covariance: Floats) -> tuple[Floats, Floats]:
    """Return square-root information (N, N) of a covariance, and the covariance that it means.

    Directions that rounding has left without a variance get the smallest that can be told from
    zero beside the others.
    """
    sigma = np.sqrt(np.maximum(np.diag(covariance), FLOOR))
    scaled = covariance / np.outer(sigma, sigma)
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    values = np.maximum(values, FLOOR)
    root = (vectors / np.sqrt(values)).T / sigma
    factor = sigma[:, None] * vectors * np.sqrt(values)
    return root, factor @ factor.T


def after_move(root: Floats, sigma: Floats) -> Floats:
    """Return square-root information (N, N) of a state after its pose was moved in the map.

    The move is known to sigma (3,) [m, m, rad], alike along both axes of the map.
    """
    inverse = np.linalg.inv(root)
    covariance = inverse @ inverse.T
    covariance[:3, :3] += np.diag(sigma**2)
    return definite(covariance)[0]
