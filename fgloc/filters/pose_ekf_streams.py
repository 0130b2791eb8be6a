"""Sensors that correct the pose EKF's state: their readings, and how far they may be off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fgloc.core.geometry import between, compose, inverse, wrap
from fgloc.core.measurements import CameraPoses, Floats, PoseFixes, PositionFixes, Stamps, Yaw
from fgloc.filters.pose_ekf_kernel import CAMERA, POSE, POSITION, YAW, Codes
from fgloc.filters.pose_ekf_settings import PoseEkfSettings

Correcting = Yaw | CameraPoses | PositionFixes | PoseFixes
"""Streams that correct the state; a gyro corrects the step before it is made."""
NEAR_NS = 500_000_000
"""Two readings further apart than this tell nothing of a leap between them [ns]."""


@dataclass(frozen=True)
class Stream:
    """One sensor that corrects the state, its readings ready for the filter."""

    sensor: Correcting
    """Where it comes from."""
    kind: int
    """CAMERA, POSE, POSITION or YAW."""
    stamps_ns: Stamps
    """(M,) stamps inside the drive."""
    values: Floats
    """(M, 3) readings, in the first columns; CAMERA: pose of the base since its frame began."""
    noises: Floats
    """(M, 3, 3) covariances; CAMERA: in the axes of the base when its frame began."""
    begins: Codes
    """(M,) 1 at readings that begin a frame of their own and tell nothing else, else 0."""
    lever: Floats
    """(3,) nominal mounting: x, y [m], yaw [rad]."""
    gate: float
    """Largest squared Mahalanobis distance that is believed."""
    zero_walk: float = 0.0
    """YAW: variance [rad²/s] by which its zero wanders."""
    lasting: float = 0.0
    """CAMERA: how often the covariance of the pose at which its frame began counts."""


def make_stream(
    sensor: Correcting,
    stamps: Stamps,
    path: Floats,
    settings: PoseEkfSettings,
    rounding: Floats,
) -> Stream:
    """Return a sensor's readings at those of its stamps (M,) that lie inside the drive.

    `path` (M, 3) is where the wheels alone put the base then, `rounding` (3,) the sigma of a pose
    that rounded counts tell. O(M).
    """
    inside = np.isin(sensor.stamps_ns, stamps)
    values, noises = np.zeros((stamps.size, 3)), np.zeros((stamps.size, 3, 3))
    begins = np.zeros(stamps.size, dtype=np.int64)
    # The larger of the body's two axes; fixes have map axes.
    along, turn = float(rounding[:2].max()), float(rounding[2])
    if isinstance(sensor, Yaw):
        values[:, 0] = sensor.yaw[inside]
        noises[:, 0, 0] = (settings.yaw * sensor.sigma) ** 2 + turn**2
        walk = sensor.drift_sigma**2 + sensor.drift_rate_sigma**2 * settings.horizon_s
        difference = np.diff(values[:, 0]) - np.diff(path[:, 2])
        limit = max(settings.leap_rad, 10.0 * sensor.sigma)
        begins = _beginnings(stamps, np.abs(wrap(difference)) > limit)
        walk *= settings.yaw_drift**2
        gate = settings.yaw_gate**2
        return Stream(sensor, YAW, stamps, values, noises, begins, np.zeros(3), gate, walk)
    if isinstance(sensor, CameraPoses):
        period = float(np.median(np.diff(stamps))) * 1e-9 if stamps.size > 1 else np.inf
        lasting = settings.camera_growth**2 * max(settings.horizon_s / period, 1.0)
        base = _base(sensor, sensor.poses[inside])
        begins = _camera_beginnings(sensor, stamps, base, path, settings)
        for begin, end in zip(*_segments(begins), strict=True):
            part = slice(begin, end)
            values[part] = between(base[begin], base[part])
            noises[part] = _camera_noise(sensor, sensor.poses[inside][part], lasting, settings)
        noises += np.diag([along**2, along**2, turn**2])
        gate = settings.camera_gate**2
        lever = np.zeros(3)
        return Stream(sensor, CAMERA, stamps, values, noises, begins, lever, gate, lasting=lasting)
    pose = isinstance(sensor, PoseFixes)
    d = 3 if pose else 2
    read = sensor.poses if isinstance(sensor, PoseFixes) else sensor.positions
    values[:, :d] = read[inside]
    spread = np.array(sensor.mount_sigma)
    # The lever arm's error turns with the robot; the larger one stands for both axes.
    spread[:2] = spread[:2].max()
    variance = (settings.fix * sensor.sigma[inside]) ** 2 + spread**2
    variance += np.array([along, along, turn])[:d] ** 2
    for a in range(d):
        noises[:, a, a] = variance[:, a]
    lever = np.zeros(3)
    lever[:d] = sensor.mount
    kind, gate = POSE if pose else POSITION, settings.fix_gate**2
    return Stream(sensor, kind, stamps, values, noises, begins, lever, gate)


def _beginnings(stamps: Stamps, leaps: npt.NDArray[np.bool_]) -> Codes:
    """Return 1 at the first of M readings and after `leaps` (M-1,) between near ones, else 0."""
    begins = np.ones(stamps.size, dtype=np.int64)
    begins[1:] = leaps & (np.diff(stamps) <= NEAR_NS)
    return begins


def _segments(begins: Codes) -> tuple[list[int], list[int]]:
    """Return where the pieces begin and end (exclusive) that `begins` (M,) cuts readings into."""
    starts = np.flatnonzero(begins).tolist()
    return starts, [*starts[1:], begins.size] if starts else []


def _base(sensor: CameraPoses, poses: Floats) -> Floats:
    """Return the base's poses (M, 3) since the first of the camera's, by the nominal mounting."""
    mount = np.array(sensor.mount)
    return compose(compose(mount, between(poses[:1], poses)), inverse(mount))


def _camera_beginnings(
    sensor: CameraPoses, stamps: Stamps, base: Floats, path: Floats, settings: PoseEkfSettings
) -> Codes:
    """Return where a camera's frame begins: at its first pose, and where it leaps.

    A tracking camera that loses its way begins again elsewhere. No wheel slips or camera drifts by
    `leap_m` or `leap_rad` from one pose to the next.
    """
    apart = between(between(path[:-1], path[1:]), between(base[:-1], base[1:]))
    far = np.hypot(apart[:, 0], apart[:, 1]) > max(settings.leap_m, 10.0 * sensor.position_sigma)
    turned = np.abs(wrap(apart[:, 2])) > max(settings.leap_rad, 10.0 * sensor.heading_sigma)
    return _beginnings(stamps, far | turned)


def _camera_noise(
    sensor: CameraPoses, poses: Floats, lasting: float, settings: PoseEkfSettings
) -> Floats:
    """Return the covariances (M, 3, 3) of the base's poses since the first of the camera's.

    What is uncertain of a camera pose: its white noise, its random walk since the beginning, and
    what mounting and scale may be off by, to first order. With the camera's displacement D = (d, δ)
    since its first pose and the mount (m, ψ), the base has moved by m + R(ψ) d − R(δ) m. Walk,
    mounting and scale are wrong the same way in one pose after the other, while the filter takes
    poses to be independent; so these parts count `lasting` times: horizon / period.
    """
    moved = between(poses[0], poses)
    seen = compose(np.array([0.0, 0.0, sensor.mount[2]]), moved)[:, :2]
    path = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    c, s = np.cos(moved[:, 2]), np.sin(moved[:, 2])
    # d base / d (m_x, m_y, psi, scale), rows x and y.
    jacobian = np.empty((path.size, 2, 4))
    jacobian[:, 0] = np.stack([1.0 - c, s, -seen[:, 1], seen[:, 0]], axis=1)
    jacobian[:, 1] = np.stack([-s, 1.0 - c, seen[:, 0], seen[:, 1]], axis=1)
    spread = np.array([*sensor.mount_sigma, sensor.scale_sigma]) ** 2
    noises = np.zeros((path.size, 3, 3))
    noises[:, :2, :2] = lasting * np.einsum("mik,k,mjk->mij", jacobian, spread, jacobian)
    position = sensor.position_sigma**2 + lasting * sensor.position_walk**2 * path
    heading = sensor.heading_sigma**2 + lasting * sensor.heading_walk**2 * path
    noises[:, 0, 0] += position
    noises[:, 1, 1] += position
    noises[:, :2, :2] *= settings.camera_position**2
    noises[:, 2, 2] = settings.camera_heading**2 * heading
    return noises
