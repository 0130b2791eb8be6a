"""A calibration as a robot file that every other command takes."""

from __future__ import annotations

from collections.abc import Sequence

from fgloc.calibration.result import CalibrationReport
from fgloc.config import robot_toml
from fgloc.estimator import CalibrationEstimate
from fgloc.toml_file import quoted

AXES = ("x", "y", "yaw")
"""Keys of a mounting, in files and behind the names of sensors."""


def calibration_toml(report: CalibrationReport) -> str:
    """Return the robot file of a calibration: found values, their sigmas as priors, mountings.

    Reading it back (`fgloc.robot_file.apply_robot_file`) gives the same robot without losing a
    digit.
    """
    drives = ", ".join(report.fit[:3]) + (
        f" and {len(report.fit) - 3} more" * (len(report.fit) > 3)
    )
    head = f"# Calibrated against {report.reference}, model {report.model}, on {drives}.\n"
    return head + robot_toml(report.robot) + "".join(_sensors(report))


def _sensors(report: CalibrationReport) -> list[str]:
    """Return the tables of sensors whose mounting was calibrated."""
    lines = []
    late = [p for p in report.sensor_parameters if p.name == "time_offset"]
    for name in mounted(report.sensor_parameters):
        own = {p.name: p for p in report.sensor_parameters}
        lines.append(f"\n[sensors.{quoted(name)}]\n")
        for axis in AXES:
            p = own.get(f"{name}_{axis}")
            if p is not None:
                lines.append(f"{axis} = {p.value!r}  # {p.unit}\n{axis}_sigma = {p.sigma!r}\n")
        # A time offset belongs to the reference: it is what the wheels were compared with.
        lines += [f"time_offset = {p.value!r}  # s, ± {p.sigma:.2g}\n" for p in late]
    return lines


def mounted(parameters: Sequence[CalibrationEstimate]) -> list[str]:
    """Return the names of sensors whose mounting is among the parameters."""
    names = (p.name.rpartition("_") for p in parameters)
    return list(dict.fromkeys(name for name, _, axis in names if axis in AXES and name))
