"""Independent random streams: one for each thing that is drawn, all from one seed."""

from __future__ import annotations

import zlib

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
    "mount",
    "lidar",
    "people",
)
"""Names of the streams. New ones go to the end: the position is what keeps old drives the same."""


def generator(seed: int, stream: str, owner: str = "") -> np.random.Generator:
    """Return the generator of one stream; what others draw, or whether, makes no difference.

    `owner` is what draws of the same seed shall differ between, e.g. recorded drives.
    """
    key = (STREAMS.index(stream),)
    entropy = [seed, zlib.crc32(owner.encode())] if owner else seed
    return np.random.default_rng(np.random.SeedSequence(entropy, spawn_key=key))
