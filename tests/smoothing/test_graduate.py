"""Graduated non-convexity: drives whose fixes are wild by the dozen, singly and in runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgloc.core.drive import Drive
from fgloc.core.measurements import PositionFixes
from fgloc.factors.robust import PLAIN, Loss
from fgloc.smoothing.batch import BatchSmoother
from fgloc.smoothing.build import build_problem
from fgloc.smoothing.graduate import SLIDING, doubtful, judged
from fgloc.smoothing.optimise import Solution, optimise
from fgloc.smoothing.settings import Settings

from .drives import scores, simulated, with_sensor

DRIVES = {
    "skid": "figure-eight?seed=1&duration=120&fix_every=1&fix_sigma=0.02",
    "differential": "random?robot=differential&seed=1&duration=120&fix_every=1&fix_sigma=0.02",
}
AWAY = 5.0
"""How far wild fixes are off [m]."""


def wild(drive: Drive, share: float, run: int, seed: int = 1) -> Drive:
    """Return the drive with a share of its fixes 5 m off, in runs of `run` that go one way."""
    (fixes,) = drive.each(PositionFixes)
    rng = np.random.default_rng(seed)
    positions, count = fixes.positions.copy(), fixes.stamps_ns.size
    off = np.zeros(count, dtype=bool)
    while off.sum() < round(share * count):
        begin, angle = int(rng.integers(0, count - run + 1)), rng.uniform(0.0, 2 * np.pi)
        new = np.arange(begin, begin + run)
        new = new[~off[new]]
        positions[new] += AWAY * np.array([np.cos(angle), np.sin(angle)])
        off[new] = True
    return with_sensor(drive, replace(fixes, positions=positions))


def slipping(drive: Drive, bursts: int, seed: int = 1) -> Drive:
    """Return the drive with one wheel 60 % too fast for 1.5 s, `bursts` times."""
    rng = np.random.default_rng(seed)
    angles, seconds = drive.wheels.angles.copy(), drive.wheels.stamps_ns[1:] * 1e-9
    for _ in range(bursts):
        begin = rng.uniform(seconds[0] + 5.0, seconds[-1] - 5.0)
        during = (seconds >= begin) & (seconds < begin + 1.5)
        angles[during, rng.integers(0, angles.shape[1])] *= 1.6
    return replace(drive, wheels=replace(drive.wheels, angles=angles))


def solved(drive: Drive, **settings: object) -> Solution:
    chosen = Settings(covariances=False, **settings)  # type: ignore[arg-type]
    return optimise(build_problem(drive, chosen), chosen)


@pytest.mark.parametrize(
    ("robot", "share", "run"),
    [
        ("skid", 0.4, 1),
        ("skid", 0.4, 4),
        ("skid", 0.3, 10),
        ("differential", 0.5, 1),
        ("differential", 0.3, 10),
    ],
)
def test_wild_fixes_by_the_dozen_are_given_up(robot: str, share: float, run: int) -> None:
    clean = simulated(DRIVES[robot])
    (fixes,) = clean.each(PositionFixes)
    drive = wild(clean, share, run)
    (moved,) = drive.each(PositionFixes)
    off = np.hypot(*(moved.positions - fixes.positions).T) > 0.5 * AWAY
    assert off.mean() >= share - 0.01
    # What is left of the fixes alone, the wild ones taken away by hand.
    kept = replace(
        fixes,
        stamps_ns=fixes.stamps_ns[~off],
        positions=fixes.positions[~off],
        sigma=fixes.sigma[~off],
    )
    # Ten that agree with each other still bend the path under the Cauchy loss, each a little.
    settings = Settings(fix_loss=Loss("geman-mcclure", 4.0)) if run == 10 else Settings()
    oracle = BatchSmoother().estimate(with_sensor(clean, kept))
    result = BatchSmoother(settings).estimate(drive)
    assert result.convergence.startswith("converged")
    assert result.counts["fixes"].down_weighted == int(off.sum())
    assert scores(result, drive).ate_rmse_m < 1.3 * scores(oracle, drive).ate_rmse_m + 0.005


def test_without_graduation_the_nearest_minimum_is_metres_away() -> None:
    # What graduation is for: the same drives from the plain solution. Were they easy, the test
    # above would prove nothing.
    drive = wild(simulated(DRIVES["skid"]), 0.4, 1)
    result = BatchSmoother(Settings(graduated=False)).estimate(drive)
    assert scores(result, drive).ate_rmse_m > 1.0


@pytest.mark.parametrize("robot", DRIVES)
def test_slip_alone_is_left_to_the_wheels_loss(robot: str) -> None:
    # Forbidding the wheels to slip costs accuracy where they do; a second look must not win.
    drive = slipping(simulated(DRIVES[robot]), 6)
    with_it, without = solved(drive), solved(drive, graduated=False)
    assert doubtful(without.point), "torn wheels must call for a second look"
    np.testing.assert_array_equal(with_it.point.states, without.point.states)
    assert with_it.converged == without.converged
    assert with_it.iterations > without.iterations


def test_a_healthy_drive_is_looked_at_once() -> None:
    drive = simulated(DRIVES["skid"])
    with_it, without = solved(drive), solved(drive, graduated=False)
    assert not doubtful(without.point)
    assert with_it.iterations == without.iterations
    np.testing.assert_array_equal(with_it.point.states, without.point.states)


def test_convex_losses_are_never_doubted() -> None:
    drive = wild(simulated(DRIVES["skid"]), 0.4, 1)
    solution = solved(drive, wheel_loss=PLAIN, fix_loss=PLAIN)
    assert not doubtful(solution.point)


def test_a_leap_is_judged_by_its_length() -> None:
    point = solved(simulated(DRIVES["skid"])).point
    # Of a healthy drive every wheel residual is inside both losses' parabola, nearly.
    assert judged(point) == pytest.approx(point.cost, rel=0.05)
    torn = point.linear[0].residual.copy()
    torn[100] = [300.0, 400.0, 0.0]
    leap = replace(point, linear=(replace(point.linear[0], residual=torn), *point.linear[1:]))
    small = 0.5 * float(point.linear[0].squared[100])
    loss = point.tables[0].loss
    paid = float(loss.cost(np.array([500.0**2]))[0]) - small
    leap = replace(leap, cost=point.cost + paid)
    # Huber's line: 2 (500 - 1) = 998, where Cauchy asks for some 20.
    assert paid < 30.0
    assert judged(leap) - judged(point) == pytest.approx(SLIDING.k * (500.0 - 1.0), rel=0.01)
