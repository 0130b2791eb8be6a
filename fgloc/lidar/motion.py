"""How a lidar moved while it scanned, from the wheels at nominal calibration."""

from __future__ import annotations

import numpy as np

from fgloc.core.geometry import EXACT, between, compose, exp, integrate, inverse, log
from fgloc.core.measurements import Floats, Scans, Stamps, WheelIncrements
from fgloc.core.robot import Robot


def scan_motion(wheels: WheelIncrements, robot: Robot, scans: Scans) -> Floats:
    """Return (N, 3) the twist of the lidar times the time of a whole scan, in its own axes.

    That is x, y [m] and heading [rad] over B·beam_period, from the first beam on, at the nominal
    robot and mounting: good to some percent, which is little of the few centimetres that a robot
    moves in a scan. Zero where beam_period is zero. A scan that is only partly inside the wheels'
    record moved on as it did inside; one that is outside did not move. Raises FglocError if the
    wheels do not determine the motion. O(wheel intervals + N), vectorised.
    """
    n, beams = scans.ranges.shape
    turn_ns = scans.beam_period * 1e9 * beams
    if n == 0 or turn_ns <= 0.0:
        return np.zeros((n, 3))
    steps = robot.base.displacements(wheels.angles, wheels.steering)
    poses = integrate(steps, np.zeros(3), EXACT)
    first, last = wheels.stamps_ns[0], wheels.stamps_ns[-1]
    begin = np.clip(scans.stamps_ns, first, last)
    end = np.clip(scans.stamps_ns + np.int64(round(turn_ns)), first, last)
    moved = between(
        _poses_at(wheels.stamps_ns, poses, steps, begin),
        _poses_at(wheels.stamps_ns, poses, steps, end),
    )
    mount = np.array(scans.mount)
    # The lidar's own displacement: mount⁻¹ ∘ base's ∘ mount.
    seen = compose(compose(inverse(mount), moved), np.broadcast_to(mount, (n, 3)))
    inside = end - begin
    share = np.where(inside > 0, turn_ns / np.maximum(inside, 1), 0.0)
    return np.asarray(log(seen) * share[:, None])


def _poses_at(stamps: Stamps, poses: Floats, steps: Floats, times: Stamps) -> Floats:
    """Return (N, 3) poses at times inside the stamps, on arcs between them; headings unwrapped."""
    interval = np.clip(np.searchsorted(stamps, times, side="right") - 1, 0, stamps.size - 2)
    share = (times - stamps[interval]) / (stamps[interval + 1] - stamps[interval])
    return compose(poses[interval], exp(steps[interval] * share[:, None]))
