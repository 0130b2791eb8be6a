"""What a simulated drive is made of: `SimSpec`, and its text form `NAME?key=value&…`.

A key is either a field of `SimSpec` (`seed=3`, `duration=120`), the name of a sensor to switch it
on or off (`camera=on`), or sensor and field joined by an underscore (`yaw_drift=0.002`,
`fix_every=10`). Every field's docstring says what it means and in which unit.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field, replace
from typing import Any

from fgloc.datasets.simulator.models import (
    AccelerometerModel,
    CameraModel,
    EncoderModel,
    FixModel,
    GyroModel,
    LidarModel,
    YawModel,
)
from fgloc.errors import FglocError


@dataclass(frozen=True)
class SimSpec:
    """Everything that determines a simulated drive; the same spec gives the same drive."""

    name: str
    """Name of the drive, e.g. "figure-eight"."""
    seed: int = 1
    """Seed of every random draw."""
    robot: str = "skid"
    """skid (the Jaguar 4x4), differential, mecanum, youbot, omni3, tricycle or swerve."""
    duration: float | None = None
    """Length of the drive [s]; closed motions repeat their lap. None: the motion's own length."""
    keyframes: int | None = None
    """Number of wheel packets, another way to say `duration`."""
    rate: float | None = None
    """Encoder packets per second [Hz]; None: the robot's own (5 Hz on the Jaguar)."""
    speed: float | None = None
    """Cruising speed [m/s]; None: the robot's own."""
    effective_track: float | None = None
    """TRUE effective track [m] of skid and differential robots; None: drawn from the prior."""
    nominal_track: float | None = None
    """Track [m] that the drive states as nominal; None: the robot's own."""
    calibration: str = "drawn"
    """drawn: the true parameters are drawn from their priors, none beyond 2.5 sigma; prior: the
    same without that limit, as statistics over many seeds need it; nominal: they are as stated."""
    track_steps: str = "off"
    """off, or TIME:FACTOR[,…]: from TIME [s] on the true effective track is FACTOR times the one
    that the drive begins with, as on another ground."""
    radius_sigma: float | None = None
    """Relative sigma the true wheel radii are drawn with; None: that of their prior."""
    wheel_noise: float = 1.0
    """Factor on the robot's wheel noise: random slip along, across and in turns; 0 for none."""
    slip: str = "off"
    """off, on (three intervals: one wheel, one side, another wheel), or WHEEL:START:END:AMOUNT[,…]:
    times in s, AMOUNT a factor (1.2) or +N counts per packet, several wheels as fl+rl."""
    truth_rate: float | None = None
    """Poses of the truth per second [Hz]; None: one at every wheel packet."""
    encoder: EncoderModel = field(default_factory=EncoderModel)
    """Encoders of the driven wheels."""
    yaw: YawModel = field(default_factory=YawModel)
    """Heading of the IMU."""
    gyro: GyroModel = field(default_factory=GyroModel)
    """Yaw rate of the IMU."""
    acc: AccelerometerModel = field(default_factory=AccelerometerModel)
    """Forward acceleration of the IMU."""
    camera: CameraModel = field(default_factory=CameraModel)
    """Odometry of a T265-like camera."""
    fix: FixModel = field(default_factory=FixModel)
    """Position fixes."""
    lidar: LidarModel = field(default_factory=LidarModel)
    """A turning lidar; worlds only."""
    people: int = 0
    """How many people walk about; worlds only."""
    world: str = ""
    """What the lidar sees: a world by name, or a TOML file by its path; worlds only."""


SEED_A_KEYS = ("seed", "nominal_track", "yaw", "yaw_rate", "yaw_zero")
"""Keys of the seed-a drives: their motion, slip and noise are fixed by definition."""
VEHICLE_KEYS = ("seed", "nominal_track", "wheel_noise")
"""Keys of the seed-a-vehicle drives: their motion and slip are those of three laboratory runs."""
MOST_PEOPLE, MOST_BEAMS = 100, 10_000
"""No more: beyond that a drive only takes time and memory."""
WORLD_KEYS = ("lidar", "people", "world")
"""Keys, and the sensor, of drives in a world; others have nothing to see."""
ADDED_SENSORS = ("gyro", "acc", "camera", "fix")
"""Sensors that may be added to either, with all of their keys."""

Setters = dict[str, tuple[tuple[str, ...], str]]


