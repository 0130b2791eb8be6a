"""Numbers from text files: fast with numpy, and exact about file and line when something is wrong.

Policy of every reader: a line that cannot be understood is an error that names file and line; a
last line without its end is a recording that was cut off, so it is dropped and counted; values
that are not finite and stamps that repeat or go back are dropped and counted. Nothing is silent.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fgloc.core.measurements import Floats, Stamps
from fgloc.errors import FglocError

Mask = npt.NDArray[np.bool_]
Integers = npt.NDArray[np.int64]

TRUNCATED = "truncated line"
NOT_A_NUMBER = "not a number"
REPEATED = "repeated stamp"
BACKWARD = "time goes back"
OUT_OF_RANGE = "stamp out of range"
LATEST_S = 9e9
"""Times from here on do not fit into int64 nanoseconds [s]."""


@dataclass(frozen=True)
class Lines:
    """The complete lines of a text file."""

    file: Path
    """Where they come from."""
    text: list[str]
    """Lines without their ends; line k of the file is text[k - 1]."""
    rest: str = ""
    """What follows the last line end: a line that was cut off, or nothing."""


@dataclass(frozen=True)
class Rows:
    """Numbers of many lines that may differ in width."""

    flat: Floats
    """All numbers, line after line."""
    widths: Integers
    """(N,) numbers on each line."""
    lines: Integers
    """(N,) line number of each row in the file, counted from 1."""

    def columns(self, count: int, rows: Mask | None = None) -> Floats:
        """Return the (M, count) first numbers of the rows (those of the mask, all when None)."""
        starts = np.cumsum(self.widths) - self.widths
        if rows is not None:
            starts = starts[rows]
        chosen: Floats = self.flat[starts[:, None] + np.arange(count)]
        return chosen


def read_bytes(path: Path) -> bytes:
    """Return a file's content; raises FglocError if it is missing or cannot be read."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise FglocError("no such file; check the path", file=path) from None
    except IsADirectoryError:
        raise FglocError("this is a folder, a file is needed", file=path) from None
    except OSError as error:
        raise FglocError(f"cannot be read: {error.strerror}", file=path) from None


def read_lines(path: Path) -> Lines:
    """Return a UTF-8 (or ASCII) text file as lines, either line end; see `read_bytes` for errors.

    Raises FglocError for an empty or a binary file.
    """
    data = read_bytes(path)
    if not data.strip():
        raise FglocError("the file is empty; record or download it again", file=path)
    if b"\0" in data:
        raise FglocError("this is a binary file, a text file is needed", file=path)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise FglocError("this line is not UTF-8 text", file=path, line=line) from None
    lines = text.replace("\r\n", "\n").split("\n")
    return Lines(path, lines[:-1], lines[-1])


def numbered(lines: Lines, rejected: Counter[str], skip: int = 0) -> tuple[list[str], Integers]:
    """Return the lines that are not blank, after `skip` lines, and their numbers in the file.

    A line without an end at the end of the file was cut off: it is counted and left out.
    """
    count(rejected, TRUNCATED, int(bool(lines.rest.strip())))
    kept = [(k, line) for k, line in enumerate(lines.text, start=1) if k > skip and line.strip()]
    return [line for _, line in kept], np.array([k for k, _ in kept], dtype=np.int64)


def split_fields(
    lines: Sequence[str],
    numbers: Integers,
    file: Path,
    *,
    widths: Sequence[int],
    separator: str | None,
    rejected: Counter[str] | None,
) -> tuple[list[list[str]], Integers]:
    """Return the fields of every line and the line numbers; `separator` None means white space.

    A last line with too few fields was cut off: it is counted and left out (with `rejected` None
    it is an error like any other). Raises FglocError with the line for any other number of fields
    than the allowed `widths`.
    """
    fields = [line.split(separator) for line in lines]
    if (
        rejected is not None
        and fields
        and len(fields[-1]) < max(widths)
        and len(fields[-1]) not in widths
    ):
        count(rejected, TRUNCATED)
        fields, numbers = fields[:-1], numbers[:-1]
    wrong = [k for k, row in enumerate(fields) if len(row) not in widths]
    if wrong:
        expected = " or ".join(str(w) for w in widths)
        raise FglocError(
            f"{len(fields[wrong[0]])} fields where {expected} are expected; "
            "remove or repair the line",
            file=file,
            line=int(numbers[wrong[0]]),
        )
    return fields, numbers


