"""The simulated cases of seed A: a 4×4 skid-steer vehicle in three motions and eight scenarios.

Definition: encoder packets at 5 Hz for 10 s; the vehicle starts and stops instantly; one count
rolls s = 2πR/N with R = 0.135 m and N = 300. The effective track differs between the cases.

The truth follows exact arcs. The published recursion steps along the mean heading of a packet
instead; all three motions end at the same pose either way ((4.5239, 0, 0°), two turns on the
spot, one closed circle of radius 1.8 m), and within the circle the two differ by 2.4 mm at most.
The published end-point errors of Models 1 and 2 need the recursion (0.1278 m for Model 2 in the
spin with +40 counts; exact arcs would give 0.1273 m).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from fgloc.core.drive import Drive, Reference
from fgloc.core.measurements import WheelIncrements
from fgloc.core.robot import Robot, WheelNoise
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.simulator.course import Course
from fgloc.datasets.simulator.faults import Slip, apply_slip, describe
from fgloc.datasets.simulator.models import YawModel
from fgloc.datasets.simulator.robots import JAGUAR_RADIUS, JAGUAR_TICKS, jaguar
from fgloc.datasets.simulator.sensors import measure_all
from fgloc.datasets.simulator.spec import SimSpec
from fgloc.datasets.simulator.streams import generator

PACKET_NS = 200_000_000
PACKETS = 50
TICK = 2.0 * math.pi / JAGUAR_TICKS
"""Size of one encoder count [rad]."""
DRIFT = 0.01 / 7.0
"""Yaw drift of the vehicle at rest [rad/s]: one step of 0.01 rad every seven seconds."""
SLIP_TICKS = 40.0
"""Extra counts per packet in the scenarios that the published Model 2 numbers follow from: two of
three where the wheels slip in 10 and 5 packets, all three where they do in 9 and 6."""


@dataclass(frozen=True)
class Case:
    """One of the seed's three reference motions."""

    track: float
    """Effective track of the case [m]."""
    left: float
    """Counts per packet of both left wheels while moving."""
    right: float
    """Counts per packet of both right wheels while moving."""
    start_s: float
    """The vehicle starts (instantly) at this time [s]."""
    stop_s: float
    """The vehicle stops (instantly) at this time [s]."""


CASES: dict[str, Case] = {
    "straight": Case(0.48, 40.0, 40.0, 1.0, 9.0),
    "spin": Case(0.72, 40.0, -40.0, 1.0, 9.0),
    # The seed's text says 80 counts on the left; its numbers are those of 100.
    "circle": Case(0.9, 100.0, 60.0, 0.0, 10.0),
}

SLIP_RATE = SLIP_TICKS * TICK / (PACKET_NS * 1e-9)
"""The same as a rate [rad/s]."""
SLIP20 = (Slip(("fl",), 3.0, 5.0, 1.2), Slip(("rr",), 4.0, 5.0, 1.2))
"""The slip that the seed describes: front left and rear right turn 20 % faster than they roll."""
SCENARIOS: dict[str, tuple[Slip, ...]] = {
    "ideal": (),
    "noise": (),
    "slip20": SLIP20,
    "slip40ticks": (
        Slip(("fl",), 3.0, 5.0, extra_rate=SLIP_RATE),
        Slip(("rr",), 4.0, 5.0, extra_rate=SLIP_RATE),
    ),
    # 3 s < t < 5 s and 4 s <= t <= 5 s, where the others have 3 s < t <= 5 s and 4 s < t <= 5 s.
    "slip40ticks96": (
        Slip(("fl",), 3.0, 4.8, extra_rate=SLIP_RATE),
        Slip(("rr",), 3.8, 5.0, extra_rate=SLIP_RATE),
    ),
    "bothleft": (Slip(("fl", "rl"), 3.0, 5.0, 1.2),),
    "allwheels": (Slip(("fl", "fr", "rl", "rr"), 3.0, 5.0, 1.2),),
    "slip20noise": SLIP20,
}
NOISY = ("noise", "slip20noise")
"""Scenarios whose encoders and yaw are noisy."""

