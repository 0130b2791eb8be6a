"""The README shows what its commands print: every line of its examples is compared."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from fgloc.cli import main

README = Path(__file__).parent.parent / "README.md"
BLOCKS: list[str] = re.findall(r"```\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
EXAMPLES = [b for b in BLOCKS if b.startswith("$ fgloc")]
DEMO = "compare sim:demo --methods model1,model2,model3,pose-ekf,batch,online"
"""What `make demo` runs."""


def shown(block: str) -> list[str]:
    """Return the output lines of an example; an ellipsis stands for what is left out."""
    lines = [line.rstrip() for line in block.splitlines()]
    return [line for line in lines if line and line != "…" and not line.startswith("$ ")]


def alike(line: str, other: str) -> bool:
    """Return True if two lines have the same words, and numbers that differ by two fifths at most.

    What a search over discrete matches ends with is not the same on every processor: 0.092 m here
    was 0.123 m on another machine.
    """
    one, two = line.split(), other.split()
    return len(one) == len(two) and all(
        a == b or (_number(a) and _number(b) and abs(float(a) - float(b)) <= 0.4 * abs(float(a)))
        for a, b in zip(one, two, strict=True)
    )


def _number(word: str) -> bool:
    return re.fullmatch(r"-?\d+\.\d+", word) is not None


def printed(commands: list[str], capsys: pytest.CaptureFixture[str]) -> list[str]:
    """Return what the commands print."""
    for command in commands:
        assert main(shlex.split(command)) == 0
    return [line.rstrip() for line in capsys.readouterr().out.splitlines()]


def test_the_demo_prints_the_table(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (table,) = (b for b in BLOCKS if "model1" in b and not b.startswith("$"))
    output = printed([DEMO], capsys)
    assert len(shown(table)) == 8
    assert [line for line in shown(table) if line not in output] == []


@pytest.mark.parametrize("block", EXAMPLES, ids=[b.splitlines()[-1][:40] for b in EXAMPLES])
def test_an_example_prints_what_is_shown(
    block: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    request: pytest.FixtureRequest,
) -> None:
    monkeypatch.chdir(tmp_path)
    commands = [line[len("$ fgloc ") :] for line in block.splitlines() if line.startswith("$ ")]
    commands = [c for c in commands if not c.startswith("datasets fetch")]
    if "drive.log" not in block:
        request.getfixturevalue("data_dir")
    output = printed(commands, capsys)
    assert shown(block)
    same = alike if "csail" in block else str.__eq__
    assert [line for line in shown(block) if not any(same(line, o) for o in output)] == []


def test_there_are_examples() -> None:
    assert len(EXAMPLES) == 6
