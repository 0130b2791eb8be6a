"""The online engine as an estimator: a drive replayed as it would have come live."""

from __future__ import annotations

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.geometry import compose
from fgloc.core.start import start_pose, trim_to_truth
from fgloc.core.trajectory import Trajectory
from fgloc.estimator import CalibrationEstimate, Result, SensorCount
from fgloc.online.engine import OnlineEngine, Start
from fgloc.online.replay import packets
from fgloc.online.settings import OnlineSettings
from fgloc.smoothing.initial import ORIGIN_SIGMA


class OnlineSmoother:
    """Replays a drive through the online engine; every pose is kept as it was emitted."""

    def __init__(self, settings: OnlineSettings | None = None) -> None:
        self.settings = settings if settings is not None else OnlineSettings()

    @property
    def method(self) -> str:
        """Return "online"."""
        return "online"

    def estimate(self, drive: Drive) -> Result:
        """Return the poses emitted at every wheel packet, with the last calibration."""
        drive = trim_to_truth(drive)
        engine = OnlineEngine(
            drive.robot, drive.sensors, drive.truth, self.settings, drive.wheels.resolution
        )
        engine.begin(int(drive.wheels.stamps_ns[0]), start_of(drive))
        n = drive.wheels.stamps_ns.size
        poses, covariances = np.zeros((n, 3)), np.zeros((n, 3, 3))
        poses[0], covariances[0] = engine.propagation.state[:3], engine.propagation.covariance()
        k = 0
        for packet in packets(drive):
            if packet.sensor:
                engine.reading(packet.sensor, packet.stamp_ns, packet.values, packet.extra)
                continue
            engine.wheels(packet.stamp_ns, packet.values, packet.extra)
            k += 1
            poses[k] = engine.propagation.state[:3]
            covariances[k] = engine.propagation.covariance()
        return Result(
            method=self.method,
            drive=drive.name,
            trajectory=Trajectory(drive.wheels.stamps_ns, poses, covariances),
            sensors_used=("wheels",),
            calibration=_calibration(engine),
            counts={
                name: SensorCount(t.accepted, t.down_weighted, sum(t.rejected.values()))
                for name, t in engine.tally.items()
            },
        )


def start_of(drive: Drive) -> Start:
    """Return where a drive starts: its truth's first pose, or the origin."""
    if drive.truth is None:
        return Start(np.zeros(3), np.full(3, ORIGIN_SIGMA), np.zeros(3), np.zeros(3))
    base = start_pose(drive)
    mount = np.array(drive.truth.mount, dtype=np.float64)
    return Start(compose(base, mount), np.array(drive.truth.sigma), base, mount)


def _calibration(engine: OnlineEngine) -> tuple[CalibrationEstimate, ...]:
    """Return the calibration as it is known at the end."""
    posterior = engine.smoother.posterior
    assert posterior is not None
    b = engine.layout.width
    sigma = np.sqrt(np.diag(posterior.covariance)[b:])
    return tuple(
        CalibrationEstimate(
            name=p.name,
            nominal=p.nominal,
            value=p.to_value(float(u)),
            sigma=float(s) * abs(p.derivative(float(u))),
            prior_sigma=p.prior_sigma,
            unit=p.unit,
        )
        for p, u, s in zip(engine.layout.parameters, posterior.calibration, sigma, strict=True)
    )
