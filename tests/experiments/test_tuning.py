"""The tuning procedure on a problem with a known answer, and on Model 3."""

from __future__ import annotations

import math
import pickle
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from fgloc.core.bases import differential
from fgloc.core.drive import Drive, Reference
from fgloc.core.measurements import WheelIncrements
from fgloc.core.robot import Robot
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.simulator import load_sim
from fgloc.errors import FglocError
from fgloc.estimator import Estimator, Result
from fgloc.experiments.tunables import MODEL3, TUNABLES, tunable
from fgloc.experiments.tuning import (
    Bounds,
    Tunable,
    Tuned,
    Values,
    ate,
    e_max,
    end_position,
    mean_score,
    tune,
)

BEST = {"a": 3e-5, "b": 20.0, "c": 0.04}
RANGES = {"a": Bounds(1e-8, 1e-2, 1e-3), "b": Bounds(0.1, 100.0, 1.0), "c": Bounds(1e-3, 1, 1)}


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
    found = tune(bowl.tunable(), [still(), still("twice")], 150, seed=3)
    # The defaults are decades away.
    assert found.default_score == pytest.approx(
        mean_score(bowl.build(RANGES_DEFAULT), [still()]) * 1.5
    )
    assert found.default_score > 10.0
    assert found.score < 1.5 * 0.1 * 1.05
    for name, value in found.values.items():
        assert abs(math.log10(value / BEST[name])) < 0.1
    assert found.at_limit == ()
    assert found.evaluations == len(found.history) == 150
    assert found.score == min(t.score for t in found.history)
    assert all(r.low <= t.values[n] <= r.high for t in found.history for n, r in RANGES.items())


RANGES_DEFAULT = {name: b.default for name, b in RANGES.items()}


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
        ({"tunable": Bowl(fails_above=0.0).tunable()}, "fails whatever .*: b is too large"),
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


def slipping(seed: int) -> Drive:
    return load_sim(f"random?seed={seed}&duration=40&slip=on")


def test_model3_gets_better_on_the_training_seeds_and_others() -> None:
    train, others = [slipping(s) for s in range(4)], [slipping(s) for s in range(50, 56)]
    found = tune(MODEL3, train, 40)
    assert set(found.values) == {"heading_variance", "track_variance", "yaw_variance"}
    assert found.default_score == mean_score(MODEL3.build(MODEL3.defaults), train)
    assert found.score < 0.97 * found.default_score
    usual = mean_score(MODEL3.build({}), others)
    assert mean_score(MODEL3.build(found.values), others) < usual
    # All of it goes to another process and back.
    assert pickle.loads(pickle.dumps(found)) == found
    sent: Tunable = pickle.loads(pickle.dumps(MODEL3))
    assert mean_score(sent.build(found.values), train) == found.score


def test_what_can_be_tuned() -> None:
    assert tunable("model3") is TUNABLES["model3"] is MODEL3
    # The ranges hold the defaults of the method itself.
    assert MODEL3.build(MODEL3.defaults) == MODEL3.build({})
    with pytest.raises(FglocError, match="model1 cannot be tuned; choose from model3"):
        tunable("model1")
    assert isinstance(tune(Bowl().tunable(), [still()], 10), Tuned)
