"""What the engine rests on: propagation, the prior of a window that slides, unknown starts."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from fgloc.core.geometry import between, compose, wrap
from fgloc.core.measurements import Floats
from fgloc.core.preintegration import Integrator
from fgloc.datasets.simulator import load_sim
from fgloc.online import smoother
from fgloc.online.online import OnlineSmoother, notes
from fgloc.online.priors import after_move, after_walk, prior_table
from fgloc.online.replay import packets
from fgloc.online.settings import OnlineSettings

from .driving import counted, engine_for, feed, run, without_truth
from .fuzz import ROBOTS, fuzz


def test_propagated_covariance_is_that_of_drawn_starts_and_calibrations() -> None:
    """Start and calibration drawn from the posterior, driven by the same wheels: Monte Carlo."""
    drive = load_sim("random?robot=differential&duration=12&rate=10&yaw=off&fix_every=1&seed=5")
    engine = engine_for(drive, OnlineSettings(relinearise_every=10_000))
    sent = list(packets(drive))
    run(engine, [p for p in sent if p.stamp_ns <= sent[0].stamp_ns + 10_000_000_000], every=50)
    engine.update()
    posterior = engine.smoother.posterior
    state = engine.window.state(posterior.number).copy()
    left = [p for p in sent if p.stamp_ns > engine.now_ns and not p.sensor]
    for packet in left:
        # Nothing but the wheels: no keyframe may be smoothed on the way.
        engine.propagation.add(packet.values, np.zeros(2), 0.1)
    noise = engine.propagation.displacement_covariance
    rng = np.random.default_rng(1)
    integrator = Integrator(drive.robot)
    newest = engine.propagation.state
    draws = rng.multivariate_normal(
        np.zeros(posterior.covariance.shape[0]), posterior.covariance, size=4000
    )
    errors = np.empty((draws.shape[0], 3))
    for k, draw in enumerate(draws):
        integrator.restart(engine.layout.values(posterior.border + draw[3:]))
        for packet in left:
            integrator.add(packet.values, np.zeros(2), 0.1)
        start = compose(state[:3], draw[:3])
        errors[k] = between(newest[:3], compose(start, integrator.displacement))
    sampled = np.cov(errors.T)
    predicted = engine.propagation.joint()[:3, :3] - noise
    sigma = np.sqrt(np.diag(predicted))
    np.testing.assert_allclose(
        sampled / np.outer(sigma, sigma), predicted / np.outer(sigma, sigma), atol=0.08
    )


def test_a_window_that_slid_knows_what_one_that_did_not_knows() -> None:
    drive = load_sim("figure-eight?robot=differential&duration=40&rate=10&fix_every=1&seed=2")
    found = []
    for lag in (np.inf, 8.0):
        settings = OnlineSettings(lag_s=lag, calibration_walk=0.0, robust=False)
        engine = engine_for(drive, settings)
        run(engine, packets(drive), every=100)
        found.append((engine.propagation.state, engine.propagation.covariance()))
    assert engine.window.base > 200
    (whole, whole_cov), (slid, slid_cov) = found
    sigma = np.sqrt(np.diag(whole_cov))
    assert (np.abs(slid[:3] - whole[:3]) < 0.05 * sigma).all(), (slid - whole)[:3] / sigma
    np.testing.assert_allclose(np.diag(slid_cov), np.diag(whole_cov), rtol=0.02)


def test_a_walk_of_the_calibration_adds_to_its_covariance() -> None:
    """P' = P + walk² σ² t on the robot's own parameters, and nothing else."""
    drive = load_sim("random?duration=2&rate=10&fix_every=1")
    engine = engine_for(drive)
    layout = engine.layout
    n, b, free = layout.size, layout.width, len(layout.free)
    rng = np.random.default_rng(2)
    root = np.triu(rng.normal(size=(n, n))) + 3.0 * np.eye(n)
    prior = prior_table(np.zeros(b), np.zeros(n - b), root)
    expected = np.linalg.inv(root.T @ root)
    walk = np.array([0.01 * p.solver_sigma for p in layout.parameters[:free]])
    walked = after_walk(prior, b, walk)[0].sqrt_information[0]
    own = np.arange(b, b + free)
    expected[own, own] += walk**2
    np.testing.assert_allclose(np.linalg.inv(walked.T @ walked), expected, rtol=1e-8, atol=1e-12)


def test_a_moved_pose_is_as_unsure_as_its_move() -> None:
    rng = np.random.default_rng(4)
    root = np.triu(rng.normal(size=(6, 6))) + 3.0 * np.eye(6)
    sigma = np.array([2.0, 2.0, 0.5])
    after = after_move(root, sigma)
    expected = np.linalg.inv(root.T @ root)
    expected[:3, :3] += np.diag(sigma**2)
    np.testing.assert_allclose(np.linalg.inv(after.T @ after), expected, rtol=1e-8)


def final_error(poses: Floats, truth: Floats) -> tuple[float, float]:
    """Return the distance [m] and turn [rad] between two poses."""
    off = poses[:3] - truth
    return float(np.hypot(off[0], off[1])), float(abs(wrap(off[2])))


@pytest.mark.parametrize("held", [6000, 400])
def test_a_start_found_after_standing_for_a_minute(
    monkeypatch: pytest.MonkeyPatch, held: int
) -> None:
    """Also where the window could not hold the whole wait: `held` keyframes at most."""
    monkeypatch.setattr(smoother, "HELD", held)
    drive = load_sim("random?robot=differential&duration=30&rate=10&yaw=off&fix_every=1&seed=3")
    wait = 60_000_000_000
    engine = engine_for(without_truth(drive))
    begin = engine.now_ns
    rng = np.random.default_rng(7)
    assert drive.truth is not None
    home = drive.truth.trajectory.poses[0, :2]
    sent = []
    for k in range(1, 600):
        if k % 10 == 0:
            engine.reading(
                "fixes",
                begin + k * 100_000_000,
                home + 0.05 * rng.normal(size=2),
                np.full(2, 0.05),
            )
        engine.wheels(begin + k * 100_000_000, np.zeros(2))
        assert len(engine.window.stamps_ns) <= held + 20
    for packet in packets(drive):
        later = replace(packet, stamp_ns=packet.stamp_ns + wait)
        feed(engine, later)
        sent.append(later)
    assert engine.spots.aligner is None
    metres, turn = final_error(engine.propagation.state, drive.truth.trajectory.poses[-1])
    assert metres < 0.15, metres
    assert turn < 0.15, turn


def test_without_fixes_an_unknown_start_is_the_origin() -> None:
    drive = without_truth(load_sim("random?robot=differential&duration=20&rate=10&seed=3"))
    engine = engine_for(drive)
    run(engine, packets(drive), every=50)
    assert engine.window.base == 0
    assert not list(notes(engine))


@pytest.mark.parametrize("robot", ROBOTS)
def test_every_base_is_localised(robot: str) -> None:
    drive = load_sim(f"random?robot={robot}&duration=10&rate=10&fix_every=1")
    sent = list(packets(drive))
    engine = engine_for(drive)
    run(engine, sent, every=20)
    assert drive.truth is not None
    metres, turn = final_error(engine.propagation.state, drive.truth.trajectory.poses[-1])
    assert metres < 0.2, metres
    assert turn < 0.2, turn
    counted(engine, sent)


@pytest.mark.parametrize("seed", range(6))
def test_faulty_packets_never_break_the_engine(seed: int) -> None:
    fuzz(seed, seconds=15)


CODE = """
from fgloc.datasets.simulator import load_sim
from fgloc.online.online import OnlineSmoother
t = OnlineSmoother().estimate(load_sim("{spec}")).trajectory
import hashlib
print(hashlib.sha256(t.poses.tobytes() + t.covariances.tobytes()).hexdigest())
"""


def test_the_same_drive_gives_the_same_bytes_here_and_in_another_process() -> None:
    spec = "random?duration=20&rate=10&gyro=on&camera=on&fix_every=1"
    found = [OnlineSmoother().estimate(load_sim(spec)).trajectory for _ in range(2)]
    hashed = []
    for one in found:
        assert one.covariances is not None
        hashed.append(one.poses.tobytes() + one.covariances.tobytes())
    assert hashed[0] == hashed[1]
    import hashlib

    done = subprocess.run(
        [sys.executable, "-c", CODE.format(spec=spec)], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == hashlib.sha256(hashed[0]).hexdigest()
