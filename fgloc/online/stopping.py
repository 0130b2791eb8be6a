"""Ctrl-C and SIGTERM between two packets: an engine must not be left in the middle of one."""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """While it is open the first signal is only noted; a second one acts as it would have."""

    def __init__(self) -> None:
        self._signal: int | None = None
        self._before: dict[int, Any] = {}

    def __enter__(self) -> StopRequest:
        # Only the main thread may set handlers, and an ignored signal stays ignored.
        if threading.current_thread() is threading.main_thread():
            for number in SIGNALS:
                if signal.getsignal(number) is not signal.SIG_IGN:
                    self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._restore()
        if error is None:
            # It came behind the last packet.
            self.obey()

    def asked(self) -> bool:
        """Return True once a signal came."""
        return self._signal is not None

    def obey(self) -> None:
        """Do what the signal noted would have done, if one was; that usually raises."""
        number, self._signal = self._signal, None
        if number is not None:
            self._restore()
            signal.raise_signal(number)

    def _note(self, number: int, frame: FrameType | None) -> None:
        """Remember the first signal."""
        if self._signal is not None:
            self.obey()
        self._signal = number

    def _restore(self) -> None:
        """Put the handlers back that were there before."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before.clear()
