"""Parsing: what is an error names its line, what is rejected is counted."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from fgloc.datasets import intervals, text
from fgloc.errors import FglocError


def parse(tmp_path: Path, content: str, *widths: int) -> tuple[text.Rows, Counter[str]]:
    file = tmp_path / "a.csv"
    file.write_text(content)
    rejected: Counter[str] = Counter()
    body, numbers = text.numbered(text.read_lines(file), rejected)
    rows = text.parse_rows(body, numbers, file, widths=widths, separator=",", rejected=rejected)
    return rows, rejected


def test_rows_of_two_widths_and_windows_line_ends(tmp_path: Path) -> None:
    rows, rejected = parse(tmp_path, "1,2\r\n\r\n3,4,-0\r\n", 2, 3)
    np.testing.assert_array_equal(rows.columns(2), [[1, 2], [3, 4]])
    np.testing.assert_array_equal(rows.columns(3, rows.widths == 3), [[3, 4, 0]])
    assert rows.lines.tolist() == [1, 3]
    assert not rejected


@pytest.mark.parametrize("tail", ["3,", "3,4", "3\n"])
def test_a_cut_off_last_line_is_counted(tmp_path: Path, tail: str) -> None:
    rows, rejected = parse(tmp_path, "1,2\n" + tail, 2)
    assert rows.columns(2).tolist() == [[1.0, 2.0]]
    assert rejected == {text.TRUNCATED: 1}


@pytest.mark.parametrize(
    ("content", "line", "what"),
    [
        ("1,2\n3,x\n5,6\n", 2, "'x' is not a number"),
        ("1,2\n\n3,\n5,6\n", 3, "'' is not a number"),
        ("1,2\n3,4,5\n5,6\n", 2, "3 fields where 2"),
        ("1,2\n3,4\n5,6,7\n", 3, "3 fields where 2"),
    ],
)
def test_a_wrong_line_is_named(tmp_path: Path, content: str, line: int, what: str) -> None:
    with pytest.raises(FglocError, match=what) as error:
        parse(tmp_path, content, 2)
    assert str(error.value).startswith(f"{tmp_path / 'a.csv'}:{line}: ")


@pytest.mark.parametrize("content", [b"", b" \n", b"1,2\0\n", b"1,2\n\xff\xfe\n"])
def test_files_that_hold_no_text(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "a.csv"
    file.write_bytes(content)
    with pytest.raises(FglocError, match=r"a\.csv"):
        text.read_lines(file)


def test_a_missing_file_and_a_folder(tmp_path: Path) -> None:
    with pytest.raises(FglocError, match="no such file"):
        text.read_lines(tmp_path / "none")
    with pytest.raises(FglocError, match="folder"):
        text.read_lines(tmp_path)


def test_stamps_that_repeat_or_go_back_are_counted() -> None:
    rejected: Counter[str] = Counter()
    keep = text.forward_stamps(np.array([1, 2, 2, 1, 3, 2, 4]), rejected)
    assert keep.tolist() == [True, True, False, False, True, False, True]
    assert rejected == {text.REPEATED: 1, text.BACKWARD: 2}


def test_unix_seconds_keep_their_microseconds() -> None:
    # 1750066761.3658922 as a double is 1750066761.36589217...: nearest to that in whole ns.
    assert text.seconds_to_ns(np.array([1750066761.3658922])).tolist() == [1750066761365892172]


def test_a_lost_increment_keeps_the_rate_of_its_interval() -> None:
    # 2 rad a second throughout; the second interval's value is lost, the stamp 3 repeats.
    stamps = np.array([0, 1, 2, 3, 3, 4]) * 1_000_000_000
    values = np.array([[9.0], [2.0], [np.nan], [2.0], [2.0], [2.0]])
    rejected: Counter[str] = Counter()
    kept, increments, stretch = intervals.usable_increments(stamps, values, rejected)
    assert (kept // 1_000_000_000).tolist() == [0, 1, 3, 4]
    assert increments[:, 0].tolist() == [2.0, 4.0, 2.0]
    assert stretch.tolist() == [1.0, 2.0, 1.0]
    assert rejected == {text.REPEATED: 1, f"wheels {text.NOT_A_NUMBER}": 1}