def keys(drive: str = "", *, world: bool = True) -> Setters:
    """Return the query keys of a named drive: key → (path of field names in SimSpec, type).

    `world` says whether the drive has one. Without a name, all there are.
    """
    found: Setters = {}
    plain = SimSpec("")
    for f in dataclasses.fields(SimSpec):
        if f.name == "name":
            continue
        default = getattr(plain, f.name)
        if dataclasses.is_dataclass(default):
            for inner in dataclasses.fields(default):
                key = f.name if inner.name in ("on", "kind") else f"{f.name}_{inner.name}"
                found[key] = ((f.name, inner.name), str(inner.type))
        else:
            found[f.name] = ((f.name,), str(f.type))
    if not world:
        found = {k: v for k, v in found.items() if v[0][0] not in WORLD_KEYS}
    if not drive.startswith("seed-a-"):
        return found
    if drive.startswith("seed-a-vehicle-"):
        named, sensors = set(VEHICLE_KEYS), {"yaw", *ADDED_SENSORS}
    else:
        named, sensors = set(SEED_A_KEYS), set(ADDED_SENSORS)
    return {k: v for k, v in found.items() if k in named or v[0][0] in sensors}


def _value(key: str, text: str, kind: str) -> Any:
    """Return the text as the field's type; raises FglocError with what would be right."""
    if kind == "bool":
        switches = {"on": True, "1": True, "off": False, "0": False}
        if text in switches:
            return switches[text]
        raise FglocError(f"{key}={text}: write on or off")
    if kind == "str":
        return text
    try:
        number = int(text) if kind.startswith("int") else float(text)
    except ValueError:
        what = "a whole number" if kind.startswith("int") else "a number"
        raise FglocError(f"{key}={text}: {key} must be {what}") from None
    if not math.isfinite(number):
        raise FglocError(f"{key}={text}: {key} must be finite")
    return number


def parse(text: str, named: dict[str, SimSpec]) -> SimSpec:
    """Return the spec of `NAME?key=value&…`, starting from the named drive's own.

    Raises FglocError for an unknown name, key or value, with those that exist.
    """
    name, _, query = text.partition("?")
    if name not in named:
        raise FglocError(
            f"there is no simulated drive {name!r}; use one of {', '.join(sorted(named))}"
        )
    spec = named[name]
    known = keys(name, world=bool(spec.world))
    for item in query.split("&") if query else []:
        key, equals, value = item.partition("=")
        if key not in known or not equals:
            raise FglocError(
                f"{name}: unknown key {key!r}; write key=value with one of {', '.join(known)}"
            )
        path, kind = known[key]
        parsed = _value(key, value, kind)
        if len(path) == 2:
            model = replace(getattr(spec, path[0]), **{path[1]: parsed})
            spec = replace(spec, **{path[0]: model})
        else:
            spec = replace(spec, **{path[0]: parsed})
    _validate(spec)
    return spec


def _validate(spec: SimSpec) -> None:
    """Raise FglocError for values that no drive can have."""
    positive = {
        "duration": spec.duration,
        "keyframes": spec.keyframes,
        "rate": spec.rate,
        "speed": spec.speed,
        "effective_track": spec.effective_track,
        "nominal_track": spec.nominal_track,
        "truth_rate": spec.truth_rate,
        "fix_sigma": spec.fix.sigma,
        "lidar_range_sigma": spec.lidar.range_sigma,
    }
    for sensor in ("yaw", "gyro", "acc", "camera", "lidar"):
        positive[f"{sensor}_rate"] = getattr(spec, sensor).rate
    for key, value in positive.items():
        if value is not None and not value > 0:
            raise FglocError(f"{key}={value}: {key} must be greater than 0")
    if spec.seed < 0:
        raise FglocError(f"seed={spec.seed}: a seed must not be negative")
    if spec.calibration not in ("drawn", "prior", "nominal"):
        raise FglocError(f"calibration={spec.calibration}: write drawn, prior or nominal")
    for sensor in ("encoder", "yaw", "gyro", "acc", "camera", "fix", "lidar"):
        dropout = getattr(spec, sensor).dropout
        if not 0.0 <= dropout < 1.0:
            raise FglocError(f"{sensor}_dropout={dropout}: a probability below 1 is needed")
    if not 0 <= spec.people <= MOST_PEOPLE:
        raise FglocError(f"people={spec.people}: from 0 to {MOST_PEOPLE} can walk about")
    if not 2 <= spec.lidar.beams <= MOST_BEAMS:
        raise FglocError(f"lidar_beams={spec.lidar.beams}: from 2 to {MOST_BEAMS} are possible")
    if spec.fix.every < 0.0:
        raise FglocError(f"fix_every={spec.fix.every}: a time in seconds, or 0 for no fixes")
    if spec.duration is not None and spec.keyframes is not None:
        raise FglocError("duration and keyframes say the same thing; give one of them")
