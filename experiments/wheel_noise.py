"""Are the wheel noise defaults right? Sparse fixes on recorded drives say so.

`python -m fgloc.experiments.wheel_noise [--data DIR] [--odometry]` smooths recorded drives of every
robot with a position fix every 10 s and every 3 s (2 mm) and prints, per robot and path, medians
over the drives of

- chi²/n: squared normalised residuals of all sensors per fix component, near 1 where the noise
  that a kind of base is given (`fgloc.core.robot.typical_noise`) is what its wheels do, less where
  a drive is too short for the calibration to be told from the noise;
- NEES: squared normalised pose error against the whole truth, ideally 3;
- the position error.

With --odometry the displacements of the nominal wheels are taken for the odometry of a body whose
wheels are not known, and so are its noise and parameters.

No default is fitted to one drive: a kind of base has one set of values, rounded.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np

from fgloc.core.bases import SKID_TRACK_PRIOR, body_odometry
from fgloc.core.drive import Drive
from fgloc.core.evaluation import evaluate
from fgloc.core.measurements import WheelIncrements
from fgloc.core.robot import Robot
from fgloc.datasets.registry import expand, load_drive
from fgloc.errors import FglocError
from fgloc.estimator import Result
from fgloc.experiments.fixes import with_fixes
from fgloc.smoothing.batch import BatchSmoother

FAMILIES = ("optiodom:*", "vitko-swerve:*", "jackal-jackass:1")
STRIDE = 3
"""Every third drive of a family is enough for a median."""
INTERVALS_S = (10.0, 3.0)
SIGMA_M = 0.002


def chi2_per_component(result: Result) -> float:
    """Return the sum of squared normalised residuals over the number of fix components."""
    squared = sum(float(np.sum(s.normalised**2)) for s in result.residuals)
    components = sum(s.normalised.size for s in result.residuals if s.sensor == "fixes")
    return squared / components


def _label(drive: Drive) -> str:
    """Return what the drives of one line of the table share."""
    return f"{drive.robot.name} {drive.motion or ''}".strip()


def as_odometry(drive: Drive) -> Drive:
    """Return a drive whose nominal wheels are the odometry of a body.

    The nominal track of a skidding robot says little of how it turns, so its rotation scale keeps
    the prior of that track.
    """
    base = body_odometry()
    if drive.robot.base.kind == "skid-steer":
        scales = (p for p in base.parameters if p.name != "rotation_scale")
        turn = next(p for p in base.parameters if p.name == "rotation_scale")
        base = replace(base, parameters=(*scales, replace(turn, prior_sigma=SKID_TRACK_PRIOR)))
    moved = drive.robot.base.displacements(drive.wheels.angles, drive.wheels.steering)
    wheels = WheelIncrements("wheels", drive.wheels.stamps_ns, moved, base.driven_names)
    return replace(drive, robot=Robot.typical(drive.robot.name, base), wheels=wheels)


def main(arguments: list[str]) -> int:
    """Print the table; needs the recorded drives (--data DIR or $FGLOC_DATA)."""
    parser = argparse.ArgumentParser(prog="fgloc.experiments.wheel_noise")
    parser.add_argument("--data", type=Path, help="folder of recorded drives")
    parser.add_argument("--odometry", action="store_true", help="as if the wheels were not known")
    options = parser.parse_args(arguments)
    data = options.data
    rows: dict[tuple[str, float], list[tuple[float, float, float]]] = defaultdict(list)
    for family in FAMILIES:
        for name in expand([family], data)[::STRIDE]:
            drive = load_drive(name, data)
            drive = as_odometry(drive) if options.odometry else drive
            for interval in INTERVALS_S:
                try:
                    offered = with_fixes(drive, interval, SIGMA_M, 0)
                except FglocError:
                    continue  # too short for a single fix
                result = BatchSmoother().estimate(offered)
                assert drive.truth is not None
                found = {c.name: c.value for c in result.calibration}
                sensor, mount = drive.truth.sensor, drive.truth.mount
                axes = zip(("x", "y", "yaw"), mount, strict=True)
                at = [found.get(f"{sensor}_{axis}", nominal) for axis, nominal in axes]
                error = evaluate(result.trajectory, drive.truth, (at[0], at[1], at[2]))
                nees = np.nan if error.nees is None else error.nees
                rows[_label(drive), interval].append(
                    (chi2_per_component(result), nees, error.ate_rmse_m)
                )
    print(f"{'robot and path':40}{'fix every':>10}{'drives':>8}{'chi²/n':>8}{'NEES':>8}{'mm':>8}")
    for (label, interval), values in sorted(rows.items()):
        chi2, nees, error_m = np.median(np.array(values), axis=0)
        print(
            f"{label:40}{interval:8.0f} s{len(values):8}{chi2:8.2f}{nees:8.2f}{1e3 * error_m:8.1f}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
