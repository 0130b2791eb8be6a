"""The online engine with iSAM2 inside, against its own solver and against what must not happen."""

from __future__ import annotations

import numpy as np
import pytest

from fgloc.core.drive import Drive
from fgloc.datasets.simulator import load_sim
from fgloc.estimator import Result
from fgloc.online.online import OnlineSmoother
from fgloc.online.settings import OnlineSettings
from fgloc.smoothing.isam import IncrementalGraph


def localised(drive: Drive, engine: str) -> Result:
    """Return the result of an engine with a window shorter than the drive."""
    settings = OnlineSettings(lag_s=15.0, engine=engine)  # type: ignore[arg-type]
    return OnlineSmoother(settings).estimate(drive)


@pytest.mark.parametrize(
    "sensors",
    ["robot=differential&yaw=off", "gyro=on&camera=on", "robot=mecanum&gyro=on&yaw=off"],
)
def test_both_solvers_end_at_the_same_pose_and_calibration(sensors: str) -> None:
    drive = load_sim(f"random?seed=3&duration=40&rate=10&fix_every=2&fix_sigma=0.02&{sensors}")
    chain, isam = (localised(drive, engine) for engine in ("chain", "isam2"))
    apart = isam.trajectory.poses[-1] - chain.trajectory.poses[-1]
    assert np.hypot(apart[0], apart[1]) < 2e-3
    assert abs(apart[2]) < np.deg2rad(0.1)
    for one, other in zip(chain.calibration, isam.calibration, strict=True):
        # iSAM2 linearises a calibration anew when it has moved by a hundredth.
        assert other.value == pytest.approx(one.value, abs=0.3 * one.sigma)
        assert other.sigma == pytest.approx(one.sigma, rel=0.05)
    assert chain.trajectory.covariances is not None
    assert isam.trajectory.covariances is not None
    variances = [np.diag(r.trajectory.covariances[-1]) for r in (chain, isam)]  # type: ignore[index]
    np.testing.assert_allclose(variances[1], variances[0], rtol=0.1)
    assert isam.counts["fixes"] == chain.counts["fixes"]


def test_a_failure_inside_isam2_is_rebuilt_and_does_not_get_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drive = load_sim("random?seed=3&duration=20&rate=10&fix_every=2&robot=differential&yaw=off")
    healthy = localised(drive, "isam2")
    real = IncrementalGraph.update
    broken = []

    def update(graph: IncrementalGraph) -> None:
        real(graph)
        if graph.newest == 80 and not broken:
            broken.append(graph.newest)
            graph._recover(RuntimeError("Indeterminant linear system"), ())

    monkeypatch.setattr(IncrementalGraph, "update", update)
    hurt = localised(drive, "isam2")
    assert broken
    apart = hurt.trajectory.poses[-1] - healthy.trajectory.poses[-1]
    assert np.hypot(apart[0], apart[1]) < 2e-3
    assert np.isfinite(hurt.trajectory.poses).all()
