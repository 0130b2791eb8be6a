"""The course of a recorded drive: its truth smoothed, so that it can be differentiated.

A recorded truth is no motion yet: poses are noisy, come at uneven times and are missing in places,
and a gyro made from their differences would read mostly that. So poses are fitted locally:
at every time a parabola in x, y and heading through the poses of a few hundredths of a second
around it, nearer ones counting more (tricube weights: Cleveland, J. Amer. Statist. Assoc. 74,
1979). Motion of less than about 5 Hz stays; the robot's trembling is real, and sensors feel it.
Where a recording tells when its poses were taken (`Reference.taken_ns`), those times are used, not
the times at which the poses arrived.

With the swerve's motion capture (64 Hz, standing noise 0.01 mm and 0.05 mrad) about 0.02 mrad of
the noise is left: a gyro of 0.005 °/s/√Hz turns as far in a twentieth of a second. Without the
frames' times it would be 0.4 mrad in a spin, as messages are late by 10 ms and more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fgloc.core import geometry
from fgloc.core.compiled import compiled
from fgloc.core.drive import Drive
from fgloc.core.measurements import Floats, Stamps
from fgloc.core.start import trim_to_truth
from fgloc.datasets.simulator.course import Course
from fgloc.errors import FglocError

HALF_WIDTH_S = 0.1
"""Half of the time over which poses are fitted [s]."""
PERIODS = 3.0
"""Half of it in periods of the truth, at least: a parabola needs more than three poses."""
FEWEST = 5
"""Fewer poses around a time are no fit; there the course is interpolated between two poses."""
NORMAL_MEDIAN = 0.6745
"""Median of the absolute value of a standard normal number."""
MOST_LEVERAGE = 0.9
"""Leverage beyond which residuals are no measure of noise."""
MAX_GAP_S = 0.25
"""Between poses further apart nothing is known of the motion [s]: no sensor reads there."""
FINE_STEP_NS = 5_000_000
COARSE_STEP_NS = 20_000_000
LONG_NS = 600_000_000_000
"""Drives longer than this are followed in coarse steps."""


@dataclass(frozen=True)
class RecordedCourse:
    """What a robot did, as far as its recording tells."""

    course: Course
    """Smooth poses of the base from 0 on."""
    begin_ns: int
    """Stamp of the drive at which the course is 0."""
    gaps_ns: Stamps
    """(N, 2) begin and end of the times of which the recording tells nothing, in the course's."""
    noise: tuple[float, float, float]
    """Standard deviations of what is left of the truth's noise in x, y [m] and heading [rad], at
    most: what the robot trembles too fast for the fit counts as noise here."""

    def known(self, stamps_ns: Stamps) -> npt.NDArray[np.bool_]:
        """Return (M,) True where the motion at stamps (M,) of the course is known."""
        if not self.gaps_ns.size:
            return np.ones(stamps_ns.size, dtype=np.bool_)
        after = np.searchsorted(self.gaps_ns[:, 0], stamps_ns, side="left") - 1
        inside = stamps_ns < self.gaps_ns[np.maximum(after, 0), 1]
        return np.asarray(~((after >= 0) & inside))


