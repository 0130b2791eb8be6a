"""Compile every inner loop once, so that the first drive of a user does not wait for it."""

from __future__ import annotations

from numba.core.event import install_timer

from fgloc.core.evaluation import evaluate
from fgloc.datasets.simulator import load_sim
from fgloc.errors import FglocError
from fgloc.estimator import run
from fgloc.experiments import methods

DRIVE = "square?duration=10&camera=on&gyro=on&fix_every=2"
"""A drive with every kind of sensor."""


def compile_kernels() -> float:
    """Run every method on a small simulated drive; return the seconds spent compiling.

    About 20 s the first time, 0 when the compiled loops are found in the cache.
    """
    compiling: list[float] = []
    with install_timer("numba:compile", compiling.append):
        drive = load_sim(DRIVE)
        for name in methods.available():
            try:
                result = run(methods.create(name), drive)
            except FglocError:
                # It needs a sensor that this drive does not have.
                continue
            if drive.truth is not None:
                evaluate(result.trajectory, drive.truth)
    return sum(compiling)
