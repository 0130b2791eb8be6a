"""What a sensor saw of the robot's motion beside what two wheels turned meanwhile."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fgloc.core.drive import Drive
from fgloc.core.geometry import between, wrap
from fgloc.core.measurements import CameraPoses, Floats, Stamps
from fgloc.errors import FglocError

PERIOD_S = 0.5
"""Time over which a sensor's motion is looked at, at least [s]; the publication has 0.8 s."""
LONGEST = 3.0
"""An interval so many times longer than usual holds a silence of the sensor."""

Indices = npt.NDArray[np.int64]


def displacements_of(
    drive: Drive, sensor: str | None = None, period_s: float = PERIOD_S
) -> tuple[Floats, Floats, Floats]:
    """Return what `solve` takes: angles (N, 2) [rad], seconds (N,), displacements (N, 3).

    The sensor is the camera of that name, or the drive's first camera; where a drive has none, its
    recorded truth, which is mounted somewhere, too. Of its poses those at least `period_s` apart
    are used, since over shorter times its noise is all there is; wheels that turned steadily within
    an interval are split at a pose's stamp. Intervals more than LONGEST periods long (or than
    LONGEST usual intervals of the sensor) hold a silence and are left out. Raises FglocError for a
    base without exactly the wheels left and right, and for a drive without such a sensor. O(N + M).
    """
    names = drive.robot.base.driven_names
    if sorted(names) != ["left", "right"]:
        raise FglocError(
            f"{drive.name}: the closed form needs a base with the wheels left and right, this one "
            f"has {', '.join(names)}"
        )
    stamps, poses = _poses(drive, sensor)
    wheels = drive.wheels
    inside = (stamps >= wheels.stamps_ns[0]) & (stamps <= wheels.stamps_ns[-1])
    stamps, poses = stamps[inside], poses[inside]
    chosen = _apart(stamps, int(period_s * 1e9))
    stamps, poses = stamps[chosen], poses[chosen]
    if stamps.size < 2:
        raise FglocError(f"{drive.name}: fewer than two poses of the sensor during the drive")
    # The integers are differences from the first stamp: they keep their digits as floats.
    since = (wheels.stamps_ns - wheels.stamps_ns[0]).astype(np.float64)
    at = (stamps - wheels.stamps_ns[0]).astype(np.float64)
    turned = np.vstack([np.zeros(2), np.cumsum(wheels.angles, axis=0)])
    order = [names.index("left"), names.index("right")]
    angles = np.column_stack([np.diff(np.interp(at, since, turned[:, k])) for k in order])
    seconds = np.diff(stamps) * 1e-9
    moved = between(poses[:-1], poses[1:])
    moved[:, 2] = wrap(moved[:, 2])
    whole = seconds <= LONGEST * max(period_s, float(np.median(seconds)))
    return angles[whole], seconds[whole], moved[whole]


def _poses(drive: Drive, sensor: str | None) -> tuple[Stamps, Floats]:
    """Return the stamps and poses of the sensor, or of the truth where there is no camera."""
    cameras = drive.each(CameraPoses)
    if sensor is None and not cameras and drive.truth is not None:
        return drive.truth.trajectory.stamps_ns, drive.truth.trajectory.poses
    for camera in cameras:
        if sensor in (None, camera.sensor):
            return camera.stamps_ns, camera.poses
    called = "" if sensor is None else f" called {sensor}"
    there = ", ".join(c.sensor for c in cameras) or "none"
    raise FglocError(f"{drive.name}: there is no camera{called}; there is {there}")


def _apart(stamps: Stamps, period: int) -> Indices:
    """Return indices of stamps at least `period` [ns] apart, each the first that is."""
    chosen = [0] if stamps.size else []
    while chosen and stamps[-1] - stamps[chosen[-1]] >= period:
        chosen.append(int(np.searchsorted(stamps, stamps[chosen[-1]] + period)))
    return np.array(chosen, dtype=np.int64)
