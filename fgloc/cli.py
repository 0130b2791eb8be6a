"""The command line: running one command, and how errors leave. Work is done in `fgloc.commands`.

Nothing here imports numpy: `fgloc --help` and a mistyped option answer at once.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import signal
import sys
import threading
import traceback
from collections.abc import Sequence
from types import FrameType

from fgloc.errors import FglocError
from fgloc.usage import build_parser

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells report it."""
BROKEN_PIPE = 141
"""Exit status when the reader of a pipe went away, as shells report it."""
TERMINATED = 143
"""Exit status after SIGTERM, as shells report it."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status: 0, 1 known error, 2 wrong usage, 130 Ctrl-C.

    `argv` are the arguments without the program's name, those of the process when None. Wrong
    usage and --help leave by SystemExit, as argparse does.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # A terminal that does not know σ shows a question mark; no reason to fail.
            stream.reconfigure(errors="replace")
    args = build_parser().parse_args(argv)
    if threading.current_thread() is threading.main_thread():
        # The default action ends the process on the spot and leaves temporary files behind.
        signal.signal(signal.SIGTERM, _terminate)
    try:
        handler = importlib.import_module(f"fgloc.commands.{args.command}")
        status: int = handler.run(args)
        sys.stdout.flush()
    except KeyboardInterrupt:
        _say("fgloc: interrupted")
        return INTERRUPTED
    except BrokenPipeError:
        # `fgloc … | head`: the rest is not wanted. The interpreter flushes once more at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except Exception as error:
        if args.debug:
            traceback.print_exc()
        _say(f"fgloc: error: {_message(error, debug=args.debug)}")
        return 1
    return status


def _message(error: Exception, *, debug: bool) -> str:
    """Return one line about an error: what is wrong, and what to do."""
    if isinstance(error, FglocError):
        text = str(error)
    elif isinstance(error, OSError) and error.filename is not None and error.strerror:
        text = f"{os.fsdecode(error.filename)}: {error.strerror}"
    elif isinstance(error, ImportError) and not str(error.name).startswith("fgloc"):
        text = f"a library cannot be imported: {error}; `fgloc doctor` shows what is missing"
    else:
        text = f"this is a defect of fgloc: {type(error).__name__}: {error}"
        if not debug:
            text += "; run again with --debug to see where"
    return " ".join(text.split())


def _say(line: str) -> None:
    """Print a line on stderr, and do not mind if nobody reads it."""
    with contextlib.suppress(BrokenPipeError):
        print(line, file=sys.stderr)


def _terminate(number: int, frame: FrameType | None) -> None:
    """Leave through the blocks that clean up."""
    raise SystemExit(TERMINATED)


if __name__ == "__main__":
    sys.exit(main())
