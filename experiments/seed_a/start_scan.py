"""Evidence on Model 3's circle: which starts of the track lead to the printed errors?

The seed prints neither the initial track nor its variance. Both are scanned: the two printed
numbers of the circle, 0.188 m with noise (Table 3.5) and 0.532 m with slip (Table 3.6), must come
from one start.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

TRACKS = tuple(round(0.48 + 0.04 * k, 2) for k in range(13))
"""Initial tracks [m], from L to 2 L."""
SIGMAS = (0.0, *(float(s) for s in np.geomspace(1e-4, 0.5, 32)))
"""Initial sigmas of the track [m]."""
PRINTED = (0.188, 0.532)
"""Errors of the circle in Tables 3.5 and 3.6 [m]."""
NOISE_SEEDS = (1, 2, 3)
"""Draws of the noise; their median error counts."""
SLIPS = ("slip20", "slip40ticks")
"""Kinds of slip that Table 3.6 might be of."""


@dataclass(frozen=True)
class Start:
    """What one start leads to in the circle."""

    track: float
    """Initial track [m]."""
    sigma: float
    """Its initial sigma [m]."""
    noise: float
    """Error at the end with noise [m]."""
    slip: tuple[float, float]
    """Errors at the end with a slip of 20 % and of 40 counts [m]."""

    @property
    def miss(self) -> float:
        """Return how far the start is from giving both printed errors [m], with either slip."""
        return min(max(abs(self.noise - PRINTED[0]), abs(s - PRINTED[1])) for s in self.slip)


def scan(track: float) -> list[Start]:
    """Return the errors of all initial sigmas at one initial track; some 200 runs of Model 3."""
    from fgloc.datasets.registry import load_drive
    from fgloc.filters.model3 import Model3, Model3Settings

    name = "sim:seed-a-circle-{}?nominal_track={:g}&seed={}"
    noisy = [load_drive(name.format("noise", track, seed)) for seed in NOISE_SEEDS]
    slipping = [load_drive(name.format(slip, track, 1)) for slip in SLIPS]
    found = []
    for sigma in SIGMAS:
        model = Model3(Model3Settings(track_sigma=sigma))
        ends = []
        for drive in (*noisy, *slipping):
            assert drive.truth is not None
            last = model.estimate(drive).trajectory.poses[-1] - drive.truth.trajectory.poses[-1]
            ends.append(math.hypot(last[0], last[1]))
        n = len(noisy)
        found.append(Start(track, sigma, float(np.median(ends[:n])), (ends[n], ends[n + 1])))
    return found


def plot_scan(starts: list[Start], path: Path) -> Path:
    """Draw where all starts end and where the printed pair lies; return the PNG's path."""
    from matplotlib.colors import Normalize

    from fgloc.report.figures import new_figure, save
    from fgloc.report.plot_experiment import PUBLISHED

    figure = new_figure(10.5, 5.0)
    grid = figure.subplots(1, 2, sharex=True, sharey=True)
    scale = Normalize(min(TRACKS), max(TRACKS))
    for axes, k, name in zip(grid, (0, 1), ("20 %", "40 counts more"), strict=True):
        for track in TRACKS:
            line = [s for s in starts if s.track == track]
            x, y = [s.noise for s in line], [s.slip[k] for s in line]
            axes.plot(x, y, color="#BBBBBB", lw=0.8, zorder=1)
            dots = axes.scatter(x, y, c=[track] * len(x), norm=scale, cmap="viridis", s=14)
        axes.plot(*PRINTED, "*", color=PUBLISHED, ms=16, zorder=3)
        axes.annotate(
            "printed",
            PRINTED,
            xytext=(10, 6),
            textcoords="offset points",
            color=PUBLISHED,
        )
        axes.set_title(f"slip of {name}", fontsize="medium")
        axes.set_xlabel("scenario 2, error at the end [m]")
        axes.grid(alpha=0.3)
    grid[0].set_ylabel("scenario 3, error at the end [m]")
    figure.colorbar(dots, ax=list(grid), label="initial track [m]")
    figure.suptitle("Model 3 in the circle: every initial track and sigma")
    return save(figure, path)
