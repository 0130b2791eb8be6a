"""Bases by the name of their kind, for files that describe a robot in a few keys."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from fgloc.core import bases
from fgloc.core.kinematics import WheeledBase
from fgloc.errors import FglocError

BASES: dict[str, Callable[..., WheeledBase]] = {
    "differential": bases.differential,
    "skid-steer": bases.skid_steer,
    "mecanum": bases.mecanum,
    "omni-3": bases.omni3,
    "tricycle": bases.tricycle,
    "4wis4wid": bases.four_wheel_steer,
    "odometry": bases.body_odometry,
}
"""Constructors that a file may name by the `kind` of what they make."""


def make_base(description: Mapping[str, Any], what: str) -> WheeledBase:
    """Return the base that `description` says: its `kind` and the arguments of the constructor.

    A key `name` is left to the caller. Raises FglocError, in which the description is called
    `what`, for an unknown kind, a missing or unknown argument or one of a wrong type.
    """
    arguments = {key: value for key, value in description.items() if key not in ("kind", "name")}
    kind = description.get("kind")
    if not isinstance(kind, str) or kind not in BASES:
        raise FglocError(f"{what}.kind is {kind!r}, known are {', '.join(BASES)}")
    signature = inspect.signature(BASES[kind])
    needed = [p.name for p in signature.parameters.values() if p.default is p.empty]
    missing = [name for name in needed if name not in arguments]
    if missing:
        raise FglocError(f"{what}: {kind} needs {', '.join(needed)}; {missing[0]} is missing")
    try:
        signature.bind(**arguments)
        return BASES[kind](**arguments)
    except (TypeError, ValueError, KeyError, FglocError) as error:
        raise FglocError(f"{what}: {error}") from None
