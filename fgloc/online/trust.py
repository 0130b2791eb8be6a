"""Which heading sensors to believe, decided within the window as batch decides for a drive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.factors.tables import FactorTable, Kind
from fgloc.online.priors import first_prior
from fgloc.online.smoother import WindowSmoother
from fgloc.smoothing.sensors import KNOWN
from fgloc.smoothing.trust import (
    AT_ODDS,
    FREE_SCALE,
    GAIN,
    SAME,
    STRAINED,
    STRANGE,
    STRETCHED,
    bent,
    pulled,
    scale_note,
    tells,
)

SUSPECTS = (Kind.YAW, Kind.YAW_RATE)
"""Sensors that may lie about the heading while everything else agrees."""
PATIENCE = 4
"""After a trial that changed nothing the next one waits this many times longer."""
UNSURE = 25.0
"""Factor on the covariance of the pose at which a window without a sensor begins."""


@dataclass(frozen=True)
class Verdict:
    """A sensor that is not believed any more, or only in part."""

    sensor: str
    """Its name."""
    reason: str
    """What a user should know."""
    lost: int | None
    """How many of its factors were in the window; None: it is still used."""


class Trust:
    """Watches the window's residuals and finds out a heading sensor that contradicts the rest."""

    def __init__(self, smoother: WindowSmoother) -> None:
        self._smoother = smoother
        self._wait = 0
        self._pause = 1
        # Sigmas of camera scales that were freed, by parameter.
        self._freed: dict[str, float] = {}

    def look(self) -> Verdict | None:
        """Look at the last whole pass; try the window without a suspect if it is strained.

        A trial costs tens of milliseconds; the more of them were in vain, the rarer they become.
        """
        smoother = self._smoother
        suspects = sorted(
            {t.sensor for t in smoother.window.tables.values() if t.kind in SUSPECTS and t.first}
        )
        if self._wait > 0:
            self._wait -= 1
            return None
        now, far = smoother.evidence(), stretch(smoother, smoother.calibration)
        before, lost = now.strain, now.doubted
        tried = far >= STRETCHED or lost >= AT_ODDS
        if lost >= AT_ODDS:
            # A window at a poor minimum doubts what it would believe at a better one; no trial
            # without a suspect may be praised for having looked anew.
            lost = min(lost, smoother.solve_without(None, self._prior()).evidence.doubted)
        strained = before >= STRAINED or far >= STRETCHED or lost >= AT_ODDS
        arbiter = any(tells(t.kind, t.sensor) and t.first for t in smoother.window.tables.values())
        parameters = smoother.window.layout.parameters
        for suspect in suspects:
            own = bent(f"{suspect}_drift", parameters, smoother.calibration) if arbiter else 0.0
            if not strained and own < STRANGE:
                continue
            tried = True
            trial = smoother.solve_without(suspect, self._prior())
            then = trial.evidence
            after = then.strain
            verdict = None
            if before >= STRAINED and after < GAIN * before:
                verdict = (
                    f"{suspect} contradicts the absolute sensors and is left out from now on: "
                    f"without it their mean cost falls from {before:.3g} to {after:.3g} (0.5 is "
                    "right)"
                )
            elif far >= STRETCHED and stretch(smoother, trial.point.u) < 0.5 * far:
                verdict = (
                    f"{suspect} could only be right if the robot's calibration were {far:.1f} "
                    "prior sigmas from nominal, and is left out from now on; if the robot is like "
                    "that, say so with --robot"
                )
            elif lost >= AT_ODDS and then.doubted < GAIN * lost:
                verdict = (
                    f"{suspect} contradicts the absolute sensors and is left out from now on: "
                    f"without it {then.doubted:.0%} of their factors are doubted, not {lost:.0%}"
                )
            elif own >= STRANGE and after <= before + SAME:
                verdict = (
                    f"{suspect} could only be right if it drifted {own:.0f} prior sigmas fast, and "
                    "is left out from now on; if it does, say so in its noise"
                )
            if verdict is not None:
                gone = smoother.adopt(trial, suspect, self._prior())
                self._pause = 1
                return Verdict(suspect, verdict, gone)
        freed = self._with_free_scale(far) if far >= STRETCHED else None
        if freed is not None:
            return freed
        if tried:
            self._wait = self._pause
            self._pause *= PATIENCE
        return None

    def _with_free_scale(self, far: float) -> Verdict | None:
        """Free the scale of the cameras where they bend the robot by `far` prior sigmas.

        See `fgloc.smoothing.trust`: wheels and camera cannot both be right, and a ruler measured
        the wheels. Position fixes decide by themselves.
        """
        smoother = self._smoother
        parameters = smoother.window.layout.parameters
        tables = smoother.window.tables.values()
        names = {f"{t.sensor}_scale" for t in tables if t.kind == Kind.CAMERA and t.first}
        columns = {
            p.name: k
            for k, p in enumerate(parameters)
            if p.name in names - self._freed.keys() and p.prior_sigma > KNOWN
        }
        if not columns:
            return None
        sigmas = {n: max(parameters[k].prior_sigma, FREE_SCALE) for n, k in columns.items()}
        prior = self._prior(sigmas)
        trial = smoother.solve_without(None, prior)
        if stretch(smoother, trial.point.u) > 0.5 * far:
            return None
        smoother.adopt(trial, None, prior, smoother.window.newest + 1)
        self._freed |= sigmas
        self._pause = 1
        sensor = next(iter(columns)).removesuffix("_scale")
        told = [
            f"{n} is {parameters[k].to_value(trial.point.u[k]):.3f}" for n, k in columns.items()
        ]
        return Verdict(sensor, scale_note(sensor, far, ", ".join(told)), None)

    def _prior(self, sigmas: Mapping[str, float] | None = None) -> FactorTable:
        """Return a prior that the suspect has not spoiled.

        The pose is where it was thought to be, less surely; the calibration is as at the
        beginning, but for `sigmas` by parameter. At the very beginning nothing is spoiled.
        """
        window = self._smoother.window
        prior = window.prior
        assert prior is not None
        b = window.layout.width
        root = prior.sqrt_information[0]
        if window.base > 0:
            covariance = np.linalg.inv(root.T @ root)
            root = np.linalg.inv(np.linalg.cholesky(UNSURE * covariance[:b, :b]))
        freed = {**self._freed, **(sigmas or {})}
        return first_prior(window, prior.measurements[0, :b], root[:b, :b], freed)


def stretch(smoother: WindowSmoother, calibration: Floats) -> float:
    """Return how many prior sigmas the robot's own calibration is away, at most.

    Of parameters that the drive observes; see `fgloc.smoothing.trust.stretch`.
    """
    layout = smoother.window.layout
    known = smoother.posterior.covariance[layout.width :, layout.width :]
    return pulled(layout.parameters[: len(layout.free)], calibration, known)
