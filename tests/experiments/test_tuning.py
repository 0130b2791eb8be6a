"""The tuning procedure on a problem with a known answer, and on Model 3."""

from __future__ import annotations

import math
import pickle
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from fgloc.core.bases import differential
from fgloc.core.drive import Drive, Reference
from fgloc.core.measurements import CameraPoses, PositionFixes, WheelIncrements, Yaw, YawRate
from fgloc.core.robot import Robot
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.simulator import load_sim
from fgloc.errors import FglocError
from fgloc.estimator import Estimator, Result
from fgloc.experiments.methods import create
from fgloc.experiments.tunables import (
    MODEL3,
    POSE_EKF,
    RL_EKF,
    TUNABLE,
    build_model3,
    tunable,
    with_noise,
)
from fgloc.experiments.tuning import (
    Tunable,
    ate,
    e_max,
    end_position,
    mean_score,
    tune,
)
from fgloc.experiments.tuning_search import Bounds, Search, Values

BEST = {"a": 3e-5, "b": 20.0, "c": 0.04}
RANGES = {"a": Bounds(1e-8, 1e-2, 1e-3), "b": Bounds(0.1, 100.0, 1.0), "c": Bounds(1e-3, 1, 1)}
DEFAULTS = {name: b.default for name, b in RANGES.items()}


def still(name: str = "still") -> Drive:
    """Return a drive of 2 s in which nothing moves."""
    stamps = np.arange(21, dtype=np.int64) * 100_000_000
    wheels = WheelIncrements("wheels", stamps, np.zeros((20, 2)), ("left", "right"))
    truth = Reference(Trajectory(stamps, np.zeros((21, 3))))
    return Drive(name, Robot("test", differential(0.1, 0.1, 0.5)), wheels, (), truth)


@dataclass
class Bowl:
    """A method that is wrong by 0.1 m and more, the further its values lie from the best ones."""

    calls: list[Values] = field(default_factory=list)
    fails_above: float = math.inf

    def build(self, values: Values) -> Estimator:
        return _Wrong(self, values)

    def tunable(self, **ranges: Bounds) -> Tunable:
        return Tunable("bowl", ranges or RANGES, self.build)


@dataclass
class _Wrong:
    bowl: Bowl
    values: Values
    method: str = "bowl"

    def estimate(self, drive: Drive) -> Result:
        self.bowl.calls.append(self.values)
        if self.values.get("b", 0.0) > self.bowl.fails_above:
            raise FglocError("b is too large")
        decades = [math.log10(v / BEST[n]) for n, v in self.values.items()]
        # A narrow valley: the sum of all matters ten times as much as each.
        off = 0.1 + sum(d * d for d in decades) + 10.0 * sum(decades) ** 2
        poses = np.zeros((21, 3))
        poses[:, 0] = off * (2.0 if drive.name == "twice" else 1.0)
        return Result("bowl", drive.name, Trajectory(drive.wheels.stamps_ns, poses), ())


def test_finds_the_best_values_within_the_budget() -> None:
    bowl = Bowl()
    found = tune(bowl.tunable(), [still(), still("twice")], 120, seed=3)
    # The defaults are decades away.
    assert found.default_score == pytest.approx(mean_score(bowl.build(DEFAULTS), [still()]) * 1.5)
    assert found.default_score > 10.0
    assert found.score < 1.5 * 0.1 * 1.05
    for name, value in found.values.items():
        assert abs(math.log10(value / BEST[name])) < 0.1
    assert found.at_limit == ()
    assert found.evaluations == len(found.history) == 120
    assert found.best_score == min(t.score for t in found.history)
    assert found.score == pytest.approx(found.best_score, rel=0.01)
    assert all(r.low <= t.values[n] <= r.high for t in found.history for n, r in RANGES.items())


def test_every_method_gets_the_same_number_of_estimates() -> None:
    for ranges in (RANGES, {"a": RANGES["a"]}):
        bowl = Bowl()
        tune(bowl.tunable(**ranges), [still(), still("twice")], 64)
        assert len(bowl.calls) == 2 * 64


def test_the_same_seed_gives_the_same_search() -> None:
    one, again, other = (tune(Bowl().tunable(), [still()], 60, seed) for seed in (1, 1, 2))
    assert one == again
    assert one.history[1] != other.history[1]
    # The defaults come first, whatever the seed.
    assert one.history[0] == other.history[0]


def test_never_worse_than_the_defaults() -> None:
    # At the best values already: nothing else is returned.
    ranges = {n: replace(r, default=BEST[n]) for n, r in RANGES.items()}
    found = tune(Bowl().tunable(**ranges), [still()], 40)
    assert found.values == BEST
    assert found.score == found.default_score == pytest.approx(0.1)


def test_a_best_value_outside_the_range_is_said_to_be_at_its_limit() -> None:
    ranges = {"a": RANGES["a"], "b": Bounds(0.1, 2.0, 1.0)}
    found = tune(Bowl().tunable(**ranges), [still()], 80)
    assert found.at_limit == ("b",)


def test_points_that_fail_are_avoided() -> None:
    bowl = Bowl(fails_above=5.0)
    found = tune(bowl.tunable(), [still()], 120)
    assert any(math.isinf(t.score) for t in found.history)
    assert found.values["b"] <= 5.0
    assert math.isfinite(found.score)


def test_the_search_goes_on_where_the_defaults_fail() -> None:
    ranges = RANGES | {"b": replace(RANGES["b"], default=50.0)}
    found = tune(Bowl(fails_above=30.0).tunable(**ranges), [still()], 100)
    assert math.isinf(found.default_score)
    assert found.score < 1.0


