"""Checks that every measurement makes of itself: stamps, shapes, noise, mounting."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from fgloc.errors import FglocError

Floats = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]


def check_arrays(
    sensor: str,
    stamps: Stamps,
    arrays: dict[str, npt.NDArray[Any]],
    rows: int,
    width: tuple[int, ...] | None = None,
) -> None:
    """Raise FglocError unless stamps strictly increase and arrays are finite with `rows` rows.

    `width` is the shape of one row, () for a plain number; None leaves it to the caller.
    """
    if stamps.dtype != np.int64 or stamps.ndim != 1:
        raise FglocError(f"{sensor}: stamps must be a one-dimensional int64 array of nanoseconds")
    if stamps.size > 1 and not bool(np.all(np.diff(stamps) > 0)):
        k = int(np.flatnonzero(np.diff(stamps) <= 0)[0]) + 1
        raise FglocError(f"{sensor}: stamp {k} does not come after the one before it")
    for name, values in arrays.items():
        if values.shape[0] != rows:
            raise FglocError(f"{sensor}: {name} has {values.shape[0]} rows, expected {rows}")
        if width is not None and values.shape != (rows, *width):
            raise FglocError(f"{sensor}: {name} must have shape {(rows, *width)}")
        if not bool(np.all(np.isfinite(values))):
            raise FglocError(f"{sensor}: {name} holds a value that is not finite")


def check_noise(
    sensor: str, positive: dict[str, float], others: dict[str, float] | None = None
) -> None:
    """Raise FglocError unless `positive` are finite and above zero, `others` finite and not below.

    A sigma of zero would give a measurement infinite weight.
    """
    for name, value in positive.items():
        if not 0.0 < value < math.inf:
            raise FglocError(f"{sensor}: {name} must be positive and finite, got {value}")
    for name, value in (others or {}).items():
        if not 0.0 <= value < math.inf:
            raise FglocError(f"{sensor}: {name} must be finite and not negative, got {value}")


def check_mount(sensor: str, mount: tuple[float, ...], sigma: tuple[float, ...], n: int) -> None:
    """Raise FglocError unless a mounting and its sigmas are `n` finite numbers each."""
    if len(mount) != n or len(sigma) != n:
        raise FglocError(f"{sensor}: mount and mount_sigma must have {n} numbers")
    if not all(map(math.isfinite, mount)):
        raise FglocError(f"{sensor}: mount must be finite, got {mount}")
    check_noise(sensor, {}, {"mount_sigma": min(sigma), "largest mount_sigma": max(sigma)})
