"""One seeded fuzz case: a simulated drive, a few faults, and what must hold all the same.

By hand, for long: `python -m tests.online.fuzz 0 300`.
"""

from __future__ import annotations

import sys
import time
import traceback
import warnings
from dataclasses import replace
from functools import lru_cache

import numpy as np

from fgloc.core.drive import Drive
from fgloc.datasets.simulator import load_sim
from fgloc.online.replay import packets

from .driving import counted, engine_for, run
from .mutations import MUTATIONS

ROBOTS = ("skid", "differential", "mecanum", "omni3", "tricycle", "swerve")
SENSORS = (
    "yaw=off",
    "fix_every=1",
    "gyro=on&camera=on&fix_every=2",
    "yaw=off&gyro=on&fix_every=5&fix_x=0.2&fix_mount_sigma=0.1",
    "camera=on",
)


@lru_cache(maxsize=64)
def drive_of(robot: str, sensors: str, seconds: int) -> Drive:
    """Return a simulated drive."""
    return load_sim(f"random?robot={robot}&duration={seconds}&rate=10&{sensors}")


def fuzz(seed: int, seconds: int = 60) -> str:
    """Run one case; return what was done to the drive. Raises AssertionError if it went wrong."""
    rng = np.random.default_rng(seed)
    robot, sensors = str(rng.choice(ROBOTS)), str(rng.choice(SENSORS))
    drive = drive_of(robot, sensors, seconds)
    if rng.random() < 0.4:
        drive = replace(drive, truth=None)
    sent = list(packets(drive))
    names = []
    for k in rng.integers(len(MUTATIONS), size=int(rng.integers(1, 4))):
        sent = MUTATIONS[k](sent, rng) if sent else sent
        names.append(MUTATIONS[k].__name__)
    what = f"{robot} {sensors} truth={drive.truth is not None} {'+'.join(names)}"
    try:
        engine = engine_for(drive)
        run(engine, sent, every=7)
        counted(engine, sent)
    except Exception as error:
        raise AssertionError(f"seed {seed}: {what}: {type(error).__name__}: {error}") from error
    return f"{what} rebuilds={engine.rebuilds} repairs={engine.smoother.repairs}"


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    failed = 0
    for case in range(int(sys.argv[1]), int(sys.argv[2])):
        begin = time.perf_counter()
        try:
            said = fuzz(case)
        except AssertionError as error:
            failed += 1
            said = f"FAILED {error}"
            cause = traceback.extract_tb(error.__cause__.__traceback__)[-3:]
            said += " @ " + " < ".join(f"{f.name}:{f.lineno}" for f in reversed(cause))
        print(f"{case} {time.perf_counter() - begin:.1f}s {said}", flush=True)
    print(f"{failed} failed")
