"""A drive: everything that was measured on one run, the robot's nominal description, the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeVar

from fgloc.core.checks import check_arrays, check_mount, check_noise
from fgloc.core.measurements import Sensor, Stamps, WheelIncrements
from fgloc.core.robot import Robot
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError

S = TypeVar("S")


@dataclass(frozen=True)
class Reference:
    """A recorded truth and what is known of how it was recorded."""

    trajectory: Trajectory
    """Poses of the reference's own frame (marker body, lidar) in the map frame."""
    sensor: str = "truth"
    """Name of the reference; its mounting is calibrated as `<sensor>_x/_y/_yaw`."""
    sigma: tuple[float, float, float] = (1e-3, 1e-3, 2e-3)
    """Standard deviations of one recorded pose: x, y [m], heading [rad]."""
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Nominal pose of the reference's frame on the robot: x, y [m], yaw [rad]."""
    mount_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Prior standard deviations of the mount [m, m, rad]; 0 means known exactly."""
    taken_ns: Stamps | None = None
    """(N,) when the poses were taken, where the recording knows that better than its stamps tell:
    a motion capture that counts its frames, while its messages come late. None: at their stamps.
    For those who make sensors of a truth; estimates are scored at the stamps."""

    def __post_init__(self) -> None:
        if self.taken_ns is not None:
            check_arrays(self.sensor, self.taken_ns, {}, len(self.trajectory))
            if self.taken_ns.size != len(self.trajectory):
                raise FglocError(f"{self.sensor}: there must be one time a pose was taken for each")
        # The estimators' start is tied to the truth with these sigmas.
        check_noise(
            self.sensor,
            {f"sigma of {n}": s for n, s in zip(("x", "y", "heading"), self.sigma, strict=True)},
        )
        check_mount(self.sensor, self.mount, self.mount_sigma, 3)


@dataclass(frozen=True)
class Drive:
    """One run of one robot. Built by readers and the simulator, read by every estimator."""

    name: str
    """The id that was asked for, e.g. "vitko-swerve:1", or the file's path."""
    robot: Robot
    """Nominal kinematics, priors and wheel noise."""
    wheels: WheelIncrements
    """The encoders; every drive has them."""
    sensors: tuple[Sensor, ...] = ()
    """All other streams, each with a name of its own."""
    truth: Reference | None = None
    """The recorded truth, where there is one. Estimators never look at it except for the start."""
    motion: str | None = None
    """Label of the reference motion (for totals over repetitions), where the dataset has one."""
    rejected: Mapping[str, int] = field(default_factory=dict)
    """How many lines or samples the reader rejected, by reason; shown with every result."""
    notes: tuple[str, ...] = ()
    """What a user should know about this recording, one sentence each."""
    true_calibration: Mapping[str, float] | None = None
    """Simulated drives: the calibration that produced the measurements, by parameter name."""

    def __post_init__(self) -> None:
        names = [self.wheels.sensor, *(s.sensor for s in self.sensors)]
        if len(set(names)) != len(names):
            raise FglocError(f"{self.name}: two sensors have the same name: {sorted(names)}")
        if self.wheels.wheels != self.robot.base.driven_names:
            raise FglocError(
                f"{self.name}: the encoders are {self.wheels.wheels}, "
                f"the robot's driven wheels {self.robot.base.driven_names}"
            )

    def each(self, kind: type[S]) -> tuple[S, ...]:
        """Return all streams of one kind, e.g. `drive.each(Yaw)`, in recorded order."""
        return tuple(s for s in self.sensors if isinstance(s, kind))

    @property
    def duration_s(self) -> float:
        """Return the time between the first and the last wheel stamp [s]."""
        return float(self.wheels.stamps_ns[-1] - self.wheels.stamps_ns[0]) * 1e-9
