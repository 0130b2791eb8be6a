"""Closed-form calibration of a two-wheel base and of where its sensor sits (Censi et al. 2013).

Censi, Franchi, Marchionni, Oriolo, "Simultaneous calibration of odometry and sensor parameters for
mobile robots", IEEE Transactions on Robotics 29(2), 2013. From what two wheels turned and how a
sensor moved in its own frame meanwhile, without initial values: both wheel radii, the track and
the sensor's pose on the robot.

With o the robot's displacement, l the sensor's pose on the robot and s the sensor's displacement,
l ∘ s = o ∘ l. The turn does not depend on l: theta = J21·left + J22·right, two numbers that linear
least squares gives (J21 = -r_left / b, J22 = r_right / b). With these known, the rest of the
equation is linear in (b, l_x, l_y, cos l_theta, sin l_theta), homogeneous, with one quadratic
constraint, cos² + sin² = 1. Eliminating the first three leaves the eigenvector of a 2×2 matrix.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fgloc.calibration.displacements import displacements_of as displacements_of
from fgloc.core.geometry import between, compose, exp, wrap
from fgloc.core.measurements import Floats
from fgloc.errors import FglocError

NAMES = ("wheel_radius.left", "wheel_radius.right", "effective_track", "x", "y", "yaw")
"""Order of the values; x, y and yaw are the sensor's, `<sensor>_x` in other tables."""
TRIMS = 4
"""How often the worst intervals are left out, as published."""
SHARE = 0.01
"""Share of the intervals left out each time for their place, and as many for their heading."""
MAX_CONDITION = 75.0
"""Largest condition number of the wheels' 2×2 normal matrix, as published: driving and turning
(in m of wheel travel) may differ by a factor of 8.7."""
FEWEST = 6
"""Fewer intervals are refused."""

CLEARLY = 25.0
"""Driving exceeds turning by more, in squares: one of the two is as good as missing."""

Indices = npt.NDArray[np.int64]


