"""Where filters take the heading from: the stream, its reading nearest to a stamp, its silences."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fgloc.core.drive import Drive
from fgloc.core.measurements import Stamps, Yaw, YawRate
from fgloc.errors import FglocError

SILENCE_S = 0.5
"""A gap of the yaw sensor longer than this [s] is bridged with the encoders' turn."""


def heading_source(drive: Drive, method: str) -> Yaw | YawRate:
    """Return the stream the heading comes from: the first yaw, else the first yaw rate.

    Raises FglocError, naming the method, if the drive has neither or the stream is empty.
    """
    streams: tuple[Yaw | YawRate, ...] = (*drive.each(Yaw), *drive.each(YawRate))
    if not streams:
        raise FglocError(f"{method} needs a yaw sensor; {drive.name} has none")
    if streams[0].stamps_ns.size == 0:
        raise FglocError(
            f"{streams[0].sensor}: the stream is empty; {method} needs at least one reading"
        )
    return streams[0]


def nearest_readings(
    yaw: Yaw, stamps: Stamps
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.bool_]]:
    """Return for (N,) stamps the index of the reading nearest in time, and whether it is heard.

    A stamp hears nothing if it lies in a gap of more than 0.5 s, away from the readings at the
    gap's ends. Before the first and after the last reading the gap ends with the stamps. The
    stream must not be empty. O(N log M).
    """
    after = np.searchsorted(yaw.stamps_ns, stamps)
    late = np.minimum(after, yaw.stamps_ns.size - 1)
    early = np.maximum(after - 1, 0)
    nearest = np.where(
        np.abs(yaw.stamps_ns[late] - stamps) < np.abs(yaw.stamps_ns[early] - stamps), late, early
    )
    distance = np.abs(yaw.stamps_ns[nearest] - stamps)
    begin = np.where(after > 0, yaw.stamps_ns[early], stamps[0])
    end = np.where(after < yaw.stamps_ns.size, yaw.stamps_ns[late], stamps[-1])
    periods = np.diff(yaw.stamps_ns)
    near = min(float(np.median(periods)) if periods.size else 0.0, 0.5 * SILENCE_S * 1e9)
    return nearest, ~((end - begin > SILENCE_S * 1e9) & (distance > near))


def rate_note(sensor: str) -> str:
    """Return the sentence that a yaw rate had to stand in for a yaw."""
    return f"no yaw sensor: the rate of {sensor} is integrated, bias unknown"


def silence_note(sensor: str, silent: npt.NDArray[np.bool_], what: str) -> tuple[str, ...]:
    """Return the sentence for the `silent` steps (N,), which go on as `what` says, or nothing."""
    if not silent.any():
        return ()
    return (
        f"{sensor} is silent for more than {SILENCE_S} s: "
        f"{int(silent.sum())} of {silent.size} steps {what}",
    )
