"""YAML as plain values that know the line they came from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fgloc.errors import FglocError

MOST_NODES = 200_000
"""A file with more values than this is no configuration; aliases can make them of a few lines."""
_TRUE, _FALSE = {"true", "yes", "on"}, {"false", "no", "off"}
_ENDLESS = {".inf": math.inf, "+.inf": math.inf, "-.inf": -math.inf, ".nan": math.nan}


@dataclass(frozen=True)
class Node:
    """One value of a YAML file."""

    value: Any
    """A dict of Nodes by key, a list of Nodes, or a bool, int, float, str or None."""
    line: int
    """Line where it begins, from 1; of a mapping's value: the line of its key."""

    def plain(self) -> Any:
        """Return the value without lines: dicts, lists and scalars."""
        if isinstance(self.value, dict):
            return {key: node.plain() for key, node in self.value.items()}
        if isinstance(self.value, list):
            return [node.plain() for node in self.value]
        return self.value


def read_yaml(path: Path) -> Node:
    """Return the content of a YAML file; no tag makes anything but plain values.

    `yes`, `no`, `on` and `off` are booleans and `1e-9` is a number, as the parameter readers of
    ROS have it. Raises FglocError naming file and line for a missing file, text that is not UTF-8,
    bad YAML and a key that comes twice.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise FglocError("no such file; --ekf wants a YAML file", file=path) from None
    except OSError as error:
        raise FglocError(f"cannot be read: {error.strerror}", file=path) from error
    except UnicodeDecodeError as error:
        raise FglocError("is not UTF-8 text; --ekf wants a YAML file", file=path) from error
    try:
        root = YAML(typ="safe", pure=True).compose(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        reason = (error.problem or error.context or "not understood").splitlines()[0]
        line = None if mark is None else mark.line + 1
        raise FglocError(f"is not YAML: {reason}", file=path, line=line) from error
    except (YAMLError, ValueError, RecursionError) as error:
        reason = str(error).splitlines()[0] if str(error) else "nested too deep"
        raise FglocError(f"is not YAML: {reason}", file=path) from error
    if root is None:
        return Node(None, 1)
    left = [MOST_NODES]
    try:
        return _node(root, root.start_mark.line + 1, path, left)
    except RecursionError as error:
        raise FglocError("is nested too deep; is it a configuration?", file=path) from error


def _node(node: Any, line: int, path: Path, left: list[int]) -> Node:
    """Return a composed node as values; `left` counts down how many more there may be."""
    left[0] -= 1
    if left[0] < 0:
        raise FglocError("holds too many values; is it a configuration?", file=path)
    if node.id == "mapping":
        found: dict[str, Node] = {}
        for key, value in node.value:
            at = key.start_mark.line + 1
            name = str(key.value)
            if name in found:
                raise FglocError(f"{name} is given twice; leave one", file=path, line=at)
            found[name] = _node(value, at, path, left)
        return Node(found, line)
    if node.id == "sequence":
        return Node([_node(v, v.start_mark.line + 1, path, left) for v in node.value], line)
    # Quoted text stays text.
    return Node(_scalar(node.value) if node.style is None else node.value, line)


def _scalar(text: str) -> Any:
    """Return what an unquoted word means."""
    low = text.strip().lower()
    if low in ("", "~", "null"):
        return None
    if low in _TRUE or low in _FALSE:
        return low in _TRUE
    if low in _ENDLESS:
        return _ENDLESS[low]
    for kind in (int, float):
        try:
            # Python also takes "nan", "infinity" and 1_000; YAML does not.
            return kind(text) if text[-1:].isdigit() or text.endswith(".") else text
        except ValueError:
            continue
    return text
