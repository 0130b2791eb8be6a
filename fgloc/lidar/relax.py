"""A plain pose graph of displacements and closures, solved by GTSAM."""

from __future__ import annotations

from typing import Any

import numpy as np

from fgloc.core.geometry import between, wrap
from fgloc.core.measurements import Floats
from fgloc.lidar.icp import Indices


def in_moving_axes(relative: Floats, covariance: Floats) -> Floats:
    """Return covariances (M, 3, 3) of relative poses (M, 3) in the moving frame's axes.

    They come in the reference's, as matching gives them; GTSAM wants the others.
    """
    c, s = np.cos(relative[:, 2]), np.sin(relative[:, 2])
    turn = np.zeros((len(relative), 3, 3))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = c, s, -s, c
    turn[:, 2, 2] = 1.0
    return np.asarray(turn @ covariance @ turn.transpose(0, 2, 1))


def relax(
    poses: Floats,
    steps: tuple[Floats, Floats],
    ends: tuple[Indices, Indices],
    closures: tuple[Floats, Floats],
) -> tuple[Floats, Floats]:
    """Return the relaxed poses (N, 3) and how far each closure is off then, in sigmas (C,).

    `poses` is where it starts; `steps` are displacements (N-1, 3) with covariances, `closures`
    relative poses (C, 3) with covariances between the scans `ends`, all in their first scan's
    axes. Closures have a robust loss: Huber's first, which pulls from however far, then
    Geman–McClure's, so that one which does not fit lets go. The first pose is fixed. About 0.2 ms
    a pose.
    """
    solved = poses
    for robust in ("Huber", "GemanMcClure"):
        solved = _solve(solved, steps, ends, closures, robust)
    off = between(closures[0], between(solved[ends[0]], solved[ends[1]]))
    off[:, 2] = wrap(off[:, 2])
    information = np.linalg.inv(in_moving_axes(*closures))
    return solved, np.sqrt(np.einsum("ni,nij,nj->n", off, information, off))


def _solve(
    poses: Floats,
    steps: tuple[Floats, Floats],
    ends: tuple[Indices, Indices],
    closures: tuple[Floats, Floats],
    loss: str,
) -> Floats:
    """Return the poses (N, 3) that fit best with this loss on the closures."""
    import gtsam

    graph = gtsam.NonlinearFactorGraph()
    values = gtsam.Values()
    for k, pose in enumerate(poses):
        values.insert(k, gtsam.Pose2(*pose))
    fixed = gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*poses[0]), fixed))
    robust = getattr(gtsam.noiseModel.mEstimator, loss).Create(3.0)
    every = np.arange(len(poses))
    for first, second, (relative, covariance), doubted in (
        (every[:-1], every[1:], steps, False),
        (*ends, closures, True),
    ):
        moving = in_moving_axes(relative, covariance)
        for a, b, z, p in zip(first, second, relative, moving, strict=True):
            noise: Any = gtsam.noiseModel.Gaussian.Covariance(p)
            if doubted:
                noise = gtsam.noiseModel.Robust.Create(robust, noise)
            graph.add(gtsam.BetweenFactorPose2(int(a), int(b), gtsam.Pose2(*z), noise))
    parameters = gtsam.LevenbergMarquardtParams()
    # The default ordering recurses as deep as a drive is long.
    parameters.setOrderingType("METIS")
    solved = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    out = np.empty((len(poses), 3))
    for k, _ in enumerate(poses):
        pose = solved.atPose2(k)
        out[k] = pose.x(), pose.y(), pose.theta()
    # Headings come back within half a turn; on they go from where they were.
    out[:, 2] = poses[:, 2] + wrap(out[:, 2] - poses[:, 2])
    return out
