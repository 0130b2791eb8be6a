"""Model 1: the encoders alone, integrated from the start with nominal parameters."""

from __future__ import annotations

from dataclasses import dataclass

from fgloc.core.drive import Drive
from fgloc.core.geometry import INTEGRATORS, Integrator, integrate
from fgloc.core.start import start_pose, trim_to_truth
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError
from fgloc.estimator import Result, SensorCount


@dataclass(frozen=True)
class Model1:
    """Wheel odometry: the base's least-squares displacement of every interval, one after another.

    Source: seed A, equations of Model 1 (skid-steer, midpoint step), here for every base.
    """

    integrator: Integrator = "exact"
    """exact: arc of constant twist; midpoint: along the mean heading; euler: along the old one."""

    def __post_init__(self) -> None:
        if self.integrator not in INTEGRATORS:
            raise FglocError(
                f"unknown integrator {self.integrator!r}; choose one of {', '.join(INTEGRATORS)}"
            )

    @property
    def method(self) -> str:
        """Return the method id."""
        return "model1"

    def estimate(self, drive: Drive) -> Result:
        """Return a pose at every wheel stamp; covariances are not known. O(N).

        Raises FglocError if wheels and truth do not overlap or the wheels do not determine the
        motion.
        """
        trimmed = trim_to_truth(drive)
        wheels = trimmed.wheels
        displacements = trimmed.robot.base.displacements(wheels.angles, wheels.steering)
        scheme = INTEGRATORS.index(self.integrator)
        poses = integrate(displacements, start_pose(trimmed), scheme)
        left_out = drive.wheels.stamps_ns.size - wheels.stamps_ns.size
        return Result(
            self.method,
            drive.name,
            Trajectory(wheels.stamps_ns, poses),
            (wheels.sensor,),
            counts={wheels.sensor: SensorCount(wheels.angles.shape[0], rejected=left_out)},
            notes=trim_note(left_out),
        )


def trim_note(left_out: int) -> tuple[str, ...]:
    """Return the sentence for `left_out` wheel increments before the truth, or nothing."""
    if not left_out:
        return ()
    return (f"{left_out} wheel increments before the recorded truth begins are left out",)
