"""Sparse position fixes made from a recorded truth, for recordings of wheels and truth only."""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass, replace

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.measurements import PositionFixes
from fgloc.core.start import trim_to_truth
from fgloc.errors import FglocError

NAME = "fixes"
"""Name of the stream in tables and results."""
SHORTEST_NS = 1_000_000
"""Shortest time between fixes [ns]; below it, billions of due times would fill the memory."""
MOST = 10_000_000
"""So many fixes and no more."""
DEFAULT_SIGMA_M = 0.01
"""Standard deviation of a fix along x and along y [m] where none is given."""


@dataclass(frozen=True)
class FixSpec:
    """How often the truth is offered and how noisy."""

    every_s: float
    """Time from one fix to the next [s]; the first comes this long after the start."""
    sigma_m: float = DEFAULT_SIGMA_M
    """Standard deviation of the added noise along x and along y [m]."""

    def __post_init__(self) -> None:
        for value in (self.every_s, self.sigma_m):
            if not (math.isfinite(value) and value > 0.0):
                raise FglocError(
                    "fixes need a positive time between fixes [s] and a positive sigma [m], "
                    f"got {self.every_s}:{self.sigma_m}"
                )

    def __str__(self) -> str:
        return f"a position fix every {self.every_s:g} s, σ {self.sigma_m:g} m"


def parse(text: str) -> FixSpec:
    """Return the meaning of "EVERY_S[:SIGMA_M]", e.g. "10:0.002"; FglocError if it has none."""
    every, _, sigma = text.partition(":")
    try:
        return FixSpec(float(every), float(sigma) if ":" in text else DEFAULT_SIGMA_M)
    except ValueError:
        raise FglocError(
            f"--fixes {text!r} is not EVERY_S[:SIGMA_M]; write e.g. 10:0.002 for a fix every "
            "10 s with a sigma of 2 mm"
        ) from None


def with_fixes(drive: Drive, every_s: float, sigma_m: float, seed: int) -> Drive:
    """Return the drive with a stream "fixes": the recorded truth, sparse and noisy.

    The stream is called "fixes", or "truth_fixes" where the drive has one of that name.
    A fix is the position of the reference's own frame, so its lever arm is the reference's
    mounting. The first comes `every_s` after the estimators start; each stands at the recorded
    stamp nearest to its due time, and is left out where none lies within a quarter of `every_s`
    (a gap in the truth). Noise is Gaussian, the same for the same seed and drive. Raises
    FglocError if the drive has no truth or is too short for a single fix.
    """
    spec = FixSpec(every_s, sigma_m)
    if drive.truth is None:
        raise FglocError(
            f"{drive.name} has no recorded truth to make position fixes from; leave out --fixes"
        )
    taken = any(s.sensor == NAME for s in drive.sensors)
    wheels = trim_to_truth(drive).wheels.stamps_ns
    truth = drive.truth.trajectory
    period = spec.every_s * 1e9
    if period < SHORTEST_NS:
        raise FglocError(f"a fix every {every_s:g} s is more than any truth holds; ask for 0.001")
    count = int(float(wheels[-1] - wheels[0]) / period + 1e-9)
    if count > MOST:
        raise FglocError(
            f"{drive.name} lasts {drive.duration_s:.3g} s, {spec} would be {count}; ask for fewer"
        )
    due = wheels[0] + np.round(period * np.arange(1, count + 1)).astype(np.int64)
    late = np.minimum(np.searchsorted(truth.stamps_ns, due), len(truth) - 1)
    early = np.maximum(late - 1, 0)
    nearer = np.abs(truth.stamps_ns[early] - due) <= np.abs(truth.stamps_ns[late] - due)
    chosen = np.where(nearer, early, late)
    stamps = truth.stamps_ns[chosen]
    kept = (np.abs(stamps - due) <= period / 4) & (stamps > wheels[0]) & (stamps <= wheels[-1])
    # One draw for every due time: a gap in the truth does not change the noise of later fixes.
    # The drive's name is part of the seed, else all drives of a set would share one noise.
    generator = np.random.default_rng([seed, zlib.crc32(drive.name.encode())])
    noise = generator.normal(0.0, spec.sigma_m, (count, 2))
    chosen, noise = chosen[kept], noise[kept]
    if chosen.size == 0:
        raise FglocError(
            f"{drive.name} lasts {drive.duration_s:.1f} s, too short for {spec}; "
            "ask for a smaller time between fixes"
        )
    # What a fix states of itself includes that the recorded truth is not exact either.
    sigma = np.hypot(spec.sigma_m, np.array(drive.truth.sigma[:2]))
    fixes = PositionFixes(
        f"truth_{NAME}" if taken else NAME,
        truth.stamps_ns[chosen],
        truth.poses[chosen, :2] + noise,
        np.tile(sigma, (chosen.size, 1)),
        mount=drive.truth.mount[:2],
        mount_sigma=drive.truth.mount_sigma[:2],
        mount_name=drive.truth.sensor,
    )
    return replace(drive, sensors=(*drive.sensors, fixes))
