"""Stamps that go back: a single one is not used, a clock that was set back is followed."""

from __future__ import annotations

from collections import deque

PERSISTENT = 10
"""So many stamps in a row that lie in the past but follow each other mean a clock set back."""
REMEMBERED = 100
"""Among so many packets of the wheels one that was sent twice is found."""


class Clock:
    """Turns a robot's stamps into a time that does not go back."""

    def __init__(self) -> None:
        self.shift_ns = 0
        self.shifts: list[int] = []
        self._now = -(2**62)
        self._before = -(2**62)
        self._in_past = 0
        self._recent: deque[tuple[int, bytes]] = deque(maxlen=REMEMBERED)

    @property
    def doubtful(self) -> bool:
        """Return True while it is open whether the clock was set back."""
        return self._in_past > 0

    def repeats(self, stamp_ns: int, content: bytes) -> bool:
        """Return True if one of the last wheel packets had this very stamp and content."""
        packet = (stamp_ns, content)
        if self.time(stamp_ns) <= self._now and packet in self._recent:
            return True
        self._recent.append(packet)
        return False

    def time(self, stamp_ns: int) -> int:
        """Return the engine's time of a stamp."""
        return stamp_ns + self.shift_ns

    def admit(self, stamp_ns: int) -> bool:
        """Take the next wheel stamp; False if it lies in the past and cannot be used.

        After PERSISTENT stamps that lie in the past but increase, the clock counts as set back:
        the engine's time goes on as if the last of them had followed the one before the step at
        their own distance.
        """
        time = self.time(stamp_ns)
        follows = stamp_ns > self._before
        gap = stamp_ns - self._before
        self._before = stamp_ns
        if time > self._now:
            self._now, self._in_past = time, 0
            return True
        self._in_past = self._in_past + 1 if follows else 1
        if self._in_past < PERSISTENT:
            return False
        step = self._now + gap - time
        self.shift_ns += step
        self.shifts.append(step)
        self._now, self._in_past = self.time(stamp_ns), 0
        return True
