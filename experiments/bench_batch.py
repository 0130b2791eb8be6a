"""Benchmark: the batch smoother beside GTSAM's own optimizer on the same chain, in one run.

`python -m fgloc.experiments.bench_batch [KEYFRAMES]` drives a simulated differential robot for
that many keyframes, with one calibration vector and a position fix every hundred keyframes. Each
contestant runs in a process of its own, so that its peak memory is its own:

- arrow: this project's smoother with its specialised elimination (calibration estimated);
- gtsam: the same smoother, eliminated by GTSAM with METIS (calibration estimated);
- native: GTSAM's LevenbergMarquardtOptimizer with METIS on BetweenFactorPose2 and
  PoseTranslationPrior2D, the calibration fixed at nominal (it has no factor for it).

Printed are seconds and peak memory of building the graph and of optimising, and the ratios to
native. The machine's speed cancels in the ratios.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time

import numpy as np

from fgloc.core.bases import differential
from fgloc.core.drive import Drive
from fgloc.core.geometry import EXACT, integrate
from fgloc.core.measurements import Floats, PositionFixes, WheelIncrements
from fgloc.core.robot import Robot
from fgloc.smoothing.build import build_problem
from fgloc.smoothing.optimise import optimise
from fgloc.smoothing.problem import Problem
from fgloc.smoothing.settings import Settings
from fgloc.smoothing.sweep import sweep

CONTESTANTS = ("arrow", "gtsam", "native")
FIX_EVERY = 100
FIX_SIGMA = 0.02
PERIOD_NS = 100_000_000


def bench_drive(keyframes: int, seed: int = 0) -> Drive:
    """Return a wandering differential drive of `keyframes` wheel packets, 1 % off calibration."""
    rng = np.random.default_rng(seed)
    base = differential(0.05, 0.05, 0.3)
    true = np.array([0.0503, 0.0499, 0.303])
    n = keyframes - 1
    turn = 0.05 * np.sin(np.arange(n) / 90.0) + rng.normal(0.0, 0.01, n)
    step = np.full(n, 0.03)
    angles = np.stack(
        [(step - turn * true[2] / 2) / true[0], (step + turn * true[2] / 2) / true[1]], axis=1
    )
    poses = integrate(base.displacements(angles, None, true), np.zeros(3), EXACT)
    angles += rng.normal(0.0, 0.004, angles.shape) * np.sqrt(0.05 * np.abs(angles)) / 0.05
    stamps = np.arange(keyframes, dtype=np.int64) * PERIOD_NS
    at = np.arange(0, keyframes, FIX_EVERY)
    fixes = PositionFixes(
        "fixes",
        stamps[at],
        poses[at, :2] + rng.normal(0.0, FIX_SIGMA, (at.size, 2)),
        np.full((at.size, 2), FIX_SIGMA),
    )
    wheels = WheelIncrements("wheels", stamps, angles, base.driven_names)
    return Drive("bench", Robot.typical("bench", base), wheels, (fixes,))


def _ours(drive: Drive, solver: str) -> dict[str, float]:
    """Build and optimise with this project's smoother."""
    settings = Settings(
        robust=False, solver="gtsam" if solver == "gtsam" else "arrow", covariances=False
    )
    # Compile outside the clock, on a beginning of the same drive.
    optimise(build_problem(drive, settings).window(0, 200), settings)
    begin = time.perf_counter()
    problem = build_problem(drive, settings)
    built = time.perf_counter()
    solution = optimise(problem, settings)
    return {
        "build_s": built - begin,
        "optimise_s": time.perf_counter() - built,
        "iterations": solution.iterations,
        "error": solution.point.cost,
    }


def _native(drive: Drive) -> dict[str, float]:
    """Build and optimise GTSAM's own factors for the same chain, calibration at nominal."""
    import gtsam  # heavy: only in this contestant's process

    problem: Problem = build_problem(drive, Settings(robust=False))
    wheels = problem.wheel_table(np.zeros(len(problem.parameters)))
    displacement: Floats = wheels.measurements[:, :3]
    # The smoother finds its own first guess (inside its clock); native is given the same one.
    guess, _, _ = sweep(problem, Settings(robust=False))
    begin = time.perf_counter()
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, pose in enumerate(guess[:, :3]):
        values.insert(k, gtsam.Pose2(*pose))
    for k, d in enumerate(displacement):
        noise = gtsam.noiseModel.Gaussian.SqrtInformation(wheels.sqrt_information[k])
        graph.add(gtsam.BetweenFactorPose2(k, k + 1, gtsam.Pose2(*d), noise))
    for table in problem.tables:
        if table.sensor == "fixes":
            noise = gtsam.noiseModel.Isotropic.Sigma(2, FIX_SIGMA)
            for k, m in zip(table.first.tolist(), table.measurements, strict=True):
                pose = gtsam.Pose2(m[0], m[1], 0.0)
                graph.add(gtsam.PoseTranslationPrior2D(k, pose, noise))
        else:
            noise = gtsam.noiseModel.Gaussian.SqrtInformation(table.sqrt_information[0])
            graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*table.measurements[0, :3]), noise))
    built = time.perf_counter()
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setOrderingType("METIS")
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters)
    optimizer.optimize()
    return {
        "build_s": built - begin,
        "optimise_s": time.perf_counter() - built,
        "iterations": optimizer.iterations(),
        "error": optimizer.error(),
    }


def _contest(name: str, keyframes: int) -> dict[str, float]:
    """Run one contestant in this process and return its figures, peak memory included."""
    drive = bench_drive(keyframes)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    figures = _native(drive) if name == "native" else _ours(drive, name)
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {**figures, "peak_mb": after / 1024, "added_mb": (after - before) / 1024}


def main(arguments: list[str]) -> int:
    """Run all contestants and print the table; or one, as JSON, for the parent process."""
    if len(arguments) == 2 and arguments[0] in CONTESTANTS:
        print(json.dumps(_contest(arguments[0], int(arguments[1]))))
        return 0
    keyframes = int(arguments[0]) if arguments else 100_000
    rows: dict[str, dict[str, float]] = {}
    for name in CONTESTANTS:
        command = [sys.executable, "-m", "fgloc.experiments.bench_batch", name, str(keyframes)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        rows[name] = json.loads(done.stdout)
    native = rows["native"]
    total = native["build_s"] + native["optimise_s"]
    print(f"batch, {keyframes} keyframes, one calibration vector, a fix every {FIX_EVERY}")
    print(
        f"{'':8}{'build s':>9}{'optim. s':>10}{'steps':>7}{'peak MB':>9}{'added MB':>10}"
        f"{'time ratio':>12}{'optim. ratio':>14}{'memory ratio':>14}"
    )
    for name, row in rows.items():
        ours = row["build_s"] + row["optimise_s"]
        print(
            f"{name:8}{row['build_s']:9.2f}{row['optimise_s']:10.2f}{row['iterations']:7.0f}"
            f"{row['peak_mb']:9.0f}{row['added_mb']:10.0f}{ours / total:12.2f}"
            f"{ours / native['optimise_s']:14.2f}{row['peak_mb'] / native['peak_mb']:14.2f}"
        )
    print("time ratio: build + optimise, ours to native; optim. ratio: ours in full to")
    print("native's optimise alone; memory ratio: peak of the whole process.")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
