"""Benchmark: the batch smoother beside GTSAM's own optimizer on the same chain, in one run.

`python -m fgloc.experiments.bench_batch [KEYFRAMES [CONTESTANT ...]]` drives a simulated
differential robot for that many keyframes, with one calibration vector and a position fix every
hundred keyframes. Contestants:

- arrow: this project's smoother with its specialised elimination (calibration estimated);
- gtsam: the same smoother, eliminated by GTSAM (calibration estimated);
- native: GTSAM's LevenbergMarquardtOptimizer with METIS on BetweenFactorPose2 and
  PoseTranslationPrior2D, the calibration fixed at that of the first guess (it has no factor
  for it).

All start from the same first guess, the sweep's, which is timed on a line of its own: native could
not find one. Each runs in a process of its own, so that its peak memory is its own. Printed are
seconds of building the graph and of optimising, iterations, memory, and ratios to native. The
machine's speed cancels in the ratios.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from fgloc.core.bases import differential
from fgloc.core.drive import Drive
from fgloc.core.geometry import EXACT, integrate
from fgloc.core.measurements import Floats, PositionFixes, WheelIncrements
from fgloc.core.robot import Robot
from fgloc.smoothing.build import build_problem
from fgloc.smoothing.minimise import minimise
from fgloc.smoothing.optimise import optimise
from fgloc.smoothing.settings import Settings
from fgloc.smoothing.sweep import sweep

Figures = dict[str, float]

CONTESTANTS = ("arrow", "gtsam", "native")
FIX_EVERY = 100
FIX_SIGMA = 0.02
PERIOD_NS = 100_000_000


def bench_drive(keyframes: int, seed: int = 0, fix_every: int = FIX_EVERY) -> Drive:
    """Return a wandering differential drive of `keyframes` wheel packets, 1 % off calibration.

    With a position fix at every `fix_every`-th packet.
    """
    return bench_drive_with_truth(keyframes, seed, fix_every)[0]


def bench_drive_with_truth(keyframes: int, seed: int, fix_every: int) -> tuple[Drive, Floats]:
    """Return `bench_drive` and the true poses (keyframes, 3), which no contestant is told."""
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
    at = np.arange(0, keyframes, fix_every)
    fixes = PositionFixes(
        "fixes",
        stamps[at],
        poses[at, :2] + rng.normal(0.0, FIX_SIGMA, (at.size, 2)),
        np.full((at.size, 2), FIX_SIGMA),
    )
    wheels = WheelIncrements("wheels", stamps, angles, base.driven_names)
    return Drive("bench", Robot.typical("bench", base), wheels, (fixes,)), poses


def _megabytes() -> float:
    """Return the peak memory of this process so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _guess(drive: Drive, file: Path) -> Figures:
    """Write the first guess, and what native needs of the graph, for the contestants."""
    settings = Settings(robust=False, covariances=False)
    problem = build_problem(drive, settings)
    sweep(problem.window(0, 2000), settings)  # compile outside the clock
    begin = time.perf_counter()
    states, u, iterations = sweep(problem, settings)
    seconds = time.perf_counter() - begin
    wheels = problem.wheel_table(u)
    start, fixes = (
        next(t for t in problem.tables if t.sensor == name) for name in ("start", "fixes")
    )
    np.savez(
        file,
        states=states,
        u=u,
        displacement=problem.displacement(u),
        whitening=wheels.sqrt_information,
        start=start.measurements[0, :3],
        start_whitening=start.sqrt_information[0],
        fixed=fixes.first,
        fixes=fixes.measurements[:, :2],
    )
    return {"sweep_s": seconds, "iterations": iterations}


def _ours(drive: Drive, solver: str, file: Path) -> Figures:
    """Build and optimise with this project's smoother."""
    settings = Settings(
        robust=False, solver="gtsam" if solver == "gtsam" else "arrow", covariances=False
    )
    # Compile outside the clock, on a beginning of the same drive.
    optimise(build_problem(drive, settings).window(0, 200), settings)
    with np.load(file) as guess:
        states, u = guess["states"], guess["u"]
    before = _megabytes()
    begin = time.perf_counter()
    problem = build_problem(drive, settings)
    built = time.perf_counter()
    point, iterations, _ = minimise(problem, settings, states, u, False)
    return {
        "build_s": built - begin,
        "optimise_s": time.perf_counter() - built,
        "iterations": iterations,
        "error": point.cost,
        "added_mb": _megabytes() - before,
    }


