"""What a calibration over many drives found: values, their uncertainty, and what they are worth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from fgloc.core.evaluation import Evaluation
from fgloc.core.measurements import Floats
from fgloc.core.robot import Robot
from fgloc.core.totals import Totals
from fgloc.estimator import CalibrationEstimate


@dataclass(frozen=True)
class DriveResiduals:
    """Residuals of one sensor on one drive of the fit."""

    drive: str
    """Id of the drive."""
    sensor: str
    """Name of the sensor; the reference's for a recorded truth."""
    components: tuple[str, ...]
    """What is compared, with its unit, e.g. ("x [m]", "y [m]", "heading [rad]")."""
    rms: tuple[float, ...]
    """Root mean square of each component, in its unit."""
    normalised: tuple[float, ...]
    """The same over its standard deviation: 1 where the noise model is right."""
    count: int
    """How many residuals of each component there are."""
    weight: float = 1.0
    """Weight of the drive in the fit; below 1 where the other drives contradict it."""


@dataclass(frozen=True)
class DriveError:
    """Wheel odometry alone on one drive, open loop from its true start: before and after."""

    drive: str
    """Id of the drive."""
    motion: str | None
    """Its motion label, for totals."""
    nominal: Evaluation
    """With the robot as it was described."""
    value: Evaluation
    """With the robot as it was calibrated."""


@dataclass(frozen=True)
class Candidate:
    """A kinematic model that was tried."""

    id: str
    """Short name, e.g. "geometry", "full-linear", "full-linear+rotation-scale"."""
    title: str
    """What it is, in words."""
    parameters: int
    """How many parameters it has free."""
    in_sample: float
    """Error on the drives of the fit, as a share of nominal's."""
    held_out: float
    """The same on drives left out of the fit, in turn; NaN where there are too few drives."""
    spread: float
    """Standard error of `held_out`."""
    chosen: bool = False
    """Whether the calibration is of this model."""
    identified: bool = True
    """Whether the drives observe what it adds; a model that they do not is never chosen."""


@dataclass(frozen=True)
class ClockFit:
    """How the clocks of wheels and reference differ on one drive: t_wheels = t + offset + rate·t,
    with t the reference's time since the drive's first wheel stamp."""

    drive: str
    """Id of the drive."""
    offset_s: float
    """Offset at the first wheel stamp [s]."""
    offset_sigma_s: float
    """Its standard deviation [s]."""
    rate: float
    """Relative rate of the clocks [1]."""
    rate_sigma: float
    """Its standard deviation [1]."""


@dataclass(frozen=True)
class CalibrationReport:
    """Everything `fgloc calibrate` tells."""

    fit: tuple[str, ...]
    """Ids of the drives of the fit."""
    reference: str
    """What the wheels were compared with, e.g. "truth", "camera, gyro", "wheels alone"."""
    model: str
    """Id of the chosen candidate."""
    nominal: Robot
    """The robot as the drives of the fit describe it."""
    robot: Robot
    """The calibrated robot: found values as nominal, posterior sigmas as priors."""
    parameters: tuple[CalibrationEstimate, ...]
    """All calibrated parameters, the robot's first, then those of sensors and reference."""
    covariance: Floats
    """(G, G) posterior covariance of `parameters`, physical units."""
    residuals: tuple[DriveResiduals, ...]
    """Residuals of the fit, a row a drive and sensor."""
    evaluation: tuple[DriveError, ...]
    """Errors on the drives to evaluate, before and after; empty where none were given."""
    candidates: tuple[Candidate, ...] = ()
    """Models that were tried, the simplest first; empty where there was no choice."""
    closed_form: Mapping[str, float] = field(default_factory=dict)
    """Parameters in closed form, where there is one, by name: where the fit began."""
    condition: float | None = None
    """Condition number of the closed form's equations, scaled columns; None without one."""
    clocks: tuple[ClockFit, ...] = ()
    """Clock differences that were found, a row a drive of the fit."""
    advice: tuple[str, ...] = ()
    """Which motion would observe what these drives did not, a sentence each."""
    notes: tuple[str, ...] = ()
    """What a user should know, a sentence each."""
    total_nominal: Totals | None = None
    """Total error over `evaluation` with the nominal robot, as `compare` has it."""
    total_value: Totals | None = None
    """The same with the calibrated robot."""
    seconds: float = 0.0
    """Time that the fit took, without reading and evaluating [s]."""

    @property
    def time_offset_s(self) -> float:
        """Return by how much the wheels' stamps are late against the reference's [s]."""
        return next((p.value for p in self.parameters if p.name == "time_offset"), 0.0)

    @property
    def sensor_parameters(self) -> tuple[CalibrationEstimate, ...]:
        """Return the parameters that are not the robot's: mountings, camera scale."""
        own = {p.name for p in self.robot.base.parameters}
        return tuple(p for p in self.parameters if p.name not in own)


def calibrated_robot(robot: Robot, estimates: Sequence[CalibrationEstimate]) -> Robot:
    """Return the robot with found values as nominal and their sigmas as priors.

    Parameters that are not its own are left to others; those it keeps fixed stay fixed.
    """
    own = {p.name for p in robot.base.parameters}
    mine = {e.name: e for e in estimates if e.name in own}
    base = robot.base.with_values({n: e.value for n, e in mine.items()})
    parameters = tuple(
        replace(p, prior_sigma=mine[p.name].sigma, correlation=0.0) if p.name in mine else p
        for p in base.parameters
    )
    return replace(robot, base=replace(base, parameters=parameters))
