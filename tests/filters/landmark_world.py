"""A robot that drives in circles among point landmarks, with noise exactly as it is stated."""

from __future__ import annotations

import numpy as np

from fgloc.core import bases
from fgloc.core.drive import Drive, Reference
from fgloc.core.geometry import Floats, chain, compose, exp, wrap
from fgloc.core.measurements import LandmarkSightings, Stamps, WheelIncrements
from fgloc.core.robot import Robot, WheelNoise
from fgloc.core.trajectory import Trajectory

BASE = bases.differential(0.1, 0.1, 0.5)
NOISE = WheelNoise(
    rolling=0.01, lateral=0.0, turning=0.0, standing=1e-6, standing_turn=1e-6, veering=0.0
)
MOUNT = (0.2, -0.05, 0.3)
PERIOD_NS = 100_000_000
START_SIGMA = (0.01, 0.01, 0.01)


def circle_of_landmarks(count: int, radius: float = 4.0) -> Floats:
    """Return (count, 2) landmarks round the circle that the robot drives."""
    angle = 2.0 * np.pi * np.arange(count) / count
    return np.stack([radius * np.cos(angle), 1.5 + radius * np.sin(angle)], axis=1)


def drive(
    landmarks: Floats,
    *,
    seed: int,
    steps: int = 200,
    every: int = 2,
    identified: bool = True,
    far: float = 3.0,
    noise: float = 1.0,
    sigma: tuple[float, float] = (0.05, 0.01),
    hidden: range = range(0),
) -> Drive:
    """Return a drive of `steps` wheel increments, 0.5 m/s along a circle of 1.5 m.

    Landmarks nearer than `far` are seen at each `every`th stamp, not so those with an index in
    `hidden` during the second half. `noise` scales what is drawn, not what is stated.
    """
    rng = np.random.default_rng(seed)
    stamps: Stamps = np.arange(steps + 1, dtype=np.int64) * PERIOD_NS
    # Left and right wheel on a circle of 1.5 m: (0.5 ∓ 0.5/1.5·0.25) m/s.
    angles = np.tile(np.array([0.5 - 1.0 / 12.0, 0.5 + 1.0 / 12.0]) * 0.1 / 0.1, (steps, 1))
    begin = noise * rng.standard_normal(3) * START_SIGMA
    truth = chain(exp(BASE.displacements(angles)), begin)
    slip = noise * NOISE.rolling * np.sqrt(np.abs(0.1 * angles)) * rng.standard_normal(angles.shape)
    wheels = WheelIncrements("wheels", stamps, angles + slip / 0.1, BASE.driven_names)
    sensor = compose(truth, np.array(MOUNT))
    rows = []
    for k in range(every, steps + 1, every):
        d = landmarks - sensor[k, :2]
        distance = np.hypot(d[:, 0], d[:, 1])
        for i in np.flatnonzero(distance < far):
            if i in hidden and k > steps // 2:
                continue
            bearing = np.arctan2(d[i, 1], d[i, 0]) - sensor[k, 2]
            e = noise * rng.standard_normal(2) * sigma
            rows.append((k, i, distance[i] + e[0], wrap(np.array(bearing + e[1]))))
    table = np.array(rows).reshape(-1, 4)
    seen = LandmarkSightings(
        "marks",
        table[:, 0].astype(np.int64) * PERIOD_NS,
        table[:, 1].astype(np.int64) if identified else np.full(len(table), -1),
        table[:, 2],
        table[:, 3],
        *sigma,
        mount=MOUNT,
    )
    # The start is known as well as it says: the estimators begin at the nominal one.
    reference = Reference(
        Trajectory(stamps, np.vstack([np.zeros(3), truth[1:]])), sigma=START_SIGMA
    )
    return Drive("circle", Robot("robot", BASE, NOISE), wheels, (seen,), reference)
