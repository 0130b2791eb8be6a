"""Benchmark: what scan matching and loop closure alone make of a drive, beside its truth.

`python -m fgloc.experiments.bench_matching [--data DIR] [DRIVE…]` (default `csail:0`) prints for
each drive with a lidar and a truth: how many scans were used, how far the chain of displacements
drifts, how many closures were found and how many of them are wrong (more than 0.5 m or 3° off, in
directions that their covariance claims to know), and the errors of the path that the closures
straighten, aligned with the truth on SE(2). No wheels but as a first guess, no walls, no graph of
the smoother's.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.geometry import between, chain, compose, wrap
from fgloc.core.measurements import Floats
from fgloc.datasets.registry import load_drive
from fgloc.errors import FglocError
from fgloc.lidar.closures import Closures
from fgloc.lidar.surfaces import Mask
from fgloc.smoothing.front import Front, look_around

WRONG_M, WRONG_RAD, CLAIMED = 0.5, np.radians(3.0), 16.27
"""When a closure is wrong, and the squared sigmas (99.9 % of three degrees of freedom) up to which
its covariance owns up to it."""


def true_poses(drive: Drive, front: Front) -> tuple[Floats, Mask]:
    """Return the used scans' true lidar poses (N, 3), nominal mounting, and a mask of them (N,).

    FglocError where the drive has no truth. Truth is interpolated on SE(2); a scan outside it, or
    in a gap of more than three seconds, is left out.
    """
    if drive.truth is None:
        raise FglocError(f"{drive.name}: there is no truth to compare with")
    truth, at = drive.truth.trajectory, front.scans.stamps_ns
    k = np.clip(np.searchsorted(truth.stamps_ns, at), 1, truth.stamps_ns.size - 1)
    gap = truth.stamps_ns[k] - truth.stamps_ns[k - 1]
    share = (at - truth.stamps_ns[k - 1]) / gap
    step = between(truth.poses[k - 1], truth.poses[k])
    step[:, 2] = wrap(step[:, 2])
    poses = compose(truth.poses[k - 1], step * share[:, None])
    inside = (share >= 0.0) & (share <= 1.0) & (gap < 3e9)
    mount = between(np.array(drive.truth.mount), np.array(front.scans.mount))
    return compose(poses, np.broadcast_to(mount, poses.shape)), inside


def aligned_errors(poses: Floats, truth: Floats) -> tuple[float, float]:
    """Return the rms of position [m] and heading [rad] after the best rotation and shift."""
    a, b = poses[:, :2] - poses[:, :2].mean(axis=0), truth[:, :2] - truth[:, :2].mean(axis=0)
    turn = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    c, s = np.cos(turn), np.sin(turn)
    off = a @ np.array([[c, s], [-s, c]]) - b
    heading = wrap(poses[:, 2] + turn - truth[:, 2])
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1)))), float(np.sqrt(np.mean(heading**2)))


def wrong_closures(closures: Closures, truth: Floats, inside: Mask) -> tuple[int, int, float]:
    """Return how many closures could be judged, how many are wrong, and the median error [m]."""
    judged = inside[closures.first] & inside[closures.second]
    first, second = closures.first[judged], closures.second[judged]
    off = closures.relative[judged] - between(truth[first], truth[second])
    off[:, 2] = wrap(off[:, 2])
    information = np.linalg.inv(closures.covariance[judged])
    squared = np.einsum("ni,nij,nj->n", off, information, off)
    distance = np.hypot(off[:, 0], off[:, 1])
    wrong = (distance > WRONG_M) | (np.abs(off[:, 2]) > WRONG_RAD)
    median = float(np.median(distance)) if distance.size else np.nan
    return int(judged.sum()), int(np.sum(wrong & (squared > CLAIMED))), median


def main(arguments: list[str]) -> int:
    """Print the table; FglocError for drives that cannot be read or have no lidar."""
    parser = argparse.ArgumentParser(prog="fgloc.experiments.bench_matching")
    parser.add_argument("--data", type=Path, default=None)
    parser.add_argument("drives", nargs="*", default=["csail:0"])
    options = parser.parse_args(arguments)
    print(
        f"{'drive':24}{'scans':>7}{'matched':>9}{'chain m':>9}{'deg':>7}"
        f"{'pairs':>7}{'closed':>8}{'wrong':>7}{'error m':>9}{'closed m':>10}{'deg':>7}{'s':>7}"
    )
    for name in options.drives:
        drive = load_drive(name, options.data)
        begin = time.perf_counter()
        front = look_around(drive)
        took = time.perf_counter() - begin
        if front is None:
            raise FglocError(f"{name}: there is no lidar in this drive")
        truth, inside = true_poses(drive, front)
        chained = chain(front.chain.relative, np.zeros(3))
        before = aligned_errors(chained[inside], truth[inside])
        after = aligned_errors(front.closures.poses[inside], truth[inside])
        judged, wrong, median = wrong_closures(front.closures, truth, inside)
        print(
            f"{name:24}{inside.size:7}{front.chain.matched.mean():9.1%}{before[0]:9.3f}"
            f"{np.degrees(before[1]):7.2f}{front.closures.compared:7}{judged:8}{wrong:7}"
            f"{median:9.3f}{after[0]:10.3f}{np.degrees(after[1]):7.2f}{took:7.1f}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
