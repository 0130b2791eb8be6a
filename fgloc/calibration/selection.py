"""Which model, and whether the clocks differ: decided on drives that were left out of the fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fgloc.calibration.closed_form import ClosedForm, closed_form, intervals
from fgloc.calibration.models import Choice
from fgloc.calibration.path_fit import OFFSET_SIGMA_S, RATE_SIGMA, Model, PathFit, fit_paths
from fgloc.calibration.paths import PathData, pieces
from fgloc.calibration.result import Candidate, ClockFit
from fgloc.calibration.validation import MIN_DRIVES, Errors, errors, held_out, open_loop
from fgloc.core.kinematics import Parameter
from fgloc.core.measurements import Floats
from fgloc.core.motion_models import added

PIECES = 6
"""Pieces that few drives are cut into, each, for choosing a model."""
NO_WORSE = 0.03
"""A simpler model is taken if the error left out grows by no more than this part."""
ROUGH = 0.03
"""Steps of less than this part of a posterior sigma end the fits that are compared."""
LOOK = 2
"""Steps of a fit that only tells whether clocks are worth a search."""
LATE_S = 0.1
"""Offsets of clocks that matter [s]."""
LATE_SIGMA = 2.5
"""How many sigmas they must be off."""
TIME_OFFSET = Parameter("time_offset", 0.0, 0.1, unit="s")
"""By how much the wheels' stamps are late against the reference's, for all drives of a robot."""
LATE_DRIVES = 1.0 / 3.0
"""Part of the drives that must tell so."""


@dataclass(frozen=True)
class Selected:
    """The fit of the model that was chosen."""

    choice: Choice
    """Its name and robot."""
    fit: PathFit
    """The fit to all drives."""
    candidates: tuple[Candidate, ...]
    """All that were tried."""
    clocks: tuple[ClockFit, ...]
    """How clocks differ, where they do."""
    began: ClosedForm | None
    """Where the search began."""
    notes: tuple[str, ...]
    """What a user should know."""


def select(
    data: Sequence[PathData], choices: Sequence[Choice], mount: tuple[Parameter, ...]
) -> Selected:
    """Return the fit of the model that does best on drives left out, the simplest among equals.

    A model with fewer parameters is taken if its error on the drives left out is not worse by more
    than the standard error of the difference, or by 3 %; one that adds what the drives do not
    observe is not taken at all. Where fewer than three drives are given, they are cut into pieces
    for this. The clocks' offset and rate are estimated drive by drive where a third of the drives
    shows that they differ. Raises FglocError as `fit_paths`.
    """
    tried = [Model(c.robot, mount) for c in choices]
    seen = intervals(data)
    begins = [closed_form(seen, m) for m in tried]
    parts = list(data)
    if len(data) < MIN_DRIVES and len(choices) > 1:
        parts = [piece for d in data for piece in pieces(d, PIECES)]
    fits: list[PathFit] = []
    for model, began in zip(tried, begins, strict=True):
        found = _of_simpler(model, fits)
        if found is None and began is not None:
            found = began.u
        fits.append(fit_paths(data, model, found, done=ROUGH))
    best = 0
    candidates: tuple[Candidate, ...] = ()
    if len(choices) > 1 and len(parts) >= MIN_DRIVES:
        best, candidates = _compare(data, parts, choices, fits)
    fit, clocks, notes = _with_clocks(data, fit_paths(data, tried[best], fits[best].u))
    if not clocks and len(parts) >= MIN_DRIVES:
        fit, late = _with_offset(data, parts, fit)
        notes += late
    return Selected(choices[best], fit, candidates, clocks, begins[best], notes)


def _of_simpler(model: Model, fits: Sequence[PathFit]) -> Floats | None:
    """Return the solution of the largest simpler model, what it does not have at nominal; or None.

    A model that adds parameters to another begins where that ended, so that a step or two is left.
    """
    names = [p.name for p in model.parameters]
    for fit in reversed(fits):
        found = {p.name: k for k, p in enumerate(fit.model.parameters)}
        if found.keys() <= set(names):
            return np.array([fit.u[found[n]] if n in found else 0.0 for n in names])
    return None


def _compare(
    data: Sequence[PathData],
    parts: Sequence[PathData],
    choices: Sequence[Choice],
    fits: Sequence[PathFit],
) -> tuple[int, tuple[Candidate, ...]]:
    """Return which model to take, and what each of them is worth."""
    nominal, whole = _nominal(parts, fits[0].model), _nominal(data, fits[0].model)
    shares = [_left_out(data, parts, fit).shares(nominal) for fit in fits]
    inside = [float(np.mean(_in_sample(data, fit).shares(whole))) for fit in fits]
    mean = [float(np.mean(s)) for s in shares]
    told = [k for k, f in enumerate(fits) if _identified(f)]
    best = min(told, key=lambda k: mean[k]) if told else 0
    chosen = best
    for k in told:
        more = shares[k] - shares[best]
        allowed = max(_standard_error(more), NO_WORSE * mean[best])
        if float(np.mean(more)) <= allowed and _count(fits[k]) < _count(fits[chosen]):
            chosen = k
    return chosen, tuple(
        Candidate(c.id, c.title, _count(f), i, m, _standard_error(s), k == chosen, k in told)
        for k, (c, f, i, m, s) in enumerate(zip(choices, fits, inside, mean, shares, strict=True))
    )


def _identified(fit: PathFit) -> bool:
    """Return whether the drives observe what a model adds to the wheels.

    Squares, straight with spins at their corners, tell a rotation scale from the track by nothing
    but the priors: such a model does well on more squares, and badly on anything else.
    """
    sigma = np.sqrt(np.diag(fit.covariance))
    more = {p.name for p in added(fit.model.robot.base)}
    return all(
        s < 0.5 * p.solver_sigma
        for p, s in zip(fit.model.parameters, sigma, strict=True)
        if p.name in more
    )


def _count(fit: PathFit) -> int:
    """Return how many parameters of the robot a fit has."""
    return len(fit.model.free)


def _standard_error(values: Floats) -> float:
    """Return the standard error of a mean."""
    return float(np.std(values, ddof=1) / np.sqrt(values.size)) if values.size > 1 else np.inf


def _nominal(data: Sequence[PathData], model: Model) -> Errors:
    """Return the errors of the robot as it is described."""
    described = replace(model, mount=())
    return errors(open_loop(data, described, np.zeros(len(described.parameters))))


def _left_out(data: Sequence[PathData], parts: Sequence[PathData], fit: PathFit) -> Errors:
    """Return the errors of parts that are left out in turn; `parts` are the drives, or pieces."""
    whole = len(parts) == len(data)
    return held_out(parts, fit if whole else fit_paths(parts, fit.model, fit.u))


def _in_sample(data: Sequence[PathData], fit: PathFit) -> Errors:
    """Return the errors of the drives of the fit."""
    return errors(open_loop(data, fit.model, fit.u))


def _with_offset(
    data: Sequence[PathData], parts: Sequence[PathData], fit: PathFit
) -> tuple[PathFit, tuple[str, ...]]:
    """Return the fit with one time offset for all drives, where that predicts drives left out."""
    model = replace(fit.model, offset=(TIME_OFFSET,))
    late = fit_paths(data, model, np.append(fit.u, 0.0), LOOK)
    for last in (False, True):
        offset = TIME_OFFSET.to_value(float(late.u[-1]))
        sigma = float(np.sqrt(late.covariance[-1, -1])) * TIME_OFFSET.scale
        if abs(offset) < LATE_SIGMA * sigma:
            return fit, ()
        late = late if last else fit_paths(data, model, late.u)
    nominal = _nominal(parts, fit.model)
    without, with_ = (_left_out(data, parts, f).shares(nominal) for f in (fit, late))
    gain = without - with_
    if float(np.mean(gain)) <= _standard_error(gain):
        return fit, ()
    when = "early" if offset < 0.0 else "late"
    note = (
        f"stamps of the wheels are {abs(offset) * 1e3:.0f} ± {sigma * 1e3:.0f} ms {when} against "
        "those of the reference (time_offset); errors are taken with that put right"
    )
    return late, (note,)


def _differ(fit: PathFit) -> bool:
    """Return whether enough drives show that their clocks differ."""
    offset = np.array([v[0] for v in fit.local]) * OFFSET_SIGMA_S
    sigma = np.array([s[0] for s in fit.local_sigma]) * OFFSET_SIGMA_S
    late = np.abs(offset) > np.maximum(LATE_S, LATE_SIGMA * sigma)
    return float(np.mean(late)) >= LATE_DRIVES


def _with_clocks(
    data: Sequence[PathData], fit: PathFit
) -> tuple[PathFit, tuple[ClockFit, ...], tuple[str, ...]]:
    """Return the fit with the clocks free where they differ, and by how much they do."""
    model = replace(fit.model, clock=True)
    # Two steps tell whether it is worth a search.
    free = fit_paths(data, model, fit.u, LOOK)
    if not _differ(free):
        return fit, (), ()
    free = fit_paths(data, model, free.u)
    offset = np.array([v[0] for v in free.local]) * OFFSET_SIGMA_S
    if not _differ(free):
        return fit, (), ()
    clocks = tuple(
        ClockFit(
            d.drive.name,
            float(v[0] * OFFSET_SIGMA_S),
            float(s[0] * OFFSET_SIGMA_S),
            float(v[1] * RATE_SIGMA),
            float(s[1] * RATE_SIGMA),
        )
        for d, v, s in zip(data, free.local, free.local_sigma, strict=True)
    )
    note = (
        f"the clocks of wheels and reference differ (by {np.max(np.abs(offset)):.2f} s at most "
        "when a drive begins): offset and rate are estimated for every drive of the fit, and "
        "errors are still taken by the clocks as recorded"
    )
    return free, clocks, (note,)
