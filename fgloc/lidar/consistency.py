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
def _adjoint(x: float, y: float, t: float, out: Floats) -> None:
    """Write the matrix that takes small motions of a frame at (x, y, t) to those of its map."""
    c, s = np.cos(t), np.sin(t)
    out[0, 0], out[0, 1], out[0, 2] = c, -s, y
    out[1, 0], out[1, 1], out[1, 2] = s, c, -x
    out[2, 0], out[2, 1], out[2, 2] = 0.0, 0.0, 1.0


@compiled
def _carry(j: Floats, covariance: Floats, spread: Floats) -> None:
    """Add j·covariance·jᵀ to `spread`; by loops, which compile in a tenth of the time."""
    for a in range(3):
        for b in range(3):
            total = 0.0
            for c in range(3):
                for d in range(3):
                    total += j[a, c] * covariance[c, d] * j[b, d]
            spread[a, b] += total


@compiled
def _squared(spread: Floats, e: Floats) -> float:
    """Return eᵀ·spread⁻¹·e for a positive definite 3×3, by its Cholesky factor."""
    a = np.sqrt(spread[0, 0])
    b, d = spread[1, 0] / a, spread[2, 0] / a
    c = np.sqrt(spread[1, 1] - b * b)
    f = (spread[2, 1] - d * b) / c
    g = np.sqrt(spread[2, 2] - d * d - f * f)
    u = e[0] / a
    v = (e[1] - b * u) / c
    w = (e[2] - d * u - f * v) / g
    return float(u * u + v * v + w * w)


@compiled
def _add(
    pose: Floats, inverse: bool, covariance: Floats, total: Floats, spread: Floats, work: Floats
) -> None:
    """Append a relative pose to `total`, or its inverse, and its covariance to `spread`.

    The covariance is that of (x, y, heading) in the first frame's axes; `spread` is of the loop's
    small motion in the frame in which the loop begins. `work` (3, 3) is scratch.
    """
    x, y, t = pose[0], pose[1], pose[2]
    c, s = np.cos(total[2]), np.sin(total[2])
    if inverse:
        ci, si = np.cos(t), np.sin(t)
        x, y, t = -(ci * x + si * y), si * pose[0] - ci * y, -t
    mx, my = total[0] + c * x - s * y, total[1] + s * x + c * y
    # The covariance stands at the end of the relative pose, turned as its beginning: where the
    # small motions are those of x, y and of the heading about that end.
    if inverse:
        _adjoint(mx, my, total[2] + t, work)
        # The reference is at (mx, my) now, the end at `total`.
        work[0, 2], work[1, 2] = total[1], -total[0]
    else:
        _adjoint(mx, my, total[2], work)
    _carry(work, covariance, spread)
    total[0], total[1], total[2] = mx, my, total[2] + t


@compiled
def accumulate(steps: Floats, covariance: Floats, poses: Floats) -> Floats:
    """Return (N, 3, 3): covariance of the path to every scan, as a small motion of the map.

    `steps` (N-1, 3), their `covariance` (N-1, 3, 3), `poses` (N, 3) the path. The covariance of a
    stretch is the difference of two entries. O(N).
    """
    out = np.zeros((poses.shape[0], 3, 3))
    total, spread, work = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    for k in range(steps.shape[0]):
        for a in range(3):
            total[a] = poses[k, a]
            for b in range(3):
                spread[a, b] = 0.0
        _add(steps[k], False, covariance[k], total, spread, work)
        for a in range(3):
            for b in range(3):
                out[k + 1, a, b] = out[k, a, b] + spread[a, b]
    return out


@compiled
def _stretch(
    poses: Floats, path: Floats, i: int, j: int, total: Floats, spread: Floats, work: Floats
) -> None:
    """Append the path from scan i to scan j, either way in time, to a loop."""
    c, s = np.cos(poses[i, 2]), np.sin(poses[i, 2])
    # From map axes to the loop's: the map's origin seen from scan i, appended to the loop.
    x, y, t = -(c * poses[i, 0] + s * poses[i, 1]), s * poses[i, 0] - c * poses[i, 1], -poses[i, 2]
    ct, st = np.cos(total[2]), np.sin(total[2])
    _adjoint(total[0] + ct * x - st * y, total[1] + st * x + ct * y, total[2] + t, work)
    low, high = min(i, j), max(i, j)
    _carry(work, path[high] - path[low], spread)
    dx, dy = poses[j, 0] - poses[i, 0], poses[j, 1] - poses[i, 1]
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
    total, spread, work = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    for k in range(count):
        for d in range(min(neighbours, k)):
            m = k - 1 - d
            for a in range(3):
                total[a] = 0.0
                for b in range(3):
                    spread[a, b] = 0.0
            _add(relative[k], True, covariance[k], total, spread, work)
            _stretch(poses, path, first[k], first[m], total, spread, work)
            _add(relative[m], False, covariance[m], total, spread, work)
            _stretch(poses, path, second[m], second[k], total, spread, work)
            total[2] = wrap_scalar(total[2])
            out[k, d] = _squared(spread, total)
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
