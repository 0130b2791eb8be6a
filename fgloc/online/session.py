"""One replay of a drive: packets handed over in time, poses kept, the state saved now and then."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fgloc.core.drive import Drive
from fgloc.estimator import Live, Spread
from fgloc.online.checkpoint_folder import CheckpointFolder
from fgloc.online.engine import OnlineEngine, Start
from fgloc.online.layout import make_layout
from fgloc.online.pacing import Pace
from fgloc.online.replay import Packet, packets
from fgloc.online.settings import OnlineSettings
from fgloc.online.stopping import StopRequest
from fgloc.online.track import Track


def _silent(text: str) -> None:
    """Say nothing."""


@dataclass(frozen=True)
class ReplayOptions:
    """How a drive is replayed; nothing here changes a pose."""

    speed: float | None = None
    """Hand packets over when their time has come, so many times faster; None: at once."""
    folder: Path | None = None
    """Where the state is saved; None: nowhere."""
    every_s: float = 1.0
    """Seconds of the drive between two saves."""
    resume: bool = False
    """Go on from the folder's state; where there is none, begin at the beginning."""
    say: Callable[[str], None] = _silent
    """Told what a user should know while it happens."""


class Session:
    """Replays one drive."""

    def __init__(
        self, drive: Drive, start: Start | None, settings: OnlineSettings, options: ReplayOptions
    ) -> None:
        """Begin, or go on from a checkpoint; raises FglocError if that is not possible."""
        self.track = Track(
            drive.wheels.stamps_ns,
            make_layout(drive.robot, drive.sensors, drive.truth).parameters,
        )
        self.notes: list[str] = []
        self._drive = drive
        self._options = options
        self._folder = None
        self._updates: list[float] = []
        self._saves: list[float] = []
        self._late: Spread | None = None
        self._packets = 0
        if options.folder is not None:
            self._folder = CheckpointFolder(options.folder, drive)
        if self._folder is not None and options.resume and self._folder.used:
            self.engine, self._packets = self._folder.load(settings, self.track)
            self._resumed = self.track.count
            options.say(f"going on after {self._resumed} poses, from {options.folder}")
            return
        if self._folder is not None:
            if options.resume:
                options.say(f"no checkpoint in {options.folder}: beginning at the start")
            self._folder.clear()
        wheels = drive.wheels
        self.engine = OnlineEngine(
            drive.robot, drive.sensors, drive.truth, settings, wheels.resolution
        )
        self.engine.begin(int(wheels.stamps_ns[0]), start)
        self.track.emit(self.engine)
        self._resumed = 0
        self._save(finished=False)

    def run(self) -> None:
        """Hand over all packets that are left.

        On Ctrl-C or SIGTERM the state is saved, where there is a folder, before they act.
        """
        options = self._options
        pace = None
        saved_ns = self.engine.now_ns
        with StopRequest() as stop:
            for packet in packets(self._drive, self._packets):
                if options.speed is not None:
                    if pace is None:
                        pace = Pace(options.speed, packet.stamp_ns, options.say)
                    pace.wait(packet.stamp_ns, stop.asked)
                if stop.asked():
                    self._save(finished=False)
                    stop.obey()
                self._hand_over(packet)
                if self.engine.now_ns - saved_ns >= options.every_s * 1e9:
                    saved_ns = self.engine.now_ns
                    self._save(finished=False)
            self._save(finished=True)
        if pace is not None:
            self._late = Spread.of(pace.late_s)
            self.notes += pace.verdict()

    @property
    def live(self) -> Live:
        """Return how the engine kept up; only after `run`."""
        return Live(
            updates=self.engine.updates,
            update=Spread.of(self._updates),
            late=self._late,
            save=Spread.of(self._saves),
            resumed_poses=self._resumed,
        )

    def _hand_over(self, packet: Packet) -> None:
        """Give the engine one packet, and keep the pose that it emits after the wheels'."""
        engine = self.engine
        updates, begin = engine.updates, time.perf_counter()
        if packet.sensor:
            engine.reading(packet.sensor, packet.stamp_ns, packet.values, packet.extra)
        else:
            engine.wheels(packet.stamp_ns, packet.values, packet.extra)
        if engine.updates > updates:
            self._updates.append(time.perf_counter() - begin)
        if not packet.sensor:
            self.track.emit(engine)
        self._packets += 1

    def _save(self, finished: bool) -> None:
        """Save the state, where there is a folder."""
        if self._folder is None:
            return
        begin = time.perf_counter()
        self._folder.save(self.engine, self.track, self._packets, finished)
        self._saves.append(time.perf_counter() - begin)
