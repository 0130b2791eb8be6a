"""`fgloc doctor` says what is broken and fails if it is needed."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from fgloc.commands import doctor


def test_probe_reports_crash_error_and_output() -> None:
    crash = doctor._probe("x", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    assert (crash.ok, crash.detail) == (False, "crashes with SIGSEGV")
    error = doctor._probe("x", "raise OSError('libusb is gone')")
    assert (error.ok, error.detail) == (False, "OSError: libusb is gone")
    said = doctor._probe("x", "print(1); print(2)")
    assert (said.ok, said.detail) == (True, "2")


def test_dependency_that_is_not_there() -> None:
    check = doctor._dependency("no-such-package", "no_such_package", required=True)
    assert not check.ok
    assert check.detail.startswith("not installed")


@pytest.mark.parametrize(("required", "status"), [(True, 1), (False, 0)])
def test_exit_status(
    required: bool,
    status: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    checks = [doctor.Check("a", True, True, "1"), doctor.Check("b", False, required, "[red]gone")]
    monkeypatch.setattr(doctor, "examine", lambda data: checks)
    assert doctor.run(argparse.Namespace(data=None, json=None)) == status
    out = capsys.readouterr().out
    assert "[red]gone" in out
    assert ("Does not work: b." in out) == required


def test_data_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("FGLOC_DATA", str(tmp_path / "nowhere"))
    checks = {c.name: c for c in doctor._data(tmp_path)}
    assert checks["--data"].ok
    assert checks["FGLOC_DATA"].detail.endswith("nowhere: no such folder")
    assert checks["cache"].ok
    assert not (tmp_path / "cache").exists()
    assert not checks["vitko-swerve"].ok
    assert not any(c.required for c in checks.values())


def test_recorded_data_is_seen(data_dir: Path) -> None:
    checks = {c.name: c for c in doctor._data(None)}
    assert checks["vitko-swerve"].detail == "18 runs"
