"""Motions of the simulated robots: the wanted body twist over time, within acceleration limits.

A motion is a `Profile`: a list of knots between which the body twist changes linearly, so speeds
never jump. Its integral over a step is exact, so a square closes whatever the step length is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.errors import FglocError

REST_S = 1.0
"""Every motion begins and ends with so much rest [s]."""
EIGHT_AMPLITUDE = 2.404825557695773
"""First zero of the Bessel function J0 [rad]: with heading A·sin(φ) at constant dφ/ds the path
closes, since its x displacement over a turn is proportional to J0(A)."""
EIGHT_LAP_S = 32.0
"""Duration of one figure-eight at the robot's usual speed [s]."""


@dataclass(frozen=True)
class Limits:
    """What the robot may do while it drives a motion."""

    speed: float
    """Cruising speed [m/s]."""
    turn_rate: float
    """Yaw rate when turning [rad/s]."""
    acceleration: float
    """Largest acceleration [m/s²]."""
    turn_acceleration: float
    """Largest yaw acceleration [rad/s²]."""
    holonomic: bool = False
    """True if the base can drive sideways."""
    spins: bool = True
    """False for a base that takes its corners as arcs instead of turning on the spot."""


@dataclass(frozen=True)
class Profile:
    """Knots of a piecewise linear body twist."""

    times: Floats
    """(K,) times of the knots [s], increasing, from 0."""
    twists: Floats
    """(K, 3) body twist at the knots: v_x, v_y [m/s], ω [rad/s]."""

    def displacements(self, step_s: float, steps: int) -> Floats:
        """Return the (steps, 3) exact integral of the twist over each step; 0 after the end."""
        grid = np.minimum(np.arange(steps + 1) * step_s, self.times[-1])
        width = np.diff(self.times)[:, None]
        slope = np.diff(self.twists, axis=0) / width
        areas = np.cumsum((self.twists[1:] + self.twists[:-1]) / 2.0 * width, axis=0)
        before = np.vstack([np.zeros((1, 3)), areas[:-1]])
        k = np.minimum(np.searchsorted(self.times, grid, side="right") - 1, width.size - 1)
        passed = (grid - self.times[k])[:, None]
        total = before[k] + passed * (self.twists[k] + 0.5 * slope[k] * passed)
        return np.diff(total, axis=0)

    @property
    def duration_s(self) -> float:
        """Return the time of the last knot [s]."""
        return float(self.times[-1])


def _chain(durations: list[float], twists: list[tuple[float, float, float]]) -> Profile:
    """Return a profile from times between knots [s] and the twist at the end of each."""
    times = np.concatenate([[0.0], np.cumsum(durations)])
    knots = np.array([(0.0, 0.0, 0.0), *twists])
    keep = np.concatenate([[True], np.diff(times) > 1e-9])
    return Profile(times[keep], knots[keep])