@dataclass(frozen=True)
class CensiSolution:
    """What the closed form found, with the covariance that the kept intervals give."""

    values: Floats
    """(6,) as NAMES: radii [m], track [m], the sensor's x, y [m] and yaw [rad] on the robot."""
    covariance: Floats
    """(6, 6) inverse of the Fisher information, for the noise found [m², m·rad, rad²]."""
    condition: float
    """Condition number of the wheels' normal matrix; large where a drive excites too little."""
    noise: Floats
    """(3,) standard deviations of a displacement: x, y [m], heading [rad] in the sensor's frame."""
    residuals: Floats
    """(N, 3) measured minus predicted displacement of ALL intervals, in the sensor's frame."""
    kept: Indices
    """(K,) indices of the intervals that were used."""

    @property
    def sigmas(self) -> Floats:
        """Return the (6,) standard deviations of the values."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def value(self, name: str) -> float:
        """Return one value by its name in NAMES."""
        return float(self.values[NAMES.index(name)])

    def sigma(self, name: str) -> float:
        """Return one standard deviation by its name in NAMES."""
        return float(self.sigmas[NAMES.index(name)])


def solve(
    angles: Floats,
    seconds: Floats,
    displacements: Floats,
    *,
    trims: int = TRIMS,
    share: float = SHARE,
    max_condition: float = MAX_CONDITION,
) -> CensiSolution:
    """Return radii, track and sensor pose that explain N intervals best; no initial values needed.

    `angles` (N, 2) what the left and the right wheel turned [rad], forward positive; `seconds` (N,)
    how long each interval took, positive (wheels that turn steadily drive an arc; nothing else
    depends on it); `displacements` (N, 3) the sensor's motion in its own frame: x, y [m], turn
    [rad]. `trims` times, the `share` of intervals with the largest residuals in place and in
    heading is left out, as published. Raises FglocError for arrays that do not fit, and for a
    drive whose condition number is above `max_condition`, naming the motion that is missing.
    O(N log N). Source: Censi et al. 2013, eq. 14-19 and the authors' published program.
    """
    angles, seconds, displacements = _checked(angles, seconds, displacements)
    kept = np.arange(angles.shape[0])
    first = kept
    for trim in range(trims + 1):
        values, condition = _closed_form(angles[kept], displacements[kept], max_condition)
        if trim == trims:
            break
        worst = _worst(values, angles[kept], displacements[kept], share)
        kept = kept[~worst]
        first = kept if trim == 0 else first
    # As published: the noise is that of the intervals left after the first trim, since later ones
    # cut the tails of what is only noise.
    spread = displacements[first] - predicted(values, angles[first])
    noise = np.std(spread, axis=0, ddof=1)
    if not bool(np.all(noise > 0.0)):
        # Measurements without noise: rounding is what is left of it.
        noise = np.maximum(noise, 1e-12)
    jacobian = predicted_jacobian(values, angles[kept]) / noise[None, :, None]
    information = np.einsum("nij,nik->jk", jacobian, jacobian)
    return CensiSolution(
        values,
        _inverse(information),
        condition,
        noise,
        displacements - predicted(values, angles),
        kept.astype(np.int64),
    )


def predicted(values: Floats, angles: Floats) -> Floats:
    """Return the (N, 3) displacements of the sensor in its own frame for (N, 2) wheel angles [rad].

    `values` (6,) as NAMES. The robot drives an arc of constant twist. O(N).
    """
    mount = values[3:]
    return between(mount, compose(_driven(values, angles), mount))


def predicted_jacobian(values: Floats, angles: Floats) -> Floats:
    """Return the (N, 3, 6) derivatives of `predicted` by the values. O(N)."""
    left, right, track = values[:3]
    mount = values[3:]
    phi_left, phi_right = angles[:, 0], angles[:, 1]
    way = 0.5 * (left * phi_left + right * phi_right)
    turn = (right * phi_right - left * phi_left) / track
    robot = _driven(values, angles)
    zero = np.zeros_like(turn)
    # By way and turn of the arc, then by what these depend on.
    by_way = exp(np.column_stack([np.ones_like(way), zero, turn]))[:, :2]
    by_turn = way[:, None] * _chord_derivative(turn)
    ways = np.stack([phi_left / 2.0, phi_right / 2.0, zero], axis=1)
    turns = np.stack([-phi_left / track, phi_right / track, -turn / track], axis=1)
    place = by_way[:, :, None] * ways[:, None, :] + by_turn[:, :, None] * turns[:, None, :]
    c, s = np.cos(robot[:, 2]), np.sin(robot[:, 2])
    # The turning robot carries its sensor along.
    carried = np.column_stack([-s * mount[0] - c * mount[1], c * mount[0] - s * mount[1]])
    place += carried[:, :, None] * turns[:, None, :]
    back = np.array(
        [[math.cos(mount[2]), math.sin(mount[2])], [-math.sin(mount[2]), math.cos(mount[2])]]
    )
    out = np.zeros((angles.shape[0], 3, 6))
    out[:, :2, :3] = back @ place
    out[:, 2, :3] = turns
    rotation = np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1)
    out[:, :2, 3:5] = back @ (rotation - np.eye(2))
    moved = predicted(values, angles)
    out[:, 0, 5], out[:, 1, 5] = moved[:, 1], -moved[:, 0]
    return out


def _chord_derivative(turn: Floats) -> Floats:
    """Return (N, 2) derivatives by t of an arc's chord (sin t / t, (1 - cos t) / t) of length 1."""
    # Below, the differences of nearly equal numbers would lose more digits than the series leaves.
    small = np.abs(turn) < 1e-3
    t = np.where(small, 1.0, turn)
    sine, cosine = np.sin(t) / t, 2.0 * np.sin(t / 2.0) ** 2 / t
    along = np.where(small, -turn / 3.0, (np.cos(t) - sine) / t)
    across = np.where(small, 0.5 - turn**2 / 8.0, (np.sin(t) - cosine) / t)
    return np.column_stack([along, across])


def _driven(values: Floats, angles: Floats) -> Floats:
    """Return the (N, 3) displacements of the robot along arcs."""
    left, right = values[0] * angles[:, 0], values[1] * angles[:, 1]
    return exp(
        np.column_stack([0.5 * (left + right), np.zeros_like(left), (right - left) / values[2]])
    )


