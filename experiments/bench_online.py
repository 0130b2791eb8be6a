"""Benchmark: the online engine, update by update, beside GTSAM's own fixed-lag smoother.

`python -m fgloc.experiments.bench_online [KEYFRAMES]` drives a simulated differential robot for
that many keyframes at 10 Hz, with a position fix every second and a window of 30 s. Each
contestant runs in a process of its own:

- online: this project's engine as `fgloc localise` runs it, calibration estimated;
- isam2: the same engine with this project's factors in iSAM2 instead of its own elimination;
- native: GTSAM's IncrementalFixedLagSmoother on BetweenFactorPose2 and PoseTranslationPrior2D,
  QR, relinearised as the design asks for, the calibration fixed at nominal;
- slam20, slam60, slam200: the engine on a ring road with about so many walls, seen by a lidar at
  10 Hz; the time is that of everything between two scans, and a fifth of the keyframes are driven;
- walls: the incremental graph with 60 walls in the window beside wheels and fixes, of which each
  keyframe sees 8 and another set every half second.

Printed are the time of an update (everything between a wheel packet and the pose for it, keyframe
included), its growth from the first tenth to the last, the memory that the drive added, and the
ratio of the medians. The first 600 keyframes are left out: the window fills, code is loaded.
"""

from __future__ import annotations

import gc
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Literal

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.geometry import compose, inverse
from fgloc.core.measurements import Floats
from fgloc.experiments.bench_batch import FIX_SIGMA, bench_drive, bench_drive_with_truth
from fgloc.experiments.bench_slam import localise_scans, ring_drive
from fgloc.factors.tables import FactorTable, Kind
from fgloc.online.engine import OnlineEngine
from fgloc.online.online import start_of
from fgloc.online.priors import prior_table
from fgloc.online.replay import packets
from fgloc.online.settings import OnlineSettings
from fgloc.smoothing.build import build_problem
from fgloc.smoothing.settings import Settings

SLAM = {"slam20": 20, "slam60": 60, "slam200": 200}
CONTESTANTS = ("online", "isam2", "native", "walls", *SLAM)
WALLS, SEEN, STRIDE, DWELL = 60, 8, 7, 5
WALL_SIGMA = (0.02, 0.02)
FIX_EVERY = 10
SETTLE = 600
LAG_S = 30.0


def _online(drive: Drive, engine_name: Literal["chain", "isam2"] = "chain") -> Floats:
    """Return the seconds (K,) that the engine took for each keyframe."""
    settings = OnlineSettings(lag_s=LAG_S, engine=engine_name)
    engine = OnlineEngine(drive.robot, drive.sensors, drive.truth, settings, 0.0)
    engine.begin(int(drive.wheels.stamps_ns[0]), start_of(drive))
    seconds = np.zeros(drive.wheels.angles.shape[0])
    k = 0
    for packet in packets(drive):
        begin = time.perf_counter()
        if packet.sensor:
            engine.reading(packet.sensor, packet.stamp_ns, packet.values, packet.extra)
        else:
            engine.wheels(packet.stamp_ns, packet.values, packet.extra)
            engine.propagation.covariance()
        seconds[k] += time.perf_counter() - begin
        k += not packet.sensor
    return seconds


def _native(drive: Drive) -> Floats:
    """Return the seconds (K,) that GTSAM's fixed-lag smoother took for each keyframe."""
    import gtsam  # heavy: only in this contestant's process

    problem = build_problem(drive, Settings(robust=False))
    wheels = problem.wheel_table(np.zeros(len(problem.parameters)))
    displacement = wheels.measurements[:, :3]
    fixes = {
        int(k): m
        for t in problem.tables
        if t.sensor == "fixes"
        for k, m in zip(t.first, t.measurements, strict=True)
    }
    parameters = gtsam.ISAM2Params()
    parameters.setFactorization("QR")
    parameters.setRelinearizeThreshold(0.01)
    parameters.relinearizeSkip = 10
    parameters.findUnusedFactorSlots = True
    smoother = gtsam.IncrementalFixedLagSmoother(LAG_S, parameters)
    noise = gtsam.noiseModel.Isotropic.Sigma(2, FIX_SIGMA)
    pose = gtsam.Pose2(*problem.states[0, :3])
    seconds = np.zeros(displacement.shape[0])
    for k in range(displacement.shape[0] + 1):
        begin = time.perf_counter()
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        stamps = gtsam.FixedLagSmootherKeyTimestampMap()
        if k == 0:
            tight = gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)
            graph.add(gtsam.PriorFactorPose2(0, pose, tight))
        else:
            step = gtsam.Pose2(*displacement[k - 1])
            model = gtsam.noiseModel.Gaussian.SqrtInformation(wheels.sqrt_information[k - 1])
            graph.add(gtsam.BetweenFactorPose2(k - 1, k, step, model))
            pose = pose.compose(step)
        if k in fixes:
            at = gtsam.Pose2(fixes[k][0], fixes[k][1], 0.0)
            graph.add(gtsam.PoseTranslationPrior2D(k, at, noise))
        values.insert(k, pose)
        stamps.insert((k, 0.1 * k))  # type: ignore[no-untyped-call]
        smoother.update(graph, values, stamps)
        pose = smoother.calculateEstimatePose2(k)
        smoother.getISAM2().marginalCovariance(k)
        if k:
            seconds[k - 1] = time.perf_counter() - begin
    return seconds


def _isam2(drive: Drive) -> Floats:
    """Return the seconds (K,) that the engine took for each keyframe with iSAM2 inside."""
    return _online(drive, "isam2")


