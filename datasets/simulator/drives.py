"""The named simulated drives: from `NAME?key=value&…` to a `Drive` with its truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgloc.core.drive import Drive, Reference
from fgloc.core.kinematics import WheeledBase, prior_correlation
from fgloc.core.measurements import Floats
from fgloc.core.robot import scaled
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.simulator import seed_a, seed_a_vehicle
from fgloc.datasets.simulator.course import Course, roll
from fgloc.datasets.simulator.disturbance import disturb
from fgloc.datasets.simulator.faults import Slip, apply_slip, describe, parse_slips
from fgloc.datasets.simulator.models import FixModel, LidarModel, YawModel
from fgloc.datasets.simulator.motions import MOTIONS, Limits
from fgloc.datasets.simulator.robots import RobotModel, build
from fgloc.datasets.simulator.rplidar import device, measure_scans
from fgloc.datasets.simulator.sensors import CUT, cut_normal, measure_all, measure_wheels
from fgloc.datasets.simulator.spec import SimSpec, parse
from fgloc.datasets.simulator.streams import generator
from fgloc.datasets.simulator.tour import keep_to_course, plan
from fgloc.datasets.simulator.worlds import World, load_world
from fgloc.errors import FglocError


def _in_world(name: str, robot: str, lidar: str) -> SimSpec:
    """Return the settings of a drive in the world of the same name: wheels and a lidar."""
    return SimSpec(
        name, robot=robot, yaw=YawModel(on=False), lidar=LidarModel(kind=lidar), world=name
    )


NAMED: dict[str, SimSpec] = {
    **{n: SimSpec(n) for n in ("figure-eight", "square", "random", "corridor")},
    "demo": SimSpec(
        "demo",
        effective_track=0.62,
        radius_sigma=0.01,
        slip="on",
        fix=FixModel(every=10.0, sigma=0.05),
    ),
    "seed-b-room": _in_world("seed-b-room", "youbot", "a2"),
    "seed-c-1": _in_world("seed-c-1", "differential", "a1"),
    "seed-c-2": _in_world("seed-c-2", "differential", "a1"),
    # One lap and a quarter: the first corridor is seen again after the tour.
    "office": replace(_in_world("office", "differential", "a2"), duration=240.0),
    "hall": _in_world("hall", "differential", "a2"),
    **seed_a.SPECS,
    **seed_a_vehicle.SPECS,
}
"""All simulated drives by name, with their own settings."""

FINE_STEP_NS = 5_000_000
COARSE_STEP_NS = 20_000_000
LONG_NS = 600_000_000_000
"""Drives longer than this are simulated in coarse steps."""


def load_sim(spec: str) -> Drive:
    """Return the simulated drive of `NAME?key=value&…` (without the prefix `sim:`).

    Deterministic: the same text gives the same drive. Raises FglocError for an unknown name, key
    or value, with what there is. O(duration): 10,000 s at 10 Hz take about a second.
    """
    settings = parse(spec, NAMED)
    name = f"sim:{spec}"
    if settings.name in seed_a.SPECS:
        return seed_a.build_drive(settings, name)
    if settings.name in seed_a_vehicle.SPECS:
        return seed_a_vehicle.build_drive(settings, name)
    return simulate(settings, name)


def load_sim_world(spec: str) -> World | None:
    """Return the world of the simulated drive `NAME?key=value&…`; None if it has none.

    Raises FglocError as `load_sim` does for the text and for the world's file.
    """
    settings = parse(spec, NAMED)
    return load_world(settings.world) if settings.world else None


def true_values(model: RobotModel, spec: SimSpec) -> Floats:
    """Return the (P,) true parameters: drawn from the priors, or nominal, then as stated.

    Nothing drawn lies beyond 2.5 sigma unless the spec asks for the whole prior. Raises FglocError
    for a track where the robot has none.
    """
    base = model.robot.base
    rng = generator(spec.seed, "calibration")
    correlate = np.linalg.cholesky(prior_correlation(base.parameters))
    if spec.calibration == "prior":
        drawn = correlate @ rng.standard_normal(len(base.parameters))
    else:
        # Correlated as the prior says, and still within 2.5 sigma.
        drawn = np.clip(correlate @ cut_normal(rng, len(base.parameters)), -CUT, CUT)
    values = base.nominal()
    if spec.calibration != "nominal":
        for k, p in enumerate(base.parameters):
            sigma = p.solver_sigma
            if spec.radius_sigma is not None and p.name.startswith("wheel_radius."):
                sigma = spec.radius_sigma
            values[k] = p.to_value(sigma * float(drawn[k]))
    if spec.effective_track is not None:
        names = [p.name for p in base.parameters]
        if "effective_track" not in names:
            raise FglocError(
                f"effective_track: robot={spec.robot} has no track; use robot=skid or differential"
            )
        values[names.index("effective_track")] = spec.effective_track
    return values


def _slips(
    spec: SimSpec, base: WheeledBase, tick: float, rate: float, end: float
) -> tuple[Slip, ...]:
    """Return the slips of the spec; "on" is three intervals: one wheel, one side, another wheel."""
    names = base.driven_names
    if spec.slip == "off":
        return ()
    if spec.slip != "on":
        return parse_slips(spec.slip, names, tick, rate)
    side = tuple(n for n in names if base.wheels[base.driven[names.index(n)]].y > 0.0) or names[:1]
    first, second, third = 0.15 * end, 0.45 * end, 0.75 * end
    return (
        Slip(names[:1], first, first + 0.03 * end, 1.3),
        Slip(side, second, second + 0.02 * end, 1.2),
        Slip(names[-1:], third, third + 0.03 * end, 1.3),
    )


def _track_steps(spec: SimSpec, base: WheeledBase) -> list[tuple[float, float]]:
    """Return from when on [s] the effective track is by which factor another one."""
    if spec.track_steps == "off":
        return []
    if not any(p.name == "effective_track" for p in base.parameters):
        raise FglocError(
            f"track_steps: robot={spec.robot} has no track; use robot=skid or differential"
        )
    steps = []
    for text in spec.track_steps.split(","):
        begin, _, factor = text.partition(":")
        try:
            step = (float(begin), float(factor))
        except ValueError:
            step = (-1.0, 0.0)
        if not (step[0] >= 0.0 and 0.1 <= step[1] <= 10.0):
            raise FglocError(f"track_steps: {text!r} is no TIME:FACTOR, as in 30:0.8,60:1.2")
        steps.append(step)
    return sorted(steps)


def simulate(spec: SimSpec, name: str) -> Drive:
    """Return the drive of a spec whose motion is one of `MOTIONS` or in a world, with id `name`."""
    model = build(spec.robot, spec.nominal_track)
    base = model.robot.base
    rate = spec.rate if spec.rate is not None else model.encoder_hz
    if rate > 1e9 / FINE_STEP_NS:
        raise FglocError(f"rate={rate}: at most {1e9 / FINE_STEP_NS:g} Hz can be simulated")
    world = load_world(spec.world) if spec.world else None
    if spec.lidar.kind != "off":
        device(spec.lidar.kind)
    wanted, start, step_ns = _wanted(spec, model, rate, world)
    values = true_values(model, spec)
    truth_by_name = {p.name: float(v) for p, v in zip(base.parameters, values, strict=True)}
    icr_x = truth_by_name.get("icr_x", 0.0)
    if "icr_x" in truth_by_name:
        wanted[:, 1] = -icr_x * wanted[:, 2]
    noise = scaled(model.robot.noise, spec.wheel_noise)
    rng = generator(spec.seed, "rolling")
    commanded, true = disturb(wanted, base, values, model.steered, noise, step_ns * 1e-9, rng)
    if world is not None:
        # Holding the heading alone would take the robot through a wall after some time.
        slip = true - commanded
        commanded, true = keep_to_course(wanted, slip, start, model.holonomic, icr_x)
    course = Course.follow(true, step_ns, start)
    angles, steering = roll(base, values, model.steered, commanded)
    for begin, factor in _track_steps(spec, base):
        k = round(begin * 1e9 / step_ns)
        other = values.copy()
        other[[p.name for p in base.parameters].index("effective_track")] *= factor
        angles[k:] = roll(base, other, model.steered, commanded[k:])[0]
    encoder = spec.encoder
    if encoder.ticks < 0:
        encoder = replace(encoder, ticks=model.ticks)
    # Extra counts of a slip are the robot's own where the encoder is continuous.
    tick = 2.0 * np.pi / (encoder.ticks or model.ticks)
    slips = _slips(spec, base, tick, rate, course.duration_ns * 1e-9)
    angles = apply_slip(angles, course.boundaries_ns, base.driven_names, slips)
    wheels = measure_wheels(
        course, angles, steering, base.driven_names, rate, encoder, generator(spec.seed, "encoder")
    )
    sensors, mounts = measure_all(course, spec)
    if world is not None and spec.lidar.kind != "off":
        scans, mount = measure_scans(course, world, spec.lidar, spec.people, spec.seed)
        sensors, mounts = (*sensors, scans), mounts | mount
    stamps = course.stamps(spec.truth_rate if spec.truth_rate is not None else rate)
    truth = Trajectory(stamps, course.poses_at(stamps))
    return Drive(
        name,
        model.robot,
        wheels,
        sensors,
        Reference(truth, "truth", (1e-4, 1e-4, 1e-4)),
        notes=describe(slips),
        true_calibration=truth_by_name | mounts,
    )


def _wanted(
    spec: SimSpec, model: RobotModel, rate: float, world: World | None
) -> tuple[Floats, Floats, int]:
    """Return wanted displacements (M, 3), the pose they start from (3,) and their step [ns].

    A whole number of packets at `rate` [Hz], so that the last one ends with the drive.
    """
    usual = model.speed if world is None else world.speed
    limits = Limits(
        spec.speed if spec.speed is not None else usual,
        model.turn_rate,
        model.acceleration,
        model.turn_acceleration,
        model.holonomic,
        spec.robot != "tricycle",
    )
    duration = spec.keyframes / rate if spec.keyframes is not None else spec.duration
    if world is None:
        profile = MOTIONS[spec.name](limits, duration, generator(spec.seed, "motion"))
    else:
        tour = plan(world, limits, duration)
        profile = tour.profile
    packets = np.ceil((profile.duration_s if duration is None else duration) * rate - 1e-6)
    total_ns = round(packets / rate * 1e9)
    step_ns = FINE_STEP_NS if total_ns <= LONG_NS else COARSE_STEP_NS
    steps = -(-total_ns // step_ns)
    if world is None:
        return profile.displacements(step_ns * 1e-9, steps), np.zeros(3), step_ns
    return *tour.displacements(step_ns * 1e-9, steps), step_ns
