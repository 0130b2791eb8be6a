"""Which heading sensors to believe, decided within the window as batch decides for a drive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.factors.tables import FactorTable, Kind
from fgloc.online.priors import first_prior
from fgloc.online.smoother import WindowSmoother, mean_cost
from fgloc.smoothing.trust import GAIN, STRAINED, STRETCHED, pulled

SUSPECTS = (Kind.YAW, Kind.YAW_RATE)
"""Sensors that may lie about the heading while everything else agrees."""
PATIENCE = 4
"""After a trial that changed nothing the next one waits this many times longer."""
UNSURE = 25.0
"""Factor on the covariance of the pose at which a window without a sensor begins."""


@dataclass(frozen=True)
class Verdict:
    """A sensor that is not believed any more."""

    sensor: str
    """Its name."""
    reason: str
    """What a user should know."""
    lost: int
    """How many of its factors were in the window."""


class Trust:
    """Watches the window's residuals and finds out a heading sensor that contradicts the rest."""

    def __init__(self, smoother: WindowSmoother) -> None:
        self._smoother = smoother
        self._wait = 0
        self._pause = 1

    def look(self) -> Verdict | None:
        """Look at the last whole pass; try the window without a suspect if it is strained.

        A trial costs tens of milliseconds; the more of them were in vain, the rarer they become.
        """
        smoother = self._smoother
        suspects = sorted(
            {t.sensor for t in smoother.window.tables.values() if t.kind in SUSPECTS and t.first}
        )
        if not suspects or self._wait > 0:
            self._wait -= 1
            return None
        before, far = smoother.strain(), stretch(smoother, smoother.calibration)
        if before < STRAINED and far < STRETCHED:
            return None
        for suspect in suspects:
            trial = smoother.solve_without(suspect, self._prior())
            after = mean_cost(trial.tables, trial.squared)
            verdict = None
            if before >= STRAINED and after < GAIN * before:
                verdict = (
                    f"{suspect} contradicts the absolute sensors and is left out from now on: "
                    f"without it their mean cost falls from {before:.3g} to {after:.3g} (0.5 is "
                    "right)"
                )
            elif far >= STRETCHED and stretch(smoother, trial.calibration) < 0.5 * far:
                verdict = (
                    f"{suspect} could only be right if the robot's calibration were {far:.1f} "
                    "prior sigmas from nominal, and is left out from now on; if the robot is like "
                    "that, say so with --robot"
                )
            if verdict is not None:
                lost = smoother.adopt(trial, suspect, self._prior())
                self._pause = 1
                return Verdict(suspect, verdict, lost)
        self._wait = self._pause
        self._pause *= PATIENCE
        return None

    def _prior(self) -> FactorTable:
        """Return a prior that the suspect has not spoiled.

        The pose is where it was thought to be, less surely; the calibration is as at the
        beginning. At the very beginning nothing is spoiled.
        """
        window = self._smoother.window
        prior = window.prior
        assert prior is not None
        if window.base == 0:
            return prior
        b = window.layout.width
        covariance = np.linalg.inv(prior.sqrt_information[0].T @ prior.sqrt_information[0])
        pose = UNSURE * covariance[:b, :b]
        root = np.linalg.inv(np.linalg.cholesky(pose))
        return first_prior(window, prior.measurements[0, :b], root)


def stretch(smoother: WindowSmoother, calibration: Floats) -> float:
    """Return how many prior sigmas the robot's own calibration is away, at most.

    Of parameters that the drive observes; see `fgloc.smoothing.trust.stretch`.
    """
    layout = smoother.window.layout
    known = smoother.posterior.covariance[layout.width :, layout.width :]
    return pulled(layout.parameters[: len(layout.free)], calibration, known)
