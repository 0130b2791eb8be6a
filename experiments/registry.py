"""All experiments by name; a module is imported when its experiment is asked for."""

from __future__ import annotations

import difflib
import importlib

from fgloc.errors import FglocError
from fgloc.experiments.experiment import Experiment

MODULES: dict[str, str] = {
    "seed-a-simulation": "fgloc.experiments.seed_a.simulation",
    "seed-a-vehicle": "fgloc.experiments.seed_a.vehicle",
    "seed-d-nominal": "fgloc.experiments.seed_d.nominal",
    "seed-d-calibration": "fgloc.experiments.seed_d.calibration",
    "calibration": "fgloc.experiments.calibration.recorded",
    "slip": "fgloc.experiments.slip",
    "faults": "fgloc.experiments.faults",
    "seed-b": "fgloc.experiments.rooms.seed_b",
    "seed-c": "fgloc.experiments.rooms.seed_c",
    "csail": "fgloc.experiments.csail",
    "mrclam": "fgloc.experiments.mrclam",
}
"""Modules with a constant EXPERIMENT, by the experiment's id, in the order of the list."""


def find(name: str) -> Experiment:
    """Return an experiment by name; raises FglocError naming the known ones and the nearest."""
    if name not in MODULES:
        near = difflib.get_close_matches(name, MODULES, n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise FglocError(f"no experiment is called {name!r}; {hint}known are {', '.join(MODULES)}")
    experiment: Experiment = importlib.import_module(MODULES[name]).EXPERIMENT
    return experiment


def every() -> list[Experiment]:
    """Return all experiments in the order of the list."""
    return [find(name) for name in MODULES]
