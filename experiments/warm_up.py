"""Compile every inner loop once, so that the first drive of a user does not wait for it."""

from __future__ import annotations

from numba.core.event import install_timer

from fgloc.core.evaluation import evaluate
from fgloc.datasets.simulator import load_sim
from fgloc.errors import FglocError
from fgloc.estimator import run
from fgloc.experiments import methods

DRIVE = "square?duration=10&camera=on&gyro=on&fix_every=2"
"""A drive with every kind of sensor but those that see landmarks."""
ROOM = "seed-c-1?duration=4"
"""A drive with a lidar among walls."""


def compile_kernels(*drives: str) -> float:
    """Run every method on small simulated drives; return the seconds spent compiling.

    About 20 s the first time for `DRIVE`, which is the default, and as much for `ROOM`; 0 when
    the compiled loops are found in the cache.
    """
    compiling: list[float] = []
    with install_timer("numba:compile", compiling.append):
        for drive in map(load_sim, drives or (DRIVE,)):
            for name in methods.available():
                try:
                    result = run(methods.create(name), drive)
                except FglocError:
                    # It needs a sensor that this drive does not have.
                    continue
                if drive.truth is not None:
                    evaluate(result.trajectory, drive.truth)
    return sum(compiling)
