"""The command line: its speed, its exit codes, and one line for every error."""

from __future__ import annotations

import argparse
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from fgloc import usage
from fgloc.cli import main
from fgloc.core.geometry import INTEGRATORS
from fgloc.errors import FglocError
from fgloc.experiments.methods import available
from fgloc.usage import build_parser

ROOT = Path(__file__).resolve().parent.parent
Handler = Callable[[argparse.Namespace], int]


def fgloc(*arguments: str, code: str = "") -> subprocess.CompletedProcess[str]:
    """Run the command in a process of its own; `code` replaces parts of it before it starts."""
    script = f"import sys\nfrom fgloc.cli import main\n{code}\nsys.exit(main())"
    return subprocess.run(
        [sys.executable, "-c", script, *arguments],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        timeout=60,
    )


@pytest.fixture
def handler(monkeypatch: pytest.MonkeyPatch) -> Callable[[Handler], None]:
    """Return a function that puts another handler behind `fgloc doctor`."""

    def put(run: Handler) -> None:
        monkeypatch.setattr("fgloc.commands.doctor.run", run)

    monkeypatch.setattr(signal, "signal", lambda *_: None)
    return put


def test_help_is_quick_and_imports_nothing_heavy() -> None:
    heavy = {"numpy", "numba", "scipy", "gtsam", "open3d", "matplotlib", "rich", "msgspec"}
    code = f"import atexit; atexit.register(lambda: print('HEAVY', {heavy} & sys.modules.keys()))"
    done = fgloc("--help", code=code)
    assert done.returncode == 0
    assert "HEAVY set()" in done.stdout
    for command in ("smooth", "compare", "simulate", "datasets", "view", "doctor"):
        assert command in done.stdout
    # Best of five, so that a busy machine does not decide.
    times = []
    for _ in range(5):
        begin = time.perf_counter()
        fgloc("--help")
        times.append(time.perf_counter() - begin)
    assert min(times) < 0.3


def test_version() -> None:
    done = fgloc("--version")
    assert (done.returncode, done.stdout) == (0, "fgloc 0.1.0\n")


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["nonsense"],
        ["compare"],
        ["smooth", "a", "b"],
        ["compare", "a", "--integrator", "simpson"],
        ["compare", "a", "--fixes", "0"],
        ["compare", "a", "--fixes", "10:-1"],
        ["compare", "a", "--fixes", "10:"],
        ["compare", "a", "--fixes", "10:1:1"],
        ["compare", "a", "--fixes", "nan"],
        ["smooth", "a", "--fixes", "inf"],
        ["smooth", "a", "--seed", "-1"],
        ["smooth", "a", "--seed", "1.5"],
        ["smooth", "a", "--save", "poses.txt"],
        ["simulate", "demo", "--format", "bag"],
        ["datasets"],
        ["datasets", "fetch"],
        ["datasets", "convert", "a"],
        ["compare", "a", "--meth", "batch"],
    ],
)
def test_wrong_usage_exits_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert "usage: fgloc" in capsys.readouterr().err


def test_option_names_are_attribute_names() -> None:
    line = "compare a b --methods batch --fixes 10:0.002 --seed 7 --integrator euler --robot r.toml"
    args = build_parser().parse_args(line.split())
    assert (args.command, args.drives, args.methods) == ("compare", ["a", "b"], "batch")
    assert (args.fixes, args.seed, args.integrator) == ("10:0.002", 7, "euler")
    assert args.robot == Path("r.toml")
    assert args.data is args.json is args.out is None
    assert args.debug is False
    args = build_parser().parse_args(
        ["--debug", "datasets", "convert", "d", "f.npz", "--data", "x"]
    )
    assert (args.datasets_command, args.drive, args.file) == ("convert", "d", Path("f.npz"))
    assert args.data == Path("x")
    assert args.debug is True
    assert build_parser().parse_args(["smooth", "a", "--debug"]).debug is True


@pytest.mark.parametrize("command", ["smooth", "localise", "compare"])
def test_encoder_selection_is_an_option_of_every_estimate(command: str) -> None:
    parser = build_parser()
    assert parser.parse_args([command, "a"]).encoder_selection is False
    assert parser.parse_args([command, "a", "--encoder-selection"]).encoder_selection is True


def test_copies_of_names_agree_with_their_source() -> None:
    assert ",".join(available()) == usage.METHODS
    assert INTEGRATORS == usage.INTEGRATORS


