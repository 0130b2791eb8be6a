"""An experiment: a name, what it needs, and one function from a context to a report.

    EXPERIMENT = Experiment("my-experiment", "what it shows", (), run)

in a module that `fgloc.experiments.registry` names is all that makes a new one. The types of the
report live in `fgloc.report.experiment_report`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from fgloc.datasets.registry import find_folder
from fgloc.errors import FglocError
from fgloc.experiments.workers import Progress, run_jobs
from fgloc.report.experiment_report import Report

J = TypeVar("J")
R = TypeVar("R")


def silent(done: int, total: int, text: str) -> None:
    """Tell nobody."""


@dataclass(frozen=True)
class Context:
    """What an experiment is run with."""

    data: Path | None = None
    """Folder of recorded drives that is searched first; see `fgloc.datasets.registry`."""
    processes: int = 2
    """Number of worker processes; 1 does all work in this one. Results do not depend on it."""
    seeds: int | None = None
    """Number of seeds in place of the experiment's own; None for its own."""
    progress: Progress = silent
    """Told (finished pieces, all pieces, what was finished last)."""

    def over(self, usual: int) -> range:
        """Return the seeds 1, 2, …: `usual` of them, or as many as were asked for."""
        return range(1, 1 + (usual if self.seeds is None else self.seeds))

    def map(
        self, work: Callable[[J], R], jobs: Sequence[J], describe: Callable[[J], str] = str
    ) -> list[R]:
        """Return `work(job)` for every job, in order, computed in `processes` processes.

        See `fgloc.experiments.workers.run_jobs`. Jobs of about a second suit it: each one is a
        line of progress in a pipe.
        """
        return run_jobs(work, jobs, self.processes, self.progress, describe)


@dataclass(frozen=True)
class Experiment:
    """One experiment that `fgloc experiments run` can run."""

    id: str
    """Name on the command line."""
    summary: str
    """What it shows, for the list."""
    needs: tuple[str, ...]
    """Data sets that must be on this machine; () for a simulated one."""
    run: Callable[[Context], Report]
    """Does the work. May raise FglocError."""

    def missing(self, data: Path | None) -> str | None:
        """Return what is missing on this machine and how to get it; None if nothing is."""
        for name in self.needs:
            try:
                find_folder(name, data)
            except FglocError as error:
                return str(error)
        return None
