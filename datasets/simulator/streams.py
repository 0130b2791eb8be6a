"""Independent random streams: one for each thing that is drawn, all from one seed."""

from __future__ import annotations

import numpy as np

STREAMS = (
    "calibration",
    "motion",
    "rolling",
    "encoder",
    "yaw",
    "gyro",
    "acc",
    "camera",
    "fix",
    "log",
)
"""Names of the streams. New ones go to the end: the position is what keeps old drives the same."""


def generator(seed: int, stream: str) -> np.random.Generator:
    """Return the generator of one stream; what others draw, or whether, makes no difference."""
    key = (STREAMS.index(stream),)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