def _closed_form(angles: Floats, moved: Floats, max_condition: float) -> tuple[Floats, float]:
    """Return the (6,) values that fit these intervals, and the condition number."""
    normal = angles.T @ angles
    condition = _check_excitation(angles, normal, max_condition)
    j_left, j_right = np.linalg.solve(normal, angles.T @ moved[:, 2])
    turn = j_left * angles[:, 0] + j_right * angles[:, 1]
    # The arc of a robot whose track is 1; both its coordinates are proportional to the track.
    way = 0.5 * (j_right * angles[:, 1] - j_left * angles[:, 0])
    arc = exp(np.column_stack([way, np.zeros_like(way), turn]))
    s, c = np.sin(turn), 1.0 - np.cos(turn)
    x, y = moved[:, 0], moved[:, 1]
    rows = np.concatenate(
        [
            np.column_stack([-arc[:, 0], c, s, x, -y]),
            np.column_stack([-arc[:, 1], -s, c, y, x]),
        ]
    )
    matrix = rows.T @ rows
    free, bound, mixed = matrix[:3, :3], matrix[3:, 3:], matrix[:3, 3:]
    # The first three unknowns minimise for any heading; what is left is a form in cos and sin.
    eliminate = np.linalg.solve(free, mixed)
    reduced = bound - mixed.T @ eliminate
    heading = np.linalg.eigh(0.5 * (reduced + reduced.T))[1][:, 0]
    rest = -eliminate @ heading
    # Either sign of the eigenvector solves; the track is positive.
    sign = 1.0 if rest[0] >= 0.0 else -1.0
    track, place, heading = abs(float(rest[0])), sign * rest[1:], sign * heading
    values = np.array(
        [-track * j_left, track * j_right, track, *place, math.atan2(heading[1], heading[0])]
    )
    if not bool(np.all(np.isfinite(values))) or not bool(np.all(values[:3] > 0.0)):
        raise FglocError(
            f"the closed form finds radii of {values[0]:.3g} and {values[1]:.3g} m and a track of "
            f"{values[2]:.3g} m; check that both wheels count forward and which one is left"
        )
    return values, condition


def _check_excitation(angles: Floats, normal: Floats, most: float) -> float:
    """Return the condition number; raises FglocError that names the missing motion."""
    low, high = (float(v) for v in np.linalg.eigvalsh(normal))
    condition = high / low if low > 0.0 else math.inf
    if condition <= most:
        return condition
    forward = float(((angles[:, 0] + angles[:, 1]) ** 2).sum())
    turning = float(((angles[:, 1] - angles[:, 0]) ** 2).sum())
    if high <= 0.0:
        missing = "the wheels stand still; drive"
    elif forward > CLEARLY * turning:
        missing = "the drive hardly turns; add spins in both directions"
    elif turning > CLEARLY * forward:
        missing = "the drive only spins; add straight stretches"
    else:
        missing = "the wheels always turn in the same ratio; add other curves, a spin, a straight"
    raise FglocError(
        f"wheels and sensor do not determine the calibration (condition number {condition:.3g}, "
        f"allowed {most:g}): {missing}"
    )


def _worst(values: Floats, angles: Floats, moved: Floats, share: float) -> npt.NDArray[np.bool_]:
    """Return the mask of intervals beyond the 1 - share quantile, in place or in heading."""
    mount = values[3:]
    # As published, where the sensor gets to is compared in the robot's frame: l ∘ s and o ∘ l.
    off = compose(mount, moved) - compose(_driven(values, angles), mount)
    place, heading = np.hypot(off[:, 0], off[:, 1]), np.abs(wrap(off[:, 2]))
    at = min(round((1.0 - share) * place.size), place.size - 1)
    return np.asarray((place > np.sort(place)[at]) | (heading > np.sort(heading)[at]))


def _inverse(information: Floats) -> Floats:
    """Return the inverse of an information matrix; its units differ by orders of magnitude."""
    scale = 1.0 / np.sqrt(np.diag(information))
    scaled = information * np.outer(scale, scale)
    return np.asarray(np.linalg.inv(scaled) * np.outer(scale, scale))


def _checked(
    angles: Floats, seconds: Floats, displacements: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return the arrays as floats; raises FglocError for shapes and values that do not fit."""
    angles, seconds, displacements = (
        np.asarray(a, dtype=np.float64) for a in (angles, seconds, displacements)
    )
    n = angles.shape[0] if angles.ndim == 2 else 0
    if angles.shape != (n, 2) or seconds.shape != (n,) or displacements.shape != (n, 3):
        raise FglocError(
            "the closed form needs angles (N, 2), seconds (N,) and displacements (N, 3); got "
            f"{angles.shape}, {seconds.shape} and {displacements.shape}"
        )
    if n < FEWEST:
        raise FglocError(f"the closed form needs at least {FEWEST} intervals, got {n}")
    if not all(bool(np.all(np.isfinite(a))) for a in (angles, seconds, displacements)):
        raise FglocError("the closed form needs finite angles, seconds and displacements")
    if not bool(np.all(seconds > 0.0)):
        raise FglocError("the closed form needs intervals of positive length")
    return angles, seconds, displacements
