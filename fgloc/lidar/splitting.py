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

from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats, Stamps
from fgloc.lidar.beams import Beams


@compiled
def split(beams: Beams, penalty: float, clutter: float, work: Floats, before: Stamps) -> int:
    """Write the piece of each of n beams (-1: none) into its label; return how many pieces.

    `work` (12, n + 1 or more) and `before` (n + 1 or more,) are scratch. O(n · candidates): those
    are the beams of the wall at hand and few others.
    """
    ux, uy, r, weight, label = beams.ux, beams.uy, beams.r, beams.weight, beams.label
    n = r.size
    least, so_far = work[0], work[1]
    # Of each candidate: first beam, least cost before it, that beam's direction, and sums.
    start, paid, cx, cy = work[2], work[3], work[4], work[5]
    m11, m12, m22, b1, b2, zz = work[6], work[7], work[8], work[9], work[10], work[11]
    least[0] = 0.0
    candidates = 0
    for j in range(n):
        if beams.breaks[j]:
            candidates = 0
        k = candidates
        start[k], paid[k], cx[k], cy[k] = j, least[j], ux[j], uy[j]
        m11[k] = m12[k] = m22[k] = b1[k] = b2[k] = zz[k] = 0.0
        candidates += 1
        w, inverse = weight[j], 1.0 / r[j]
        x, y, wz = ux[j], uy[j], w * inverse
        wzz = wz * inverse
        for k in range(candidates):
            # In axes along the candidate's first beam the sums keep their digits.
            c, s = x * cx[k] + y * cy[k], y * cx[k] - x * cy[k]
            wc, ws = w * c, w * s
            a11, a12, a22 = m11[k] + wc * c, m12[k] + wc * s, m22[k] + ws * s
            d1, d2, dz = b1[k] + wz * c, b2[k] + wz * s, zz[k] + wzz
            m11[k], m12[k], m22[k], b1[k], b2[k], zz[k] = a11, a12, a22, d1, d2, dz
            det = a11 * a22 - a12 * a12
            explained = d1 * d1 * a22 - 2.0 * d1 * d2 * a12 + d2 * d2 * a11
            misfit = dz - explained / det
            # Also where det is zero: a single beam.
            so_far[k] = paid[k] + (misfit if misfit > 0.0 and det > 0.0 else 0.0)
        best, chosen = least[j] + clutter, -1
        for k in range(candidates):
            if so_far[k] + penalty < best:
                best, chosen = so_far[k] + penalty, int(start[k])
        least[j + 1] = best
        before[j + 1] = chosen
        kept = 0
        for k in range(candidates):
            if so_far[k] <= best:
                if kept < k:
                    start[kept], paid[kept], cx[kept], cy[kept] = start[k], paid[k], cx[k], cy[k]
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
