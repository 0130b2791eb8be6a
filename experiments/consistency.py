"""Are the covariances right? NEES and NIS over many simulated drives, with their bounds.

`python -m fgloc.experiments.consistency [--seeds 100] [--methods batch] [--drive random]
[--duration 120]` simulates drives without slip of three kinds of base, each with continuous and
with coarse encoders, runs the methods on them and prints the averages over the seeds of

- pose NEES: squared normalised error of the last pose, 3 degrees of freedom;
- calibration NEES: that of the robot's calibration, one degree for each parameter with a prior;
- NIS: that of the last fix, 2 degrees, against what the method predicts without having seen it;

each with the bounds in which 95 % of such averages lie if the covariances are right.

Everything an estimator is told is drawn as it is told: the true calibration from its whole prior,
correlation included, the start from its sigma, the yaw's drift rate from its sigma, slip, yaw and
fixes from their noise models. Only the rounding of coarse encoders is what real encoders do.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fgloc.core.consistency import Average, average, squared_normalised
from fgloc.core.drive import Drive, Reference
from fgloc.core.evaluation import error_series
from fgloc.core.measurements import PositionFixes
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.simulator import load_sim
from fgloc.datasets.simulator.sensors import DRIFT_RATE_SIGMA
from fgloc.errors import FglocError
from fgloc.estimator import Result
from fgloc.experiments.methods import create, parse

START_SIGMA = (0.02, 0.02, 0.01)
"""Sigma of the start x, y [m], heading [rad]: large enough to be seen in what follows."""
SEEDS = 100
DURATION_S = 120.0
FIXES = "fix_every=10&fix_sigma=0.05"
YAW = "yaw=on&yaw_resolution=0&yaw_sigma=0.005"
NO_YAW = "yaw=off"


@dataclass(frozen=True)
class Scenario:
    """One kind of simulated drive; every seed makes a drive of it."""

    base: str
    """Kind of base, as in `robot=…` of the simulator."""
    ticks: int
    """Encoder counts per revolution; 0 continuous."""
    sensors: str
    """Keys of the simulator for the sensors besides wheels and fixes."""

    @property
    def label(self) -> str:
        """Return the scenario in a few words."""
        yaw = " + yaw" if self.sensors == YAW else ""
        return f"{self.base}{yaw}, {f'{self.ticks} counts' if self.ticks else 'continuous'}"


SCENARIOS = tuple(
    Scenario(base, ticks, sensors)
    for base, sensors in (("differential", NO_YAW), ("skid", YAW), ("mecanum", NO_YAW))
    for ticks in (0, 300)
)
"""What is simulated by default: three bases, continuous encoders and the Jaguar's coarse ones."""


@dataclass(frozen=True)
class RunErrors:
    """Squared normalised errors of one method on one drive; NaN where it states no covariance."""

    pose: float
    """At the last pose, 3 degrees of freedom."""
    calibration: float
    """Of the robot's calibration, in the solver's variables (logarithms of radii and track)."""
    calibration_dof: int
    """Number of calibration parameters of the robot with a prior."""
    nis: float
    """Of the last fix, predicted without it; 2 degrees of freedom."""


@dataclass(frozen=True)
class Consistency:
    """Averages of one method over all seeds of one scenario; None without covariances."""

    method: str
    """Method id."""
    scenario: Scenario
    """What was simulated."""
    pose: Average | None
    """NEES of the last pose."""
    calibration: Average | None
    """NEES of the calibration."""
    nis: Average | None
    """NIS of the last fix."""


def simulate(scenario: Scenario, seed: int, drive: str, duration_s: float) -> tuple[Drive, Drive]:
    """Return a simulated drive, and the same as it is offered: with a start that is not exact.

    Estimators start from the first pose of the truth, which they are told to be wrong by
    START_SIGMA; so it is made wrong by that much. Errors are taken against the drive itself.
    """
    rng = np.random.default_rng([seed, 1])
    drift = DRIFT_RATE_SIGMA * float(rng.standard_normal())
    true = load_sim(
        f"{drive}?robot={scenario.base}&seed={seed}&duration={duration_s:g}&calibration=prior"
        f"&encoder_ticks={scenario.ticks}&{FIXES}&{scenario.sensors}&yaw_drift={drift!r}"
    )
    assert true.truth is not None
    poses = true.truth.trajectory.poses.copy()
    poses[0] += np.array(START_SIGMA) * rng.standard_normal(3)
    start = Reference(
        Trajectory(true.truth.trajectory.stamps_ns, poses), true.truth.sensor, START_SIGMA
    )
    return true, replace(true, truth=start)


def run_errors(method: str, true: Drive, offered: Drive) -> RunErrors:
    """Run a method on the offered drive and return how far it is from the true one.

    Two runs: one with all fixes, one without the last. Raises FglocError as the method does.
    """
    result = create(method).estimate(offered)
    calibration, dof = calibration_nees(result, true)
    return RunErrors(final_pose_nees(result, true), calibration, dof, last_nis(method, offered))


def final_pose_nees(result: Result, drive: Drive) -> float:
    """Return the squared normalised error of the last pose (3 degrees); NaN without covariance."""
    assert drive.truth is not None
    series = error_series(result.trajectory, drive.truth)
    if series.covariances is None:
        return float("nan")
    return squared_normalised(series.errors[-1], series.covariances[-1])


