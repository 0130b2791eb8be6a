"""Parts of drives."""

from __future__ import annotations

import numpy as np
import pytest

from fgloc.datasets.cut import Cut, parse
from fgloc.datasets.registry import expand, load_drive
from fgloc.errors import FglocError


def test_seconds_and_percents() -> None:
    assert parse("begin=10&end=60") == Cut(10.0, 60.0)
    assert parse("end=33%") == Cut(0.0, 0.33, (False, True))


@pytest.mark.parametrize("query", ["from=3", "end=x", "begin=-1", "begin=5&end=5", "end=nan"])
def test_what_is_no_cut_is_an_error(query: str) -> None:
    with pytest.raises(FglocError, match="cut:"):
        parse(query)


def test_two_parts_make_the_whole() -> None:
    whole = load_drive("sim:demo")
    first = load_drive("cut:sim:demo?end=40")
    rest = load_drive("cut:sim:demo?begin=40")
    assert first.name == "cut:sim:demo?end=40"
    assert first.wheels.stamps_ns[-1] <= whole.wheels.stamps_ns[0] + 40_000_000_000
    np.testing.assert_allclose(
        first.wheels.angles.sum(axis=0) + rest.wheels.angles.sum(axis=0),
        whole.wheels.angles.sum(axis=0),
        rtol=0.02,
    )
    half = load_drive("cut:sim:demo?begin=50%")
    assert half.duration_s == pytest.approx(whole.duration_s / 2, abs=0.2)


def test_nothing_left_is_an_error() -> None:
    with pytest.raises(FglocError, match="fewer than two wheel packets"):
        load_drive("cut:sim:demo?begin=1e6")
    with pytest.raises(FglocError, match="lacks a drive"):
        load_drive("cut:?begin=1")


def test_a_cut_of_a_simulated_query_is_the_last_one() -> None:
    drive = load_drive("cut:sim:demo?seed=3?end=5")
    assert drive.duration_s <= 5.0
    assert expand(["cut:sim:demo?seed=3?end=5"]) == ["cut:sim:demo?seed=3?end=5"]
