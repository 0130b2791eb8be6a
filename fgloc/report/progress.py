"""Progress on stderr: a bar on a terminal, plain lines in a pipe."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import Any, TextIO


class ProgressLines:
    """Shows how far a long piece of work is; a context manager.

    On a terminal one bar with the last thing done, which disappears at the end; elsewhere one
    line for each thing done.
    """

    def __init__(self, title: str, stream: TextIO | None = None) -> None:
        self._title = title
        self._stream = sys.stderr if stream is None else stream
        self._bar: Any = None
        self._task: Any = None

    def __enter__(self) -> ProgressLines:
        if self._stream.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

            self._bar = Progress(
                TextColumn("{task.fields[title]}"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.description}", markup=False),
                console=Console(file=self._stream),
                transient=True,
            )
            self._bar.start()
            self._task = self._bar.add_task("", title=self._title, total=None)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def step(self, done: int, total: int, text: str) -> None:
        """Say that `done` of `total` things are finished, the last one described by `text`."""
        if self._bar is not None:
            self._bar.update(self._task, completed=done, total=total, description=text)
        else:
            print(f"[{done}/{total}] {text}", file=self._stream, flush=True)
