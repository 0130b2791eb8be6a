"""`fgloc experiments` as it is typed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fgloc.cli import main
from fgloc.experiments import registry
from fgloc.experiments.experiment import Context, Experiment
from fgloc.report.experiment_report import Cell, Column, Report, Row, Table


def work(job: int) -> int:
    return job + 1


def small(context: Context) -> Report:
    found = context.map(work, list(context.over(4)), lambda j: f"seed {j}")
    table = Table("t", "T", ("a",), (Column("m", "M"),), (Row(("x",), {"m": Cell(1.0, 1, 1.0)}),))
    return Report("Small", (table,), settings={"found": found})


@pytest.fixture
def known(monkeypatch: pytest.MonkeyPatch) -> None:
    """Put two small experiments in the place of the real ones."""
    monkeypatch.setattr(registry, "MODULES", {"small": "", "needy": ""})
    experiments = {
        "small": Experiment("small", "is small", (), small),
        "needy": Experiment("needy", "needs much", ("vitko-swerve",), small),
    }
    real = registry.find
    for module in ("fgloc.experiments.registry.find", "fgloc.commands.experiments.find"):
        monkeypatch.setattr(module, lambda n: experiments[n] if n in experiments else real(n))


@pytest.mark.usefixtures("known")
def test_list(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FGLOC_DATA", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    target = tmp_path / "list.json"
    assert main(["experiments", "list", "--json", str(target)]) == 0
    out = capsys.readouterr().out
    assert "small       yes           is small" in out
    assert "needy       no            needs much" in out
    assert "get it with: fgloc datasets fetch vitko-swerve" in out
    small_entry, needy = json.loads(target.read_text())["experiments"]
    assert small_entry == {"id": "small", "summary": "is small", "needs": [], "missing": None}
    assert "not on this machine" in needy["missing"]
    assert main(["experiments", "run", "needy"]) == 1
    assert "fgloc: error: needy cannot run: dataset vitko-swerve" in capsys.readouterr().err


@pytest.mark.usefixtures("known")
def test_run_writes_what_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    numbers, out = tmp_path / "n.json", tmp_path / "runs"
    arguments = ["experiments", "run", "small", "--json", str(numbers), "--out", str(out)]
    assert main([*arguments, "--seeds", "3", "--processes", "1"]) == 0
    shown = capsys.readouterr()
    assert "Of 1 published numbers: 1 reproduced." in shown.out
    assert [line for line in shown.err.splitlines() if line.startswith("[")] == [
        "[1/3] seed 1",
        "[2/3] seed 2",
        "[3/3] seed 3",
    ]
    assert json.loads(numbers.read_text())["settings"] == {"found": [2, 3, 4]}
    settings = json.loads((out / "latest" / "settings.json").read_text())
    assert settings["experiment"] == "small"
    assert (settings["seeds"], settings["processes"]) == (3, 1)
    assert (out / "latest" / "report.html").exists()


def test_unknown_name_names_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["experiments", "run", "seed-a-simulaton"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "did you mean seed-a-simulation? known are seed-a-simulation" in line


@pytest.mark.parametrize(
    "arguments", [[], ["run"], ["run", "x", "--seeds", "0"], ["run", "x", "--processes", "x"]]
)
def test_wrong_usage_exits_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["experiments", *arguments])
    assert caught.value.code == 2
    assert "usage: fgloc experiments" in capsys.readouterr().err


def test_a_place_that_cannot_be_written_is_known_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["experiments", "run", "no-such-one", "--json", str(tmp_path)]) == 1
    assert "is a folder" in capsys.readouterr().err


def test_every_experiment_has_the_name_it_is_registered_under() -> None:
    assert [e.id for e in registry.every()] == list(registry.MODULES)


def test_every_experiment_is_documented() -> None:
    text = (Path(__file__).parents[2] / "docs" / "experiments.md").read_text(encoding="utf-8")
    for name in registry.MODULES:
        assert f"\n## {name}\n" in text


def test_an_interrupt_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(context: Context) -> Report:
        raise KeyboardInterrupt

    broken = Experiment("small", "", (), interrupted)
    monkeypatch.setattr("fgloc.commands.experiments.find", lambda name: broken)
    out, numbers = tmp_path / "runs", tmp_path / "n.json"
    arguments = ["experiments", "run", "small", "--out", str(out), "--json", str(numbers)]
    assert main(arguments) == 130
    assert capsys.readouterr().err.splitlines()[-1] == "fgloc: interrupted"
    assert list(tmp_path.iterdir()) == []
