"""Ctrl-C between two packets is noted and not lost."""

from __future__ import annotations

import signal

import pytest

from fgloc.online.stopping import StopRequest


def interrupt(reached: list[str], *, obey: bool, times: int = 1) -> None:
    """Interrupt a stretch of work so many times; note how far it comes."""
    with StopRequest() as stop:
        assert not stop.asked()
        for k in range(times):
            signal.raise_signal(signal.SIGINT)
            reached.append(f"signal {k + 1}")
            assert stop.asked()
        if obey:
            stop.obey()
            reached.append("behind obey")
        reached.append("end")


@pytest.mark.parametrize(
    ("obey", "times", "expected"),
    [
        (True, 1, ["signal 1"]),
        (False, 1, ["signal 1", "end"]),  # it came behind the last packet
        (False, 2, ["signal 1"]),  # a second one acts at once
    ],
)
def test_a_signal_acts_when_it_should(obey: bool, times: int, expected: list[str]) -> None:
    before = signal.getsignal(signal.SIGINT)
    reached: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        interrupt(reached, obey=obey, times=times)
    assert reached == expected
    assert signal.getsignal(signal.SIGINT) is before


def test_an_ignored_signal_stays_ignored() -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with StopRequest() as stop:
            signal.raise_signal(signal.SIGINT)
            assert not stop.asked()
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)
