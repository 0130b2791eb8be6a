"""Progress on stderr: a bar on a terminal, plain lines in a pipe."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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

    def say(self, text: str) -> None:
        """Print a line that stays, above the bar where there is one."""
        if self._bar is not None:
            self._bar.console.print(text, markup=False)
        else:
            print(text, file=self._stream, flush=True)


@contextmanager
def telling_of_compilation(say: Callable[[str], None]) -> Iterator[None]:
    """Say so, once, if the inner loops have to be compiled first: 20 s of silence look like a hang.

    Nothing is said where they are found in the cache, as `fgloc doctor` leaves them.
    """
    from numba.core.event import Event, Listener, install_listener

    class Once(Listener):
        said = False

        def on_start(self, event: Event) -> None:
            if not self.said:
                self.said = True
                say("compiling the inner loops, about 20 s; this happens once")

        def on_end(self, event: Event) -> None:
            pass

    with install_listener("numba:compile", Once()):
        yield
