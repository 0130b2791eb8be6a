"""Benchmark: the unscented filter of Model 3 beside filterpy's on the same data, in one run.

`python -m fgloc.experiments.bench_filters [PACKETS]` drives a simulated skid-steer robot for that
many wheel packets (default 100,000) and prints steps per second of

- model3: `Model3().estimate`, everything from a drive to a result, the kernels compiled before;
- filterpy: `predict` and `update` of its UnscentedKalmanFilter with Python functions for the
  model, on the first packets only, since it is slow; needs the extra `dev`.

The machine's speed cancels in the ratio of the two. `filterpy_filter` is also what the tests hold
Model 3 to, step by step.
"""

from __future__ import annotations

import math
import sys
import time
from typing import Any

import numpy as np

from fgloc.core.bases import skid_steer
from fgloc.core.drive import Drive
from fgloc.core.geometry import wrap
from fgloc.core.measurements import Floats, WheelIncrements, Yaw
from fgloc.core.robot import Robot
from fgloc.errors import FglocError
from fgloc.filters.model3 import Model3, Model3Settings

RADIUS = 0.135
NOMINAL_TRACK = 0.48
TRUE_TRACK = 0.75
PACKETS = 100_000
FILTERPY_PACKETS = 2000
"""So many steps take filterpy about a second."""
REPEATS = 5
"""The fastest run counts: others share the machine."""
PERIOD_NS = 200_000_000
YAW_SIGMA = 0.03


