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

    `work` (9, n + 1 or more) and `before` (n + 1 or more,) are scratch. O(n · candidates): those
    are the beams of the wall at hand and few others.
    """
    ux, uy, r, weight, label = beams.ux, beams.uy, beams.r, beams.weight, beams.label
    n = r.size
    least, start, so_far = work[0], work[1], work[2]
    m11, m12, m22, b1, b2, zz = work[3], work[4], work[5], work[6], work[7], work[8]
    least[0] = 0.0
    candidates = 0
    for j in range(n):
        if beams.breaks[j]:
            candidates = 0
        start[candidates] = j
        m11[candidates] = m12[candidates] = m22[candidates] = 0.0
        b1[candidates] = b2[candidates] = zz[candidates] = 0.0
        candidates += 1
        inverse, w = 1.0 / r[j], weight[j]
        whole = w * inverse * inverse
        best, chosen = least[j] + clutter, -1
        for k in range(candidates):
            i = int(start[k])
            # In axes along the candidate's first beam the sums keep their digits.
            c, s = ux[j] * ux[i] + uy[j] * uy[i], uy[j] * ux[i] - ux[j] * uy[i]
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
