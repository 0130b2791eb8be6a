"""SE(2) once: poses (x, y, theta), exact Jacobians, as numba scalars and as array forms.

A pose maps the moving frame to the fixed one. A tangent vector (dx, dy, dtheta) is a twist times
time in the body frame; `exp` follows it along an arc of constant twist. Scalar functions write
into an `out` array of length 3, so that kernels allocate nothing; array functions broadcast over
leading axes and return new arrays. Angles are never wrapped unless `wrap` is called.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from fgloc.core.compiled import compiled

Floats = npt.NDArray[np.float64]

Integrator = Literal["exact", "midpoint", "euler"]
INTEGRATORS: tuple[Integrator, ...] = ("exact", "midpoint", "euler")
EXACT, MIDPOINT, EULER = range(3)


@compiled
def wrap_scalar(angle: float) -> float:
    """Return the angle [rad] in [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


@compiled
def arc_coefficients(dtheta: float) -> tuple[float, float, float, float]:
    """Return (a, b, a', b') with a = sin t / t, b = (1 - cos t) / t and their derivatives.

    Below |t| = 0.05 the Taylor series is used: the closed forms of a', b' lose digits like 1/t².
    """
    t = dtheta
    if abs(t) < 0.05:
        t2 = t * t
        a = 1.0 - t2 / 6.0 * (1.0 - t2 / 20.0 * (1.0 - t2 / 42.0 * (1.0 - t2 / 72.0)))
        b = t / 2.0 * (1.0 - t2 / 12.0 * (1.0 - t2 / 30.0 * (1.0 - t2 / 56.0)))
        da = -t / 3.0 * (1.0 - t2 / 10.0 * (1.0 - t2 / 28.0 * (1.0 - t2 / 54.0)))
        db = 0.5 - t2 / 8.0 * (1.0 - t2 / 18.0 * (1.0 - t2 / 40.0 * (1.0 - t2 / 70.0)))
        return a, b, da, db
    s, c = np.sin(t), np.cos(t)
    return s / t, (1.0 - c) / t, (c - s / t) / t, (s - (1.0 - c) / t) / t


@compiled
def step_scalar(xi: Floats, scheme: int, out: Floats) -> None:
    """Write the pose reached by the body displacement `xi` into `out`.

    `scheme` is EXACT (constant twist), MIDPOINT (straight along the mean heading; the seeds'
    Models) or EULER (straight along the old heading).
    """
    dx, dy, dt = xi[0], xi[1], xi[2]
    if scheme == 0:
        a, b, _, _ = arc_coefficients(dt)
        out[0] = a * dx - b * dy
        out[1] = b * dx + a * dy
    elif scheme == 1:
        c, s = np.cos(dt / 2.0), np.sin(dt / 2.0)
        out[0] = c * dx - s * dy
        out[1] = s * dx + c * dy
    else:
        out[0] = dx
        out[1] = dy
    out[2] = dt


@compiled
def exp_jacobian_scalar(xi: Floats, out: Floats) -> None:
    """Write the 3×3 derivative of the exact step's (x, y, theta) by `xi` into `out`."""
    a, b, da, db = arc_coefficients(xi[2])
    out[0, 0], out[0, 1], out[0, 2] = a, -b, da * xi[0] - db * xi[1]
    out[1, 0], out[1, 1], out[1, 2] = b, a, db * xi[0] + da * xi[1]
    out[2, 0], out[2, 1], out[2, 2] = 0.0, 0.0, 1.0


@compiled
def compose_scalar(p: Floats, q: Floats, out: Floats) -> None:
    """Write p ∘ q into `out` (which may be p or q)."""
    c, s = np.cos(p[2]), np.sin(p[2])
    x = p[0] + c * q[0] - s * q[1]
    y = p[1] + s * q[0] + c * q[1]
    out[2] = p[2] + q[2]
    out[0] = x
    out[1] = y


@compiled
def between_scalar(p: Floats, q: Floats, out: Floats) -> None:
    """Write p⁻¹ ∘ q, the pose of q seen from p, into `out`."""
    c, s = np.cos(p[2]), np.sin(p[2])
    dx, dy = q[0] - p[0], q[1] - p[1]
    out[0] = c * dx + s * dy
    out[1] = -s * dx + c * dy
    out[2] = q[2] - p[2]


@compiled
def integrate(displacements: Floats, start: Floats, scheme: int) -> Floats:
    """Return the (N+1, 3) poses that N body displacements (N, 3) reach from `start`. O(N)."""
    poses = np.empty((displacements.shape[0] + 1, 3))
    # Entry by entry: assigning the row would compile a shape check of several seconds.
    poses[0, 0], poses[0, 1], poses[0, 2] = start[0], start[1], start[2]
    step = np.empty(3)
    for k in range(displacements.shape[0]):
        step_scalar(displacements[k], scheme, step)
        compose_scalar(poses[k], step, poses[k + 1])
    return poses


@compiled
def chain(steps: Floats, start: Floats) -> Floats:
    """Return the (N+1, 3) poses reached by composing N relative poses (N, 3) from `start`. O(N)."""
    poses = np.empty((steps.shape[0] + 1, 3))
    poses[0, 0], poses[0, 1], poses[0, 2] = start[0], start[1], start[2]
    for k in range(steps.shape[0]):
        compose_scalar(poses[k], steps[k], poses[k + 1])
    return poses


def wrap(angle: Floats) -> Floats:
    """Return angles [rad] wrapped to [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def compose(p: Floats, q: Floats) -> Floats:
    """Return p ∘ q for poses (..., 3), broadcasting."""
    c, s = np.cos(p[..., 2]), np.sin(p[..., 2])
    x = p[..., 0] + c * q[..., 0] - s * q[..., 1]
    y = p[..., 1] + s * q[..., 0] + c * q[..., 1]
    return np.stack([x, y, p[..., 2] + q[..., 2]], axis=-1)


def inverse(p: Floats) -> Floats:
    """Return p⁻¹ for poses (..., 3)."""
    c, s = np.cos(p[..., 2]), np.sin(p[..., 2])
    x = -c * p[..., 0] - s * p[..., 1]
    y = s * p[..., 0] - c * p[..., 1]
    return np.stack([x, y, -p[..., 2]], axis=-1)


def between(p: Floats, q: Floats) -> Floats:
    """Return p⁻¹ ∘ q for poses (..., 3), broadcasting; the heading is not wrapped."""
    return compose(inverse(p), q)


def exp(xi: Floats) -> Floats:
    """Return the pose reached along an arc of constant twist `xi` (..., 3)."""
    t = xi[..., 2]
    small = np.abs(t) < 1e-4
    safe = np.where(small, 1.0, t)
    a = np.where(small, 1.0 - t * t / 6.0, np.sin(safe) / safe)
    b = np.where(small, t / 2.0 * (1.0 - t * t / 12.0), 2.0 * np.sin(safe / 2.0) ** 2 / safe)
    x = a * xi[..., 0] - b * xi[..., 1]
    y = b * xi[..., 0] + a * xi[..., 1]
    return np.stack([x, y, t], axis=-1)


def log(pose: Floats) -> Floats:
    """Return the twist (..., 3) whose `exp` is the pose, for its heading as it stands (no wrap)."""
    half = pose[..., 2] / 2.0
    small = np.abs(half) < 1e-4
    safe = np.where(small, 1.0, half)
    d = np.where(small, 1.0 - half * half / 3.0, safe / np.tan(safe))
    x = d * pose[..., 0] + half * pose[..., 1]
    y = -half * pose[..., 0] + d * pose[..., 1]
    return np.stack([x, y, pose[..., 2]], axis=-1)


def interpolate(p: Floats, q: Floats, fraction: Floats) -> Floats:
    """Return the pose a `fraction` (...,) of the way from p to q along a constant twist (..., 3).

    The shorter way round is taken (the relative heading is wrapped), and the heading continues
    from p's without a jump.
    """
    step = between(p, q)
    step[..., 2] = wrap(step[..., 2])
    return compose(p, exp(log(step) * np.asarray(fraction)[..., None]))


def rotate_covariance(covariance: Floats, heading: Floats) -> Floats:
    """Return covariances (..., 3, 3) of (x, y, theta) turned from body to map axes by `heading`.

    Use -heading for the way back. Source: design of the GTSAM boundary (Pose2 marginals are in
    the body frame).
    """
    c, s = np.cos(heading), np.sin(heading)
    rotation = np.zeros((*np.shape(heading), 3, 3))
    rotation[..., 0, 0] = c
    rotation[..., 0, 1] = -s
    rotation[..., 1, 0] = s
    rotation[..., 1, 1] = c
    rotation[..., 2, 2] = 1.0
    turned: Floats = rotation @ covariance @ np.swapaxes(rotation, -1, -2)
    return turned
