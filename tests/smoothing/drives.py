"""What the smoother's tests do to simulated drives, and how they look at results."""

from __future__ import annotations

from dataclasses import replace

from fgloc.core.drive import Drive
from fgloc.core.evaluation import Evaluation, evaluate
from fgloc.core.measurements import Sensor
from fgloc.datasets.simulator import load_sim
from fgloc.estimator import CalibrationEstimate, Result


def simulated(query: str) -> Drive:
    """Return a simulated drive without yaw sensor unless the query asks for one."""
    return load_sim(query if "yaw=" in query else query + "&yaw=off")


def with_sensor(drive: Drive, sensor: Sensor) -> Drive:
    """Return the drive with one stream replaced by another of its name, or added."""
    others = tuple(s for s in drive.sensors if s.sensor != sensor.sensor)
    return replace(drive, sensors=(*others, sensor))


def scores(result: Result, drive: Drive) -> Evaluation:
    assert drive.truth is not None
    return evaluate(result.trajectory, drive.truth)


def parameters(result: Result) -> dict[str, CalibrationEstimate]:
    return {c.name: c for c in result.calibration}


def sigmas_off(result: Result, truth: dict[str, float]) -> dict[str, float]:
    """Return how many posterior sigmas each named parameter is from its true value."""
    found = parameters(result)
    return {n: abs(found[n].value - v) / found[n].sigma for n, v in truth.items()}


def assert_recovered(result: Result, drive: Drive, limit: float = 4.0) -> None:
    """Assert that every simulated parameter is within `limit` sigmas and none was certain."""
    assert drive.true_calibration
    # What the robot holds fixed (sigma 0) is not estimated.
    fixed = {p.name for p in drive.robot.base.parameters if p.prior_sigma == 0.0}
    truth = {n: v for n, v in drive.true_calibration.items() if n not in fixed}
    for name, off in sigmas_off(result, truth).items():
        assert off < limit, f"{name} is {off:.1f} sigmas off"
    for c in result.calibration:
        assert 0.0 < c.sigma <= c.prior_sigma * (1 + 1e-9), c.name
