"""The one interface of every filter and smoother, and what it returns."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.kinematics import Parameter
from fgloc.core.measurements import Floats, Stamps
from fgloc.core.trajectory import Trajectory
from fgloc.lidar.walls import Map


@dataclass(frozen=True)
class CalibrationEstimate:
    """One calibration parameter after estimation; all values physical (m, rad, s, 1)."""

    name: str
    """Contract name, e.g. "effective_track"."""
    nominal: float
    """Value before estimation."""
    value: float
    """Estimated value."""
    sigma: float
    """Posterior standard deviation."""
    prior_sigma: float
    """Prior standard deviation."""
    unit: str = "m"
    """"m", "rad", "s" or "1"."""

    @property
    def observed(self) -> bool:
        """Return True if the data told more than the prior: posterior sigma < half prior sigma."""
        return self.sigma < 0.5 * self.prior_sigma


def calibration_of(
    parameters: Sequence[Parameter], u: Floats, covariance: Floats | None
) -> tuple[tuple[CalibrationEstimate, ...], Floats | None]:
    """Return calibration variables and their (G, G) covariance in physical units.

    `u` (G,) and `covariance` (G, G) are in solver variables; without one, sigmas are NaN.
    """
    sigma = np.full(len(parameters), np.nan)
    if covariance is not None:
        scale = np.array([p.derivative(float(v)) for p, v in zip(parameters, u, strict=True)])
        covariance = np.asarray(covariance * np.outer(scale, scale))
        sigma = np.sqrt(np.diag(covariance))
    estimates = tuple(
        CalibrationEstimate(
            name=p.name,
            nominal=p.nominal,
            value=p.to_value(float(v)),
            sigma=float(s),
            prior_sigma=p.prior_sigma,
            unit=p.unit,
        )
        for p, v, s in zip(parameters, u, sigma, strict=True)
    )
    return estimates, covariance


Mount = tuple[float, float, float]
"""Pose of something on the base: x [m], y [m], yaw [rad]."""


class Mounted(Protocol):
    """What sits somewhere on the robot: a reference, a lidar, a camera."""

    @property
    def sensor(self) -> str:
        """Return its name, under which the mounting is calibrated."""
        ...

    @property
    def mount(self) -> Mount:
        """Return its nominal mounting [m, m, rad]."""
        ...


def calibrated_mount(calibration: Sequence[CalibrationEstimate], mounted: Mounted) -> Mount:
    """Return where something is mounted [m, m, rad]: nominal, with what was calibrated."""
    found = {c.name: c.value for c in calibration}
    x, y, yaw = (
        found.get(f"{mounted.sensor}_{axis}", nominal)
        for axis, nominal in zip(("x", "y", "yaw"), mounted.mount, strict=True)
    )
    return x, y, yaw


@dataclass(frozen=True)
class SensorResiduals:
    """Residuals of one sensor at the solution."""

    sensor: str
    """Sensor name."""
    components: tuple[str, ...]
    """Label with unit for each of the d components, e.g. ("x [m]", "y [m]")."""
    stamps_ns: Stamps
    """(M,) stamps."""
    values: Floats
    """(M, d) residuals in units."""
    normalised: Floats
    """(M, d) whitened residuals; standard normal if the noise model is right."""
    weights: Floats
    """(M,) robust weight of each measurement, 1 = fully believed."""


DOWN_WEIGHTED = 0.25
"""A factor whose robust weight is below this counts as down-weighted."""


@dataclass(frozen=True)
class SensorCount:
    """How many measurements of one sensor were used and how.

    Where an estimator interpolates, one counts for each pose (yaw) or interval between poses
    (wheels, gyro, camera) that the sensor tells something of, not for each sample.
    """

    accepted: int
    """Used with (nearly) full weight."""
    down_weighted: int = 0
    """Used with a robust weight below 0.25."""
    rejected: int = 0
    """Not used at all (outside the drive, invalid, gated)."""


SLIPPING = 0.05
"""Slip from which on a wheel is said to slip."""


@dataclass(frozen=True)
class WheelSlip:
    """One wheel that slipped for a while."""

    wheel: str
    """Name of the wheel."""
    begin_ns: int
    """Begin [ns]."""
    end_ns: int
    """End [ns]."""
    slip: float
    """Mean slip: 1 - way over ground / way rolled; below 0 where the wheel dragged."""
    sigma: float
    """Mean posterior standard deviation of the slip."""

    @property
    def probability(self) -> float:
        """Return the probability that the wheel slips by 5 % or more, from slip and sigma.

        NaN without a sigma.
        """
        if not self.sigma > 0.0:
            return math.nan
        return 0.5 * math.erfc((SLIPPING - abs(self.slip)) / (math.sqrt(2.0) * self.sigma))


@dataclass(frozen=True)
class TurningHistory:
    """The parameter that decides how far wheels turn the base, over time, as it was known then."""

    name: str
    """Its contract name: "effective_track", for bases without a track "base_radius" or
    "rotation_scale"."""
    unit: str
    """"m" or "1"."""
    nominal: float
    """Nominal value."""
    stamps_ns: Stamps
    """(N,) stamps."""
    values: Floats
    """(N,) estimates."""
    sigmas: Floats
    """(N,) their standard deviations."""


TURNING = ("effective_track", "base_radius", "rotation_scale")
"""Parameters that decide how far wheels turn a base, the usual one first."""


@dataclass(frozen=True)
class Spread:
    """What many times were [s]."""

    median: float
    """Half of them are below."""
    p99: float
    """99 % of them are."""
    maximum: float
    """All of them are, or equal."""

    @classmethod
    def of(cls, seconds: Sequence[float]) -> Spread | None:
        """Return the spread of some times; None of none."""
        if not seconds:
            return None
        median, p99, maximum = np.percentile(seconds, (50.0, 99.0, 100.0)).tolist()
        return cls(median, p99, maximum)


@dataclass(frozen=True)
class Live:
    """How an estimator that takes one packet after the other kept up, on this machine's clock."""

    updates: int
    """Packets after which something was smoothed, since the start of the drive."""
    update: Spread | None
    """What such a packet took, in this process."""
    late: Spread | None = None
    """How long packets waited for the engine; None unless they came in real time."""
    save: Spread | None = None
    """What a checkpoint took; None without."""
    resumed_poses: int = 0
    """So many poses are those of an earlier process."""


