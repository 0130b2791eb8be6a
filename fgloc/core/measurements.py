"""Typed measurements: one dataclass a sensor kind, each a structure of arrays over time.

Every stream has a sensor name, int64 nanosecond stamps that strictly increase, and its own noise.
A stream validates itself on construction, so code behind a reader never checks again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from fgloc.core.checks import Floats as Floats
from fgloc.core.checks import Stamps as Stamps
from fgloc.core.checks import check_arrays, check_mount, check_noise
from fgloc.errors import FglocError


@dataclass(frozen=True)
class WheelIncrements:
    """What the encoders counted, as wheel angles between consecutive stamps."""

    sensor: str
    """Name of the stream in tables and results, e.g. "wheels"."""
    stamps_ns: Stamps
    """(N+1,) interval boundaries; increment k happened in (stamps_ns[k], stamps_ns[k+1]]."""
    angles: Floats
    """(N, W) rotation of each driven wheel in the interval [rad], forward positive."""
    wheels: tuple[str, ...]
    """Names of the W driven wheels, in column order (left/right, fl/fr/rl/rr, or the dataset's)."""
    steering: Floats | None = None
    """(N, W) mean steering angle of each driven wheel in the interval [rad]; None: not steered."""
    resolution: float = 0.0
    """Size of one encoder count [rad]; 0 for a continuous signal."""

    def __post_init__(self) -> None:
        n = self.stamps_ns.size - 1
        if n < 1:
            raise FglocError(f"{self.sensor}: at least two stamps are needed, got {n + 1}")
        arrays: dict[str, npt.NDArray[Any]] = {"angles": self.angles}
        if self.steering is not None:
            arrays["steering"] = self.steering
        check_arrays(self.sensor, self.stamps_ns, arrays, n)
        for name, values in arrays.items():
            if values.shape != (n, len(self.wheels)):
                raise FglocError(f"{self.sensor}: {name} must have shape ({n}, {len(self.wheels)})")

    def between(self, first: int, last: int) -> WheelIncrements:
        """Return the increments between the stamps with these two indices."""
        return replace(
            self,
            stamps_ns=self.stamps_ns[first : last + 1],
            angles=self.angles[first:last],
            steering=None if self.steering is None else self.steering[first:last],
        )


@dataclass(frozen=True)
class Yaw:
    """Absolute heading from an IMU; its zero is arbitrary and may drift."""

    sensor: str
    """Name of the stream, e.g. "yaw"."""
    stamps_ns: Stamps
    """(N,) stamps."""
    yaw: Floats
    """(N,) heading [rad], wrapped or not, counter-clockwise positive."""
    sigma: float
    """Standard deviation of one reading [rad], quantisation included."""
    drift_sigma: float = 0.0
    """Random walk of the heading's zero [rad/sqrt(s)]."""
    resolution: float = 0.0
    """Quantisation step [rad]; 0 for a continuous signal."""
    drift_rate_sigma: float = 0.0
    """Standard deviation of a constant drift of the zero [rad/s], as a gyro's bias leaves it."""

    def __post_init__(self) -> None:
        check_arrays(self.sensor, self.stamps_ns, {"yaw": self.yaw}, self.stamps_ns.size, ())
        floors = {"drift_sigma": self.drift_sigma, "drift_rate_sigma": self.drift_rate_sigma}
        check_noise(self.sensor, {"sigma": self.sigma}, floors)


@dataclass(frozen=True)
class YawRate:
    """Angular rate about the vertical axis from a gyro."""

    sensor: str
    """Name of the stream, e.g. "gyro"."""
    stamps_ns: Stamps
    """(N,) stamps."""
    rate: Floats
    """(N,) yaw rate [rad/s]."""
    density: float
    """White noise density [rad/s/sqrt(Hz)]: over T seconds the angle has sigma density·sqrt(T)."""
    bias_sigma: float = 0.01
    """Prior standard deviation of the constant bias [rad/s]."""
    bias_walk: float = 0.0
    """Random walk of the bias [rad/s/sqrt(s)]."""

    def __post_init__(self) -> None:
        check_arrays(self.sensor, self.stamps_ns, {"rate": self.rate}, self.stamps_ns.size, ())
        walks = {"bias_sigma": self.bias_sigma, "bias_walk": self.bias_walk}
        check_noise(self.sensor, {"density": self.density}, walks)


@dataclass(frozen=True)
class Acceleration:
    """Acceleration along body x."""

    sensor: str
    """Name of the stream, e.g. "acc"."""
    stamps_ns: Stamps
    """(N,) stamps."""
    forward: Floats
    """(N,) acceleration along body x [m/s²]."""

    def __post_init__(self) -> None:
        check_arrays(
            self.sensor, self.stamps_ns, {"forward": self.forward}, self.stamps_ns.size, ()
        )


@dataclass(frozen=True)
class CameraPoses:
    """Poses of a visual(-inertial) odometry in its own frame, as a T265 gives; it drifts."""

    sensor: str
    """Name of the stream, e.g. "camera"."""
    stamps_ns: Stamps
    """(N,) stamps."""
    poses: Floats
    """(N, 3) x [m], y [m], heading [rad] of the camera in the camera's odometry frame."""
    position_walk: float
    """Random walk of the position [m/sqrt(m)]."""
    heading_walk: float
    """Random walk of the heading [rad/sqrt(m)]."""
    position_sigma: float = 1e-3
    """White noise of one position [m]."""
    heading_sigma: float = 1e-3
    """White noise of one heading [rad]."""
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Nominal pose of the camera on the robot: x [m], y [m], yaw [rad]."""
    mount_sigma: tuple[float, float, float] = (0.02, 0.02, 0.035)
    """Prior standard deviations of the mount [m, m, rad]."""
    scale_sigma: float = 0.01
    """Prior standard deviation of the scale error (scale is 1 nominally)."""

    def __post_init__(self) -> None:
        check_arrays(self.sensor, self.stamps_ns, {"poses": self.poses}, self.stamps_ns.size, (3,))
        white = {"position_sigma": self.position_sigma, "heading_sigma": self.heading_sigma}
        walks = {"position_walk": self.position_walk, "heading_walk": self.heading_walk}
        check_noise(self.sensor, white, {**walks, "scale_sigma": self.scale_sigma})
        check_mount(self.sensor, self.mount, self.mount_sigma, 3)


@dataclass(frozen=True)
class PositionFixes:
    """Absolute positions of an antenna or marker in the map frame (GPS, total station, truth)."""

    sensor: str
    """Name of the stream, e.g. "gps" or "fixes"."""
    stamps_ns: Stamps
    """(N,) stamps."""
    positions: Floats
    """(N, 2) x, y in the map frame [m]."""
    sigma: Floats
    """(N, 2) standard deviations along map x and y [m]."""
    mount: tuple[float, float] = (0.0, 0.0)
    """Nominal position of the antenna on the robot (lever arm): x, y [m]."""
    mount_sigma: tuple[float, float] = (0.0, 0.0)
    """Prior standard deviations of the lever arm [m]; 0 means known exactly."""
    mount_name: str = ""
    """Sensor whose mounting this is, calibrated as `<name>_x/_y`; empty for the stream's own."""

    def __post_init__(self) -> None:
        n = self.stamps_ns.size
        arrays = {"positions": self.positions, "sigma": self.sigma}
        check_arrays(self.sensor, self.stamps_ns, arrays, n, (2,))
        if n and not bool(np.all(self.sigma > 0.0)):
            raise FglocError(f"{self.sensor}: every sigma of a position fix must be positive")
        check_mount(self.sensor, self.mount, self.mount_sigma, 2)


@dataclass(frozen=True)
class PoseFixes:
    """Absolute poses of a sensor in the map frame (map matching, motion capture)."""

    sensor: str
    """Name of the stream."""
    stamps_ns: Stamps
    """(N,) stamps."""
    poses: Floats
    """(N, 3) x, y [m], heading [rad] in the map frame."""
    sigma: Floats
    """(N, 3) standard deviations along map x, y [m] and of the heading [rad]."""
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Nominal pose of the sensor on the robot: x, y [m], yaw [rad]."""
    mount_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Prior standard deviations of the mount [m, m, rad]; 0 means known exactly."""
    mount_name: str = ""
    """Sensor whose mounting this is, calibrated as `<name>_x/_y/_yaw`; empty: the stream's own."""

    def __post_init__(self) -> None:
        n = self.stamps_ns.size
        check_arrays(
            self.sensor, self.stamps_ns, {"poses": self.poses, "sigma": self.sigma}, n, (3,)
        )
        if n and not bool(np.all(self.sigma > 0.0)):
            raise FglocError(f"{self.sensor}: every sigma of a pose fix must be positive")
        check_mount(self.sensor, self.mount, self.mount_sigma, 3)


@dataclass(frozen=True)
class Scans:
    """Planar laser scans."""

    sensor: str
    """Name of the stream, e.g. "lidar"."""
    stamps_ns: Stamps
    """(N,) stamp of the first beam of each scan."""
    ranges: Floats
    """(N, B) ranges [m]; 0 where the beam did not return."""
    angle_min: float
    """Angle of the first beam in the sensor frame [rad]."""
    angle_increment: float
    """Angle between beams [rad], signed."""
    beam_period: float = 0.0
    """Time between beams [s]; 0 where a scan is taken at once, or was straightened before."""
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Nominal pose of the lidar on the robot: x, y [m], yaw [rad]."""
    mount_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Prior standard deviations of the mount [m, m, rad]."""
    range_sigma: float = 0.01
    """Standard deviation of a range [m], what does not grow with it."""
    range_sigma_share: float = 0.0
    """Standard deviation of a range as a share of it (0.01: 1 %), added in squares."""
    bearing_sigma: float = 0.0
    """Standard deviation of a beam's direction [rad]."""
    min_range: float = 0.0
    """Shortest range that the sensor can measure [m]."""
    max_range: float = 1000.0
    """Longest range that the sensor can measure [m]; readings from there on are no returns."""

    def __post_init__(self) -> None:
        check_arrays(self.sensor, self.stamps_ns, {"ranges": self.ranges}, self.stamps_ns.size)
        if self.ranges.ndim != 2:
            raise FglocError(f"{self.sensor}: ranges must have one row a scan")
        if not (math.isfinite(self.angle_min) and math.isfinite(self.angle_increment)):
            raise FglocError(f"{self.sensor}: the beams' directions must be finite")
        others = {
            "range_sigma_share": self.range_sigma_share,
            "bearing_sigma": self.bearing_sigma,
            "beam_period": self.beam_period,
            "min_range": self.min_range,
        }
        check_noise(self.sensor, {"range_sigma": self.range_sigma}, others)
        if not self.max_range > self.min_range:
            raise FglocError(f"{self.sensor}: max_range must be above min_range")
        check_mount(self.sensor, self.mount, self.mount_sigma, 3)


@dataclass(frozen=True)
class Survey:
    """Where landmarks are, as somebody measured them."""

    landmark: npt.NDArray[np.int64]
    """(L,) identities."""
    positions: Floats
    """(L, 2) x, y in the map frame [m]."""
    sigma: Floats
    """(L, 2) standard deviations [m]."""

    def __post_init__(self) -> None:
        n = self.landmark.size
        arrays = {"positions": self.positions, "sigma": self.sigma}
        check_arrays("survey", np.zeros(0, np.int64), arrays, n, (2,))
        if np.unique(self.landmark).size != n:
            raise FglocError("survey: a landmark stands there twice")
        if n and not bool(np.all(self.sigma > 0.0)):
            raise FglocError("survey: every sigma of a landmark must be positive")


@dataclass(frozen=True)
class LandmarkSightings:
    """Range and bearing to point landmarks; stamps may repeat: one picture, many marks."""

    sensor: str
    """Name of the stream."""
    stamps_ns: Stamps
    """(N,) stamps, non-decreasing."""
    landmark: npt.NDArray[np.int64]
    """(N,) identity of the landmark; -1 where the sensor does not know which one it is."""
    range_m: Floats
    """(N,) distance [m]."""
    bearing: Floats
    """(N,) direction in the sensor frame [rad]."""
    range_sigma: float = 0.1
    """Standard deviation of a range [m]."""
    bearing_sigma: float = 0.02
    """Standard deviation of a bearing [rad]."""
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Nominal pose of the sensor on the robot: x, y [m], yaw [rad]."""
    mount_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Prior standard deviations of the mount [m, m, rad]."""
    survey: Survey | None = None
    """What is known of the landmarks' positions; None: nothing, they are to be mapped."""

    def __post_init__(self) -> None:
        n = self.stamps_ns.size
        values = {"landmark": self.landmark, "range": self.range_m, "bearing": self.bearing}
        check_arrays(self.sensor, self.stamps_ns[:0], values, n, ())
        if n > 1 and not bool(np.all(np.diff(self.stamps_ns) >= 0)):
            raise FglocError(f"{self.sensor}: stamps go back in time")
        noise = {"range_sigma": self.range_sigma, "bearing_sigma": self.bearing_sigma}
        check_noise(self.sensor, noise)
        check_mount(self.sensor, self.mount, self.mount_sigma, 3)


Sensor = (
    Yaw
    | YawRate
    | Acceleration
    | CameraPoses
    | PositionFixes
    | PoseFixes
    | Scans
    | LandmarkSightings
)