def varied_drive(packets: int, seed: int) -> Drive:
    """Return straights, turns both ways through ±π, spins and rests of 2 s each at 5 Hz.

    All four wheels and the yaw (wrapped, its zero 2 rad off) are noisy; the true effective track
    is 0.75 m, the nominal one 0.48 m. There is no truth: the drive starts at the origin.
    """
    rng = np.random.default_rng(seed)
    manners = np.array([[4.0, 4.0], [5.0, 1.5], [-2.0, 2.0], [0.0, 0.0], [1.0, 4.0], [-3.0, -1.0]])
    chosen = np.repeat(rng.integers(0, len(manners), packets // 10 + 1), 10)[:packets]
    sides = 0.2 * manners[chosen]
    turned = np.cumsum(RADIUS * (sides[:, 1] - sides[:, 0]) / TRUE_TRACK)
    readings = 2.0 + np.append(0.0, turned) + rng.normal(0.0, YAW_SIGMA, packets + 1)
    base = skid_steer(
        ("fl", "rl"), ("fr", "rr"), RADIUS, NOMINAL_TRACK, order=("fl", "fr", "rl", "rr")
    )
    stamps = np.arange(packets + 1, dtype=np.int64) * PERIOD_NS
    angles = np.tile(sides, (1, 2)) + rng.normal(0.0, 0.02, (packets, 4))
    return Drive(
        "varied",
        Robot.typical("Jaguar 4x4", base),
        WheelIncrements("wheels", stamps, angles, base.driven_names),
        (Yaw("yaw", stamps, wrap(readings), YAW_SIGMA),),
    )


def side_ways(drive: Drive) -> Floats:
    """Return the (N, 2) ways of the left and the right side [m]: means over fl, rl and fr, rr."""
    ways = RADIUS * drive.wheels.angles
    return 0.5 * (ways[:, :2] + ways[:, 2:])


def filterpy_filter(settings: Model3Settings, start_sigma: float, track_sigma: float) -> Any:
    """Return filterpy's UnscentedKalmanFilter with Model 3's equations, at the origin.

    Its `predict` takes `left` and `right` [m], its `update` a heading [rad] as an array of one.
    Raises FglocError where filterpy is not installed.
    """
    try:
        from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
    except ImportError:
        raise FglocError(
            "filterpy is not installed; it comes with pip install 'fgloc[dev]'"
        ) from None

    def difference(a: Floats, b: Floats) -> Floats:
        d = np.subtract(a, b)
        d[2] = wrap(d[2])
        return d

    def mean(points: Floats, weights: Floats) -> Floats:
        m = weights @ points
        m[2] = math.atan2(weights @ np.sin(points[:, 2]), weights @ np.cos(points[:, 2]))
        return np.asarray(m)

    def mean_heading(points: Floats, weights: Floats) -> Floats:
        h = points[:, 0]
        return np.array([math.atan2(weights @ np.sin(h), weights @ np.cos(h))])

    def move(s: Floats, dt: float, left: float, right: float) -> Floats:
        turn = (right - left) / s[3]
        way, along = (right + left) / 2.0, s[2] + turn / 2.0
        step = np.array([way * math.cos(along), way * math.sin(along), turn, 0.0])
        return np.asarray(s + step)

    ukf = UnscentedKalmanFilter(
        4,
        1,
        PERIOD_NS * 1e-9,
        hx=lambda s: s[2:3],
        fx=move,
        points=MerweScaledSigmaPoints(4, settings.alpha, settings.beta, settings.kappa),
        x_mean_fn=mean,
        z_mean_fn=mean_heading,
        residual_x=difference,
        residual_z=lambda a, b: wrap(np.subtract(a, b)),
        state_add=np.add,
    )
    ukf.x = np.array([0.0, 0.0, 0.0, NOMINAL_TRACK])
    ukf.P = np.diag(np.array([start_sigma, start_sigma, start_sigma, track_sigma]) ** 2)
    ukf.Q = np.diag(
        [
            settings.x_variance,
            settings.y_variance,
            settings.heading_variance,
            settings.track_variance,
        ]
    )
    ukf.R = np.array([[settings.yaw_variance]])
    return ukf


def filterpy_step(ukf: Any, left: float, right: float, heading: Floats) -> None:
    """Predict by the ways of both sides [m] and correct by a heading (1,) [rad]."""
    ukf.predict(left=left, right=right)
    # filterpy 2.0 has drawn points anew by itself; 1.4.5 would use those without process noise.
    ukf.sigmas_f = ukf.points_fn.sigma_points(ukf.x, ukf.P)
    ukf.update(heading)


def model3_rate(drive: Drive) -> float:
    """Return how many packets a second Model 3 takes, from the drive to the result."""
    Model3().estimate(drive)
    seconds = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        Model3().estimate(drive)
        seconds.append(time.perf_counter() - begin)
    return float(drive.wheels.angles.shape[0] / min(seconds))


def filterpy_rate(drive: Drive, packets: int) -> float:
    """Return how many of the first `packets` a second filterpy takes."""
    (yaw,) = drive.each(Yaw)
    ways = side_ways(drive)[:packets]
    headings = wrap(yaw.yaw - yaw.yaw[0])[1:, None]
    seconds = []
    for _ in range(2):
        ukf = filterpy_filter(Model3Settings(), 1e-4, 0.168)
        begin = time.perf_counter()
        for k in range(len(ways)):
            filterpy_step(ukf, ways[k, 0], ways[k, 1], headings[k])
        seconds.append(time.perf_counter() - begin)
    return len(ways) / min(seconds)


def main(arguments: list[str]) -> int:
    """Print both rates and their ratio; exit 1 where filterpy is missing."""
    packets = int(arguments[0]) if arguments else PACKETS
    drive = varied_drive(packets, 0)
    ours = model3_rate(drive)
    print(f"unscented filter, 4 states, {packets} wheel packets with a yaw reading each")
    print(f"model3    {ours:12,.0f} steps/s")
    try:
        theirs = filterpy_rate(drive, min(packets, FILTERPY_PACKETS))
    except FglocError as error:
        print(f"fgloc: error: {error}", file=sys.stderr)
        return 1
    print(f"filterpy  {theirs:12,.0f} steps/s")
    print(f"ratio     {ours / theirs:12,.0f}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
