"""A drive's measurements merged by time, as the pose EKF's loop takes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fgloc.core.drive import Drive
from fgloc.core.geometry import chain
from fgloc.core.measurements import Floats, Stamps, YawRate
from fgloc.core.preintegration import preintegrate, rounding_sigma, split_at
from fgloc.filters.causal_gyro import turned_so_far
from fgloc.filters.miscalibration import miscalibration
from fgloc.filters.pose_ekf_kernel import Codes
from fgloc.filters.pose_ekf_settings import PoseEkfSettings
from fgloc.filters.pose_ekf_streams import Correcting, Stream, make_stream


@dataclass(frozen=True)
class Events:
    """All measurements of a drive in the order of time."""

    cuts_ns: Stamps
    """(C,) moments at which something is measured or emitted, all wheel stamps among them."""
    steps: Floats
    """(C-1, 3) relative poses between cuts by the wheels."""
    step_covariances: Floats
    """(C-1, 3, 3) their covariances, in the axes of the earlier cut."""
    emit: Codes
    """(C,) number of the wheel stamp, -1 at cuts that are none."""
    first: Codes
    """(C+1,) the first event at each cut; the last entry is E."""
    streams: tuple[Stream, ...]
    """What is measured, in the drive's order."""
    stream_of: Codes
    """(E,) index into `streams`."""
    reading_of: Codes
    """(E,) index into the stream's readings."""
    gyros: tuple[YawRate, ...]
    """Gyros, in the drive's order."""
    turns: Floats
    """(G, C-1) angle turned between cuts by each gyro [rad]."""
    turn_variances: Floats
    """(G, C-1) its variance [rad²]; 0 where the gyro was silent."""
    rounding: Floats
    """(3,) sigma of a pose that rounded encoder counts tell, in body axes [m, m, rad]."""


def merge(drive: Drive, settings: PoseEkfSettings) -> Events:
    """Return the measurements inside the drive (cut to its truth already), merged by time.

    Raises FglocError if the wheels do not determine the motion. O((N + M) log (N + M)).
    """
    wheels = drive.wheels.stamps_ns
    rounding = rounding_sigma(drive.robot, drive.wheels.resolution)
    sensors = [s for s in drive.sensors if isinstance(s, Correcting)]
    inside = [s.stamps_ns[_within(s.stamps_ns, wheels)] for s in sensors]
    cuts = np.unique(np.concatenate([wheels, *inside]))
    moved = preintegrate(split_at(drive.wheels, cuts), drive.robot)
    path = chain(moved.displacement, np.zeros(3))
    streams = tuple(
        make_stream(sensor, stamps, path[np.searchsorted(cuts, stamps)], settings, rounding)
        for sensor, stamps in zip(sensors, inside, strict=True)
    )
    seconds = np.diff(cuts) * 1e-9
    covariance = moved.covariance + miscalibration(
        drive.robot, moved.jacobian, seconds, settings.calibration, settings.horizon_s
    )
    emit = np.full(cuts.size, -1, dtype=np.int64)
    emit[np.searchsorted(cuts, wheels)] = np.arange(wheels.size)
    sizes = [s.stamps_ns.size for s in streams]
    stream_of = np.repeat(np.arange(len(streams)), sizes).astype(np.int64)
    reading_of = np.concatenate([np.zeros(0, np.int64), *(np.arange(n) for n in sizes)])
    at = np.concatenate([np.zeros(0, np.int64), *(s.stamps_ns for s in streams)])
    order = np.argsort(at, kind="stable")
    gyros = drive.each(YawRate)
    turns = np.zeros((len(gyros), seconds.size))
    variances = np.zeros((len(gyros), seconds.size))
    for k, gyro in enumerate(gyros):
        turns[k], heard = turned_so_far(gyro, cuts)
        density = gyro.density**2 + gyro.bias_sigma**2 * settings.horizon_s
        variances[k] = np.where(heard, settings.gyro**2 * density * seconds, 0.0)
    return Events(
        cuts_ns=cuts,
        steps=moved.displacement,
        step_covariances=settings.process_noise**2 * covariance,
        emit=emit,
        first=np.searchsorted(at[order], np.append(cuts, cuts[-1] + 1)).astype(np.int64),
        streams=streams,
        stream_of=stream_of[order],
        reading_of=reading_of[order],
        gyros=gyros,
        turns=turns,
        turn_variances=variances,
        rounding=rounding,
    )


def _within(stamps: Stamps, wheels: Stamps) -> npt.NDArray[np.bool_]:
    """Return which stamps lie between the first and the last wheel stamp."""
    return np.asarray((stamps >= wheels[0]) & (stamps <= wheels[-1]))
