"""Two logs of one drive without a common clock, laid over each other by how the robot turns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fgloc.core.measurements import Floats

LATEST_S = 2.0
"""Largest offset that is looked for [s]."""
FASTEST = 0.03
"""Largest difference of the clocks' rates that is looked for."""
COARSE_S, COARSE_RATE = 0.1, 0.003
"""Steps of the first search: offset [s] and rate."""
GROUP_S = 0.45
"""Turns are compared over stretches about this long [s]; shorter ones are mostly noise."""
SIMILAR = 0.9
"""Correlation that the best alignment must reach to be believed."""
LEAST_RAD = 1.0
"""Turning, all in all, below which nothing can be told [rad]."""
FEWEST = 20
"""Fewest stretches that must overlap."""


@dataclass(frozen=True)
class Alignment:
    """How the clock of one log follows from that of the other: t = offset + rate·t_own."""

    offset_s: float
    """Offset at the beginning [s]."""
    rate: float
    """Rate; 1 for equal clocks."""
    correlation: float
    """Correlation of the turns at that; of the given start where nothing better is believed."""
    moved: bool
    """False: it is the start that was given."""


def align(
    stamps_s: Floats, turn_rate: Floats, gyro_s: Floats, gyro: Floats, rate: float
) -> Alignment:
    """Return how wheels' (N,) stamps [s] must be moved so that the wheels turn as the gyro does.

    `turn_rate` (N,) is what the wheels say of turning in any unit of the right sign, since only the
    correlation counts: the answer cannot pull on a track or a scale. `gyro` (M,) [rad/s] at
    `gyro_s` (M,). `rate` is the start, with no offset; it stays unless a better pair within
    LATEST_S and FASTEST correlates by SIMILAR and the robot turned by LEAST_RAD. A search over a
    grid, then a finer one round its best: O(1000·(N + M)).
    """
    steps = np.diff(gyro_s)
    heading = np.concatenate([[0.0], np.cumsum(0.5 * (gyro[1:] + gyro[:-1]) * steps)])
    own = 0.5 * (turn_rate[1:] + turn_rate[:-1]) * np.diff(stamps_s)
    wheels = np.concatenate([[0.0], np.cumsum(own)])
    stride = max(1, round(GROUP_S / max(float(np.median(np.diff(stamps_s))), 1e-3)))
    times, turned = stamps_s[::stride], wheels[::stride]

    def correlation(offset: float, pace: float) -> float:
        at = offset + pace * times
        inside = (at >= gyro_s[0]) & (at <= gyro_s[-1])
        if inside.sum() <= max(FEWEST, 0.7 * times.size):
            return -1.0
        a, b = np.diff(turned[inside]), np.diff(np.interp(at[inside], gyro_s, heading))
        spread = float(a.std() * b.std())
        return float(np.mean((a - a.mean()) * (b - b.mean()))) / spread if spread > 0.0 else -1.0

    start = correlation(0.0, rate)
    if np.abs(np.diff(np.interp(times, gyro_s, heading))).sum() < LEAST_RAD:
        return Alignment(0.0, rate, start, False)
    best = (start, 0.0, rate)
    for offset in np.arange(-LATEST_S, LATEST_S + 1e-9, COARSE_S):
        for pace in np.arange(1.0 - FASTEST, 1.0 + FASTEST + 1e-9, COARSE_RATE):
            best = max(best, (correlation(offset, pace), float(offset), float(pace)))
    for fine in (0.25, 0.05):
        _, offset, pace = best
        for i in range(-5, 6):
            for j in range(-5, 6):
                near = (offset + i * fine * COARSE_S, pace + j * fine * COARSE_RATE)
                best = max(best, (correlation(*near), *near))
    value, offset, pace = best
    if value < SIMILAR or (offset == 0.0 and pace == rate):
        return Alignment(0.0, rate, start, False)
    return Alignment(offset, pace, value, True)
