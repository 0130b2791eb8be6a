"""Are the wheel noise defaults right? Sparse fixes on recorded drives say so.

`python -m fgloc.experiments.wheel_noise [--data DIR]` smooths recorded drives of every robot with
a position fix every 10 s and every 3 s (2 mm) and prints, per robot and path, medians over the
drives of

- chi²/n: squared normalised residuals of all sensors per fix component, near 1 where the noise
  that a kind of base is given (`fgloc.core.robot.typical_noise`) is what its wheels do, less where
  a drive is too short for the calibration to be told from the noise;
- NEES: squared normalised pose error against the whole truth, ideally 3;
- the position error.

No default is fitted to one drive: a kind of base has one set of values, rounded.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from pathlib import Path

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.evaluation import evaluate
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


def main(arguments: list[str]) -> int:
    """Print the table; needs the recorded drives (--data DIR or $FGLOC_DATA)."""
    data = Path(arguments[1]) if arguments[:1] == ["--data"] and len(arguments) == 2 else None
    rows: dict[tuple[str, float], list[tuple[float, float, float]]] = defaultdict(list)
    for family in FAMILIES:
        for name in expand([family], data)[::STRIDE]:
            drive = load_drive(name, data)
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
