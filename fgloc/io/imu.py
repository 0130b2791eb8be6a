"""From IMU messages to heading, yaw rate and forward acceleration, whatever way it is mounted."""

from __future__ import annotations

import math
from collections import Counter

import msgspec
import numpy as np

from fgloc.core.measurements import Acceleration, Floats, Sensor, WheelIncrements, Yaw, YawRate
from fgloc.datasets.text import NOT_A_NUMBER, Integers, count, finite_rows
from fgloc.io.messages import Messages, rotated_axis
from fgloc.io.stamps import stamps_of
from fgloc.io.topics import ImuTable

YAW_SIGMA, YAW_DRIFT = 0.02, 0.002
"""Noise [rad] and drift [rad/sqrt(s)] of the heading of a small AHRS, where it says nothing:
a degree, and a tenth of that in a second."""
DENSITY, BIAS_WALK = 5e-4, 5e-5
"""Noise density of a yaw rate [rad/s/sqrt(Hz)], a MEMS gyro (5e-5 to 2e-4) on a shaking robot, and
random walk of its bias [rad/s/sqrt(s)]."""
SIGMAS = {"yaw": (1e-4, 1.0), "rate": (1e-5, 0.5)}
"""Standard deviations outside are placeholders and no measure of noise [rad], [rad/s]."""
GRAVITY = (7.0, 12.6)
"""A mean acceleration within these bounds is gravity [m/s²]."""
ALONG = 0.8
"""An axis with at least this part of gravity is the vertical one."""
TURNS = 1.0
"""A drive that turns less in all [rad] does not tell how an IMU is mounted."""
AGAINST, WITH = -0.5, 0.5
"""Correlations of two rates that clearly turn against, and with, each other."""
GRID_NS = 200_000_000
"""Rates are compared as means over this time [ns]."""
ORIENTATION, RATE, ACCELERATION = slice(0, 4), slice(4, 7), slice(7, 10)
ORIENTATION_VARIANCE, RATE_VARIANCE = slice(10, 13), slice(13, 16)
ACCELERATION_VARIANCE = slice(16, 19)
UNKNOWN = -1.0
"""First element of the covariance of what an IMU does not measure (sensor_msgs/Imu)."""


def read_imu(
    messages: Messages, given: ImuTable, rejected: Counter[str], notes: list[str]
) -> tuple[list[Sensor], ImuTable]:
    """Return the streams "yaw", "gyro", "acc" of an IMU, as far as it has them, and the table.

    Nothing is taken whose covariance begins with -1 (not measured), of a heading whose quaternions
    have no length or never change, or of a rate or an acceleration that is zero throughout. The
    sign of a rate is never guessed. O(N).
    """
    stamps, index = stamps_of(messages, "imu", rejected, notes)
    table = messages.table()[index]
    good = finite_rows(table[:, RATE], rejected, f"imu {NOT_A_NUMBER}")
    stamps, table = stamps[good], table[good]
    if stamps.size < 2:
        notes.append(f"{messages.topic} has fewer than two usable messages and is left out.")
        return [], given
    axis = given.axis or _vertical(table, messages.topic, notes)
    forward = given.forward or ("+x" if axis[1] == "z" else None)
    has = _content(table)
    wanted = has if given.use is None else tuple(u for u in given.use if u in has)
    for use in given.use or ():
        if use not in has:
            notes.append(f"{messages.topic} has no {use}, which the topic map asks for.")
    if forward is None and "acceleration" in wanted:
        wanted = tuple(u for u in wanted if u != "acceleration")
        notes.append(
            f"The acceleration of {messages.topic} is left out: which axis points forward is not "
            "known; set imu.forward."
        )
    sensors: list[Sensor] = []
    used = msgspec.structs.replace(
        given, topic=messages.topic, use=wanted, axis=axis, forward=forward
    )
    up = _unit(axis)
    if "yaw" in wanted:
        upright = np.linalg.norm(table[:, ORIENTATION], axis=1) > 1e-6
        upright &= np.isfinite(table[:, ORIENTATION]).all(axis=1)
        upright &= table[:, ORIENTATION_VARIANCE.start] != UNKNOWN
        count(rejected, "imu without orientation", int((~upright).sum()))
        known = table[upright]
        heading = _heading(known[:, ORIENTATION], axis)
        heading = -heading if given.world == "ned" else heading
        told = _typical(known[:, ORIENTATION_VARIANCE] @ np.abs(up), "yaw")
        sigma = given.yaw_sigma or told or YAW_SIGMA
        drift = YAW_DRIFT if given.yaw_drift is None else given.yaw_drift
        sensors.append(Yaw("yaw", stamps[upright], heading, sigma, drift_sigma=drift))
        used = msgspec.structs.replace(used, yaw_sigma=sigma, yaw_drift=drift)
        _tell("heading", sigma, "rad", given.yaw_sigma, told, notes)
    if "rate" in wanted:
        period = float(np.median(np.diff(stamps))) * 1e-9
        told = _typical(table[:, RATE_VARIANCE] @ np.abs(up), "rate")
        told = None if told is None else told * math.sqrt(period)
        density = given.rate_density or told or DENSITY
        rate = table[:, RATE] @ up
        sensors.append(YawRate("gyro", stamps, rate, density, bias_walk=BIAS_WALK))
        used = msgspec.structs.replace(used, rate_density=density)
        _tell("yaw rate", density, "rad/s/√Hz", given.rate_density, told, notes)
    if "acceleration" in wanted and forward is not None:
        fine = finite_rows(table[:, ACCELERATION], rejected, f"imu acceleration {NOT_A_NUMBER}")
        along = table[fine, ACCELERATION] @ _unit(forward)
        sensors.append(Acceleration("acc", stamps[fine], along))
    return sensors, used