def test_status_of_the_handler_is_returned(handler: Callable[[Handler], None]) -> None:
    handler(lambda args: 1 if args.json else 0)
    assert main(["doctor"]) == 0
    assert main(["doctor", "--json", "x"]) == 1


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (
            FglocError("no such\n run; choose 1", file="a.csv", line=3),
            "a.csv:3: no such run; choose 1",
        ),
        (
            FileNotFoundError(2, "No such file or directory", "a.csv"),
            "a.csv: No such file or directory",
        ),
        (
            ModuleNotFoundError("No module named 'rosbags'", name="rosbags"),
            "a library cannot be imported: No module named 'rosbags'; "
            "`fgloc doctor` shows what is missing",
        ),
        (
            KeyError("x"),
            "this is a defect of fgloc: KeyError: 'x'; run again with --debug to see where",
        ),
    ],
)
def test_error_is_one_line(
    error: Exception,
    line: str,
    handler: Callable[[Handler], None],
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fail(args: argparse.Namespace) -> int:
        raise error

    handler(fail)
    assert main(["doctor"]) == 1
    assert capsys.readouterr().err == f"fgloc: error: {line}\n"
    assert main(["doctor", "--debug"]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_interrupt(handler: Callable[[Handler], None], capsys: pytest.CaptureFixture[str]) -> None:
    def interrupt(args: argparse.Namespace) -> int:
        raise KeyboardInterrupt

    handler(interrupt)
    assert main(["doctor"]) == 130
    assert capsys.readouterr().err == "fgloc: interrupted\n"


def test_reader_that_goes_away_is_no_error() -> None:
    code = (
        "import fgloc.commands.doctor as d\n"
        "d.run = lambda args: [print('x' * 80) for _ in range(20000)] and 0"
    )
    script = f"import sys\nfrom fgloc.cli import main\n{code}\nsys.exit(main(['doctor']))"
    process = subprocess.Popen(
        [sys.executable, "-c", script],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.readline()
    process.stdout.close()
    assert process.stderr.read() == b""
    process.stderr.close()
    assert process.wait(60) == 141


def test_termination_cleans_up(tmp_path: Path) -> None:
    code = (
        "import time\nfrom fgloc.atomic import atomic_path\n"
        "import fgloc.commands.doctor as d\n"
        "def run(args):\n"
        f"    with atomic_path({str(tmp_path / 'x')!r}) as p:\n"
        "        p.write_text('half'); print('ready', flush=True); time.sleep(60)\n"
        "d.run = run\n"
    )
    script = f"import sys\nfrom fgloc.cli import main\n{code}\nsys.exit(main(['doctor']))"
    process = subprocess.Popen(
        [sys.executable, "-c", script],
        stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"ready\n"
    assert len(list(tmp_path.iterdir())) == 1
    process.terminate()
    process.stdout.close()
    assert process.wait(60) == 143
    assert list(tmp_path.iterdir()) == []


def test_doctor_json(tmp_path: Path) -> None:
    done = fgloc("doctor", "--json", str(tmp_path / "doctor.json"))
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.endswith("Everything needed works.\n")
    report = json.loads((tmp_path / "doctor.json").read_text())
    assert set(report) == {"version", "ok", "checks"}
    names = {c["name"] for c in report["checks"] if c["ok"]}
    assert {"gtsam", "open3d", "gtsam solves", "inner loops"} <= names


def test_json_to_a_dash_is_wrong_usage(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["compare", "sim:demo", "--json", "-"])
    assert left.value.code == 2
    assert "give the name of a file" in capsys.readouterr().err


def test_drives_in_the_help_can_be_made() -> None:
    """Every simulated drive that an example names is one that the simulator knows."""
    from fgloc.datasets.simulator.drives import NAMED
    from fgloc.datasets.simulator.spec import parse

    parser = build_parser()
    (commands,) = (a for a in parser._actions if a.dest == "command")
    examples = [
        words
        for command in commands.choices.values()  # type: ignore[union-attr]
        for line in (command.epilog or "").splitlines()[1:]
        for words in [shlex.split(line)]
    ]
    assert {words[1] for words in examples} >= {"smooth", "compare", "simulate"}
    for words in examples:
        args = parser.parse_args(words[1:])
        names = [args.name] if args.command == "simulate" else []
        names += [d.removeprefix("sim:") for d in getattr(args, "drives", []) if "sim:" in d]
        for name in names:
            parse(name, NAMED)
