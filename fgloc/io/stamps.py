"""When a message was measured: header stamps, times of recording where there are none, order."""

from __future__ import annotations

from collections import Counter

import numpy as np

from fgloc.core.measurements import Stamps
from fgloc.datasets.text import BACKWARD, REPEATED, Integers, Mask, count, forward_stamps
from fgloc.io.messages import Messages

RESTART_NS = 1_000_000_000
"""A clock that falls back by more was set or started anew [ns]."""
LOST = 0.1
"""Where more of the messages than this would be dropped for their stamps, the clock restarted."""
LATE_S = 0.5
"""A delay between stamp and recording worth telling of [s]."""
ONE_CLOCK_S = 1.0
"""Stamps and times of recording further apart come from different clocks [s]."""


def stamps_of(
    messages: Messages, role: str, rejected: Counter[str], notes: list[str]
) -> tuple[Stamps, Integers]:
    """Return stamps (M,) that strictly increase and the indices (M,) of their messages.

    Header stamps count; times of recording where there is no header or its stamp is zero, and
    where only some are zero, as far as both come from one clock. What repeats, goes back or has
    no time is dropped and counted under the name of the role. O(N).
    """
    stamped, received = messages.times()
    index = np.arange(stamped.size, dtype=np.int64)
    blank = stamped == 0
    if blank.all():
        stamps = received
        if stamped.size:
            notes.append(f"{messages.topic} has no stamps: times of recording are used.")
    else:
        delay = (received[~blank] - stamped[~blank]) * 1e-9
        typical = float(np.median(delay))
        stamps = np.where(blank, received, stamped)
        if blank.any() and abs(typical) > ONE_CLOCK_S:
            count(rejected, f"{role} without a stamp", int(blank.sum()))
            stamps, index = stamped[~blank], index[~blank]
        elif blank.any():
            notes.append(
                f"{int(blank.sum())} messages of {messages.topic} have no stamp: their times of "
                "recording are used."
            )
        if abs(typical) > LATE_S:
            notes.append(
                f"{messages.topic} was recorded {typical:.3g} s after its stamps: a slow sensor, "
                "or another clock."
            )
    kept = _increasing(stamps, role, rejected, notes)
    return stamps[kept], index[kept]


def _increasing(stamps: Stamps, role: str, rejected: Counter[str], notes: list[str]) -> Integers:
    """Return the indices of stamps that strictly increase, most of them, counting the others."""
    if stamps.size < 2 or bool(np.all(np.diff(stamps) > 0)):
        return np.arange(stamps.size, dtype=np.int64)
    _, first = np.unique(stamps, return_index=True)
    once = np.sort(first).astype(np.int64)
    count(rejected, f"{role} {REPEATED}", stamps.size - once.size)
    there = stamps[once]
    # Late messages are dropped going forward; one stamp from the future is, going backward.
    ahead = forward_stamps(there, Counter())
    behind = forward_stamps(-there[::-1], Counter())[::-1]
    keep = ahead if ahead.sum() >= behind.sum() else behind
    if keep.mean() < 1.0 - LOST:
        keep = _longest_piece(there)
        notes.append(
            f"The clock of the {role} messages was set back during the recording: only the "
            f"longest piece, {int(keep.sum())} of {there.size} messages, is used."
        )
    count(rejected, f"{role} {BACKWARD}", int((~keep).sum()))
    return once[keep]


def _longest_piece(stamps: Stamps) -> Mask:
    """Return the mask of the longest stretch between two resets of the clock."""
    resets = np.flatnonzero(np.diff(stamps) < -RESTART_NS) + 1
    bounds = np.concatenate([[0], resets, [stamps.size]])
    best = int(np.argmax(np.diff(bounds)))
    keep = np.zeros(stamps.size, dtype=np.bool_)
    piece = slice(int(bounds[best]), int(bounds[best + 1]))
    keep[piece] = forward_stamps(stamps[piece], Counter())
    return keep
