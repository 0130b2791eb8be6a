"""How far a trajectory is from the truth: ATE, RPE, end point, the seeds' e_max, NEES.

Every error is measured where the truth was recorded and without alignment, from the first stamp
that both have; the SE(2)-aligned ATE stands beside it. Errors are result minus truth in map axes.
Headings are compared unwrapped: the whole turns between the two at the first common stamp are
taken away once, so that a spin of three turns is 360° off a spin of two.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fgloc.core.compiled import compiled
from fgloc.core.consistency import each_squared_normalised
from fgloc.core.drive import Reference
from fgloc.core.geometry import between, compose, interpolate
from fgloc.core.measurements import Floats, Stamps
from fgloc.core.stamped_text import continuous
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError

MAX_GAP_S = 0.5
"""Longest step between two estimates that is still interpolated [s]."""
RPE_SEGMENT_M = 1.0
"""Length of the path segments of the relative pose error [m]."""
_PATH_STEP_M = 0.01
"""The travelled path is measured in steps of at least this [m], or the noise of a truth recorded
at 100 Hz would let a standing robot travel."""


@dataclass(frozen=True)
class AxisErrors:
    """One number for each of x, y and heading."""

    x: float
    """Map x [m]."""
    y: float
    """Map y [m]."""
    theta: float
    """Heading [rad]."""


@dataclass(frozen=True)
class ErrorSeries:
    """Errors of one trajectory over time, for figures and for everything computed from them."""

    stamps_ns: Stamps
    """(M,) stamps of the truth that were used."""
    truth: Floats
    """(M, 3) recorded poses."""
    estimate: Floats
    """(M, 3) estimated poses of the same frame, interpolated."""
    errors: Floats
    """(M, 3) estimate - truth in map axes [m, m, rad], heading unwrapped."""
    covariances: Floats | None
    """(M, 3, 3) covariance of the estimate in map axes, interpolated; None if it has none."""
    excluded: int
    """Stamps of the truth inside the trajectory, but in a gap of it of more than MAX_GAP_S."""
    outside: int
    """Stamps of the truth before the trajectory begins or after it ends."""


@dataclass(frozen=True)
class Evaluation:
    """Errors of one method on one drive. The names are keys of the command's JSON."""

    ate_rmse_m: float
    """Root mean square distance from the truth, not aligned [m]."""
    ate_aligned_rmse_m: float
    """The same after the rotation and translation (no scale) that fit best in the plane [m]."""
    ate_heading_rmse_deg: float
    """Root mean square of the unwrapped heading error, not aligned [deg]."""
    end_position_m: float
    """Distance from the truth at the last stamp used [m]."""
    end_heading_deg: float
    """Absolute unwrapped heading error at the last stamp used [deg]."""
    e_max: AxisErrors
    """Largest absolute error over the drive of x, y [m] and unwrapped heading [rad]."""
    nees: float | None
    """Mean of e' inv(P) e, 3 degrees of freedom, undivided (3 if P is right); None without P."""
    rpe_1m_rmse_m: float | None
    """Root mean square of the position error over segments of 1 m of path [m]; None if shorter."""
    rpe_1m_heading_rmse_deg: float | None
    """Root mean square of the heading error over the same segments [deg]; None if shorter."""
    path_length_m: float
    """Length of the truth's path in steps of at least 1 cm [m]."""
    end_percent: float | None
    """End position error in % of the path length; None if the robot did not travel 1 cm."""
    stamps_used: int
    """Stamps of the truth at which errors were taken."""
    stamps_excluded: int
    """Stamps of the truth in gaps of the trajectory of more than 0.5 s."""
    stamps_outside: int
    """Stamps of the truth before the trajectory begins or after it ends."""
    nees_skipped: int
    """Stamps without a usable covariance (zero, singular or not finite), left out of `nees`."""

    def to_json(self) -> dict[str, Any]:
        """Return the fields as plain numbers and dicts, `e_max` as {"x", "y", "theta"}."""
        return asdict(self)


def bracket(stamps_ns: Stamps, wanted_ns: Stamps) -> tuple[npt.NDArray[np.int64], Floats]:
    """Return for each wanted stamp the index before it and how far on to the next it lies, 0..1.

    `stamps_ns` must hold at least one stamp; outside of it index and fraction stay at its ends.
    O(M log N).
    """
    if stamps_ns.size == 1:
        return np.zeros(wanted_ns.size, dtype=np.int64), np.zeros(wanted_ns.size)
    before = np.searchsorted(stamps_ns, wanted_ns, side="right") - 1
    before = np.clip(before, 0, stamps_ns.size - 2).astype(np.int64)
    step = stamps_ns[before + 1] - stamps_ns[before]
    fraction = (wanted_ns - stamps_ns[before]) / step
    return before, np.clip(fraction, 0.0, 1.0)


