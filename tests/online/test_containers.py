"""Growing arrays and live tables against plain lists, and against hand-worked cases."""

from __future__ import annotations

import numpy as np

from fgloc.factors.tables import Kind
from fgloc.online.growing import GrowingArray
from fgloc.online.live_table import LiveTable


def test_a_growing_array_is_a_list() -> None:
    rng = np.random.default_rng(3)
    array, rows = GrowingArray((2,), capacity=2), list[tuple[float, float]]()
    for step in range(3000):
        row = (float(step), float(rng.normal()))
        what = rng.random()
        if what < 0.6:
            array.append(row)
            rows.append(row)
        elif what < 0.8:
            at = int(rng.integers(len(rows) + 1))
            array.insert(at, row)
            rows.insert(at, row)
        elif what < 0.98:
            count = int(rng.integers(min(len(rows), 3) + 1))
            array.drop(count)
            del rows[:count]
        else:
            rows = rows[::3]
            array.replace(array.view[::3])
        assert len(array) == len(rows)
        np.testing.assert_array_equal(array.view, np.array(rows).reshape(-1, 2))


def test_a_growing_array_keeps_the_room_it_needs() -> None:
    array = GrowingArray((), capacity=4)
    for k in range(10_000):
        array.append(k)
        if len(array) > 10:
            array.drop(1)
    assert array._rows.shape[0] <= 32
    np.testing.assert_array_equal(array.view, np.arange(9990, 10_000))


def table() -> LiveTable:
    """Return rows at keyframes 0, 2, 4 and then, late, 1 and 2; measurement = order of arrival."""
    live = LiveTable(Kind.POSITION_FIX, "fixes", (4, 2), slice(0, 0))
    for order, first in enumerate((0, 2, 4, 1, 2)):
        live.add(first, np.full(4, float(order)), np.eye(2), weight=0.1 * order)
    return live


def order(live: LiveTable) -> list[int]:
    """Return the rows' order of arrival as they lie in the table."""
    return [int(v) for v in live.measurements.view[:, 0]]


def test_late_rows_go_behind_those_of_the_same_keyframe() -> None:
    live = table()
    assert live.first.view.tolist() == [0, 1, 2, 2, 4]
    assert order(live) == [0, 3, 1, 4, 2]
    assert [live.has(k) for k in range(-1, 6)] == [False, True, True, True, False, True, False]
    assert live.rows(1, 4) == slice(1, 4)
    assert live.rows(3, 4) == slice(4, 4)
    assert live.view(live.rows(1, 5), 1).first.tolist() == [0, 1, 1, 3]


def test_rows_of_intervals_need_both_ends() -> None:
    live = LiveTable(Kind.YAW_RATE, "gyro", (2, 1), slice(0, 0))
    for first in range(5):
        live.add(first, np.zeros(2), np.eye(1))
    assert live.rows(1, 4) == slice(1, 3)
    assert live.rows(4, 5) == slice(4, 4)


def test_the_newest_rows_can_be_taken_back_wherever_they_lie() -> None:
    live = table()
    assert live.take_back(3) == 2
    assert order(live) == [0, 1, 2]
    assert live.added == 5
    live.add(3, np.full(4, 5.0), np.eye(2))
    assert live.take_back(5) == 1
    assert live.take_back() == 3
    assert order(live) == []


def test_dropped_rows_tell_their_weights() -> None:
    live = table()
    np.testing.assert_allclose(live.drop(2), [0.0, 0.3])
    assert order(live) == [1, 4, 2]
    assert live.drop(2).size == 0
    assert live.take_back(3) == 1
    assert order(live) == [1, 2]
