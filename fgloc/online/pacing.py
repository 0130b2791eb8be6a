"""Stamps respected: packets are handed over when their time has come, and how late that was."""

from __future__ import annotations

import time
from collections.abc import Callable

BEHIND_S = 1.0
"""A packet that waits this long for the engine is worth a word."""
SLICE_S = 0.05
"""Longest sleep [s], so that a request to stop is heard."""


class Pace:
    """Lets packets wait for their time, `speed` times faster than they were measured."""

    def __init__(self, speed: float, first_ns: int, say: Callable[[str], None]) -> None:
        """Time begins now, with the stamp `first_ns`."""
        self._speed = speed
        self._first_ns = first_ns
        self._say = say
        self._begin = time.perf_counter()
        self._worth_saying = BEHIND_S
        self.late_s: list[float] = []

    def wait(self, stamp_ns: int, stopped: Callable[[], bool]) -> None:
        """Return when a packet is due, at once if that is past or if `stopped` says so."""
        due = self._begin + (stamp_ns - self._first_ns) * 1e-9 / self._speed
        while (left := due - time.perf_counter()) > 0.0 and not stopped():
            time.sleep(min(left, SLICE_S))
        late = max(-left, 0.0)
        self.late_s.append(late)
        if late >= self._worth_saying:
            # Each time it has doubled: a word a packet would be no help.
            self._worth_saying = 2.0 * late
            self._say(f"the engine is {late:.1f} s behind")

    def verdict(self) -> list[str]:
        """Return a sentence if the engine was behind at the end; none if it kept up."""
        if not self.late_s or self.late_s[-1] < BEHIND_S:
            return []
        return [
            f"the engine could not keep up with {self._speed:g} times real time: the last packet "
            f"waited {self.late_s[-1]:.1f} s"
        ]