def _tell(
    what: str, sigma: float, unit: str, given: float | None, told: float | None, notes: list[str]
) -> None:
    """Add a note of where the noise of a stream comes from."""
    if given is None:
        source = "the median of its covariance" if told is not None else "what is usual"
        notes.append(f"Noise of the IMU's {what}: {sigma:.2g} {unit}, {source}.")


def _unit(axis: str) -> Floats:
    """Return the unit vector (3,) of an axis such as "-y"."""
    out = np.zeros(3)
    out["xyz".index(axis[1])] = 1.0 if axis[0] == "+" else -1.0
    return out


def _content(table: Floats) -> tuple[str, ...]:
    """Return what an IMU measures of "yaw", "rate" and "acceleration"."""
    quaternions = table[:, ORIENTATION]
    oriented = np.isfinite(quaternions).all(axis=1) & (np.abs(quaternions).max(axis=1) > 1e-6)
    unknown = {
        name: bool(np.all(table[:, variance.start] == UNKNOWN))
        for name, variance in (
            ("yaw", ORIENTATION_VARIANCE),
            ("rate", RATE_VARIANCE),
            ("acceleration", ACCELERATION_VARIANCE),
        )
    }
    # Drivers without an orientation leave it at the identity and forget to say so.
    varies = oriented.sum() >= 2 and bool(np.any(np.ptp(quaternions[oriented], axis=0) > 0.0))
    found = {
        "yaw": varies,
        "rate": bool(np.any(table[:, RATE] != 0.0)),
        "acceleration": bool(np.any(np.nan_to_num(table[:, ACCELERATION]) != 0.0)),
    }
    return tuple(name for name, there in found.items() if there and not unknown[name])


def _vertical(table: Floats, topic: str, notes: list[str]) -> str:
    """Return the axis that points up: +z, or what gravity says where z is not vertical.

    An accelerometer at rest shows 9.8 m/s² along the axis that points up. Where that is x or y,
    the rate about z is no yaw rate. Where it is -z, drivers of two conventions differ in whether
    the IMU hangs upside down, so that is only told.
    """
    acceleration = table[np.isfinite(table[:, ACCELERATION]).all(axis=1)][:, ACCELERATION]
    if not acceleration.size:
        return "+z"
    mean = acceleration.mean(axis=0)
    length = float(np.linalg.norm(mean))
    if not GRAVITY[0] <= length <= GRAVITY[1]:
        return "+z"
    largest = int(np.argmax(np.abs(mean)))
    axis = ("-" if mean[largest] < 0.0 else "+") + "xyz"[largest]
    if abs(mean[largest]) < ALONG * length or axis == "+z":
        return "+z"
    if axis == "-z":
        notes.append(
            f"Gravity pulls {topic} the wrong way along z: it may be mounted upside down. Its "
            'signs are used as recorded; imu.axis = "-z" turns it over.'
        )
        return "+z"
    notes.append(
        f"Gravity lies along {axis} of {topic}: that axis is taken as the vertical one "
        '(imu.axis = "+z" overrules that).'
    )
    return axis