@dataclass(frozen=True)
class Result:
    """What an estimator returns for one drive."""

    method: str
    """Method id: model1, model2, batch, …"""
    drive: str
    """Id of the drive."""
    trajectory: Trajectory
    """Poses of base_link in the map frame, covariances in map axes where the method has them."""
    sensors_used: tuple[str, ...]
    """Names of the streams that entered the estimate, wheels included."""
    calibration: tuple[CalibrationEstimate, ...] = ()
    """Estimated parameters; empty for methods that estimate none."""
    residuals: tuple[SensorResiduals, ...] = ()
    """Residuals per sensor; empty for methods without."""
    counts: Mapping[str, SensorCount] = field(default_factory=dict)
    """Accepted, down-weighted and rejected measurements per sensor."""
    seconds: float = 0.0
    """Time spent estimating [s], without reading and compiling."""
    convergence: str = ""
    """One line on how the optimiser ended; empty for filters."""
    notes: tuple[str, ...] = ()
    """What a user should know about this estimate."""
    live: Live | None = None
    """How it kept up; None for methods that see the whole drive at once."""
    slips: tuple[WheelSlip, ...] = ()
    """Which wheels slipped when, in order of time; empty for methods that do not model slip."""
    calibration_covariance: Floats | None = None
    """(G, G) covariance of `calibration` in its order and physical units; None if unknown."""
    turning: TurningHistory | None = None
    """Effective track over time; None for methods that do not follow it."""
    map: Map | None = None
    """Walls and landmarks; None for methods that make no map, or without a sensor for it."""


class Estimator(Protocol):
    """A filter or smoother: a method id and one function from drive to result."""

    @property
    def method(self) -> str:
        """Return the method id."""
        ...

    def estimate(self, drive: Drive) -> Result:
        """Estimate the trajectory; raises FglocError if the drive lacks a sensor it needs."""
        ...


def run(estimator: Estimator, drive: Drive) -> Result:
    """Run an estimator on a drive and put the elapsed time, without compiling, into the result."""
    from numba.core.event import install_timer

    compiling: list[float] = []
    begin = time.perf_counter()
    # The first run on a machine compiles the kernels; that says nothing about the method.
    with install_timer("numba:compile", compiling.append):
        result = estimator.estimate(drive)
    return replace(result, seconds=time.perf_counter() - begin - sum(compiling))
