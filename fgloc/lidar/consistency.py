"""Which loop closures agree with one another: pairs of them and the drive between, as loops.

After Mangelson et al., "Pairwise consistent measurement set maximization" (ICRA 2018): two closures
and the two stretches of path between their ends make a loop that must come back to where it began,
within the covariance of its four parts. A wrong closure disagrees with nearly all others.
"""

from __future__ import annotations

import numpy as np

from fgloc.core.compiled import compiled
from fgloc.core.geometry import wrap_scalar
from fgloc.core.measurements import Floats
from fgloc.lidar.icp import Indices
from fgloc.lidar.surfaces import Mask

AGREE = 16.27
"""Squared Mahalanobis distance of a loop's end from its beginning that is still agreement: 99.9 %
of three degrees of freedom."""
NEIGHBOURS = 150
"""With how many closures before it, in the order of their later scans, each one is compared."""


@compiled
def _add(pose: Floats, inverse: bool, covariance: Floats, total: Floats, spread: Floats) -> None:
    """Append a relative pose to `total`, or its inverse, and its covariance to `spread`.

    The covariance is that of (x, y, heading) in the first frame's axes; `spread` is of the loop's
    small motion in the frame in which the loop begins.
    """
    # A relative pose of x, y, heading as a small motion of its first frame.
    a = np.eye(3)
    a[0, 2], a[1, 2] = pose[1], -pose[0]
    x, y, t = pose[0], pose[1], pose[2]
    if inverse:
        c, s = np.cos(-t), np.sin(-t)
        x, y, t = -(c * pose[0] - s * pose[1]), -(s * pose[0] + c * pose[1]), -t
        # Small motions of the last frame, which is where the inverse begins.
        ad = np.array([[c, -s, y], [s, c, -x], [0.0, 0.0, 1.0]])
        a = ad @ a
    c, s = np.cos(total[2]), np.sin(total[2])
    ad = np.array([[c, -s, total[1]], [s, c, -total[0]], [0.0, 0.0, 1.0]])
    j = ad @ a
    spread += j @ covariance @ j.T
    total[0] += c * x - s * y
    total[1] += s * x + c * y
    total[2] += t


@compiled
def accumulate(steps: Floats, covariance: Floats, poses: Floats) -> Floats:
    """Return (N, 3, 3): covariance of the path to every scan, as a small motion of the map.

    `steps` (N-1, 3), their `covariance` (N-1, 3, 3), `poses` (N, 3) the path. The covariance of a
    stretch is the difference of two entries. O(N).
    """
    out = np.zeros((poses.shape[0], 3, 3))
    total, spread = np.empty(3), np.empty((3, 3))
    for k in range(steps.shape[0]):
        total[:] = poses[k]
        spread[:] = 0.0
        _add(steps[k], False, covariance[k], total, spread)
        out[k + 1] = out[k] + spread
    return out


@compiled
def _stretch(poses: Floats, path: Floats, i: int, j: int, total: Floats, spread: Floats) -> None:
    """Append the path from scan i to scan j, either way in time, to a loop."""
    c, s = np.cos(poses[i, 2]), np.sin(poses[i, 2])
    dx, dy = poses[j, 0] - poses[i, 0], poses[j, 1] - poses[i, 1]
    # From map axes to the loop's: the map's origin seen from scan i, appended to the loop.
    x, y, t = -(c * poses[i, 0] + s * poses[i, 1]), s * poses[i, 0] - c * poses[i, 1], -poses[i, 2]
    ct, st = np.cos(total[2]), np.sin(total[2])
    mx, my, mt = total[0] + ct * x - st * y, total[1] + st * x + ct * y, total[2] + t
    cm, sm = np.cos(mt), np.sin(mt)
    ad = np.array([[cm, -sm, my], [sm, cm, -mx], [0.0, 0.0, 1.0]])
    between = path[j] - path[i] if j > i else path[i] - path[j]
    spread += ad @ between @ ad.T
    x, y, t = c * dx + s * dy, -s * dx + c * dy, poses[j, 2] - poses[i, 2]
    total[0] += ct * x - st * y
    total[1] += st * x + ct * y
    total[2] += t


@compiled
def agreement(
    poses: Floats,
    path: Floats,
    first: Indices,
    second: Indices,
    relative: Floats,
    covariance: Floats,
    neighbours: int,
) -> Floats:
    """Return (C, neighbours) squared Mahalanobis distances of every closure and those before it.

    Column d of row k is its loop with closure k - 1 - d; NaN where there is none. `poses` (N, 3)
    the drifting path, `path` what `accumulate` makes of it. O(C·neighbours).
    """
    count = first.size
    out = np.full((count, neighbours), np.nan)
    total, spread = np.empty(3), np.empty((3, 3))
    for k in range(count):
        for d in range(min(neighbours, k)):
            m = k - 1 - d
            total[:] = 0.0
            spread[:] = 0.0
            _add(relative[k], True, covariance[k], total, spread)
            _stretch(poses, path, first[k], first[m], total, spread)
            _add(relative[m], False, covariance[m], total, spread)
            _stretch(poses, path, second[m], second[k], total, spread)
            total[2] = wrap_scalar(total[2])
            out[k, d] = total @ np.linalg.solve(spread, total)
    return out


def largest_agreeing(distance: Floats) -> Mask:
    """Return a mask (C,) of closures that all agree with one another, as many as a greedy finds.

    `distance` is what `agreement` gives. The closure that disagrees with most others goes first,
    counted as a share of those it was compared with, until none disagrees. O(C·neighbours·bad).
    """
    count, neighbours = distance.shape
    one, other = np.nonzero(distance > AGREE)
    other = one - 1 - other
    k = np.arange(count)
    compared = np.minimum(k, neighbours) + np.minimum(count - 1 - k, neighbours)
    keep = np.ones(count, bool)
    while True:
        live = keep[one] & keep[other]
        bad = np.bincount(one[live], minlength=count) + np.bincount(other[live], minlength=count)
        if not bad.any():
            return keep
        keep[np.argmax(bad / np.maximum(compared, 1))] = False


def supported(distance: Floats, first: Floats, second: Floats, reach: float) -> Mask:
    """Return which closures (C,) have a companion: another one of nearly the same places.

    `first` and `second` (C,) are the path's lengths [m] at the closures' ends; both ends of a
    companion are within `reach` [m], and the two agree.
    """
    has = np.zeros(first.size, bool)
    one, d = np.nonzero(distance <= AGREE)
    other = one - 1 - d
    a, b = np.abs(first[one] - first[other]), np.abs(second[one] - second[other])
    near = (a < reach) & (b < reach)
    has[one[near]] = True
    has[other[near]] = True
    return np.asarray(has)