def calibration_nees(result: Result, drive: Drive) -> tuple[float, int]:
    """Return the squared normalised error of the robot's calibration and its degrees of freedom.

    In the solver's variables, in which the prior is Gaussian. NaN and 0 for a method that does
    not estimate all of them or states no covariance.
    """
    priors = [p for p in drive.robot.base.parameters if p.prior_sigma > 0.0]
    names = [c.name for c in result.calibration]
    known = result.calibration_covariance
    if known is None or drive.true_calibration is None or not {p.name for p in priors} <= {*names}:
        return float("nan"), 0
    at = [names.index(p.name) for p in priors]
    found = [p.to_solver(result.calibration[k].value) for p, k in zip(priors, at, strict=True)]
    true = [p.to_solver(drive.true_calibration[p.name]) for p in priors]
    scale = np.array([p.derivative(u) for p, u in zip(priors, found, strict=True)])
    covariance = known[np.ix_(at, at)] / np.outer(scale, scale)
    return squared_normalised(np.array(found) - np.array(true), covariance), len(priors)


def last_nis(method: str, drive: Drive) -> float:
    """Return the squared normalised innovation of the last fix (2 degrees); NaN without covariance.

    The method is run without that fix; its pose then and the fix are independent.
    """
    (fixes,) = drive.each(PositionFixes)
    before = PositionFixes(
        fixes.sensor,
        fixes.stamps_ns[:-1],
        fixes.positions[:-1],
        fixes.sigma[:-1],
        fixes.mount,
        fixes.mount_sigma,
    )
    others = tuple(s for s in drive.sensors if s is not fixes)
    result = create(method).estimate(replace(drive, sensors=(*others, before)))
    fix = Trajectory(fixes.stamps_ns[-1:], np.append(fixes.positions[-1], 0.0)[None])
    mount = (fixes.mount[0], fixes.mount[1], 0.0)
    series = error_series(result.trajectory, Reference(fix, fixes.sensor), mount)
    if series.covariances is None:
        return float("nan")
    innovation = series.covariances[0][:2, :2] + np.diag(fixes.sigma[-1] ** 2)
    return squared_normalised(series.errors[0, :2], innovation)


def consistency(
    methods: Sequence[str],
    seeds: Sequence[int],
    drive: str = "random",
    duration_s: float = DURATION_S,
    scenarios: Sequence[Scenario] = SCENARIOS,
) -> tuple[Consistency, ...]:
    """Return the averages of every method on every scenario, each over all seeds.

    Raises FglocError where a method cannot run, or for an unknown drive.
    """
    out = []
    for scenario in scenarios:
        errors: dict[str, list[RunErrors]] = {m: [] for m in methods}
        for seed in seeds:
            true, offered = simulate(scenario, seed, drive, duration_s)
            for method in methods:
                errors[method].append(run_errors(method, true, offered))
        out += [summarise(m, scenario, errors[m]) for m in methods]
    return tuple(out)


def summarise(method: str, scenario: Scenario, runs: Sequence[RunErrors]) -> Consistency:
    """Return the averages of independent runs with their bounds."""
    return Consistency(
        method,
        scenario,
        _average([r.pose for r in runs], [3] * len(runs)),
        _average([r.calibration for r in runs], [r.calibration_dof for r in runs]),
        _average([r.nis for r in runs], [2] * len(runs)),
    )


def _average(values: list[float], dof: list[int]) -> Average | None:
    """Return the average with bounds, or None if no run has a covariance."""
    return average(values, dof) if np.isfinite(values).any() else None


def _cell(found: Average | None) -> str:
    """Return one cell of the table."""
    if found is None:
        return f"{'–':>31}"
    skipped = f" ({found.skipped} skipped)" if found.skipped else ""
    bounds = f"{found.lower:.2f}…{found.upper:.2f}"
    return f"{found.value:10.2f} {bounds:>12} {found.verdict}{skipped}".ljust(31)


def main(arguments: list[str]) -> int:
    """Print the table; exit code 1 if an average lies outside its bounds."""
    parser = argparse.ArgumentParser(prog="python -m fgloc.experiments.consistency")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="drives per scenario")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--methods", default="batch", help="method ids, separated by commas")
    parser.add_argument("--drive", default="random", help="simulated motion")
    parser.add_argument("--duration", type=float, default=DURATION_S, help="length of a drive [s]")
    options = parser.parse_args(arguments)
    seeds = range(options.first, options.first + options.seeds)
    try:
        methods = parse(options.methods)
        rows = consistency(methods, seeds, options.drive, options.duration)
    except FglocError as error:
        print(f"fgloc: error: {error}", file=sys.stderr)
        return 1
    print(f"{options.drive}, {options.duration:g} s, {options.seeds} seeds; average, 95 % bounds")
    print(
        f"{'':10}{'':30}{'pose NEES':>10}{'':21}{'calibration NEES':>17}{'':14}{'NIS of fixes':>13}"
    )
    outside = 0
    for row in rows:
        cells = (row.pose, row.calibration, row.nis)
        outside += sum(c is not None and c.verdict != "inside" for c in cells)
        print(f"{row.method:10}{row.scenario.label:30}" + "".join(map(_cell, cells)).rstrip())
    print(f"{outside} of {3 * len(rows)} averages are outside; one in twenty would be by chance")
    return 1 if outside else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
