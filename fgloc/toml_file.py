"""Typed TOML files whose errors name file and line: what robot files and topic maps share."""

from __future__ import annotations

import math
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from fgloc.errors import FglocError

T = TypeVar("T", bound=msgspec.Struct)
SMALLEST = sys.float_info.min
"""Lowest value of what must be positive."""
_KEY = re.compile(r"\"[^\"]*\"|'[^']*'|[\w-]+")
"""One key of a dotted path in TOML, with its quotes."""


@dataclass(frozen=True)
class TomlFile:
    """A file that was read; makes errors that name the line of a key."""

    source: Path
    """Where it was read, for error messages."""
    text: str
    """What was read, for line numbers in error messages."""

    def error(self, message: str, *key: str) -> FglocError:
        """Return an error about `key` (a path of keys), with file and, where found, line."""
        return FglocError(message, file=self.source, line=_line_of(self.text, key))

    def parse(self, *known: str) -> dict[str, Any]:
        """Return the file's content, its top-level keys checked against those that are `known`.

        Raises FglocError for bad TOML or an unknown key.
        """
        try:
            raw: dict[str, Any] = msgspec.toml.decode(self.text)
        except msgspec.DecodeError as error:
            place = re.search(r"\s*\(at (?:line (\d+), column \d+|end of document)\)", str(error))
            line = int(place[1]) if place and place[1] else None
            reason = str(error)[: place.start()] if place else str(error)
            raise FglocError(f"is not TOML: {reason}", file=self.source, line=line) from error
        for name in raw:
            if name not in known:
                names = f"{', '.join(known[:-1])} and {known[-1]}"
                raise self.error(f"unknown key {name!r}; known are {names}", name)
        return raw

    def table(self, raw: object, kind: type[T], *key: str) -> T:
        """Return one table as `kind`; FglocError for an unknown key or a wrong type."""
        try:
            return msgspec.convert(raw, kind)
        except msgspec.ValidationError as error:
            message, _, place = str(error).partition(" - at `$.")
            reason = message.replace("`", "").replace("object", "a table").replace(" | null", "")
        unknown = re.search(r"unknown field (.*)", reason)
        if unknown is None:
            path = (*key, place.rstrip("`")) if place else key
            # An element of a list is part of the key that the file names.
            at = [part.partition("[")[0] for part in path]
            raise self.error(f"{'.'.join(path)}: {reason[0].lower()}{reason[1:]}", *at)
        name = unknown[1]
        if key[0] == "parameters" and isinstance(raw, dict) and isinstance(raw[name], dict):
            # TOML takes [parameters.wheel_radius.left] for a table "left" inside "wheel_radius".
            hint = f'quote a name that has a dot: [parameters."{key[1]}.{name}"]'
        else:
            hint = f"known are {', '.join(kind.__struct_fields__)}"
        raise self.error(f"unknown key {name!r} in {'.'.join(key)}; {hint}", *key, name)

    def check_number(self, value: float | None, lowest: float, *key: str) -> None:
        """Raise FglocError unless `value` is None or finite and at least `lowest`."""
        if value is not None and not (math.isfinite(value) and value >= lowest):
            want = {-math.inf: "a finite number", 0.0: "finite and not negative"}.get(lowest)
            want = want or "finite and positive"
            raise self.error(f"{'.'.join(key)} must be {want}, got {value!r}", *key)


def read_toml(path: Path, option: str, what: str) -> TomlFile:
    """Return a TOML file's text; `option` of the command line wants it, it is called `what`.

    Raises FglocError if it is missing or not UTF-8.
    """
    try:
        return TomlFile(path, path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FglocError(f"no such {what}; {option} wants a TOML file", file=path) from None
    except OSError as error:
        raise FglocError(f"cannot be read: {error.strerror}", file=path) from error
    except UnicodeDecodeError as error:
        raise FglocError(f"is not UTF-8 text; {option} wants a TOML file", file=path) from error


def quoted(text: str) -> str:
    """Return a TOML basic string."""
    escapes = {'"': '\\"', "\\": "\\\\", "\n": "\\n", "\r": "\\r", "\t": "\\t"}
    body = "".join(
        escapes.get(c) or (f"\\u{ord(c):04x}" if ord(c) < 0x20 or ord(c) == 0x7F else c)
        for c in text
    )
    return f'"{body}"'


def _line_of(text: str, key: tuple[str, ...]) -> int | None:
    """Return the line number that names the most of a path of keys; None if none is named.

    A search by words, since the parsed content knows no lines: a table's header names the
    beginning of the path, a line in that table the rest.
    """
    best: tuple[int, int | None] = (0, None)
    header: list[str] = []
    for number, line in enumerate(text.splitlines(), 1):
        body = line.partition("#")[0].strip()
        if body.startswith("["):
            header = _KEY.findall(body)
            names = header
        else:
            names = header + _KEY.findall(body.partition("=")[0])
        names = [n.strip("\"'") for n in names]
        common = 0
        while common < min(len(names), len(key)) and names[common] == key[common]:
            common += 1
        if common > best[0]:
            best = (common, number)
    return best[1]