def record(drive: Drive) -> RecordedCourse:
    """Return the course of the robot's base while both wheels and truth are recorded.

    The reference is taken to be mounted as nominal. O(M + N·w) for M poses of the course, N of the
    truth and w of them in a fit. Raises FglocError where there is no truth, it does not overlap the
    wheels, or it has fewer poses than one fit needs.
    """
    if drive.truth is None:
        raise FglocError(
            f"{drive.name} has no recorded truth to make semi-real sensors from; choose a drive "
            "with a truth, or leave out semi:"
        )
    truth = drive.truth.trajectory
    taken = truth.stamps_ns if drive.truth.taken_ns is None else drive.truth.taken_ns
    wheels = trim_to_truth(drive).wheels.stamps_ns
    begin = max(int(wheels[0]), int(taken[0]))
    end = min(int(wheels[-1]), int(taken[-1]))
    step = FINE_STEP_NS if end - begin <= LONG_NS else COARSE_STEP_NS
    count = (end - begin) // step
    if len(truth) < FEWEST or count < 1:
        raise FglocError(f"{drive.name}: its truth is too short to make semi-real sensors from")
    mount = geometry.inverse(np.array(drive.truth.mount, dtype=np.float64))
    poses = geometry.compose(truth.poses, mount)
    poses[:, 2] = np.unwrap(poses[:, 2])
    at = np.arange(count + 1, dtype=np.int64) * step
    seconds = np.asarray((taken - begin) * 1e-9, np.float64)
    smooth = local_fit(seconds, poses, np.asarray(at * 1e-9, np.float64))
    moved = geometry.log(geometry.between(smooth[:-1], smooth[1:]))
    wide = np.flatnonzero(np.diff(taken) > MAX_GAP_S * 1e9)
    gaps = np.stack([taken[wide], taken[wide + 1]], axis=1) - begin
    noise = noise_left(seconds, poses)
    return RecordedCourse(Course(step, moved, smooth), begin, gaps, noise)


def local_fit(seconds: Floats, values: Floats, at: Floats) -> Floats:
    """Return (M, C) smoothed values at times `at` (M,) [s] of values (N, C) at `seconds` (N,).

    A local parabola; between two values, linear, where fewer than `FEWEST` are near. Exact for
    values that are a parabola of time.
    """
    half = max(HALF_WIDTH_S, PERIODS * float(np.median(np.diff(seconds))))
    out = np.empty((at.size, values.shape[1]))
    _local_fit(seconds, np.ascontiguousarray(values), at, half, out)
    return out


def noise_left(seconds: Floats, poses: Floats) -> tuple[float, float, float]:
    """Return the sigmas of white noise that a local fit leaves in poses (N, 3).

    With leverage l of a pose in its own fit, residuals have variance (1 - l) of the noise's and the
    fit has l of it at most.
    """
    middle = seconds.size // 2
    impulse = np.zeros((seconds.size, 1))
    impulse[middle] = 1.0
    leverage = float(local_fit(seconds, impulse, seconds[middle : middle + 1])[0, 0])
    off = np.median(np.abs(poses - local_fit(seconds, poses, seconds)), axis=0) / NORMAL_MEDIAN
    # A pose that is all of its own fit tells nothing of its noise.
    share = min(leverage, MOST_LEVERAGE)
    x, y, heading = (off * np.sqrt(share / (1.0 - share))).tolist()
    return x, y, heading


@compiled
def _local_fit(s: Floats, values: Floats, at: Floats, half: float, out: Floats) -> None:
    """Fill `out` with the value at 0 of weighted parabolas about each time."""
    columns = values.shape[1]
    left = np.empty((3, 3))
    right = np.empty((3, columns))
    low = high = 0
    for i in range(at.size):
        t = at[i]
        while low < s.size and s[low] <= t - half:
            low += 1
        while high < s.size and s[high] < t + half:
            high += 1
        if high - low < FEWEST:
            k = min(max(np.searchsorted(s, t), 1), s.size - 1)
            part = min(max((t - s[k - 1]) / (s[k] - s[k - 1]), 0.0), 1.0)
            for c in range(columns):
                out[i, c] = values[k - 1, c] + part * (values[k, c] - values[k - 1, c])
            continue
        left[:] = 0.0
        right[:] = 0.0
        for k in range(low, high):
            x = (s[k] - t) / half
            near = 1.0 - abs(x) ** 3
            w = near * near * near
            power = w
            for a in range(3):
                # power = w·x^a; the normal equations hold w·x^(a+b).
                moment = power
                for b in range(3):
                    left[a, b] += moment
                    moment *= x
                for c in range(columns):
                    right[a, c] += power * (values[k, c] - values[low, c])
                power *= x
        found = np.linalg.solve(left, right)
        for c in range(columns):
            out[i, c] = found[0, c] + values[low, c]
