"""The one exception that a user sees as a single line."""

from __future__ import annotations

from pathlib import Path


class FglocError(Exception):
    """A known error: bad input, a missing file, a wrong name.

    The command prints it as one line, `fgloc: error: file:line: what is wrong and what to do`,
    and exits with 1. Everything that is not an `FglocError` is a defect of the program.
    """

    def __init__(
        self, message: str, *, file: str | Path | None = None, line: int | None = None
    ) -> None:
        where = ""
        if file is not None:
            where = f"{file}:{line}: " if line is not None else f"{file}: "
        super().__init__(where + message)
        self.file = file
        self.line = line
