"""Seed A's three laboratory runs, re-created: SIMULATED, since the recordings are not published.

Printed are the measured end poses, the durations, what the wheels did in words, and the errors of
the models. The rest is assumed here, and each assumption is named:

- The end pose and the duration are met exactly.
- The true effective track is the one that Model 1's printed heading errors imply: 605° in the spin
  of 1070° with 0.48 m (0.751 m), 310° in the circle of 352° (0.903 m; 0.9 m is taken). With the
  track of 0.8205 m that Model 3 printed for the spin, Model 1 would have to err by 759°.
- The circle's path is 13.1 m: the printed 0.252 m is 1.92 % of it, and 0.224 m 1.71 %.
- Speed rises and falls evenly within 1 s; it is not printed. The straight run then drives at
  0.47 m/s ("approximately 0.5").
- In the straight run the vehicle turns left all the time, and the more the further it gets: with
  an even turn, 0.08 m to the left would mean 2.0° and not the measured 3°. In the circle the
  curvature varies by a few per cent, or the end pose could not be met.
- In the straight run the front left wheel slips while the vehicle starts ("had worse contact and
  turned faster"), by as much as the printed 2.3° without encoder selection need.
- Wheel noise, encoder counts, yaw (0.01 rad, drift of 0.01 rad in 7 s) and accelerometer are
  those of the other simulated drives of this vehicle, IMU at 50 Hz: ten readings a packet.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace

import numpy as np

from fgloc.core.drive import Drive, Reference
from fgloc.core.geometry import EXACT, integrate
from fgloc.core.measurements import Floats
from fgloc.core.robot import scaled
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.simulator.course import Course, roll
from fgloc.datasets.simulator.disturbance import disturb
from fgloc.datasets.simulator.faults import Slip, apply_slip, describe
from fgloc.datasets.simulator.models import AccelerometerModel
from fgloc.datasets.simulator.robots import (
    JAGUAR_ENCODER_HZ,
    JAGUAR_RADIUS,
    JAGUAR_TICKS,
    JAGUAR_TRACK,
    jaguar,
)
from fgloc.datasets.simulator.sensors import measure_all, measure_wheels
from fgloc.datasets.simulator.spec import SimSpec
from fgloc.datasets.simulator.streams import generator

STEP_NS = 5_000_000
RAMP_S = 1.0
"""Time in which the vehicle reaches its speed, and in which it stops [s]."""
NOTE = "Simulated from the published end pose and duration; the recording is not published."

SLIPPED_M = 2.0 * JAGUAR_TRACK * math.radians(2.3)
"""What the front left wheel turned too far [m]: half of it, over the track, is the printed 2.3°."""


@dataclass(frozen=True)
class Run:
    """One laboratory run."""

    track: float
    """True effective track [m]."""
    duration_s: float
    """Printed duration [s]."""
    end: tuple[float, float, float]
    """Printed end pose: x, y [m] and cumulative heading [deg]."""
    path: float
    """Length of the path [m]; a first guess where the end pose decides it."""
    slips: tuple[Slip, ...] = ()
    """Wheels that turn faster than they roll."""


RUNS: dict[str, Run] = {
    "straight": Run(
        0.48,
        10.6,
        (4.5, 0.08, 3.0),
        4.5,
        (Slip(("fl",), 0.0, RAMP_S, extra_rate=SLIPPED_M / JAGUAR_RADIUS / RAMP_S),),
    ),
    # The sign of x is lost in the copy of the thesis that was at hand.
    "spin": Run(0.751, 9.6, (0.01, 0.0075, -1070.0), 0.0),
    "circle": Run(0.9, 13.6, (0.016, 0.009, -352.0), 13.1),
}

SPECS: dict[str, SimSpec] = {
    f"seed-a-vehicle-{name}": SimSpec(f"seed-a-vehicle-{name}", acc=AccelerometerModel(on=True))
    for name in RUNS
}
"""The named drives."""


def shares(duration_s: float) -> Floats:
    """Return the (M,) share of the motion that falls on each step: even ramps at both ends."""
    seconds = np.arange(round(duration_s / (STEP_NS * 1e-9)) + 1) * (STEP_NS * 1e-9)
    top = 1.0 / (duration_s - RAMP_S)
    rising = np.minimum(seconds, RAMP_S)
    left = np.minimum(duration_s - seconds, RAMP_S)
    cruised = np.clip(seconds - RAMP_S, 0.0, duration_s - 2.0 * RAMP_S)
    done = top * (rising**2 / (2.0 * RAMP_S) + cruised + (RAMP_S - left**2 / RAMP_S) / 2.0)
    # Before it brakes, the last term is zero since `left` is RAMP_S.
    return np.diff(done)


@functools.cache
def course_of(name: str) -> Course:
    """Return the true course of a run, which ends at the printed pose.

    Three numbers of its shape are found by Newton's method: path length and turning of the
    straight run, the two components of the spin's creeping, curvature of the circle.
    """
    from scipy.optimize import root

    run = RUNS[name]
    share = shares(run.duration_s)
    done = np.cumsum(share) - 0.5 * share
    x, y, degrees = run.end
    end = np.array([x, y, math.radians(degrees)])

    def displacements(shape: Floats) -> Floats:
        steps = np.zeros((share.size, 3))
        turn = end[2] * np.ones(share.size)
        if name == "straight":
            # Curvature grows evenly along the path.
            steps[:, 0] = run.path * (1.0 + shape[0]) * share
            turn = shape[1] + shape[2] * done
        elif name == "spin":
            # A little forward in two directions of the map, whatever the heading is.
            heading = end[2] * done
            steps[:, 0] = (shape[0] * np.cos(heading) + shape[1] * np.sin(heading)) * share
            turn = turn + shape[2]
        else:
            steps[:, 0] = run.path * share
            wave = 2.0 * math.pi * done
            turn = turn + shape[0] * np.cos(wave) + shape[1] * np.sin(wave) + shape[2]
        steps[:, 2] = turn * share
        return steps

    def miss(shape: Floats) -> Floats:
        return np.asarray(integrate(displacements(shape), np.zeros(3), EXACT)[-1] - end)

    found = root(miss, np.zeros(3), tol=1e-12)
    return Course.follow(displacements(found.x), STEP_NS)


def build_drive(spec: SimSpec, name: str) -> Drive:
    """Return the drive of a spec from `SPECS` under the id `name`.

    The course is the same for every seed; the random slip of the wheels, the phase of their
    counters and the noise of the sensors are drawn. The nominal track is 0.48 m unless the spec
    says otherwise.
    """
    case = spec.name.rpartition("-")[2]
    run = RUNS[case]
    course = course_of(case)
    model = jaguar(spec.nominal_track if spec.nominal_track is not None else JAGUAR_TRACK)
    base = model.robot.base
    truth = {p.name: p.nominal for p in base.parameters} | {"effective_track": run.track}
    values = np.array([truth[p.name] for p in base.parameters])
    noise = scaled(model.robot.noise, spec.wheel_noise)
    rng = generator(spec.seed, "rolling")
    wanted = course.displacements
    commanded, true = disturb(wanted, base, values, False, noise, STEP_NS * 1e-9, rng)
    # The course is what is known here, so the wheels take the slip, not the base.
    angles, _ = roll(base, values, False, wanted - (true - commanded))
    angles = apply_slip(angles, course.boundaries_ns, base.driven_names, run.slips)
    encoder = replace(spec.encoder, ticks=JAGUAR_TICKS)
    draws = generator(spec.seed, "encoder")
    wheels = measure_wheels(
        course, angles, None, base.driven_names, JAGUAR_ENCODER_HZ, encoder, draws
    )
    sensors, mounts = measure_all(course, spec)
    poses = course.poses_at(wheels.stamps_ns)
    return Drive(
        name,
        model.robot,
        wheels,
        sensors,
        Reference(Trajectory(wheels.stamps_ns, poses), "truth", (1e-4, 1e-4, 1e-4)),
        motion=spec.name,
        notes=(NOTE, *describe(run.slips)),
        true_calibration=truth | mounts,
    )