def test_objectives_are_those_of_a_comparison() -> None:
    # Off by 0.1 m along x everywhere.
    best = Bowl().build(BEST)
    assert [mean_score(best, [still()], o) for o in (ate, end_position, e_max)] == pytest.approx(
        [0.1, 0.1, 0.1]
    )
    assert mean_score(best, [still(), still("twice")]) == pytest.approx(0.15)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"drives": []}, "no drive to tune on"),
        ({"drives": [replace(still(), truth=None)]}, "still has no recorded truth"),
        ({"budget": 9}, "too small"),
        ({"tunable": Tunable("none", {}, Bowl().build)}, "no parameter"),
        ({"tunable": Bowl(fails_above=0.0).tunable()}, "bowl .* fails whatever .*: b is too large"),
    ],
)
def test_what_cannot_be_tuned_is_said(change: dict[str, object], message: str) -> None:
    arguments = {"tunable": Bowl().tunable(), "drives": [still()], "budget": 20} | change
    with pytest.raises(FglocError, match=message):
        tune(**arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize("bounds", [(0.0, 1.0, 0.5), (1.0, 2.0, 3.0), (1.0, 1.0, 1.0)])
def test_impossible_ranges_are_refused(bounds: tuple[float, float, float]) -> None:
    with pytest.raises(FglocError, match="a range needs"):
        Bounds(*bounds)


def test_of_points_that_cannot_be_told_apart_the_nearest_to_the_defaults() -> None:
    # Four drives and one parameter at a part u of its range, with a mean score of 1 - 0.1 u. Beside
    # the best, u = 1, it is worse by 0.1 (1 - u) on average and by ±s·sqrt(3) (1 - u) from drive to
    # drive, which is a standard error of s (1 - u): told from the best where s < 0.1.
    signs = np.array([1.0, -1.0, 1.0, -1.0])
    bounds = Bounds(1.0, 100.0, 1.0)
    for s, wanted in ((0.2, 0.0), (0.02, 1.0)):

        def score(values: Values, s: float = s) -> tuple[float, ...]:
            u = bounds.part(values["v"])
            return tuple(1.0 - 0.1 * u + s * math.sqrt(3.0) * signs * u)

        search = Search({"v": bounds}, 40, score)
        search.run(0)
        assert bounds.part(search.best.values["v"]) == pytest.approx(1.0)
        assert bounds.part(search.chosen().values["v"]) == pytest.approx(wanted)


def slipping(seed: int) -> Drive:
    return load_sim(f"random?seed={seed}&duration=40&slip=on")


def test_model3_gets_better_on_the_training_seeds_and_others() -> None:
    train, others = [slipping(s) for s in range(6)], [slipping(s) for s in range(50, 60)]
    model3 = tunable("model3", train)
    found = tune(model3, train, 40)
    assert set(found.values) == {"heading_variance", "track_variance", "yaw_variance"}
    assert found.default_score == mean_score(build_model3({}), train)
    assert found.score < 0.97 * found.default_score
    assert mean_score(model3.build(found.values), others) < mean_score(build_model3({}), others)
    # All of it goes to another process and back.
    assert pickle.loads(pickle.dumps(found)) == found
    sent: Tunable = pickle.loads(pickle.dumps(model3))
    assert mean_score(sent.build(found.values), train) == found.score


def test_a_method_s_parameters_are_those_of_the_sensors_at_hand() -> None:
    plain = [load_sim("square?duration=10")]
    rich = [*plain, load_sim("square?duration=10&camera=on&gyro=on&fix_every=2")]
    assert list(tunable("model3", rich).parameters) == list(MODEL3)
    few = tunable("pose-ekf", plain)
    assert list(few.parameters) == ["process_noise", "calibration", "horizon_s", "yaw", "yaw_drift"]
    assert set(tunable("pose-ekf", rich).parameters) == set(POSE_EKF)
    assert set(tunable("rl-ekf", rich).parameters) == set(RL_EKF)
    assert "gyro" not in tunable("rl-ekf", plain).parameters
    with pytest.raises(FglocError, match="model1 cannot be tuned; choose from model3, pose-ekf"):
        tunable("model1", plain)


@pytest.mark.parametrize("method", list(TUNABLE))
def test_defaults_of_the_ranges_are_the_method_s_own(method: str) -> None:
    drive = load_sim("square?duration=10&camera=on&gyro=on&fix_every=2")
    what = tunable(method, [drive])
    usual = create(method).estimate(drive).trajectory.poses
    np.testing.assert_allclose(
        what.build(what.defaults).estimate(drive).trajectory.poses, usual, rtol=0, atol=1e-12
    )
    # Every parameter does something, by itself, whatever the others are.
    for name, bounds in what.parameters.items():
        changed = what.defaults | {name: bounds.high}
        poses = what.build(changed).estimate(drive).trajectory.poses
        assert not np.array_equal(poses, usual), name


def test_stated_noise_is_scaled_by_kind() -> None:
    drive = load_sim("square?duration=10&camera=on&gyro=on&fix_every=2")
    assert with_noise(drive, {}).robot == drive.robot
    noisy = with_noise(drive, {"wheels": 2.0, "yaw": 3.0, "camera_heading": 4.0, "fix": 5.0})
    assert noisy.robot.noise.turning == 2.0 * drive.robot.noise.turning
    ((yaw, camera, fix), (yaw0, camera0, fix0)) = (
        (d.each(Yaw)[0], d.each(CameraPoses)[0], d.each(PositionFixes)[0]) for d in (noisy, drive)
    )
    assert yaw.sigma == 3.0 * yaw0.sigma
    assert camera.heading_sigma == 4.0 * camera0.heading_sigma
    assert camera.position_sigma == camera0.position_sigma
    np.testing.assert_array_equal(fix.sigma, 5.0 * fix0.sigma)
    assert noisy.each(YawRate)[0] == drive.each(YawRate)[0]
