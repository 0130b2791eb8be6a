"""What is measured at one instant gets a keyframe there: fixes, sightings of landmarks, scans.

A reading ahead of the wheels waits for them; a late one is put at the keyframe before its stamp,
as if its sensor were mounted further off.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Iterator
from typing import Protocol

import numpy as np

from fgloc.core.measurements import Floats
from fgloc.online.aligning import Aligner
from fgloc.online.fixes import Fix, FixTable
from fgloc.online.propagate import Propagation, moved_from
from fgloc.online.smoother import WindowSmoother
from fgloc.online.window import Window

UNPLACED = "the start is not known"
"""Reason of readings that never told, or would have to be told, where the drive started."""
BROKE = "the solver broke over it"
"""Reason of measurements that were taken back so that the window could be solved."""
LATE = "older than the window"
"""Reason of measurements at a time that is summed up already."""


class Host(Protocol):
    """What readings of one instant need of an engine."""

    window: Window
    propagation: Propagation
    now_ns: int

    def keyframe(self) -> int:
        """Make a keyframe of now; return its number."""
        ...

    def touch(self, number: int) -> None:
        """Note that a keyframe has a new factor."""
        ...

    def update(self) -> None:
        """Smooth with everything that is new; never raises."""
        ...

    def place(self, start: Floats, sigma: Floats) -> None:
        """Move the path so far to where it lies in the map, give or take sigma (3,)."""
        ...

    def reject(self, sensor: str, reason: str, count: int = 1) -> None:
        """Count readings that could not be used."""
        ...


class MapHost(Host, Protocol):
    """What readings that see landmarks need of an engine, besides."""

    def enter(self, guesses: Floats, root: Floats) -> list[int]:
        """Take new landmarks into use at guesses (2 k,), of which `root` (2 k, 2 k) is known."""
        ...

    def recall(self, numbers: list[int]) -> None:
        """Take landmarks that were put aside back into use."""
        ...

    @property
    def map_smoother(self) -> WindowSmoother:
        """Return the solver that keeps the landmarks."""
        ...


class SpotTable(Protocol):
    """One stream of readings that have a keyframe at their stamps."""

    delay_ns: int
    """How long after its stamp a reading is complete, which is where its keyframe is."""

    def first(self, fix: Fix) -> bool:
        """Note that a reading came; False if the same came before."""
        ...

    def due(self, state: Floats) -> bool:
        """Return True if a reading is worth a keyframe where the robot is now, state (B,)."""
        ...

    def add(self, number: int, fix: Fix, moved: Floats | None) -> None:
        """Make factors of a reading at a keyframe, or `moved` (3,) away from it."""
        ...

    def prune(self, before_ns: int) -> None:
        """Forget what the window has left behind."""
        ...

    def pending(self) -> list[str]:
        """Return a reason for each part of a reading that has not become a factor yet."""
        ...


class Spots:
    """All streams whose readings have a keyframe of their own."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self.tables: dict[str, SpotTable] = {}
        self.waiting: list[Fix] = []
        self.aligner: Aligner | None = None

    @property
    def fixes(self) -> dict[str, FixTable]:
        """Return the tables of fixes by sensor."""
        return {name: t for name, t in self.tables.items() if isinstance(t, FixTable)}

    def align(self) -> bool:
        """Let fixes tell where the drive starts; False if there is no sensor for that."""
        mounts = {name: table.mount for name, table in self.fixes.items()}
        self.aligner = Aligner(mounts) if mounts else None
        return bool(mounts)

    def take(self, fix: Fix) -> None:
        """Put a reading where it belongs, or let it wait for the wheels."""
        host, window = self._host, self._host.window
        if fix.stamp_ns > host.now_ns:
            insort(self.waiting, fix, key=lambda f: f.stamp_ns)
            return
        if not self.tables[fix.sensor].due(host.propagation.state):
            return
        number = window.number_at(fix.stamp_ns)
        if number < window.base:
            host.reject(fix.sensor, LATE)
            return
        if fix.stamp_ns == host.now_ns and window.stamp(number) != host.now_ns:
            number = host.keyframe()
        moved = None
        if window.stamp(number) != fix.stamp_ns:
            moved = moved_from(window, number, fix.stamp_ns)
        self._add(number, fix, moved)

    def reached(self, stamp_ns: int) -> int | None:
        """Return the stamp of the first reading that waits for the wheels up to a stamp."""
        if self.waiting and self.waiting[0].stamp_ns <= stamp_ns:
            return self.waiting[0].stamp_ns
        return None

    def release(self) -> None:
        """Use the first reading that waits: the wheels have reached its stamp."""
        host, fix = self._host, self.waiting[0]
        due = self.tables[fix.sensor].due(host.propagation.state)
        if due:
            number = host.window.newest
            if host.window.stamp(number) != host.now_ns:
                number = host.keyframe()
        self.waiting.pop(0)
        if due:
            self._add(number, fix, None)

    def _add(self, number: int, fix: Fix, moved: Floats | None) -> None:
        """Make factors of a reading, or use it to find out where the drive started."""
        host = self._host
        if self.aligner is None:
            self.tables[fix.sensor].add(number, fix, moved)
            return
        if fix.sensor not in self.fixes:
            host.reject(fix.sensor, UNPLACED)
            return
        self.aligner.add(number, fix, moved, host.window.state(number)[:3])
        found = self.aligner.start()
        if found is None:
            return
        fixes, self.aligner = self.aligner.fixes, None
        try:
            host.place(*found)
        except Exception:
            for _, one, _ in fixes:
                host.reject(one.sensor, BROKE)
            raise
        for collected in fixes:
            self._add(*collected)
        host.update()

    def prune(self) -> None:
        """Forget what the window has left behind."""
        window = self._host.window
        for table in self.tables.values():
            table.prune(window.stamp(window.base))
        for fix in [] if self.aligner is None else self.aligner.prune(window.base):
            self._host.reject(fix.sensor, UNPLACED)

    def left(self) -> Iterator[tuple[str, str]]:
        """Yield sensor and reason of every reading that never became a factor."""
        for fix in self.waiting:
            yield fix.sensor, "after the last wheel packet"
        for _, fix, _ in [] if self.aligner is None else self.aligner.fixes:
            yield fix.sensor, UNPLACED
        for name, table in self.tables.items():
            for reason in table.pending():
                yield name, reason


def empty_sigma() -> Floats:
    """Return the sigmas of a reading whose noise is that of its sensor: none."""
    return np.zeros(0)