def parse_rows(
    lines: Sequence[str],
    numbers: Integers,
    file: Path,
    *,
    widths: Sequence[int],
    separator: str | None = ",",
    rejected: Counter[str] | None,
) -> Rows:
    """Return the numbers of lines that each hold one of the allowed `widths` of numbers.

    `numbers` are the lines' numbers in the file. O(characters): one call to numpy's parser; only
    when that fails is each line parsed again to name the wrong one. Raises FglocError with the
    line for a wrong number of fields (see `split_fields`) or a field that is no number.
    """
    fields, numbers = split_fields(
        lines, numbers, file, widths=widths, separator=separator, rejected=rejected
    )
    found = np.array([len(row) for row in fields], dtype=np.int64)
    joint = " " if separator is None else separator
    flat = _numbers(joint.join(lines[: len(fields)]), joint)
    if flat is None or flat.size != found.sum():
        flat = _numbers_line_by_line(fields, file, numbers)
    return Rows(flat, found, numbers)


def _numbers(text: str, separator: str) -> Floats | None:
    """Return all numbers of a text, or None if it holds anything else."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, dtype=np.float64, sep=separator)
        except (DeprecationWarning, ValueError):
            return None


def _numbers_line_by_line(fields: list[list[str]], file: Path, numbers: Integers) -> Floats:
    """Parse slowly; raises FglocError naming the first line with a field that is no number."""
    values: list[float] = []
    for row, at in zip(fields, numbers, strict=True):
        for field in row:
            try:
                values.append(float(field))
            except ValueError:
                raise FglocError(
                    f"{field.strip()!r} is not a number; remove or repair the line",
                    file=file,
                    line=int(at),
                ) from None
    return np.array(values, dtype=np.float64)


def finite_rows(values: Floats, rejected: Counter[str], what: str = NOT_A_NUMBER) -> Mask:
    """Return the mask of rows without NaN or infinity, counting the others under `what`."""
    good: Mask = np.asarray(np.isfinite(values).all(axis=tuple(range(1, values.ndim))))
    count(rejected, what, int((~good).sum()))
    return good


def forward_stamps(stamps: Stamps, rejected: Counter[str], prefix: str = "") -> Mask:
    """Return the mask of stamps later than all before them, counting repeated and backward ones."""
    if stamps.size == 0:
        return np.zeros(0, dtype=np.bool_)
    latest = np.maximum.accumulate(stamps)
    keep = np.ones(stamps.size, dtype=np.bool_)
    keep[1:] = stamps[1:] > latest[:-1]
    back = int((stamps[1:] < latest[:-1]).sum())
    count(rejected, prefix + REPEATED, int((~keep).sum()) - back)
    count(rejected, prefix + BACKWARD, back)
    return keep


def steady_stamps(stamps: Stamps, rejected: Counter[str], prefix: str = "") -> Mask:
    """Return the mask of stamps not earlier than any before them, counting the backward ones."""
    keep: Mask = np.asarray(stamps >= np.maximum.accumulate(stamps))
    count(rejected, prefix + BACKWARD, int((~keep).sum()))
    return keep


def countable_seconds(seconds: Floats, rejected: Counter[str], prefix: str = "") -> Mask:
    """Return the mask of times [s] that fit into int64 nanoseconds, counting the others."""
    good: Mask = np.asarray(np.abs(seconds) < LATEST_S)
    count(rejected, prefix + OUT_OF_RANGE, int((~good).sum()))
    return good


def seconds_to_ns(seconds: Floats) -> Stamps:
    """Return times [s] as int64 nanoseconds, rounded (the whole seconds apart, to keep digits)."""
    whole = np.floor(seconds)
    rest = np.rint((seconds - whole) * 1e9)
    return whole.astype(np.int64) * 1_000_000_000 + rest.astype(np.int64)


def count(rejected: Counter[str], reason: str, number: int = 1) -> None:
    """Add to a count of rejected items, without leaving zero counts behind."""
    if number:
        rejected[reason] += number