class _Path:
    """Collects the stretches of a path driven from rest to rest: straights, turns and arcs."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.durations: list[float] = []
        self.twists: list[tuple[float, float, float]] = []

    def _ramp(self, amount: float, cruise: float, limit: float, axis: int) -> None:
        """Append a trapezoid (or triangle) of one twist component that covers `amount`."""
        top = min(cruise, math.sqrt(abs(amount) * limit))
        rise = top / limit
        hold = abs(amount) / top - rise if top > 0.0 else 0.0
        twist = [0.0, 0.0, 0.0]
        twist[axis] = math.copysign(top, amount)
        full = (twist[0], twist[1], twist[2])
        self.durations += [rise, hold, rise]
        self.twists += [full, full, (0.0, 0.0, 0.0)]

    def rest(self, seconds: float) -> None:
        """Append a rest [s]."""
        self.durations.append(seconds)
        self.twists.append((0.0, 0.0, 0.0))

    def straight(self, length: float) -> None:
        """Append a straight [m] from rest to rest; negative is backwards."""
        self._ramp(length, self.limits.speed, self.limits.acceleration, 0)

    def turn(self, angle: float) -> None:
        """Append a turn [rad], on the spot or, for a base that does not spin, as a slow arc."""
        if self.limits.spins:
            self.rest(0.3)
            self._ramp(angle, self.limits.turn_rate, self.limits.turn_acceleration, 2)
            self.rest(0.3)
            return
        # Speed and yaw rate rise and fall together: radius and steering angle stay constant.
        v, w = self.limits.speed / 2.0, self.limits.turn_rate
        rise = max(v / self.limits.acceleration, w / self.limits.turn_acceleration)
        hold = abs(angle) / w - rise  # positive for the quarter and half turns of these motions
        full = (v, 0.0, math.copysign(w, angle))
        self.durations += [0.3, rise, hold, rise]
        self.twists += [(0.0, 0.0, 0.0), full, full, (0.0, 0.0, 0.0)]

    def profile(self) -> Profile:
        """Return the knots collected so far."""
        return _chain(self.durations, self.twists)


def _repeat(lap: Callable[[_Path], None], limits: Limits, duration: float | None) -> Profile:
    """Return rest, laps and rest: one lap, or as many as cover the duration."""
    path = _Path(limits)
    path.rest(REST_S)
    lap(path)
    while duration is not None and sum(path.durations) < duration - REST_S:
        lap(path)
    path.rest(REST_S)
    return path.profile()


def square(limits: Limits, duration: float | None, rng: np.random.Generator) -> Profile:
    """Return a counter-clockwise square of 4 m sides; one lap without `duration`."""

    def lap(path: _Path) -> None:
        for _ in range(4):
            path.straight(4.0)
            path.turn(math.pi / 2)

    return _repeat(lap, limits, duration)


def corridor(limits: Limits, duration: float | None, rng: np.random.Generator) -> Profile:
    """Return a tour of a corridor: 15 m out with a visit to a side room, and back again."""

    def lap(path: _Path) -> None:
        for _ in range(2):
            path.straight(9.0)
            path.turn(math.pi / 2)
            path.straight(2.5)
            path.turn(math.pi)
            path.straight(2.5)
            path.turn(math.pi / 2)
            path.straight(6.0)
            path.turn(math.pi)

    return _repeat(lap, limits, duration)


def figure_eight(limits: Limits, duration: float | None, rng: np.random.Generator) -> Profile:
    """Return closed figure-eights at constant speed; two laps without `duration`.

    The heading is A·sin(φ) with A the first zero of J0; φ grows with the distance.
    """
    ramp = limits.speed / limits.acceleration
    # The ramps cover half of what cruising would, so together they cost one ramp of time.
    free = 2 * EIGHT_LAP_S if duration is None else duration - 2 * REST_S - ramp
    laps = max(1, round(free / EIGHT_LAP_S))
    cruise = free if duration is not None else laps * EIGHT_LAP_S
    if cruise < EIGHT_LAP_S / 2:
        least = EIGHT_LAP_S / 2 + 2 * REST_S + ramp
        raise FglocError(f"duration={duration}: a figure-eight needs at least {least:g} s")
    times = np.unique(np.concatenate([np.arange(0.0, cruise + ramp, 0.05), [cruise + ramp]]))
    rise = np.clip(np.minimum(times, cruise + ramp - times) / ramp, 0.0, 1.0)
    end = cruise + ramp
    late = np.clip(times - (end - ramp), 0.0, None)
    early = np.minimum(times, ramp)
    passed = times - early + early**2 / (2.0 * ramp) - late**2 / (2.0 * ramp)
    phase = 2.0 * math.pi * laps * passed / cruise
    omega = rise * EIGHT_AMPLITUDE * (2.0 * math.pi * laps / cruise) * np.cos(phase)
    twists = np.stack([limits.speed * rise, np.zeros_like(rise), omega], axis=1)
    still = np.zeros((1, 3))
    return Profile(
        np.concatenate([[0.0], REST_S + times, [2 * REST_S + end]]),
        np.vstack([still, twists, still]),
    )


def random(limits: Limits, duration: float | None, rng: np.random.Generator) -> Profile:
    """Return a drive with a new speed and yaw rate every 3 to 8 s; 60 s without `duration`.

    A base that drives sideways does so too. Speeds stay above a third of the usual one, so that
    steered wheels keep a direction. Vectorised: O(duration).
    """
    total = 60.0 if duration is None else duration
    count = int(total / 3.0) + 2
    speed = limits.speed * rng.uniform(0.6, 1.3, count)
    course = rng.uniform(-0.6, 0.6, count) if limits.holonomic else np.zeros(count)
    omega = limits.turn_rate * rng.uniform(-0.8, 0.8, count)
    target = np.stack([speed * np.cos(course), speed * np.sin(course), omega], axis=1)
    steps = np.abs(np.diff(target, axis=0, prepend=np.zeros((1, 3))))
    rise = np.maximum(
        np.max(steps[:, :2], axis=1) / limits.acceleration, steps[:, 2] / limits.turn_acceleration
    )
    hold = rng.uniform(3.0, 8.0, count) - rise
    ends = REST_S + np.cumsum(rise + np.maximum(hold, 0.5))
    stop = float(np.max(target[:, 0]) / limits.acceleration) + REST_S
    used = max(1, int(np.searchsorted(ends, total - stop)))
    begins = ends[:used] - np.maximum(hold[:used], 0.5)
    knots = np.stack([begins, ends[:used]], axis=1).ravel()
    twists = np.repeat(target[:used], 2, axis=0)
    knots[-1] = max(total - stop, knots[-2] + 0.1)
    still = np.zeros((1, 3))
    return Profile(
        np.concatenate([[0.0, REST_S], knots, [knots[-1] + stop - REST_S, knots[-1] + stop]]),
        np.vstack([still, still, twists, still, still]),
    )


def demo(limits: Limits, duration: float | None, rng: np.random.Generator) -> Profile:
    """Return one figure-eight and then a rectangle of 6 m by 3 m with turns on the spot."""
    eight = figure_eight(limits, EIGHT_LAP_S + 2 * REST_S + limits.speed / limits.acceleration, rng)

    def lap(path: _Path) -> None:
        for length in (6.0, 3.0, 6.0, 3.0):
            path.straight(length)
            path.turn(-math.pi / 2)

    loop = _repeat(lap, limits, None)
    return Profile(
        np.concatenate([eight.times, eight.duration_s + loop.times[1:]]),
        np.vstack([eight.twists, loop.twists[1:]]),
    )


MOTIONS: dict[str, Callable[[Limits, float | None, np.random.Generator], Profile]] = {
    "figure-eight": figure_eight,
    "square": square,
    "corridor": corridor,
    "random": random,
    "demo": demo,
}
"""Motions by name: (limits, duration [s] or None, generator) → profile."""
