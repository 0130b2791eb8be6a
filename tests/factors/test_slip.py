"""Slip found from a yaw sensor and fixes by reweighted least squares, and not found without."""

from __future__ import annotations

import numpy as np
import pytest

from fgloc.core import bases
from fgloc.core.geometry import chain, compose, exp
from fgloc.core.measurements import Floats, WheelIncrements
from fgloc.core.preintegration import SplitIncrements, preintegrate, split_at
from fgloc.core.robot import Robot, WheelNoise
from fgloc.errors import FglocError
from fgloc.factors.slip import (
    PULL,
    SlipModel,
    likely_side,
    redundancy_table,
    redundant,
    slip_effect,
    slip_tables,
)
from fgloc.factors.tables import FactorTable, Kind, linearise
from fgloc.smoothing.arrow import solve, stack

RADIUS, TRACK, STEP, COUNT = 0.1, 0.5, 0.1, 120
ROBOT = Robot("cart", bases.differential(RADIUS, RADIUS, TRACK), WheelNoise(rolling=0.004))


def ground() -> Floats:
    """Return (COUNT, 2) ways of both sides over ground [m]: 1 m/s on a gentle, changing bend."""
    t = (np.arange(COUNT) + 0.5) * STEP
    bend = 0.1 * np.sin(t / 2.0)
    return STEP * np.stack([1.0 - bend, 1.0 + bend], axis=1)


def tables_of(
    rolled: Floats, rng: np.random.Generator, side: Floats | None = None
) -> tuple[list[FactorTable], Floats, Floats]:
    """Return tables of a drive whose wheels rolled so far [m], true poses and start states."""
    seconds, way = np.full(COUNT, STEP), ground()
    twist = np.stack([way.mean(axis=1), 0 * way[:, 0], (way[:, 1] - way[:, 0]) / TRACK], axis=1)
    truth = chain(exp(twist), np.zeros(3))
    noisy = rolled + 0.004 * np.sqrt(np.abs(rolled)) * rng.normal(size=rolled.shape)
    stamps = (np.arange(COUNT + 1) * STEP * 1e9).astype(np.int64)
    wheels = WheelIncrements("wheels", stamps, noisy / RADIUS, ROBOT.base.driven_names)
    split = split_at(wheels, stamps)
    pre, effect = slip_effect(split, ROBOT, ROBOT.base.nominal(), np.zeros((COUNT, 2)))
    each, empty = np.arange(COUNT + 1, dtype=np.int64), slice(0, 0)
    rows = np.concatenate([pre.displacement, effect.reshape(COUNT, -1)], axis=1)
    root = np.linalg.inv(np.linalg.cholesky(pre.covariance))
    yaw = np.stack([truth[:, 2] + 0.01 * rng.normal(size=COUNT + 1), 0 * truth[:, 2]], axis=1)
    fixed = each[::10]
    fixes = np.zeros((fixed.size, 4))
    fixes[:, :2] = truth[fixed, :2] + 0.03 * rng.normal(size=(fixed.size, 2))
    if side is None:
        side = likely_side(ROBOT.base, split, SlipModel())
    tables = [
        FactorTable(Kind.WHEEL_SLIP, "wheels", each[:-1], rows, root, empty, slot=3),
        # A table's calibration block with one variable, the yaw's zero, held at 0 by its prior.
        FactorTable(Kind.YAW, "yaw", each, yaw, np.full((COUNT + 1, 1, 1), 100.0), slice(0, 1)),
        FactorTable(
            Kind.POSITION_FIX,
            "fix",
            fixed,
            fixes,
            np.tile(np.eye(2) / 0.03, (fixed.size, 1, 1)),
            empty,
        ),
        *slip_tables(SlipModel(), side, seconds, 3, 2),
    ]
    states = np.zeros((COUNT + 1, 5))
    states[:, :3] = chain(pre.displacement, np.zeros(3))
    return tables, truth, states


