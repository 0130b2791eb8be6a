"""Model 2: distance from the encoders, heading from the yaw sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fgloc.core.drive import Drive
from fgloc.core.measurements import Floats, Stamps, Yaw, YawRate
from fgloc.core.start import start_pose, trim_to_truth
from fgloc.core.trajectory import Trajectory
from fgloc.estimator import Result, SensorCount
from fgloc.filters.heading import (
    SILENCE_S,
    heading_source,
    nearest_readings,
    rate_note,
    silence_note,
)
from fgloc.filters.model1 import trim_note


@dataclass(frozen=True)
class Model2:
    """Encoder displacement turned by the mean of the yaw readings before and after each interval.

    The reading nearest in time to a wheel stamp counts; the first one is set to the start's
    heading, later ones keep their difference to it, so that the sensor's arbitrary zero drops out.
    Without a yaw stream a yaw-rate stream is integrated. Source: seed A, Model 2.
    """

    @property
    def method(self) -> str:
        """Return the method id."""
        return "model2"

    def estimate(self, drive: Drive) -> Result:
        """Return a pose at every wheel stamp; covariances are not known. O(N log M).

        Raises FglocError if the drive has neither a yaw nor a yaw-rate stream, or wheels and
        truth do not overlap.
        """
        trimmed = trim_to_truth(drive)
        wheels = trimmed.wheels
        stamps = wheels.stamps_ns
        displacements = trimmed.robot.base.displacements(wheels.angles, wheels.steering)
        encoder = np.concatenate([[0.0], np.cumsum(displacements[:, 2])])
        source = heading_source(drive, self.method)
        notes = []
        if isinstance(source, Yaw):
            turned, silent = yaw_turn(source, stamps, encoder)
        else:
            turned, silent = rate_turn(source, stamps, encoder)
            notes.append(rate_note(source.sensor))
        notes += silence_note(source.sensor, silent, "turn by the encoders")
        left_out = drive.wheels.stamps_ns.size - stamps.size
        inside = (source.stamps_ns >= stamps[0]) & (source.stamps_ns <= stamps[-1])
        accepted = int(inside.sum())
        return Result(
            self.method,
            drive.name,
            Trajectory(stamps, dead_reckon(displacements, turned, start_pose(trimmed))),
            (wheels.sensor, source.sensor),
            counts={
                wheels.sensor: SensorCount(wheels.angles.shape[0], rejected=left_out),
                source.sensor: SensorCount(accepted, rejected=inside.size - accepted),
            },
            notes=(*notes, *trim_note(left_out)),
        )


def dead_reckon(displacements: Floats, turned: Floats, start: Floats) -> Floats:
    """Return (N+1, 3) poses: displacement k (N, 3) turned by the mean of headings k and k+1.

    `turned` (N+1,) is the heading relative to the start's [rad]; the displacements' own turn is
    not used.
    """
    heading = start[2] + turned
    middle = 0.5 * (heading[:-1] + heading[1:])
    c, s = np.cos(middle), np.sin(middle)
    steps = np.stack(
        [
            c * displacements[:, 0] - s * displacements[:, 1],
            s * displacements[:, 0] + c * displacements[:, 1],
        ],
        axis=-1,
    )
    poses = np.empty((heading.size, 3))
    poses[0, :2] = start[:2]
    poses[1:, :2] = start[:2] + np.cumsum(steps, axis=0)
    poses[:, 2] = heading
    return poses


def yaw_turn(yaw: Yaw, stamps: Stamps, encoder: Floats) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Return the (N+1,) heading since the first stamp [rad] and which of the N steps are silent.

    `encoder` (N+1,) is the heading by the wheels. The readings enter as a correction to it: their
    difference to the wheels changes slowly, so unwrapping it stays right over pauses in which the
    robot turns by more than half a turn. A step is silent if its end lies in a gap of more than
    0.5 s, away from the readings at the gap's ends; it then keeps the last correction. The stream
    must not be empty.
    """
    nearest, heard = nearest_readings(yaw, stamps)
    correction = np.zeros(stamps.size)
    known = np.flatnonzero(heard)
    if known.size:
        offset = np.unwrap(yaw.yaw[nearest[known]] - encoder[known])
        last = np.maximum.accumulate(np.where(heard, np.cumsum(heard) - 1, 0))
        correction = (offset - offset[0])[last]
        correction[: known[0]] = 0.0
    return encoder + correction - encoder[0], ~heard[1:]


def rate_turn(
    gyro: YawRate, stamps: Stamps, encoder: Floats
) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Return the (N+1,) integrated rate since the first stamp [rad] and which steps are silent.

    The rate is integrated by the trapezoid rule and held for up to 0.5 s outside the recorded
    span; a step that touches a longer gap turns by the encoders, `encoder` (N+1,). The stream must
    not be empty.
    """
    limit = int(SILENCE_S * 1e9)
    times = np.concatenate(
        [[gyro.stamps_ns[0] - limit], gyro.stamps_ns, [gyro.stamps_ns[-1] + limit]]
    )
    rates = np.concatenate([gyro.rate[:1], gyro.rate, gyro.rate[-1:]])
    # Seconds since the first stamp: doubles keep nanoseconds there, not since 1970.
    seconds = (times - times[0]) * 1e-9
    at = (stamps - times[0]) * 1e-9
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (rates[1:] + rates[:-1]) * np.diff(seconds))])
    # Between two readings the integral of a linear rate is a parabola, not a straight line.
    k = np.clip(np.searchsorted(seconds, at, side="right") - 1, 0, seconds.size - 2)
    into = at - seconds[k]
    slope = (rates[k + 1] - rates[k]) / (seconds[k + 1] - seconds[k])
    reached = angle[k] + into * (rates[k] + 0.5 * slope * into)
    gaps = np.concatenate([[0], np.cumsum(np.diff(times) > limit)])
    first, last = np.searchsorted(times, stamps, side="right"), np.searchsorted(times, stamps)
    # The number of long gaps that end after a step's begin and begin before its end.
    begun = gaps[np.clip(last[1:], 0, times.size - 1)]
    ended = gaps[np.clip(first[:-1] - 1, 0, times.size - 1)]
    silent = (begun > ended) | (stamps[:-1] < times[0]) | (stamps[1:] > times[-1])
    steps = np.where(silent, np.diff(encoder), np.diff(reached))
    return np.concatenate([[0.0], np.cumsum(steps)]), silent
