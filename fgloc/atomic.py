"""Files appear whole or not at all: write beside the target, then rename over it."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fgloc.errors import FglocError


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Give a temporary path in the folder of `path`; on success it replaces `path`.

    The temporary name keeps the suffix, since several libraries pick the format by it. The caller
    writes (and closes) the temporary file. When the block raises, or writes nothing, the temporary
    file is removed and `path` stays as it was. Missing parent folders are created. A symlink is
    followed, so that the link stays and what it points at is replaced. Raises FglocError naming
    `path` for an operating system error (no permission, disk full, a folder in the way).
    """
    target = Path(path)
    try:
        # resolve() before anything is created: replacing a link would silently detach it.
        final = target.resolve() if target.is_symlink() else target
        if final.is_dir():
            raise FglocError("is a folder; give the name of a file", file=target)
        final.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _failed(target, error) from error
    # Hidden, and unguessable so that two processes writing the same file do not share it.
    temporary = final.with_name(f".{final.stem[:64]}.{secrets.token_hex(4)}.tmp{final.suffix}")
    try:
        yield temporary
        os.replace(temporary, final)
    except OSError as error:
        # Errors about other files (a reader inside the block) are not about this one.
        if error.filename is None or Path(error.filename) == temporary:
            raise _failed(target, error) from error
        raise
    finally:
        temporary.unlink(missing_ok=True)


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write `data` to `path` atomically and flushed to disk; raises FglocError if it cannot."""
    with atomic_path(path) as temporary, open(temporary, "wb") as stream:
        stream.write(data)
        stream.flush()
        os.fsync(stream.fileno())


def write_text(path: str | Path, text: str) -> None:
    """Write `text` as UTF-8 with its line ends as they are; see `write_bytes`."""
    write_bytes(path, text.encode("utf-8"))


def _failed(path: Path, error: OSError) -> FglocError:
    """Return the one-line error for a file that could not be written."""
    reason = error.strerror or str(error)
    return FglocError(f"cannot be written: {reason}; choose another place or name", file=path)
