"""A robot: its kinematics with priors, and how noisy its wheels are."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from fgloc.core.checks import check_noise
from fgloc.core.kinematics import WheeledBase


@dataclass(frozen=True)
class WheelNoise:
    """Noise of wheel odometry: white over distance, so it does not depend on the sampling rate.

    The defaults are those of rigid wheels on a hard floor; see `typical_noise`.
    """

    rolling: float = 0.004
    """Slip along the rolling direction: sigma of a wheel's travelled distance [m/sqrt(m)]."""
    lateral: float = 0.002
    """Side slip: sigma of a wheel's sideways displacement [m/sqrt(m)]."""
    turning: float = 0.01
    """Scrub when turning: sigma of the heading [rad/sqrt(rad)] over the turned angle."""
    standing: float = 1e-4
    """Floor for a standing robot [m/sqrt(s)], so that no interval is certain."""
    standing_turn: float = 5e-4
    """The same floor for the heading [rad/sqrt(s)]."""
    veering: float = 0.0
    """Heading lost on the way: sigma of the heading [rad/sqrt(m)] over the path, for bases whose
    rolling noise does not turn them; where wheels stand apart, their rolling noise does that."""

    def __post_init__(self) -> None:
        # Zeros are for simulators: without a floor, estimators find a standing interval certain.
        check_noise("wheel noise", {}, asdict(self))


def scaled(noise: WheelNoise, factor: float) -> WheelNoise:
    """Return the noise with every sigma times `factor`."""
    return WheelNoise(**{name: factor * sigma for name, sigma in asdict(noise).items()})


def typical_noise(kind: str) -> WheelNoise:
    """Return the wheel noise to expect of a base of a kind, where nothing better is known.

    Three classes, each the same for every robot in it. Rigid wheels that roll (differential,
    tricycle, steered): millimetres per root metre. Tyres that must skid to turn: several times
    that, most of all in heading. Rollers (mecanum, omni): each wheel slips along its way, and
    there is no wheel to hold the base sideways. Checked on recorded drives: with these values the
    normalised residuals of sparse fixes are near one (docs/noise.md). An odometry whose wheels
    are not known ("odometry") may be any of these: it gets the tyres' noise, and loses heading on
    the way as two wheels of that noise 0.7 m apart would.
    """
    if kind == "odometry":
        return WheelNoise(rolling=0.01, lateral=0.01, turning=0.04, veering=0.02)
    if kind == "skid-steer":
        return WheelNoise(rolling=0.01, lateral=0.01, turning=0.04)
    if kind in ("mecanum", "omni-3"):
        return WheelNoise(rolling=0.02, lateral=0.0, turning=0.015)
    return WheelNoise()


@dataclass(frozen=True)
class Robot:
    """What a drive says of its robot before anything is estimated."""

    name: str
    """Name in tables, e.g. "Jaguar 4x4"."""
    base: WheeledBase
    """Wheels and calibration parameters at their nominal values, with priors."""
    noise: WheelNoise = WheelNoise()
    """Noise of the wheel odometry."""

    @classmethod
    def typical(cls, name: str, base: WheeledBase) -> Robot:
        """Return a robot with the noise that is typical of its kind of base."""
        return cls(name, base, typical_noise(base.kind))
