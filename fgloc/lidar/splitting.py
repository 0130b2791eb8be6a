"""Cut one scan into straight pieces: the cut of least cost, exactly and without a random draw.

In polar coordinates a line is linear in two numbers: 1/r = A cos a + B sin a. The inverse range
of a beam has a known noise, so how well a run of beams fits one line is a chi-square in closed
form. Of all ways to cut a scan, `split` finds the one with the least sum of

    chi-square of the pieces + `penalty` a piece + `clutter` a beam that is in none

by dynamic programming, with candidates dropped that can no longer win (Killick, Fearnhead,
Eckley: Optimal detection of changepoints with a linear computational cost, 2012). A recursive
end-point split asks the same of single points; asking it of all points of a piece is what tells
a corner from noise of 6 cm.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats, Stamps

STEEPEST = 20.0
"""Largest tangent of the angle between a beam and a wall's normal that noise is adapted to."""
SLOPE_BEAMS = 4
"""Beams to each side that tell how obliquely a beam meets its wall."""


@compiled
def gather(
    points: Floats,
    valid: npt.NDArray[np.bool_],
    turn: bool,
    beam: Stamps,
    x: Floats,
    y: Floats,
) -> int:
    """Write the valid beams of a scan and their points in order, and return how many there are.

    A full turn begins behind the largest jump of the range, so that few walls lie across the
    seam.
    """
    n = 0
    for b in range(valid.size):
        if valid[b]:
            beam[n] = b
            n += 1
    start = 0
    if turn and n > 1:
        largest = 0.0
        for k in range(n):
            i, j = beam[k - 1 if k > 0 else n - 1], beam[k]
            near = np.hypot(points[i, 0], points[i, 1])
            far = np.hypot(points[j, 0], points[j, 1])
            jump = abs(far - near) / min(far, near)
            if jump > largest:
                largest, start = jump, k
    for k in range(n):
        i = (k + start) % n
        x[k], y[k] = points[beam[i], 0], points[beam[i], 1]
    if start > 0:
        turned = np.empty(n, np.int64)
        for k in range(n):
            turned[k] = beam[(k + start) % n]
        for k in range(n):
            beam[k] = turned[k]
    return n


@compiled
def prepare(
    n: int,
    beam: Stamps,
    x: Floats,
    y: Floats,
    beams: int,
    noise: Floats,
    most_missing: int,
    r: Floats,
    breaks: npt.NDArray[np.bool_],
    weight: Floats,
) -> None:
    """Fill ranges, breaks before a beam, and the weight of 1/r of each beam.

    noise = (range sigma, its share, bearing sigma, roughness). How obliquely a beam meets its
    wall is taken from the flatter side of its neighbourhood.
    """
    for k in range(n):
        r[k] = np.hypot(x[k], y[k])
        breaks[k] = k == 0 or (beam[k] - beam[k - 1]) % beams > most_missing + 1
    for k in range(n):
        slope = STEEPEST
        for side in range(2):
            i = k
            step = 1 if side == 0 else -1
            for _ in range(SLOPE_BEAMS):
                j = i + step
                if j < 0 or j >= n or breaks[max(i, j)]:
                    break
                i = j
            if i != k:
                across = abs(x[k] * y[i] - y[k] * x[i])
                along = abs(r[i] - r[k]) * 0.5 * (r[i] + r[k])
                if along < slope * across:
                    slope = along / across
        if slope == STEEPEST and noise[2] == 0.0 and noise[3] == 0.0:
            slope = 0.0
        variance = (
            noise[0] ** 2
            + (noise[1] * r[k]) ** 2
            + (noise[2] * r[k] * slope) ** 2
            + noise[3] ** 2 * (1.0 + slope * slope)
        )
        weight[k] = r[k] ** 4 / variance


@compiled
def split(
    n: int,
    x: Floats,
    y: Floats,
    r: Floats,
    breaks: npt.NDArray[np.bool_],
    weight: Floats,
    penalty: float,
    clutter: float,
    work: Floats,
    before: Stamps,
    label: Stamps,
) -> int:
    """Write the piece of each of n beams (-1: none) into `label`; return how many pieces.

    `work` is (9, n + 1) and `before` (n + 1,) of scratch. O(n · candidates), a few to some dozens.
    """
    least, start = work[0], work[1]
    m11, m12, m22, b1, b2, zz, so_far = (
        work[2],
        work[3],
        work[4],
        work[5],
        work[6],
        work[7],
        work[8],
    )
    least[0] = 0.0
    candidates = 0
    for j in range(n):
        if breaks[j]:
            candidates = 0
        start[candidates] = j
        m11[candidates] = m12[candidates] = m22[candidates] = 0.0
        b1[candidates] = b2[candidates] = zz[candidates] = 0.0
        candidates += 1
        inverse, w = 1.0 / r[j], weight[j]
        cj, sj = x[j] * inverse, y[j] * inverse
        whole = w * inverse * inverse
        best, chosen = least[j] + clutter, -1
        for k in range(candidates):
            i = int(start[k])
            # In axes along the candidate's first beam the sums keep their digits.
            ci, si = x[i] / r[i], y[i] / r[i]
            c, s = cj * ci + sj * si, sj * ci - cj * si
            m11[k] += w * c * c
            m12[k] += w * c * s
            m22[k] += w * s * s
            b1[k] += w * inverse * c
            b2[k] += w * inverse * s
            zz[k] += whole
            misfit = 0.0
            if j > i + 1:
                det = m11[k] * m22[k] - m12[k] * m12[k]
                if det > 0.0:
                    explained = (
                        b1[k] * b1[k] * m22[k]
                        - 2.0 * b1[k] * b2[k] * m12[k]
                        + b2[k] * b2[k] * m11[k]
                    ) / det
                    misfit = max(0.0, zz[k] - explained)
            so_far[k] = least[i] + misfit
            if so_far[k] + penalty < best:
                best, chosen = so_far[k] + penalty, i
        least[j + 1] = best
        before[j + 1] = chosen
        kept = 0
        for k in range(candidates):
            if so_far[k] <= best:
                start[kept] = start[k]
                m11[kept], m12[kept], m22[kept] = m11[k], m12[k], m22[k]
                b1[kept], b2[kept], zz[kept] = b1[k], b2[k], zz[k]
                kept += 1
        candidates = kept
    pieces = 0
    j = n
    while j > 0:
        i = before[j]
        if i < 0:
            label[j - 1] = -1
            j -= 1
        else:
            for k in range(i, j):
                label[k] = pieces
            pieces += 1
            j = i
    # From the end to the front: turn the numbers round.
    for k in range(n):
        if label[k] >= 0:
            label[k] = pieces - 1 - label[k]
    return pieces