def _native(file: Path) -> Figures:
    """Build and optimise GTSAM's own factors for the same chain."""
    import gtsam  # heavy: only in this contestant's process

    with np.load(file) as archive:
        given = dict(archive)
    before = _megabytes()
    begin = time.perf_counter()
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, pose in enumerate(given["states"][:, :3]):
        values.insert(k, gtsam.Pose2(*pose))
    for k, (d, root) in enumerate(zip(given["displacement"], given["whitening"], strict=True)):
        noise = gtsam.noiseModel.Gaussian.SqrtInformation(root)
        graph.add(gtsam.BetweenFactorPose2(k, k + 1, gtsam.Pose2(*d), noise))
    noise = gtsam.noiseModel.Isotropic.Sigma(2, FIX_SIGMA)
    for k, (x, y) in zip(given["fixed"].tolist(), given["fixes"], strict=True):
        graph.add(gtsam.PoseTranslationPrior2D(k, gtsam.Pose2(x, y, 0.0), noise))
    noise = gtsam.noiseModel.Gaussian.SqrtInformation(given["start_whitening"])
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*given["start"]), noise))
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
        "added_mb": _megabytes() - before,
    }


def _contest(name: str, keyframes: int, file: Path) -> Figures:
    """Run one contestant in this process and return its figures, peak memory included."""
    if name == "native":
        figures = _native(file)
    else:
        drive = bench_drive(keyframes)
        figures = _guess(drive, file) if name == "guess" else _ours(drive, name, file)
    return {**figures, "peak_mb": _megabytes()}


def _apart(name: str, keyframes: int, file: Path) -> Figures:
    """Run one contestant in a process of its own."""
    program = [sys.executable, "-m", "fgloc.experiments.bench_batch", name, str(keyframes)]
    done = subprocess.run([*program, str(file)], check=True, capture_output=True, text=True)
    figures: Figures = json.loads(done.stdout)
    return figures


def _print(keyframes: int, guess: Figures, rows: dict[str, Figures]) -> None:
    """Print the table; ratios where native took part."""
    print(f"batch, {keyframes} keyframes, one calibration vector, a fix every {FIX_EVERY}")
    print(
        f"first guess of all (sweep): {guess['sweep_s']:.2f} s, {guess['iterations']:.0f} short "
        f"iterations in windows, peak {guess['peak_mb']:.0f} MB; not in the times below"
    )
    print(
        f"{'':8}{'build s':>9}{'optimise s':>12}{'iterations':>12}{'peak MB':>9}{'added MB':>10}"
        f"{'time ratio':>12}{'optimise ratio':>16}{'memory ratio':>14}"
    )
    native = rows.get("native")
    for name, row in rows.items():
        line = (
            f"{name:8}{row['build_s']:9.2f}{row['optimise_s']:12.2f}{row['iterations']:12.0f}"
            f"{row['peak_mb']:9.0f}{row['added_mb']:10.0f}"
        )
        if native is not None:
            times = [r["build_s"] + r["optimise_s"] for r in (row, native)]
            line += (
                f"{times[0] / times[1]:12.2f}{row['optimise_s'] / native['optimise_s']:16.2f}"
                f"{row['added_mb'] / native['added_mb']:14.2f}"
            )
        print(line)
    print("time ratio: build + optimise, to native's; optimise ratio: to native's optimise;")
    print("memory ratio: what building and optimising add to the peak, to native's.")


def main(arguments: list[str]) -> int:
    """Run contestants and print the table; or one, as JSON, for the parent process."""
    if len(arguments) == 3 and arguments[2].endswith(".npz"):
        print(json.dumps(_contest(arguments[0], int(arguments[1]), Path(arguments[2]))))
        return 0
    keyframes = int(arguments[0]) if arguments else 100_000
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "guess.npz"
        guess = _apart("guess", keyframes, file)
        names = arguments[1:] or CONTESTANTS
        rows = {name: _apart(name, keyframes, file) for name in names}
    _print(keyframes, guess, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
