"""A mecanum robot with a lidar ahead of its middle, driving round in a room; noise as stated."""

from __future__ import annotations

import numpy as np

from fgloc.core import bases
from fgloc.core.drive import Drive, Reference
from fgloc.core.geometry import Floats, compose, exp, integrate
from fgloc.core.measurements import Scans, WheelIncrements
from fgloc.core.robot import Robot, WheelNoise
from fgloc.core.trajectory import Trajectory

# youBot: public figures of its wheels.
BASE = bases.mecanum(0.0475, 0.2355, 0.15, ("fl", "fr", "rl", "rr"))
NOISE = WheelNoise(rolling=0.02, lateral=0.0, turning=0.0, standing=1e-6, standing_turn=1e-6)
MOUNT = (0.25, 0.0, 0.0)
BEAMS = 400
PERIOD_NS = 20_000_000
SCAN_EVERY = 5
ROOM = np.array(
    [
        [-3.0, -5.0, 4.0, -5.0],
        [4.0, -5.0, 4.0, 3.0],
        [4.0, 3.0, -1.0, 3.0],
        [-1.0, 3.0, -3.0, 1.5],
        [-3.0, 1.5, -3.0, -5.0],
    ]
)
"""Walls x1, y1, x2, y2 [m]: a room with an oblique corner. Anticlockwise: seen from inside."""


def cast(poses: Floats, walls: Floats) -> Floats:
    """Return (N, B) distances from lidars at (N, B, 3) along their x axes to the nearest wall."""
    d = np.stack([np.cos(poses[..., 2]), np.sin(poses[..., 2])], axis=-1)[..., None, :]
    along = walls[:, 2:] - walls[:, :2]
    off = walls[:, :2] - poses[..., None, :2]
    across = d[..., 0] * along[:, 1] - d[..., 1] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (off[..., 0] * along[:, 1] - off[..., 1] * along[:, 0]) / across
        share = (off[..., 0] * d[..., 1] - off[..., 1] * d[..., 0]) / across
    hit = (distance > 0.0) & (share >= 0.0) & (share <= 1.0)
    return np.asarray(np.where(hit, distance, np.inf).min(axis=-1))


def drive(seed: int, seconds: float = 40.0, *, walls: Floats = ROOM, share: float = 0.01) -> Drive:
    """Return a drive of 0.4 m/s along an ellipse, moving sideways as well, with 10 scans a second.

    Every beam is sent from where the lidar is at its own time.
    """
    rng = np.random.default_rng(seed)
    steps = round(seconds * 1e9 / PERIOD_NS)
    time = np.arange(steps) * PERIOD_NS * 1e-9
    # Body twist: forward, a slow swing to both sides, a steady turn.
    twist = np.stack(
        [np.full(steps, 0.35), 0.15 * np.sin(0.5 * time), 0.3 + 0.1 * np.sin(0.3 * time)], axis=1
    )
    body = twist * (PERIOD_NS * 1e-9)
    # Mecanum: wheel rates by v_x ∓ v_y ∓ (l + w) ω over the radius, fl fr rl rr.
    k = 0.2355 + 0.15
    inverse = np.array([[1, -1, -k], [1, 1, k], [1, 1, -k], [1, -1, k]]) / 0.0475
    angles = body @ inverse.T
    np.testing.assert_allclose(BASE.displacements(angles), body, atol=1e-12)
    truth = integrate(body, np.array([0.0, -1.0, 0.0]), 0)
    path = 0.0475 * np.abs(angles)
    slip = NOISE.rolling * np.sqrt(path) * rng.standard_normal(angles.shape) / 0.0475
    stamps = np.arange(steps + 1, dtype=np.int64) * PERIOD_NS
    begins = np.arange(0, steps - SCAN_EVERY, SCAN_EVERY)
    share_of = np.arange(BEAMS) / BEAMS * SCAN_EVERY
    whole = share_of.astype(np.int64)
    within = (share_of - whole)[None, :, None]
    at = begins[:, None] + whole
    base = compose(truth[at], exp(body[at] * within))
    lidar = compose(base, np.array(MOUNT))
    beam = 2.0 * np.pi * np.arange(BEAMS) / BEAMS
    lidar[..., 2] += beam
    ranges = cast(lidar, walls)
    ranges *= 1.0 + share * rng.standard_normal(ranges.shape)
    scans = Scans(
        "lidar",
        stamps[begins],
        np.where(np.isfinite(ranges) & (ranges < 8.0), ranges, 0.0),
        0.0,
        2.0 * np.pi / BEAMS,
        PERIOD_NS * SCAN_EVERY * 1e-9 / BEAMS,
        MOUNT,
        range_sigma=0.002,
        range_sigma_share=share,
        min_range=0.15,
        max_range=8.0,
    )
    wheels = WheelIncrements("wheels", stamps, angles + slip, BASE.driven_names)
    reference = Reference(Trajectory(stamps, truth), sigma=(1e-3, 1e-3, 1e-3))
    return Drive("room", Robot("youBot", BASE, NOISE), wheels, (scans,), reference)