def interpolate_trajectory(
    trajectory: Trajectory, stamps_ns: Stamps, max_gap_s: float = MAX_GAP_S
) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Return (M, 3) poses at `stamps_ns` along arcs of constant twist, and an (M,) valid mask.

    A stamp is valid inside the trajectory unless it lies in a gap of more than `max_gap_s`
    seconds (a stamp that is exactly one of the trajectory's always is). Rows that are not valid
    are NaN. O(M log N).
    """
    poses = np.full((stamps_ns.size, 3), np.nan)
    valid = np.zeros(stamps_ns.size, dtype=np.bool_)
    if not len(trajectory):
        return poses, valid
    have = trajectory.stamps_ns
    before, fraction = bracket(have, stamps_ns)
    after = np.minimum(before + 1, have.size - 1)
    hit = (stamps_ns == have[before]) | (stamps_ns == have[after])
    near = have[after] - have[before] <= round(max_gap_s * 1e9)
    valid = (stamps_ns >= have[0]) & (stamps_ns <= have[-1]) & (hit | near)
    p, q = trajectory.poses[before[valid]], trajectory.poses[after[valid]]
    f = fraction[valid]
    poses[valid] = np.where((f == 1.0)[:, None], q, interpolate(p, q, f))
    return poses, valid


def map_mount(trajectory: Trajectory, mount: tuple[float, float, float]) -> Trajectory:
    """Return the trajectory of a frame that sits at `mount` (x, y [m], yaw [rad]) on the body.

    Covariances are carried along, the mount taken as known.
    """
    offset = np.array(mount, dtype=np.float64)
    if not offset.any():
        return trajectory
    poses = compose(trajectory.poses, offset)
    if trajectory.covariances is None:
        return Trajectory(trajectory.stamps_ns, poses)
    # Turning the body by a small angle swings the mounted frame across its lever arm.
    lever = poses[:, :2] - trajectory.poses[:, :2]
    jacobian = np.tile(np.eye(3), (len(trajectory), 1, 1))
    jacobian[:, 0, 2] = -lever[:, 1]
    jacobian[:, 1, 2] = lever[:, 0]
    covariances = jacobian @ trajectory.covariances @ jacobian.transpose(0, 2, 1)
    return Trajectory(trajectory.stamps_ns, poses, covariances)


def error_series(
    result: Trajectory,
    reference: Reference,
    mount: tuple[float, float, float] | None = None,
) -> ErrorSeries:
    """Return the errors of base_link poses `result` at the truth's stamps, not aligned.

    The result is mapped to the reference's frame by `mount` (the reference's own when None; give
    the calibrated one where it was estimated). Raises FglocError if the two have no time in common.
    """
    mapped = map_mount(result, reference.mount if mount is None else mount)
    mapped = Trajectory(mapped.stamps_ns, _unwrapped(mapped.poses), covariances=mapped.covariances)
    stamps = reference.trajectory.stamps_ns
    poses, valid = interpolate_trajectory(mapped, stamps)
    if not bool(valid.any()):
        raise FglocError(
            f"the trajectory and {reference.sensor} have no time in common; check that both clocks "
            "are the same and that the trajectory has no gaps of more than "
            f"{MAX_GAP_S} s"
        )
    truth = _unwrapped(reference.trajectory.poses)[valid]
    errors = poses[valid] - truth
    errors[:, 2] -= 2.0 * np.pi * np.rint(errors[0, 2] / (2.0 * np.pi))
    covariances = None
    if mapped.covariances is not None:
        before, fraction = bracket(mapped.stamps_ns, stamps[valid])
        after = np.minimum(before + 1, len(mapped) - 1)
        f = fraction[:, None, None]
        covariances = (1.0 - f) * mapped.covariances[before] + f * mapped.covariances[after]
    inside = (stamps >= mapped.stamps_ns[0]) & (stamps <= mapped.stamps_ns[-1])
    return ErrorSeries(
        stamps_ns=stamps[valid],
        truth=truth,
        estimate=poses[valid],
        errors=errors,
        covariances=covariances,
        excluded=int(np.count_nonzero(inside & ~valid)),
        outside=int(np.count_nonzero(~inside)),
    )


def _unwrapped(poses: Floats) -> Floats:
    """Return poses (N, 3) with a continuous heading.

    Headings that leave ±pi are continuous already and stay as they are: they may know of turns
    inside a gap, which unwrapping would take away. Only headings that all lie in ±pi are unwrapped.
    """
    if float(np.abs(poses[:, 2]).max(initial=0.0)) > np.pi + 1e-9:
        return poses
    return np.column_stack([poses[:, :2], continuous(poses[:, 2])])


def evaluate(
    result: Trajectory,
    reference: Reference,
    mount: tuple[float, float, float] | None = None,
) -> Evaluation:
    """Return all error measures of base_link poses `result` against a recorded truth.

    See `error_series` for `mount` and the module for what is compared. Raises FglocError if
    trajectory and truth have no time in common. O(M log N).
    """
    series = error_series(result, reference, mount)
    errors = series.errors
    distance = np.hypot(errors[:, 0], errors[:, 1])
    aligned = aligned_positions(series.estimate[:, :2], series.truth[:, :2])
    off = np.linalg.norm(aligned - series.truth[:, :2], axis=1)
    travelled = _travelled(np.ascontiguousarray(series.truth[:, :2]), _PATH_STEP_M)
    relative = relative_errors(series.estimate, series.truth, travelled)
    nees, skipped = _mean_nees(errors, series.covariances)
    path, end = float(travelled[-1]), float(distance[-1])
    worst = np.abs(errors).max(axis=0)
    known = relative.shape[0] > 0
    return Evaluation(
        ate_rmse_m=_rms(distance),
        ate_aligned_rmse_m=_rms(off),
        ate_heading_rmse_deg=float(np.degrees(_rms(errors[:, 2]))),
        end_position_m=end,
        end_heading_deg=float(np.degrees(abs(errors[-1, 2]))),
        e_max=AxisErrors(float(worst[0]), float(worst[1]), float(worst[2])),
        nees=nees,
        rpe_1m_rmse_m=_rms(np.hypot(relative[:, 0], relative[:, 1])) if known else None,
        rpe_1m_heading_rmse_deg=float(np.degrees(_rms(relative[:, 2]))) if known else None,
        path_length_m=path,
        end_percent=100.0 * end / path if path > 0.0 else None,
        stamps_used=int(series.stamps_ns.size),
        stamps_excluded=series.excluded,
        stamps_outside=series.outside,
        nees_skipped=skipped,
    )


def _rms(values: Floats) -> float:
    """Return the root mean square of (N,) values."""
    return float(np.sqrt(np.mean(values * values)))


def aligned_positions(moving: Floats, fixed: Floats) -> Floats:
    """Return positions `moving` (N, 2) rotated and shifted onto `fixed` (N, 2), least squares.

    In the plane Umeyama's solution without scale is one angle: the direction of the sum of
    conj(moving)·fixed about the centroids, read as complex numbers.
    """
    a, b = moving - moving.mean(axis=0), fixed - fixed.mean(axis=0)
    cosine = float(np.sum(a * b))
    sine = float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    angle = np.arctan2(sine, cosine)
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(a @ np.array([[c, s], [-s, c]]) + fixed.mean(axis=0))


@compiled
def _travelled(positions: Floats, least: float) -> Floats:
    """Return the (N,) path length up to each position, in steps of at least `least` m."""
    path = np.zeros(positions.shape[0])
    anchor = 0
    for k in range(1, positions.shape[0]):
        step = np.hypot(
            positions[k, 0] - positions[anchor, 0], positions[k, 1] - positions[anchor, 1]
        )
        path[k] = path[k - 1]
        if step >= least:
            path[k] += step
            anchor = k
    return path


def relative_errors(estimate: Floats, truth: Floats, travelled: Floats) -> Floats:
    """Return (K, 3) errors of the motion over path segments of 1 m, seen from the true end.

    A segment begins at every stamp that ends one step of the path and reaches to the first stamp
    at least RPE_SEGMENT_M further along the truth's path `travelled` (N,); segments overlap.
    Segments over 10 % too long (they span a gap) are left out. The error is the true motion's
    inverse composed with the estimated motion; its heading is not wrapped.
    """
    starts = np.flatnonzero(np.diff(travelled, prepend=-1.0) > 0.0)
    ends = np.searchsorted(travelled, travelled[starts] + RPE_SEGMENT_M)
    starts, ends = starts[ends < travelled.size], ends[ends < travelled.size]
    fits = travelled[ends] - travelled[starts] <= 1.1 * RPE_SEGMENT_M
    starts, ends = starts[fits], ends[fits]
    wanted = between(truth[starts], truth[ends])
    return between(wanted, between(estimate[starts], estimate[ends]))


def _mean_nees(errors: Floats, covariances: Floats | None) -> tuple[float | None, int]:
    """Return the mean of e' inv(P) e over rows with a regular P, and how many rows have none."""
    if covariances is None:
        return None, 0
    squared = each_squared_normalised(errors, covariances)
    known = squared[np.isfinite(squared)]
    return float(known.mean()) if known.size else None, squared.size - known.size