def _heading(quaternions: Floats, axis: str) -> Floats:
    """Return the (N,) heading [rad], unwrapped, of an axis of the IMU that lies in the ground.

    That is x where z is vertical, as for a robot; its zero does not matter.
    """
    level = {"z": "+x", "x": "+y", "y": "+z"}[axis[1]]
    turned = rotated_axis(quaternions, _unit(level))
    return np.asarray(np.unwrap(np.arctan2(turned[:, 1], turned[:, 0])))


def _typical(variance: Floats, what: str) -> float | None:
    """Return the sigma of the median of sensible variances; None where there is none."""
    sensible = variance[np.isfinite(variance) & (variance > 0.0)]
    if not sensible.size:
        return None
    sigma = math.sqrt(float(np.median(sensible)))
    low, high = SIGMAS[what]
    return sigma if low <= sigma <= high else None


def check_against_wheels(
    sensors: list[Sensor], wheels: WheelIncrements, turns: Floats, topic: str
) -> list[str]:
    """Return notes about an IMU that turns against the wheels or without regard to them.

    `turns` (N,) are the rotations of the base [rad] that the wheels tell. Compared are mean rates
    over fifths of a second in the time that both cover. O(N).
    """
    notes = []
    course = np.append(0.0, np.cumsum(turns))
    for sensor in sensors:
        if isinstance(sensor, Yaw):
            stamps, angle, what = sensor.stamps_ns, np.unwrap(sensor.yaw), "heading"
        elif isinstance(sensor, YawRate):
            steps = np.diff(sensor.stamps_ns, prepend=sensor.stamps_ns[:1]) * 1e-9
            stamps, angle, what = sensor.stamps_ns, np.cumsum(sensor.rate * steps), "yaw rate"
        else:
            continue
        grid = _shared_grid(stamps, wheels.stamps_ns)
        if grid.size < 10:
            continue
        ours = np.diff(_at(grid, wheels.stamps_ns, course))
        theirs = np.diff(_at(grid, stamps, angle))
        if np.abs(ours).sum() < TURNS or not (ours.std() > 0.0 and theirs.std() > 0.0):
            continue
        together = float(np.corrcoef(ours, theirs)[0, 1])
        if together < AGAINST:
            turn_over = 'imu.world = "ned"' if what == "heading" else 'imu.axis = "-z"'
            notes.append(
                f"The {what} of {topic} turns against the wheels (correlation {together:.2f}): "
                f"is it mounted upside down? It is used as recorded; {turn_over} turns it over."
            )
        elif together < WITH:
            notes.append(
                f"The {what} of {topic} has little to do with the turning of the wheels "
                f"(correlation {together:.2f}): one of them is wrong."
            )
        else:
            gain = float(ours @ theirs / (ours @ ours))
            if not 0.5 <= gain <= 2.0:
                notes.append(
                    f"The {what} of {topic} turns {gain:.2g} times as much as the wheels: one of "
                    "them is wrong."
                )
    return notes


def _shared_grid(one: Integers, other: Integers) -> Integers:
    """Return stamps a fifth of a second apart in the time that two streams share."""
    first, last = max(one[0], other[0]), min(one[-1], other[-1])
    # A clock that leaps by years must not fill the memory.
    count = min(max(int(last - first) // GRID_NS + 1, 0), 1_000_000)
    return np.asarray(first + np.arange(count, dtype=np.int64) * GRID_NS)


def _at(grid: Integers, stamps: Integers, values: Floats) -> Floats:
    """Return values interpolated at the stamps of a grid."""
    origin = stamps[0]
    return np.asarray(np.interp((grid - origin) * 1e-9, (stamps - origin) * 1e-9, values))
