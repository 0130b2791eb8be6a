"""A run folder appears whole, and `latest` points at the last one."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import pytest

from fgloc.errors import FglocError
from fgloc.report.rundir import RunDir

NOW = datetime(2026, 3, 4, 5, 6, 7)


def test_hidden_until_done_then_linked(tmp_path: Path) -> None:
    out = tmp_path / "runs" / "demo"
    with RunDir.create(out, now=NOW) as run:
        run.file("figures/a.png").write_text("a")
        assert run.path.name.startswith(".")
        assert not (out / "latest").exists()
    assert run.path == out / "20260304-050607"
    assert (out / "latest").is_symlink()
    assert (out / "latest" / "figures" / "a.png").read_text() == "a"
    assert sorted(p.name for p in out.iterdir()) == ["20260304-050607", "latest"]


def test_same_second_gets_a_number_and_latest_moves(tmp_path: Path) -> None:
    for number in range(3):
        with RunDir.create(tmp_path, now=NOW) as run:
            run.file("n").write_text(str(number))
    names = sorted(p.name for p in tmp_path.iterdir())
    assert names == ["20260304-050607", "20260304-050607-2", "20260304-050607-3", "latest"]
    assert (tmp_path / "latest" / "n").read_text() == "2"


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_failure_leaves_the_old_run_only(tmp_path: Path, error: type[BaseException]) -> None:
    with RunDir.create(tmp_path, now=NOW) as run:
        run.file("n").write_text("old")

    def fail() -> None:
        with RunDir.create(tmp_path, now=NOW) as run:
            run.file("n").write_text("half")
            raise error

    with pytest.raises(error):
        fail()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["20260304-050607", "latest"]
    assert (tmp_path / "latest" / "n").read_text() == "old"


def test_commit_inside_the_block_gives_the_final_path(tmp_path: Path) -> None:
    with RunDir.create(tmp_path, now=NOW) as run:
        final = run.commit()
        assert run.commit() == final == run.path
        run.file("late").write_text("x")
    assert (tmp_path / "latest" / "late").exists()


def test_refusals(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(FglocError, match="cannot hold a run folder"):
        RunDir.create(tmp_path / "file")
    (tmp_path / "latest").mkdir()
    with pytest.raises(FglocError, match="is not a link to a run"):
        RunDir.create(tmp_path)
    (tmp_path / "latest").rmdir()
    with RunDir.create(tmp_path, now=NOW) as run, pytest.raises(ValueError, match="outside"):
        run.file("../x")
