"""Progress: what is said about compiling."""

from __future__ import annotations

import numba
import numpy as np

from fgloc.report.progress import telling_of_compilation


def test_compiling_is_told_once() -> None:
    said: list[str] = []
    with telling_of_compilation(said.append):
        for _ in range(2):
            numba.njit(lambda x: x + 1)(1)
    assert len(said) == 1
    assert "once" in said[0]


def test_nothing_is_told_of_a_loop_that_is_compiled_already() -> None:
    double = numba.njit(lambda x: 2 * x)
    double(np.float64(1.0))
    said: list[str] = []
    with telling_of_compilation(said.append):
        double(np.float64(2.0))
    assert said == []
