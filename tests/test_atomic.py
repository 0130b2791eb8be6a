"""Files appear whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from fgloc.atomic import atomic_path, write_bytes, write_text
from fgloc.errors import FglocError


def test_writes_bytes_and_text_as_they_are(tmp_path: Path) -> None:
    write_bytes(tmp_path / "a", b"\x00\r\n")
    write_text(tmp_path / "sub" / "b.txt", "σ\r\n\n")
    assert (tmp_path / "a").read_bytes() == b"\x00\r\n"
    assert (tmp_path / "sub" / "b.txt").read_bytes() == b"\xcf\x83\r\n\n"
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["a", "b.txt", "sub"]


def test_failure_keeps_the_old_file_and_leaves_nothing(tmp_path: Path) -> None:
    target = tmp_path / "drive.npz"
    target.write_text("old")

    def fail() -> None:
        with atomic_path(target) as temporary:
            assert temporary.parent == tmp_path
            assert temporary.suffix == ".npz"
            temporary.write_text("new, but ha")
            raise RuntimeError("half way")

    with pytest.raises(RuntimeError, match="half way"):
        fail()
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_interruption_leaves_nothing(tmp_path: Path) -> None:
    def interrupt() -> None:
        with atomic_path(tmp_path / "x") as temporary:
            temporary.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupt()
    assert list(tmp_path.iterdir()) == []


def test_block_that_writes_nothing_is_an_error(tmp_path: Path) -> None:
    target = tmp_path / "x"
    target.write_text("old")
    with pytest.raises(FglocError, match="cannot be written"), atomic_path(target):
        pass
    assert target.read_text() == "old"


def test_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "real").write_text("old")
    link = tmp_path / "link"
    link.symlink_to("real")
    write_text(link, "new")
    assert link.is_symlink()
    assert (tmp_path / "real").read_text() == "new"


def test_folder_or_file_in_the_way_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(FglocError, match=r"is a folder; give the name of a file"):
        write_text(tmp_path, "x")
    (tmp_path / "file").write_text("")
    with pytest.raises(FglocError, match=r"file/x: cannot be written"):
        write_text(tmp_path / "file" / "x", "x")


def test_error_about_another_file_is_not_about_this_one(tmp_path: Path) -> None:
    missing = tmp_path / "missing"
    with pytest.raises(FileNotFoundError) as caught, atomic_path(tmp_path / "x"):
        missing.read_text()
    assert caught.value.filename == str(missing)