def reweighted(tables: list[FactorTable], states: Floats) -> tuple[Floats, list[float]]:
    """Return the states that reweighted least squares finds, and the costs on the way."""
    costs = []
    for _ in range(100):
        prior = np.array([[1e3, 0.0]])
        linear = [(t, linearise(t, states, np.zeros(1))) for t in tables]
        costs.append(sum(float(t.loss.cost(lin.squared).sum()) for t, lin in linear))
        weighted = [(t, lin, t.loss.weight(lin.squared)) for t, lin in linear]
        found = solve(stack(weighted, states.shape[0], 5, prior))
        assert found is not None
        moved = states + found.step
        moved[:, :3] = compose(states[:, :3], found.step[:, :3])
        states = moved
        if np.abs(found.step).max() < 1e-6:
            break
    return states, costs


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("side", "slip"), [(0, 0.2), (1, 0.2), (0, -0.2)])
def test_slip_of_one_side_is_found_in_time_and_size(seed: int, side: int, slip: float) -> None:
    # From 5 s to 7 s the wheels of one side roll a quarter more (or a sixth less) than the ground.
    rolled = ground()
    rolled[50:70, side] /= 1.0 - slip
    tables, truth, start = tables_of(rolled, np.random.default_rng(seed))
    states, costs = reweighted(tables, start)
    found = states[1:, 3:]
    assert np.median(found[50:70, side]) == pytest.approx(slip, abs=0.02)
    assert np.abs(found[51:69, side] - slip).max() < 0.08
    # Begin and end: half the slip is passed within two intervals of the truth.
    slipping = np.flatnonzero(np.abs(found[:, side]) > 0.5 * abs(slip))
    assert abs(slipping[0] - 50) <= 2
    assert abs(slipping[-1] - 69) <= 2
    assert np.abs(np.delete(found[:, side], np.arange(48, 72))).max() < 0.05
    assert np.abs(found[:, 1 - side]).max() < 0.08
    assert np.abs(states[:, :2] - truth[:, :2]).max() < 0.08
    # The rounds go down and come to rest (the first steps, far from linear, may overshoot).
    assert len(costs) < 100
    assert costs[-1] < 0.01 * costs[0]
    assert np.all(np.diff(costs[5:]) < 1e-6 * costs[5])


@pytest.mark.parametrize("seed", range(3))
def test_a_drive_without_slip_has_next_to_none(seed: int) -> None:
    tables, _, start = tables_of(ground(), np.random.default_rng(seed))
    states, _ = reweighted(tables, start)
    assert np.abs(states[:, 3:]).max() < 0.02


def test_who_is_driven_overspeeds_where_the_yaw_alone_cannot_say() -> None:
    # With heading only, an overspeeding left and an underspeeding right side look the same.
    rolled = ground()
    rolled[50:70, 0] /= 0.8
    found = {}
    for torque in (1.0, -1.0):
        tables, _, start = tables_of(rolled, np.random.default_rng(0), np.full(COUNT, torque))
        kept = [t for t in tables if t.kind != Kind.POSITION_FIX]
        hold = FactorTable(
            Kind.POSE_FIX,
            "start",
            np.zeros(1, dtype=np.int64),
            np.zeros((1, 6)),
            np.eye(3)[None] * 1e3,
            slice(0, 0),
        )
        found[torque] = np.median(reweighted([*kept, hold], start)[0][51:71, 3:], axis=0)
    assert found[1.0][0] > 0.15
    assert abs(found[1.0][1]) < 0.05
    assert found[-1.0][1] < -0.15
    assert abs(found[-1.0][0]) < 0.05


def skid(linear: bool = False) -> Robot:
    """Return a skid-steer robot with two encoders a side."""
    base = bases.skid_steer(("fl", "rl"), ("fr", "rr"), 0.1, 0.7, order=("fl", "fr", "rl", "rr"))
    return Robot("skid", bases.full_linear(base) if linear else base)


def rolled_by(robot: Robot, angles: Floats, ends: Floats | None = None) -> SplitIncrements:
    """Return increments of 0.1 s between the first and last stamp, or between all `ends`."""
    stamps = (np.arange(angles.shape[0] + 1) * 1e8).astype(np.int64)
    wheels = WheelIncrements("wheels", stamps, angles, robot.base.driven_names)
    return split_at(wheels, stamps[[0, -1]] if ends is None else stamps)


@pytest.mark.parametrize(
    "robot",
    [
        skid(),
        skid(linear=True),
        Robot("mecanum", bases.mecanum(0.08, 0.2, 0.25, ("fl", "fr", "rl", "rr"))),
    ],
)
def test_effect_of_slip_is_that_of_rolling_less(robot: Robot) -> None:
    angles = np.random.default_rng(2).normal(size=(5, 4))
    values, slips = robot.base.nominal() * 1.01, np.array([0.3, 0.0, -0.2, 0.6])
    pre, effect = slip_effect(rolled_by(robot, angles), robot, values, slips[None])
    plain = preintegrate(rolled_by(robot, angles * (1.0 - slips)), robot, values)
    np.testing.assert_allclose(pre.displacement, plain.displacement, atol=1e-14)
    np.testing.assert_allclose(pre.jacobian, plain.jacobian, atol=1e-12)
    np.testing.assert_allclose(pre.covariance, plain.covariance, atol=1e-16)
    h = 1e-5
    for wheel in range(4):
        less = h * np.eye(4)[wheel]
        differences = [
            preintegrate(rolled_by(robot, angles * (1.0 - s)), robot, values).displacement
            for s in (slips + less, slips - less)
        ]
        numerical = (differences[0] - differences[1]) / (2 * h)
        np.testing.assert_allclose(effect[:, :, wheel], numerical, atol=1e-9)


