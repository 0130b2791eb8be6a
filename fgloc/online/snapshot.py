"""Objects as arrays and plain JSON, and back: the generic half of a checkpoint.

What an object holds is found by looking, not by listing: a new attribute is saved without a line of
code. Nothing is pickled, and reading a snapshot runs no code but the package's own.
"""

from __future__ import annotations

import importlib
import math
from collections import deque
from collections.abc import Mapping
from enum import Enum
from types import MethodType
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

PLAIN = (type(None), bool, int, float, str)
"""Values that JSON holds exactly (NaN and infinity as Python writes them)."""
PACKAGE = "fgloc."
"""Objects of other packages are neither written nor made."""


class Writer:
    """Turns a value into a JSON node; arrays go into one long array a dtype.

    What is met again is written once (tuples excepted), so that what was shared
    is shared again. O(everything reachable).
    """

    def __init__(self, given: Mapping[str, Any]) -> None:
        """`given` are objects that the reader will have itself: they are written as their key."""
        self._given = {id(value): key for key, value in given.items()}
        self._keep: list[Any] = list(given.values())
        self._known: dict[int, int] = {}
        self._pieces: dict[str, list[npt.NDArray[Any]]] = {}
        self._sizes: dict[str, int] = {}

    def node(self, value: Any) -> Any:
        """Return the JSON node of a value; raises TypeError for a type that cannot be saved."""
        if type(value) in PLAIN:
            return value
        if id(value) in self._given:
            return ["given", self._given[id(value)]]
        if isinstance(value, Enum):
            return ["enum", _name(type(value)), value.value]
        if isinstance(value, np.generic):
            return ["scalar", value.dtype.str, self._store(np.array([value]))]
        if type(value) is bytes:
            return ["bytes", value.hex()]
        if isinstance(value, slice):
            return ["slice", [self.node(v) for v in (value.start, value.stop, value.step)]]
        if isinstance(value, MethodType):
            return ["method", self.node(value.__self__), value.__name__]
        if type(value) is tuple:
            return ["tuple", [self.node(v) for v in value]]
        if id(value) in self._known:
            return ["again", self._known[id(value)]]
        self._known[id(value)] = len(self._known)
        # Kept alive, or the next temporary object could have the same id.
        self._keep.append(value)
        return self._new(value)

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return all arrays met so far, joined by dtype."""
        return {f"array{dtype}": np.concatenate(p) for dtype, p in self._pieces.items()}

    def _new(self, value: Any) -> Any:
        """Return the node of something met for the first time."""
        if isinstance(value, np.ndarray):
            # The order of the axes in memory decides how products are summed up.
            order: Literal["C", "F"]
            order = "F" if value.flags.f_contiguous and not value.flags.c_contiguous else "C"
            start = self._store(value.ravel(order))
            return ["array", value.dtype.str, list(value.shape), order, start]
        if type(value) is list:
            for kind, dtype in ((float, np.float64), (int, np.int64)):
                # Thousands of readings: as arrays they take a tenth of the time.
                if value and all(type(v) is kind for v in value):
                    numbers = np.array(value, dtype)
                    return ["numbers", numbers.dtype.str, len(value), self._store(numbers)]
            if len(value) > 1 and _alike(value):
                # Readings, each looked at on its own: nothing shares or changes them.
                rows = np.array(value)
                return ["rows", rows.dtype.str, list(rows.shape), self._store(rows.ravel())]
            return ["list", [self.node(v) for v in value]]
        if type(value) is deque:
            return ["deque", value.maxlen, [self.node(v) for v in value]]
        if type(value) is dict:
            return ["dict", [[self.node(k), self.node(v)] for k, v in value.items()]]
        name = _name(type(value))
        state = value.__getstate__()
        if not name.startswith(PACKAGE) or not isinstance(state, dict):
            raise TypeError(f"{type(value)} cannot be saved in a checkpoint")
        return ["object", name, [[key, self.node(v)] for key, v in state.items()]]

    def _store(self, flat: npt.NDArray[Any]) -> int:
        """Put a flat array away; return where it begins among those of its dtype."""
        dtype = flat.dtype.str
        if flat.dtype.kind not in "biuf":
            raise TypeError(f"an array of {flat.dtype} cannot be saved in a checkpoint")
        start = self._sizes.get(dtype, 0)
        self._pieces.setdefault(dtype, []).append(flat)
        self._sizes[dtype] = start + flat.size
        return start


class Reader:
    """Turns nodes back into values; the order of nodes is that in which they were written."""

    def __init__(self, given: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        self._given = given
        self._arrays = arrays
        self._known: list[Any] = []

    def value(self, node: Any) -> Any:
        """Return the value of a node; raises LookupError, TypeError or ValueError for nonsense."""
        if type(node) in PLAIN:
            return node
        tag, *rest = node
        if tag in ("array", "numbers", "rows", "list", "deque", "dict", "object"):
            return self._new(tag, rest)
        if tag == "enum":
            return _class(rest[0])(rest[1])
        if tag == "scalar":
            return self._flat(rest[0], rest[1], 1)[0]
        if tag == "bytes":
            return bytes.fromhex(rest[0])
        if tag == "slice":
            return slice(*(self.value(v) for v in rest[0]))
        if tag == "method":
            return getattr(self.value(rest[0]), rest[1])
        if tag == "tuple":
            return tuple(self.value(v) for v in rest[0])
        if tag == "given":
            return self._given[rest[0]]
        if tag == "again":
            return self._known[rest[0]]
        raise ValueError(f"unknown node {tag!r}")

    def _new(self, tag: str, rest: list[Any]) -> Any:
        """Return a value that may be met again; it is known before its contents are."""
        made: Any
        if tag == "array":
            dtype, shape, order, start = rest
            flat = self._flat(dtype, start, math.prod(shape))
            made = flat.reshape(shape, order=order)
            self._known.append(made)
        elif tag == "numbers":
            made = self._flat(rest[0], rest[2], rest[1]).tolist()
            self._known.append(made)
        elif tag == "rows":
            dtype, shape, start = rest
            made = list(self._flat(dtype, start, math.prod(shape)).reshape(shape))
            self._known.append(made)
        elif tag == "list":
            made = []
            self._known.append(made)
            made.extend(self.value(v) for v in rest[0])
        elif tag == "deque":
            made = deque(maxlen=rest[0])
            self._known.append(made)
            made.extend(self.value(v) for v in rest[1])
        elif tag == "dict":
            made = {}
            self._known.append(made)
            for key, value in rest[0]:
                made[self.value(key)] = self.value(value)
        else:
            cls = _class(rest[0])
            made = cls.__new__(cls)
            self._known.append(made)
            state = {key: self.value(value) for key, value in rest[1]}
            if hasattr(cls, "__setstate__"):
                made.__setstate__(state)
            else:
                # Frozen dataclasses included.
                made.__dict__.update(state)
        return made

    def _flat(self, dtype: str, start: int, size: int) -> npt.NDArray[Any]:
        """Return a copy of a stored flat array."""
        if size == 0:
            return np.zeros(0, dtype)
        flat = self._arrays[f"array{dtype}"][start : start + size]
        if flat.size != size:
            raise ValueError("an array is cut off")
        return flat.copy()


def _alike(values: list[Any]) -> bool:
    """Return True for a list of arrays of one shape and dtype."""
    first = values[0]
    if type(first) is not np.ndarray:
        return False
    form = (first.shape, first.dtype)
    return all(type(v) is np.ndarray and (v.shape, v.dtype) == form for v in values)


def _name(cls: type) -> str:
    """Return where a class is found."""
    return f"{cls.__module__}:{cls.__qualname__}"


def _class(name: str) -> Any:
    """Return a class of this package by its name."""
    module, _, qualified = name.partition(":")
    if not module.startswith(PACKAGE):
        raise ValueError(f"{name} is no class of this package")
    found = getattr(importlib.import_module(module), qualified)
    if not isinstance(found, type):
        raise ValueError(f"{name} is no class")
    return found
