"""A heading sensor that suddenly contradicts all others is not believed for a while.

What `fgloc.online.trust` looks at is the whole window: a sensor that was right for half a minute
and begins to lie is drowned in it for seconds, and takes the pose along. Here only the last
moments count. Without the liar everything else must agree, wheels included, and without no other
suspect as well: that needs another witness of the turn beside the wheels, who slip.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from fgloc.factors.tables import FactorTable, Kind, Linearised, linearise
from fgloc.online.smoother import WindowSmoother
from fgloc.online.trust import SUSPECTS
from fgloc.smoothing.problem import HIDDEN
from fgloc.smoothing.trust import ARBITERS, GAIN, STRAINED

WITNESSES = (*SUSPECTS, Kind.CAMERA, Kind.POSE_FIX)
"""Who tells a turn within moments, beside the wheels, who may slip in a turn."""
SURPRISES = 2
"""So many surprises one after the other call for a look at once."""
AGREED = 1.0
"""Mean robust cost per residual component up to which all others agree; 0.5 is right."""
PAUSES_S = (5.0, 20.0)
"""How long a sensor is not believed, the first time and the second; then it is left out."""
GOOD = 5
"""So many measurements in a row that do not surprise end the probation after a pause."""
PATIENCE = 4
"""After a look that found nothing the next one waits for so many times more alarms."""


@dataclass(frozen=True)
class Pause:
    """A time for which a sensor is not believed."""

    sensor: str
    """Its name."""
    begin_ns: int
    """Stamp from which on its readings do not count."""
    until_ns: int | None
    """Stamp until which they do not; None: for good."""
    others: tuple[str, ...]
    """Who agrees without it; empty where it went on as before the pause."""
    lost: int
    """How many of its factors were in the window."""


@dataclass
class Alarm:
    """Watches what the newest measurements say of each other."""

    smoother: WindowSmoother
    """Keeps the window."""
    surprises: int = 0
    """How many there were one after the other."""
    since: int = 0
    """Keyframe before the first of them."""
    times: dict[str, int] = field(default_factory=dict)
    """How often a sensor was not believed so far."""
    good: dict[str, int] = field(default_factory=dict)
    """What a sensor on probation measured without surprise."""
    wait: int = 0
    """Alarms that are not looked at."""
    pause: int = 1
    """How many the next look in vain adds."""

    def relapse(self) -> Pause | None:
        """Return a longer pause for a sensor that surprises at once when it is heard again."""
        window = self.smoother.window
        for judged in self.smoother.judged:
            table = judged.table
            if not table.strict:
                continue
            self.good[table.sensor] = self.good.get(table.sensor, 0) + judged.nis.size
            if np.any(judged.nis > self.smoother.gates[judged.dimension]):
                since = window.newest - 1
                return self._pause(
                    table.sensor, since, (), self.smoother.forget(table.sensor, since)
                )
            if self.good[table.sensor] >= GOOD:
                table.strict = False
        return None

    def _pause(self, sensor: str, since: int, others: tuple[str, ...], lost: int) -> Pause:
        """Return a pause from a keyframe on, and put the sensor on probation after it."""
        window = self.smoother.window
        count = self.times[sensor] = self.times.get(sensor, 0) + 1
        seconds = PAUSES_S[count - 1] if count <= len(PAUSES_S) else None
        until = None if seconds is None else window.stamp(window.newest) + round(seconds * 1e9)
        self.good[sensor] = 0
        for table in window.tables.values():
            if table.sensor == sensor:
                table.strict = True
        return Pause(sensor, window.stamp(since), until, others, lost)

    def raised(self) -> bool:
        """Return True where the newest measurements surprise for the second time in a row."""
        told = [j for j in self.smoother.judged if j.table.kind in (*SUSPECTS, *ARBITERS)]
        gates = self.smoother.gates
        if told:
            surprised = any(np.any(j.nis > gates[j.dimension]) for j in told)
            self.surprises = self.surprises + 1 if surprised else 0
            if self.surprises == 1:
                self.since = self.smoother.window.newest - 1
        if self.surprises < SURPRISES:
            return False
        self.surprises = 0
        self.wait -= 1
        return self.wait < 0

    def look(self) -> Pause | None:
        """Solve the window without each suspect's newest readings; adopt what makes all agree.

        The window is left as it is where nothing does. A trial costs tens of milliseconds.
        """
        smoother, window = self.smoother, self.smoother.window
        since = max(self.since, window.base)
        tables = [*window.factors(window.base, window.tables.values()), window.wheel_factors()]
        states, u = window.states.view, smoother.calibration
        now = [linearise(t, states, u) for t in tables]
        told = [t for t in tables if t.sensor in _heard(tables, since - window.base)]
        suspects = sorted({t.sensor for t in told if t.kind in SUSPECTS})
        witnesses = {t.sensor for t in told if t.kind in WITNESSES}
        before = _cost(tables, now, since - window.base)
        if before < STRAINED or not suspects or len(witnesses) < 2:
            return None
        assert window.prior is not None
        trials = {s: smoother.solve_without(s, window.prior, since) for s in suspects}
        after = {
            s: _cost(trial.point.tables, trial.point.linear, since - window.base)
            for s, trial in trials.items()
        }
        best = min(suspects, key=lambda s: after[s])
        next_best = min((after[s] for s in suspects if s != best), default=before)
        if after[best] > min(AGREED, GAIN * before, GAIN * next_best):
            self.wait = self.pause
            self.pause *= PATIENCE
            return None
        self.pause = 1
        lost = smoother.adopt(trials[best], best, window.prior, since)
        return self._pause(best, since, tuple(sorted({t.sensor for t in told} - {best})), lost)


def pause_notes(pauses: Iterable[Pause], start_ns: int) -> Iterator[str]:
    """Yield a sentence for each pause, in seconds since the start."""
    for p in pauses:
        begin = (p.begin_ns - start_ns) * 1e-9
        why = "it still surprises the estimate"
        if p.others:
            others = ", ".join(p.others[:-1])
            why = f"{others} and {p.others[-1]} agree without it"
        if p.until_ns is None:
            yield f"{p.sensor} is left out from {begin:.1f} s on: {why}"
        else:
            until = (p.until_ns - start_ns) * 1e-9
            yield f"{p.sensor} was not believed from {begin:.1f} to {until:.1f} s: {why}"


def _heard(tables: Iterable[FactorTable], since: int) -> set[str]:
    """Return who measured something from the window's keyframe `since` on."""
    return {t.sensor for t in tables if _measures(t) and t.first.size and t.first[-1] >= since}


def _measures(table: FactorTable) -> bool:
    """Return True for factors of a sensor or the wheels, not of priors and drifting zeros."""
    return table.kind not in HIDDEN and table.sensor != "start"


def _cost(tables: Sequence[FactorTable], linear: Sequence[Linearised], since: int) -> float:
    """Return the mean robust cost per residual component from keyframe `since` on."""
    cost, count = 0.0, 0
    for table, rows in zip(tables, linear, strict=True):
        if _measures(table):
            squared = rows.squared[table.first >= since]
            cost += float(np.sum(table.loss.cost(squared)))
            count += squared.size * table.dimension
    return cost / max(count, 1)
