"""The folder of one run: it appears whole, with a time in its name and a link to the latest."""

from __future__ import annotations

import os
import secrets
import shutil
from datetime import datetime
from pathlib import Path
from types import TracebackType

from fgloc.errors import FglocError

LATEST = "latest"
"""Name of the link, beside the run folders, to the run that was finished last."""


class RunDir:
    """A run folder `<out>/<YYYYmmdd-HHMMSS>` that is filled under a hidden name and then renamed.

    Use it as a context manager: leaving the block commits, an exception (or Ctrl-C) removes
    everything written so far.

        with RunDir.create(Path("runs/demo")) as run:
            write_text(run.file("report.txt"), text)
        print(run.path)
    """

    def __init__(self, out: Path, working: Path, stamp: str) -> None:
        self._out = out
        self._working = working
        self._stamp = stamp
        self._final: Path | None = None

    @classmethod
    def create(cls, out: str | Path, *, now: datetime | None = None) -> RunDir:
        """Return a run below `out`, which is created; `now` (local time) names the folder.

        Raises FglocError if `out` cannot be written or something else there is called "latest".
        """
        folder = Path(out)
        stamp = (now or datetime.now()).strftime("%Y%m%d-%H%M%S")
        # On the same file system as the final name, else the rename would not be atomic.
        working = folder / f".{stamp}.{secrets.token_hex(4)}.tmp"
        link = folder / LATEST
        if link.exists() and not link.is_symlink():
            raise FglocError(
                "is not a link to a run; move it away or choose another --out", file=link
            )
        try:
            working.mkdir(parents=True)
        except OSError as error:
            raise _failed(folder, error) from error
        return cls(folder, working, stamp)

    @property
    def path(self) -> Path:
        """Return the folder as it is now: hidden before `commit`, final after it."""
        return self._final or self._working

    def file(self, name: str) -> Path:
        """Return the path of a file in the run, "figures/errors.png" say; makes its folder."""
        path = self.path / name
        if not path.resolve().is_relative_to(self.path.resolve()):
            raise ValueError(f"{name!r} lies outside the run folder")
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def commit(self) -> Path:
        """Give the folder its final name, turn `latest` to it and return it; again: no effect.

        A run of the same second gets -2, -3, … behind its time. Raises FglocError when the file
        system refuses.
        """
        if self._final is not None:
            return self._final
        try:
            final = self._rename()
            self._final = final
            # Replaced by renaming a new link over it: a reader never finds it missing.
            link = self._out / f".{LATEST}.{secrets.token_hex(4)}.tmp"
            link.symlink_to(final.name, target_is_directory=True)
            os.replace(link, self._out / LATEST)
        except OSError as error:
            raise _failed(self._out, error) from error
        return final

    def discard(self) -> None:
        """Remove what was written; a committed run stays."""
        if self._final is None:
            shutil.rmtree(self._working, ignore_errors=True)

    def __enter__(self) -> RunDir:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if kind is None:
                self.commit()
        finally:
            self.discard()

    def _rename(self) -> Path:
        """Move the working folder to the first free name of its second and return that."""
        number = 1
        while True:
            final = self._out / (self._stamp if number == 1 else f"{self._stamp}-{number}")
            number += 1
            if os.path.lexists(final):
                continue
            try:
                os.rename(self._working, final)
            except OSError:
                # Another run took the name in between; anything else is a real failure.
                if not os.path.lexists(final):
                    raise
            else:
                return final


def _failed(path: Path, error: OSError) -> FglocError:
    """Return the one-line error for a run folder that could not be written."""
    reason = error.strerror or str(error)
    return FglocError(f"cannot hold a run folder: {reason}; choose another --out", file=path)
