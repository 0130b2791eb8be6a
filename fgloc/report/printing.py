"""Printing tables and sentences: with lines on a terminal, as plain columns in a pipe."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

Parts = Callable[[bool], "Iterable[RenderableType]"]
"""Yields what is printed, in order; True asks for the terminal's style."""


def print_parts(parts: Parts, console: Console | None = None) -> None:
    """Print everything on stdout (or `console`).

    On a terminal with rich's lines; in a pipe as plain columns without lines or cut numbers.
    """
    from rich.console import Console
    from rich.measure import Measurement

    console = Console() if console is None else console
    if not console.is_terminal:
        console.print(plain(parts), end="", markup=False, highlight=False, soft_wrap=True)
        return
    for part in parts(True):
        if isinstance(part, str):
            console.print(part, markup=False, highlight=False)
            continue
        wide = console.options.update(max_width=1000)
        width = Measurement.get(console, wide, part).maximum
        # Too narrow a terminal breaks lines, which is better than numbers that are cut short.
        target = console
        if width > console.width:
            target = Console(file=console.file, width=width, force_terminal=True)
        target.print(part, markup=False, highlight=False)


def plain(parts: Parts) -> str:
    """Return what a pipe gets: columns set apart by spaces, no lines, nothing cut, no colours."""
    from rich.console import Console

    buffer = io.StringIO()
    console = Console(file=buffer, width=1000, color_system=None, legacy_windows=False)
    for part in parts(False):
        console.print(part, markup=False, highlight=False, soft_wrap=isinstance(part, str))
    return "\n".join(line.rstrip() for line in buffer.getvalue().splitlines()) + "\n"