NOISE = WheelNoise(rolling=0.006, lateral=0.006, turning=0.003)
"""What the drives state as their wheels' noise: the process noise of the seed's own filter, 1 mm
along and 3.2 mrad in heading a packet, at the packets of these motions (0.11 m, 0.3 rad)."""
RADIUS_SIGMA = 0.0005 / math.sqrt(3.0)
"""Prior sigma of the wheel radius [m]: 0.135 m is exact but for its last printed digit."""

IDEAL_YAW = YawModel(rate=5.0, sigma=0.0, resolution=0.0, drift=0.0, walk=0.0)
"""Yaw of all other scenarios: the true heading at every packet."""
NOISY_YAW = YawModel(rate=5.0, sigma=0.0, resolution=0.01, drift=DRIFT, walk=0.0)
"""Yaw of the noisy scenarios: a linear drift is added first, then the sum is rounded to 0.01 rad.
When the first step of the drift is seen is a matter of the key `yaw_zero`."""

SPECS: dict[str, SimSpec] = {
    f"seed-a-{case}-{scenario}": SimSpec(
        f"seed-a-{case}-{scenario}", yaw=NOISY_YAW if scenario in NOISY else IDEAL_YAW
    )
    for case in CASES
    for scenario in SCENARIOS
}
"""The named drives: three cases times eight scenarios."""


def build_drive(spec: SimSpec, name: str) -> Drive:
    """Return the drive of a spec from `SPECS` under the id `name`.

    Wheel increments are whole counts, except in noisy scenarios, where each of the four wheels
    gets uniform ±0.5 count in every packet. The nominal track is the case's own unless the spec
    says otherwise.
    """
    _, _, case_name, scenario = spec.name.split("-")
    case = CASES[case_name]
    ends = np.arange(1, PACKETS + 1, dtype=np.int64) * PACKET_NS
    moving = (ends > round(case.start_s * 1e9)) & (ends <= round(case.stop_s * 1e9))
    left, right = case.left * moving, case.right * moving
    metres = JAGUAR_RADIUS * TICK
    displacements = np.zeros((PACKETS, 3))
    displacements[:, 0] = metres * (left + right) / 2.0
    displacements[:, 2] = metres * (right - left) / case.track
    course = Course.follow(displacements, PACKET_NS)

    robot = _robot(spec.nominal_track if spec.nominal_track is not None else case.track)
    base = robot.base
    counts = np.stack([left, right, left, right], axis=1)
    slips = SCENARIOS[scenario]
    angles = apply_slip(counts * TICK, course.boundaries_ns, base.driven_names, slips)
    if scenario in NOISY:
        angles += TICK * generator(spec.seed, "encoder").uniform(-0.5, 0.5, counts.shape)
    sensors, mounts = measure_all(course, spec)
    values = {p.name: p.nominal for p in base.parameters} | {"effective_track": case.track}
    return Drive(
        name,
        robot,
        WheelIncrements("wheels", course.boundaries_ns, angles, base.driven_names, None, TICK),
        sensors,
        Reference(Trajectory(course.boundaries_ns, course.poses), "truth", (1e-4, 1e-4, 1e-4)),
        motion=f"seed-a-{case_name}",
        notes=describe(slips),
        true_calibration=values | mounts,
    )


def _robot(nominal_track: float) -> Robot:
    """Return the Jaguar as the seed describes it: radius as printed, noise as in its filter."""
    robot = jaguar(nominal_track).robot
    parameters = tuple(
        replace(p, prior_sigma=RADIUS_SIGMA) if p.name.startswith("wheel_radius.") else p
        for p in robot.base.parameters
    )
    return replace(robot, base=replace(robot.base, parameters=parameters), noise=NOISE)
