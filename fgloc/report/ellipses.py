"""Uncertainty that can be seen: ellipses and bands, magnified by a round number where tiny."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fgloc.core.measurements import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIGMAS_95 = 2.4477
"""Half axes of a plane 95 % ellipse in standard deviations: the root of chi² 5.991, 2 degrees."""
MAGNIFICATIONS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)


def magnification(typical: float, wanted: float) -> int:
    """Return how many times to enlarge what is `typical` large, so that it is about `wanted`.

    The largest of MAGNIFICATIONS that does not go beyond; 1 for what is large enough.
    """
    ratio = wanted / typical if typical > 0.0 else 1.0
    return max((m for m in MAGNIFICATIONS if m <= max(ratio, 1.0)), default=1)


def reduction(typical: float, most: float) -> int:
    """Return by what to divide what is `typical` large, so that it is at most `most`.

    The smallest of MAGNIFICATIONS that does; 1 for what is small enough.
    """
    return min((m for m in MAGNIFICATIONS if m * most >= typical), default=MAGNIFICATIONS[-1])


def enlarged(text: str, times: int, divisor: int = 1) -> str:
    """Return a legend's text that says how many times as large, or as small, things are drawn."""
    if divisor > 1:
        return f"{text} (drawn at 1/{divisor})"
    return text + (f" (drawn {times}× as large)" if times > 1 else "")


def ellipse_axes(covariances: Floats) -> tuple[Floats, Floats, Floats]:
    """Return half axes [m] of 95 % ellipses, the long and the short one, and where the long points.

    `covariances` are (..., 2, 2) of x, y; the direction [rad] is counter-clockwise from x.
    """
    values, vectors = np.linalg.eigh(covariances)
    half = SIGMAS_95 * np.sqrt(np.maximum(values, 0.0))
    return half[..., 1], half[..., 0], np.arctan2(vectors[..., 1, 1], vectors[..., 0, 1])


def ellipse_outlines(positions: Floats, covariances: Floats, corners: int = 32) -> Floats:
    """Return (N, corners + 1, 2) closed outlines of 95 % ellipses in map axes [m], in true size."""
    long, short, angle = (a[:, None] for a in ellipse_axes(covariances))
    turn = np.linspace(0.0, 2.0 * np.pi, corners + 1)
    u, v = long * np.cos(turn), short * np.sin(turn)
    x = positions[:, :1] + np.cos(angle) * u - np.sin(angle) * v
    y = positions[:, 1:] + np.sin(angle) * u + np.cos(angle) * v
    return np.stack([x, y], axis=-1)


def draw_ellipses(
    axes: Axes, positions: Floats, covariances: Floats, wanted: float, shade: str, label: str
) -> None:
    """Draw 95 % ellipses of (x, y), enlarged so that the typical one is `wanted` [m] across.

    `positions` are (N, 2), `covariances` (N, 2, 2) in map axes; the legend gets `label`, with
    the magnification.
    """
    from matplotlib.collections import EllipseCollection

    long, short, angle = ellipse_axes(covariances)
    times = magnification(2.0 * float(np.median(long)), wanted)
    axes.add_collection(
        EllipseCollection(
            2.0 * times * long,
            2.0 * times * short,
            np.degrees(angle),
            units="xy",
            offsets=positions,
            offset_transform=axes.transData,
            facecolors=(shade, 0.2),
            edgecolors=(shade, 0.9),
            linewidths=0.9,
            zorder=3,
        )
    )
    text = enlarged(label, times)
    axes.plot([], [], "o", mfc=(shade, 0.2), mec=shade, ms=9, label=text)
