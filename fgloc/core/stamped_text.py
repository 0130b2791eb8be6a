"""Text tables with time stamps: exact nanoseconds in and out, errors that name file and line.

A stamp never passes through a float: 1.7e9 s with 9 decimals has more digits than a double holds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from decimal import ROUND_HALF_EVEN, Context, Decimal, DecimalException
from itertools import chain
from pathlib import Path

import numpy as np

from fgloc.core.measurements import Floats, Stamps
from fgloc.errors import FglocError

_NANO = Context(prec=60, rounding=ROUND_HALF_EVEN)
_LARGEST = 2**63 - 1


def read_lines(path: Path) -> list[str]:
    """Return the lines of a text file; raises FglocError if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    except FileNotFoundError:
        raise FglocError("no such file; check the path", file=path) from None
    except OSError as error:
        raise FglocError(f"cannot be read: {error.strerror}", file=path) from None


@dataclass(frozen=True)
class Table:
    """The data rows of a text file as tokens, with where they stood."""

    path: Path
    """The file, for error messages."""
    numbers: list[int]
    """Line number of each row, from 1."""
    rows: list[list[str]]
    """Tokens of each row."""

    def require(self, columns: Sequence[str]) -> None:
        """Raise FglocError naming the first row that has not one token for each of `columns`."""
        for number, row in zip(self.numbers, self.rows, strict=True):
            if len(row) != len(columns):
                raise FglocError(
                    f"{len(row)} columns where {len(columns)} belong: {' '.join(columns)}",
                    file=self.path,
                    line=number,
                )

    def floats(self, first: int, last: int) -> Floats:
        """Return columns [first, last) as (N, last - first) floats.

        Raises FglocError naming the line of a token that is not a finite number. O(N).
        """
        shape = (len(self.rows), last - first)
        tokens = chain.from_iterable(row[first:last] for row in self.rows)
        try:
            values = np.array(list(tokens), dtype=np.float64)
        except ValueError:
            raise self._blame(float, first, last, "is not a number") from None
        values = values.reshape(shape)
        if not bool(np.all(np.isfinite(values))):
            k, column = (int(i) for i in np.argwhere(~np.isfinite(values))[0])
            token = self.rows[k][first + column]
            raise FglocError(f"{token} is not finite", file=self.path, line=self.numbers[k])
        return values

    def integers(self, column: int) -> Stamps:
        """Return one column as int64; raises FglocError naming the line of a bad token."""
        try:
            return np.array([int(row[column]) for row in self.rows], dtype=np.int64)
        except (ValueError, OverflowError):
            what = "is not an integer of 64 bits"
            raise self._blame(_int64, column, column + 1, what) from None

    def stamps(self, column: int) -> Stamps:
        """Return one column of decimal seconds as int64 nanoseconds, exactly.

        Digits after the ninth are rounded to nearest. Raises FglocError naming the line of a bad
        stamp, or of one that does not come after the stamp before it.
        """
        try:
            stamps = np.array([parse_stamp(row[column]) for row in self.rows], dtype=np.int64)
        except ValueError:
            what = "is not a time in seconds"
            raise self._blame(parse_stamp, column, column + 1, what) from None
        self.check_increasing(stamps)
        return stamps

    def check_increasing(self, stamps: Stamps) -> None:
        """Raise FglocError naming the first line whose stamp does not come after the one before."""
        late = np.flatnonzero(stamps[1:] <= stamps[:-1])
        if late.size:
            k = int(late[0]) + 1
            raise FglocError(
                "the stamp does not come after the one before it; sort the file by time and drop "
                "repeated stamps",
                file=self.path,
                line=self.numbers[k],
            )

    def _blame(
        self, parse: Callable[[str], object], first: int, last: int, what: str
    ) -> FglocError:
        """Return the error for the first token of columns [first, last) that `parse` refuses."""
        for number, row in zip(self.numbers, self.rows, strict=True):
            for token in row[first:last]:
                try:
                    parse(token)
                except (ValueError, OverflowError):
                    return FglocError(f"{token!r} {what}", file=self.path, line=number)
        return FglocError(what, file=self.path)


def _int64(token: str) -> int:
    """Return the token as an integer of 64 bits or raise ValueError."""
    value = int(token)
    if abs(value) > _LARGEST:
        raise ValueError(token)
    return value


def read_table(path: Path, columns: Sequence[str]) -> tuple[Table, list[str]]:
    """Return the rows of a blank-separated text file and its comment lines (starting with `#`).

    Raises FglocError for a missing file, an empty one, or a row that does not fit `columns`.
    """
    lines = read_lines(path)
    split = [line.split() for line in lines]
    keep = [k for k, tokens in enumerate(split) if tokens and not tokens[0].startswith("#")]
    comments = [line for line in lines if line.lstrip().startswith("#")]
    if not keep:
        raise FglocError("holds no poses", file=path)
    table = Table(path, [k + 1 for k in keep], [split[k] for k in keep])
    table.require(columns)
    return table, comments


def parse_stamp(token: str) -> int:
    """Return decimal seconds ("12.5", "1.7e9") as nanoseconds, exactly; ValueError if it is not."""
    try:
        value = _NANO.scaleb(Decimal(token), 9)
    except DecimalException:
        raise ValueError(token) from None
    if not value.is_finite() or abs(value) > _LARGEST:
        raise ValueError(token)
    return int(value.to_integral_value(rounding=ROUND_HALF_EVEN))


def format_stamps(stamps_ns: Stamps) -> list[str]:
    """Return int64 nanoseconds as seconds with exactly 9 digits after the point."""
    seconds, nanoseconds = np.divmod(np.abs(stamps_ns), 1_000_000_000)
    signs = np.where(stamps_ns < 0, "-", "").tolist()
    parts = zip(signs, seconds.tolist(), nanoseconds.tolist(), strict=True)
    return [f"{sign}{s}.{ns:09d}" for sign, s, ns in parts]


def format_rows(template: str, columns: Iterable[Iterable[object]]) -> str:
    """Return the %-template filled once a row from columns of equal length.

    Columns must hold Python objects (`array.tolist()`): %r then writes the shortest text that
    reads back to the same double, at most 17 digits.
    """
    rows = list(zip(*columns, strict=True))
    return template * len(rows) % tuple(chain.from_iterable(rows))


def continuous(heading: Floats) -> Floats:
    """Return headings (N,) [rad] unwrapped: no step over half a turn, the first as it is.

    Whole turns are counted as integers, so that rounding does not add up over a long file.
    """
    turns = np.cumsum(np.rint(np.diff(heading) / (2.0 * np.pi)))
    return heading - 2.0 * np.pi * np.concatenate([np.zeros(min(1, heading.size)), turns])
