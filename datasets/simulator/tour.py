"""The way of a robot along the waypoints of a world, and the driver who keeps to it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fgloc.core import geometry
from fgloc.core.compiled import compiled
from fgloc.core.geometry import compose_scalar, step_scalar, wrap_scalar
from fgloc.core.measurements import Floats
from fgloc.datasets.simulator.motions import REST_S, Limits, Profile
from fgloc.datasets.simulator.worlds import World
from fgloc.errors import FglocError

TURN_SPEED = 0.6
"""Speed in a corner, as a share of the cruising speed."""
SHARPEST = math.radians(120.0)
"""Sharper corners are turned on the spot [rad]."""
STRAIGHT = 1e-6
"""A corner below this is none [rad]."""
FINE = 2000
"""Steps in which a turn is integrated to find its shape."""
PAUSE_S = 0.3
"""Rest before and after a turn on the spot [s]."""
STEER_M = 0.4
"""Distance over which the driver steers back to the way [m]."""
HOLD_RAD = 0.5
"""Turned angle over which the driver takes back a heading error [rad]."""


@dataclass(frozen=True)
class Corner:
    """How a corner is driven."""

    angle: float
    """Change of heading [rad]."""
    reach: float
    """How far before the corner the turn begins, and after it ends [m]; 0 on the spot."""
    speed: float
    """Speed in the turn [m/s]; 0 on the spot."""
    rate: float
    """Largest yaw rate of the turn [rad/s]."""


@dataclass(frozen=True)
class Tour:
    """The planned way through a world."""

    profile: Profile
    """Body twist over time as if all turns followed the way."""
    start: Floats
    """(3,) pose at the beginning."""
    laps: tuple[tuple[float, bool], ...]
    """When each lap begins [s], and whether it is driven sideways: without turning."""

    def displacements(self, step_s: float, steps: int) -> tuple[Floats, Floats]:
        """Return wanted body displacements (steps, 3) of steps of `step_s` [s], and the start."""
        along = self.profile.displacements(step_s, steps)
        if not any(sideways for _, sideways in self.laps):
            return along, self.start
        poses = geometry.integrate(along, self.start, geometry.EXACT)
        begins = np.array([begin for begin, _ in self.laps])
        lap = np.searchsorted(begins, np.arange(steps + 1) * step_s, side="right") - 1
        heading = poses[:, 2].copy()
        turned = 0.0
        for k, (_, sideways) in enumerate(self.laps):
            during = np.flatnonzero(lap == k)
            if not during.size:
                continue
            heading[during] -= turned
            if sideways:
                kept = float(heading[during[0]])
                turned += float(heading[during[-1]]) - kept
                heading[during] = kept
        poses[:, 2] = heading
        return geometry.log(geometry.between(poses[:-1], poses[1:])), self.start


def plan(world: World, limits: Limits, duration: float | None) -> Tour:
    """Return the way through a world: its laps, or as many as `duration` [s] needs.

    Laps are driven sideways only by a base that can. Raises FglocError for waypoints that are too
    close to each other for their turns.
    """
    profile, begins = _profile(world, limits, duration)
    leg = world.waypoints[1] - world.waypoints[0]
    start = np.array([*world.waypoints[0], math.atan2(leg[1], leg[0])])
    styles = [world.laps[k % len(world.laps)] for k in range(len(begins))]
    sideways = [limits.holonomic and style == "sideways" for style in styles]
    return Tour(profile, start, tuple(zip(begins, sideways, strict=True)))


def _profile(world: World, limits: Limits, duration: float | None) -> tuple[Profile, list[float]]:
    """Return the profile of all laps, all turns along the way, and the time each lap begins [s]."""
    legs = np.diff(world.waypoints, axis=0, append=world.waypoints[:1])
    legs = legs if world.closed else legs[:-1]
    length = np.hypot(legs[:, 0], legs[:, 1])
    course = np.arctan2(legs[:, 1], legs[:, 0])
    # Corner k lies at the end of leg k.
    angles = geometry.wrap(np.roll(course, -1) - course)
    if not world.closed:
        angles[-1] = 0.0
    if not limits.spins and bool(np.any(sharp := np.abs(angles) > SHARPEST)):
        at = world.waypoints[(int(np.flatnonzero(sharp)[0]) + 1) % len(world.waypoints)]
        raise FglocError(
            f"world {world.name}: this robot cannot turn on the spot, as it would have to at "
            f"({at[0]:g}, {at[1]:g}); take another robot or world"
        )
    corners = [_corner(float(a), limits) for a in angles]
    none = Corner(0.0, 0.0, 0.0, 0.0)
    durations, twists = [REST_S], [(0.0, 0.0, 0.0)]
    starts: list[float] = []
    lap = 0
    while True:
        starts.append(sum(durations))
        # A drive of a given length is cut; else the last lap ends at rest.
        more = world.closed and (duration is not None or lap + 1 < len(world.laps))
        for k in range(length.size):
            before = corners[k - 1] if k or lap else none
            after = corners[k] if k + 1 < length.size or more else none
            rest = float(length[k]) - before.reach - after.reach
            if rest < 0.0:
                at, to = world.waypoints[k], world.waypoints[(k + 1) % len(world.waypoints)]
                raise FglocError(
                    f"world {world.name}: from ({at[0]:g}, {at[1]:g}) to ({to[0]:g}, {to[1]:g}) "
                    f"there is no room for the turns, which need {before.reach + after.reach:.2f} "
                    "m; move the waypoints apart or drive slower (speed=…)"
                )
            _straight(durations, twists, rest, before.speed, after.speed, limits)
            _turn(durations, twists, after, limits)
        lap += 1
        if not more or (duration is not None and sum(durations) >= duration):
            break
    durations.append(REST_S)
    twists.append((0.0, 0.0, 0.0))
    return _chain(durations, twists), starts


def _chain(
    durations: list[float], twists: list[tuple[float, float, float]], speed: float = 0.0
) -> Profile:
    """Return a profile from times between knots [s] and the twist at the end of each.

    `speed` [m/s] is that at the beginning.
    """
    times = np.concatenate([[0.0], np.cumsum(durations)])
    knots = np.array([(speed, 0.0, 0.0), *twists])
    keep = np.concatenate([[True], np.diff(times) > 1e-9])
    return Profile(times[keep], knots[keep])


def _corner(angle: float, limits: Limits) -> Corner:
    """Return how a corner of this angle [rad] is driven; on the spot if it is sharp."""
    if abs(angle) < STRAIGHT:
        return Corner(0.0, 0.0, limits.speed, 0.0)
    rate = min(limits.turn_rate, math.sqrt(abs(angle) * limits.turn_acceleration))
    if abs(angle) > SHARPEST:
        return Corner(angle, 0.0, 0.0, rate)
    corner = Corner(angle, 0.0, TURN_SPEED * limits.speed, rate)
    durations: list[float] = []
    twists: list[tuple[float, float, float]] = []
    _turn(durations, twists, corner, limits)
    turn = _chain(durations, twists, corner.speed)
    moved = turn.displacements(turn.duration_s / FINE, FINE)
    end = geometry.integrate(moved, np.zeros(3), geometry.EXACT)[-1]
    # The turn is the same both ways, so both legs are cut by the same length.
    return Corner(angle, float(end[1]) / math.sin(angle), corner.speed, rate)


def _turn(
    durations: list[float],
    twists: list[tuple[float, float, float]],
    corner: Corner,
    limits: Limits,
) -> None:
    """Append the knots of a turn: the yaw rate rises, holds and falls."""
    if corner.rate == 0.0:
        return
    rise = corner.rate / limits.turn_acceleration
    hold = max(abs(corner.angle) / corner.rate - rise, 0.0)
    full = (corner.speed, 0.0, math.copysign(corner.rate, corner.angle))
    still = (corner.speed, 0.0, 0.0)
    pause = PAUSE_S if corner.speed == 0.0 else 0.0
    durations += [pause, rise, hold, rise, pause]
    twists += [still, full, full, still, still]


def _straight(
    durations: list[float],
    twists: list[tuple[float, float, float]],
    length: float,
    before: float,
    after: float,
    limits: Limits,
) -> None:
    """Append the knots of a straight [m] from one speed to another [m/s], cruising between."""
    if length <= 0.0:
        return
    a = limits.acceleration
    top = min(limits.speed, math.sqrt(a * length + 0.5 * (before**2 + after**2)))
    if top < max(before, after):
        # Too short to brake or speed up as gently.
        durations.append(2.0 * length / (before + after))
        twists.append((after, 0.0, 0.0))
        return
    rise, fall = (top - before) / a, (top - after) / a
    ramps = 0.5 * ((before + top) * rise + (top + after) * fall)
    durations += [rise, max(length - ramps, 0.0) / top, fall]
    twists += [(top, 0.0, 0.0), (top, 0.0, 0.0), (after, 0.0, 0.0)]


@compiled
def keep_to_course(
    wanted: Floats, slip: Floats, start: Floats, holonomic: bool, icr_x: float
) -> tuple[Floats, Floats]:
    """Return (commanded, true) displacements (M, 3) of a driver who sees where the robot is.

    `wanted` (M, 3) is the planned way from `start`, `slip` (M, 3) what the base moves beside the
    commands. Errors are taken back over some distance: sideways ones by steering, or directly where
    the base can do that. A base whose centre of rotation is at `icr_x` [m] moves sideways with it
    when it turns. O(M).
    """
    m = wanted.shape[0]
    commanded = wanted.copy()
    true = np.empty((m, 3))
    plan = start.copy()
    pose = start.copy()
    local = np.empty(3)
    for k in range(m):
        dx, dy = plan[0] - pose[0], plan[1] - pose[1]
        c, s = np.cos(pose[2]), np.sin(pose[2])
        ahead, left = c * dx + s * dy, c * dy - s * dx
        turn = wrap_scalar(plan[2] - pose[2])
        way = np.hypot(wanted[k, 0], wanted[k, 1])
        share = 1.0 - np.exp(-way / STEER_M)
        held = 1.0 - np.exp(-abs(wanted[k, 2]) / HOLD_RAD)
        commanded[k, 0] += share * ahead
        if holonomic:
            commanded[k, 1] += share * left
            commanded[k, 2] += max(share, held) * turn
        else:
            # Critically damped over the way: an error to the side falls like (1 + s/L)·exp(-s/L).
            commanded[k, 2] += way * (2.0 * turn / STEER_M + left / STEER_M**2) + held * turn
            commanded[k, 1] = -icr_x * commanded[k, 2]
        for a in range(3):
            true[k, a] = commanded[k, a] + slip[k, a]
        step_scalar(wanted[k], 0, local)
        compose_scalar(plan, local, plan)
        step_scalar(true[k], 0, local)
        compose_scalar(pose, local, pose)
    return commanded, true