def _sight(wall: Floats, pose: Floats, rng: np.random.Generator) -> Floats:
    """Return the measurement row of a wall (normal angle, point 2) seen from a pose (3,)."""
    angle, along = wall[0], rng.normal()
    point = wall[1:] + along * np.array([-np.sin(angle), np.cos(angle)])
    seen = compose(inverse(pose), np.append(point, 0.0))[:2] + rng.normal(0.0, 0.01, 2)
    beta = angle - pose[2] + rng.normal(0.0, WALL_SIGMA[0])
    return np.concatenate([[beta], seen, wall[1:], np.zeros(3)])


def _walls(drive: Drive) -> Floats:
    """Return the seconds (K,) of the incremental graph with walls."""
    from fgloc.factors.gtsam_factors import rows_of  # heavy: GTSAM
    from fgloc.smoothing.isam import IncrementalGraph

    keyframes = drive.wheels.stamps_ns.size
    _, truth = bench_drive_with_truth(keyframes, 0, FIX_EVERY)
    rng = np.random.default_rng(1)
    walls = np.column_stack([rng.uniform(-3.0, 3.0, WALLS), 10.0 * rng.normal(size=(WALLS, 2))])
    problem = build_problem(drive, Settings(robust=False))
    wheels = problem.wheel_table(np.zeros(len(problem.parameters)))
    fixes = next(t for t in problem.tables if t.sensor == "fixes")
    fix_at = {int(k): r for k, r in zip(fixes.first, rows_of(fixes), strict=True)}
    steps = rows_of(wheels)
    root = np.diag(1.0 / np.array(WALL_SIGMA))[None]
    graph = IncrementalGraph(3, np.full(len(problem.parameters), 1e-5))
    state = problem.states[0].copy()
    state[:3] = truth[0]
    tight = prior_table(state, np.zeros(3), np.diag([1e3] * 3 + [30.0] * 3))
    graph.start(0.0, 0, state, rows_of(tight))
    graph.update()
    seconds = np.zeros(keyframes - 1)
    for k in range(1, keyframes):
        ids = (np.arange(SEEN) * STRIDE + k // DWELL) % WALLS
        rows = [steps[k - 1], *([fix_at[k]] if k in fix_at else [])]
        table = FactorTable(
            Kind.WALL,
            "walls",
            np.full(SEEN, k),
            np.array([_sight(walls[i], truth[k], rng) for i in ids]),
            np.tile(root, (SEEN, 1, 1)),
            slice(0, 0),
            second=ids,
        )
        begin = time.perf_counter()
        guess = graph.state(k - 1)
        guess[:3] = compose(guess[:3], wheels.measurements[k - 1, :3])
        graph.add(0.1 * k, k, guess, rows)
        for i in ids.tolist():
            if not graph.has_landmark(i):
                graph.add_landmark(i, np.array([walls[i, 0], 0.0]))
        graph.add_rows(rows_of(table))
        graph.update()
        graph.state(k)
        seconds[k - 1] = time.perf_counter() - begin
    return seconds


RUN: dict[str, Callable[[Drive], Floats]] = {
    "online": _online,
    "isam2": _isam2,
    "native": _native,
    "walls": _walls,
}


def _contest(name: str, keyframes: int) -> dict[str, float]:
    """Run one contestant in this process and return its figures."""
    keyframes = keyframes // 5 if name in ("walls", *SLAM) else keyframes
    if name in SLAM:
        scans = ring_drive(SLAM[name], keyframes / 10.0)
        localise_scans(ring_drive(SLAM[name], SETTLE / 10.0))
        gc.collect()
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        seconds = localise_scans(scans)[SETTLE:] * 1e3
    else:
        drive = bench_drive(keyframes, fix_every=FIX_EVERY)
        RUN[name](bench_drive(SETTLE, fix_every=FIX_EVERY))  # loads and compiles outside the clock
        gc.collect()
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        seconds = RUN[name](drive)[SETTLE:] * 1e3
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    tenth = seconds.size // 10
    first, last = seconds[:tenth], seconds[-tenth:]
    return {
        "median_ms": float(np.median(seconds)),
        "p99_ms": float(np.quantile(seconds, 0.99)),
        "max_ms": float(seconds.max()),
        "mean_ms": float(seconds.mean()),
        "growth": float(last.mean() / first.mean()),
        "added_mb": (after - before) / 1024,
    }


def main(arguments: list[str]) -> int:
    """Run all contestants and print the table; or one, as JSON, for the parent process."""
    if len(arguments) == 2 and arguments[0] in CONTESTANTS:
        print(json.dumps(_contest(arguments[0], int(arguments[1]))))
        return 0
    keyframes = int(arguments[0]) if arguments else 50_000
    print(f"online, {keyframes} keyframes at 10 Hz, a fix every second, window {LAG_S:g} s")
    print(
        f"{'':8}{'median ms':>11}{'p99 ms':>9}{'max ms':>9}{'mean ms':>9}{'last/first tenth':>18}"
        f"{'added MB':>10}{'median ratio':>14}"
    )
    rows = {}
    for name in CONTESTANTS:
        command = [sys.executable, "-m", "fgloc.experiments.bench_online", name, str(keyframes)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        rows[name] = json.loads(done.stdout)
    for name, row in rows.items():
        print(
            f"{name:8}{row['median_ms']:11.3f}{row['p99_ms']:9.3f}{row['max_ms']:9.2f}"
            f"{row['mean_ms']:9.3f}{row['growth']:18.2f}{row['added_mb']:10.1f}"
            f"{row['median_ms'] / rows['native']['median_ms']:14.2f}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