def test_what_wheels_tell_twice() -> None:
    # Front and rear wheel of a side: two conditions. A mecanum base: its diagonals' sums agree.
    conditions = redundant(skid().base)
    assert conditions.shape == (2, 4)
    np.testing.assert_allclose(conditions @ conditions.T, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(conditions @ [0.3, -0.2, 0.3, -0.2], 0.0, atol=1e-12)
    assert np.linalg.norm(conditions @ [0.1, 0.0, 0.0, 0.0]) == pytest.approx(0.1 / np.sqrt(2))
    rollers = redundant(bases.mecanum(0.08, 0.2, 0.25, ("fl", "fr", "rl", "rr")))
    np.testing.assert_allclose(np.abs(rollers), 0.5, atol=1e-12)
    # Ways of a forward, a sideways and a turning motion, w_i = x forward ∓ sideways ∓ turn.
    moves = np.array([[1, 1, 1, 1], [-1, 1, 1, -1], [-1, 1, -1, 1]], dtype=np.float64)
    np.testing.assert_allclose(rollers @ moves.T, 0.0, atol=1e-12)
    assert redundant(ROBOT.base).shape == (0, 2)
    assert redundant(bases.omni3((0.1,) * 3, 0.2, (0.5, 2.6, 4.7))).shape == (0, 3)
    assert redundant(skid(linear=True).base).shape == (0, 4)
    assert redundancy_table(rolled_by(ROBOT, np.ones((3, 2))), ROBOT, (), 3, PULL) is None


def test_contradiction_has_the_noise_of_its_wheels() -> None:
    robot = Robot("skid", skid().base, WheelNoise(rolling=0.02, standing=0.001))
    angles = np.array([[3.0, 2.0, 2.0, 2.0]])
    table = redundancy_table(rolled_by(robot, angles), robot, (0, 1), 3, PULL)
    assert table is not None
    residual = linearise(table, np.zeros((2, 7)), np.zeros(2)).residual
    # 0.1 m apart; variance of both wheels 0.02²·(0.3 + 0.2) + 2·0.001²·0.1.
    sigma = np.sqrt(0.02**2 * 0.5 + 2e-6 * 0.1)
    assert np.linalg.norm(residual) == pytest.approx(0.1 / sigma, rel=1e-9)
    # Slips of 1/3 of the front left wheel put it right; each wheel has its side's radius.
    states = np.zeros((2, 7))
    states[1, 3] = 1.0 / 3.0
    np.testing.assert_allclose(linearise(table, states, np.zeros(2)).residual, 0.0, atol=1e-9)
    assert table.measurements[0, -4:].tolist() == [0.0, 1.0, 0.0, 1.0]


def test_side_is_that_of_the_force_on_the_wheels() -> None:
    model = SlipModel(clear=0.5, resistance=0.2)
    # Speeding up by 1 m/s² forwards, then backwards, braking by the same, and steady.
    speed = np.array([0.1, 0.2, 0.3, 0.4, -0.4, -0.3, -0.2, -0.1])
    angles = np.stack([speed * 0.1 / RADIUS] * 2, axis=1)
    side = likely_side(ROBOT.base, rolled_by(ROBOT, angles, angles), model)
    np.testing.assert_allclose(side[:3], np.tanh(2.4**3), atol=1e-12)
    np.testing.assert_allclose(side[5:], -np.tanh(1.6**3), atol=1e-12)
    # Steady, and one wheel that begins to slip: the motors push against the resistance only.
    steady = np.ones((8, 2))
    steady[4:, 0] = 1.3
    side = likely_side(ROBOT.base, rolled_by(ROBOT, steady, steady), model)
    np.testing.assert_allclose(side, np.tanh(0.4**3), atol=1e-12)
    assert not likely_side(ROBOT.base, rolled_by(ROBOT, 0 * steady, steady), model).any()
    assert likely_side(ROBOT.base, rolled_by(ROBOT, steady[:1]), model).tolist() == [0.0]


@pytest.mark.parametrize("wrong", [{"usual": 0.0}, {"lasts": -1.0}, {"unlikely": 0.5}])
def test_a_slip_model_must_make_sense(wrong: dict[str, float]) -> None:
    with pytest.raises(FglocError, match=f"slip model: {next(iter(wrong))} must be"):
        SlipModel(**wrong)  # type: ignore[arg-type]
