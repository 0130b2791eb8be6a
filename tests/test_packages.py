"""pyproject.toml names what is really there."""

from __future__ import annotations

import os
import re
import tomllib
from pathlib import Path

import pytest

from fgloc.commands import doctor

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
SETUPTOOLS = PROJECT["tool"]["setuptools"]


def packages_on_disk() -> set[str]:
    """Return the dotted names of all folders with an __init__.py below fgloc, links followed."""
    found = set()
    for folder, _, files in os.walk(ROOT / "fgloc", followlinks=True):
        if "__init__.py" in files:
            found.add(".".join(Path(folder).relative_to(ROOT).parts))
    return found


def test_every_package_is_listed() -> None:
    assert sorted(SETUPTOOLS["packages"]) == sorted(packages_on_disk())


def test_every_folder_with_modules_is_a_package() -> None:
    folders = {
        ".".join(Path(folder).relative_to(ROOT).parts)
        for folder, _, files in os.walk(ROOT / "fgloc", followlinks=True)
        if any(f.endswith(".py") for f in files)
    }
    assert folders == packages_on_disk()


@pytest.mark.parametrize("name", SETUPTOOLS["packages"])
def test_mapped_folder_is_the_linked_one(name: str) -> None:
    mapping = SETUPTOOLS["package-dir"]
    # The longest mapped beginning decides, as in setuptools.
    parts = name.split(".")
    head = next(h for n in range(len(parts), 0, -1) if (h := ".".join(parts[:n])) in mapping)
    mapped = ROOT / mapping[head] / Path(*name.split(".")[head.count(".") + 1 :])
    assert mapped.resolve() == ROOT.joinpath(*parts).resolve()


def test_doctor_checks_every_dependency() -> None:
    def names(requirements: list[str]) -> set[str]:
        return {re.split(r"[^\w.-]", r, maxsplit=1)[0] for r in requirements}

    assert set(doctor.REQUIRED) | {"libusb-package"} == names(PROJECT["project"]["dependencies"])
    extras = PROJECT["project"]["optional-dependencies"]
    features = [r for extra, rs in extras.items() if extra != "dev" for r in rs]
    assert set(doctor.OPTIONAL) == names(features)
