"""How this project compiles its inner loops: one decorator, one set of options."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile a function with numba at its first call and cache the result beside its file.

    Division by zero gives inf or nan as in numpy, not an exception: callers check what comes out,
    and the code is smaller, so that the first call does not wait as long.
    """
    return cast(F, numba.njit(cache=True, error_model="numpy")(function))
